"""Plugins: found by entry point, checked one by one, refused by name, and isolated from each other in calls."""

from __future__ import annotations

import importlib.metadata
import inspect
import logging
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

import pluggy

from polishd import hookspecs
from polishd.config.cell import PORTS, CellConfig, load_config
from polishd.config.toml_loader import did_you_mean, join_words
from polishd.hookspecs import (
    API_VERSION,
    PROJECT,
    DeviceType,
    DwellSolver,
    NotifierType,
    ProgramFormat,
    RemovalModel,
    SurfaceReader,
)
from polishd.model.errors import PluginError
from polishd.model.events import Event
from polishd.model.program import Envelope, Plan

# Checks of a plugin before its use. Each returns the reason to refuse it, or None.

HOOKS = frozenset(name for name in vars(hookspecs) if name.startswith(f"{PROJECT}_"))
DECLARATIONS: dict[str, type[Any]] = {
    "polishd_device_types": DeviceType,
    "polishd_program_formats": ProgramFormat,
    "polishd_surface_readers": SurfaceReader,
    "polishd_removal_models": RemovalModel,
    "polishd_dwell_solvers": DwellSolver,
    "polishd_notifiers": NotifierType,
}
"""Hooks that declare records, with the class of the records."""


@dataclass(frozen=True, slots=True)
class RefusedPlugin:
    """A plugin that was not loaded, with the reason."""

    name: str
    reason: str

    def __str__(self) -> str:
        """Return the message."""
        return f"plugin {self.name!r} refused: {self.reason}"


def wrong_version(plugin: Any) -> str | None:
    """Check that the plugin states its API version."""
    version = getattr(plugin, "POLISHD_API", None)
    if version is None:
        return f"it does not state its API version. Add POLISHD_API = {API_VERSION}."
    if version != API_VERSION or isinstance(version, bool):
        return f"it was written for API {version!r}, this polishd has API {API_VERSION}. Install a matching version."
    return None


def misspelt_hooks(plugin: Any) -> str | None:
    """Check that each name of a hook exists and is marked."""
    for name in dir(plugin):
        member = inspect.getattr_static(plugin, name)
        function = inspect.unwrap(member) if callable(member) else getattr(member, "__func__", None)
        marked = hasattr(function, f"{PROJECT}_impl")
        if name not in HOOKS and (marked or (name.startswith(f"{PROJECT}_") and inspect.isfunction(function))):
            return f"{name} is not a hook{did_you_mean(name, HOOKS)} Hooks: {join_words(HOOKS)}"
        if name in HOOKS and not marked:
            return f"{name} is not marked. Put @hookimpl from polishd.api before it."
    return None


def wrong_records(hook: str, records: Any) -> str | None:
    """Check that a declaring hook returned a sequence of its record, each name once."""
    kind = DECLARATIONS[hook]
    if not isinstance(records, Sequence) or isinstance(records, str):
        return f"{hook} must return a list of {kind.__name__}, not {type(records).__name__}"
    for record in records:
        if not isinstance(record, kind):
            return f"{hook} must return {kind.__name__}, not {type(record).__name__}"
        if not isinstance(record.name, str) or not record.name:
            return f"{hook}: {kind.__name__}.name must be a word, not {record.name!r}"
        if isinstance(record, DeviceType | NotifierType) and (reason := _wrong_type(record)):
            kind_name = "device" if isinstance(record, DeviceType) else "notifier"
            return f"{hook}: {kind_name} type {record.name!r}: {reason}"
    names = [record.name for record in records]
    twice = {name for name in names if names.count(name) > 1}
    return f"{hook} declares {join_words(twice)} twice" if twice else None


def _wrong_type(record: DeviceType | NotifierType) -> str | None:
    if isinstance(record, DeviceType) and record.port not in PORTS:
        return f"port {record.port!r} does not exist; ports: {join_words(PORTS)}"
    if not hasattr(record.options, "model_validate"):
        return "options must be a pydantic model"
    return None


log = logging.getLogger(__name__)

GROUP = "polishd"
OWN = "polishd"
RENAMED = {
    "plan_guard": "plan_checks",
    **dict.fromkeys(
        ("spindle", "cia402", "device_profiles", "loader", "force_sensor", "monitors", "universal_robots", "handover"),
        "devices",
    ),
}
"""Old names of plugins: a cell file with one is refused with the new name."""
SLOW_S = 0.25
"""Time for an event after which the log names the plugin."""


@dataclass(frozen=True, slots=True)
class LoadedPlugin:
    """A plugin in use, with a separate plugin manager, so that a call reaches only this plugin."""

    name: str
    distribution: str
    version: str
    records: Mapping[str, tuple[Any, ...]]
    """Records by declaring hook."""
    manager: pluggy.PluginManager

    def implements(self, hook: str) -> bool:
        """Whether the plugin implements that hook."""
        return bool(getattr(self.manager.hook, hook).get_hookimpls())


@dataclass(frozen=True, slots=True)
class PluginReport:
    """Loaded plugins, and refused ones with their reasons."""

    loaded: tuple[LoadedPlugin, ...]
    refused: tuple[RefusedPlugin, ...]

    def require(self) -> None:
        """Raise PluginError with each refused plugin: a cell does not run without a part of its config."""
        if self.refused:
            raise PluginError("\n".join(map(str, self.refused)))


class Hooks:
    """Typed calls of all hooks over the loaded plugins."""

    def __init__(self, report: PluginReport) -> None:
        self.report = report

    def device_types(self) -> dict[str, DeviceType]:
        """By name."""
        return self._records("polishd_device_types")

    def plugin_of(self, hook: str, name: str) -> str:
        """Return the plugin that declared the record of that name."""
        return next(plugin.name for plugin in self.report.loaded if name in _names(plugin.records[hook]))

    def substitute(self, port: str) -> DeviceType | None:
        """Return the type whose simulated device can replace any device of a port."""
        types = self.device_types().values()
        return next((one for one in types if one.port == port and one.substitute is not None), None)

    def program_formats(self) -> dict[str, ProgramFormat]:
        """By name."""
        return self._records("polishd_program_formats")

    def surface_readers(self) -> dict[str, SurfaceReader]:
        """Surface readers by name, in the order in which they are tried: as in the config, with polishd's last.

        Some of polishd's readers accept any text, so that other readers must come first.
        """
        others_first = sorted(self.report.loaded, key=lambda plugin: plugin.distribution == OWN)
        return {record.name: record for plugin in others_first for record in plugin.records["polishd_surface_readers"]}

    def removal_models(self) -> dict[str, RemovalModel]:
        """By name."""
        return self._records("polishd_removal_models")

    def dwell_solvers(self) -> dict[str, DwellSolver]:
        """By name."""
        return self._records("polishd_dwell_solvers")

    def notifiers(self) -> dict[str, NotifierType]:
        """By name."""
        return self._records("polishd_notifiers")

    def check_plan(self, plan: Plan, envelope: Envelope) -> list[str]:
        """Return all violations, each with its plugin's name; an exception or a wrong result is a violation."""
        found = []
        for plugin in self._with("polishd_check_plan"):
            try:
                answers = plugin.manager.hook.polishd_check_plan(plan=plan, envelope=envelope)
            except Exception as error:
                log.exception("plugin %s failed to check a plan", plugin.name)
                found.append(f"{plugin.name}: raised {type(error).__name__}: {error}")
            else:
                found += [f"{plugin.name}: {violation}" for violation in _violations(answers)]
        return found

    def on_event(self, event: Event) -> None:
        """Pass the event to each plugin; exceptions are logged."""
        for plugin in self._with("polishd_on_event"):
            begun = time.monotonic()
            try:
                plugin.manager.hook.polishd_on_event(event=event)
            except Exception:
                log.exception("plugin %s failed on event %s", plugin.name, event.name)
            if (took := time.monotonic() - begun) > SLOW_S:
                log.info("plugin %s took %.1f s for event %s", plugin.name, took, event.name)

    def cli(self, app: Any) -> None:
        """Let each plugin add commands; exceptions are logged."""
        for plugin in self._with("polishd_cli"):
            try:
                plugin.manager.hook.polishd_cli(app=app)
            except Exception:
                log.exception("plugin %s failed to add its commands", plugin.name)

    def _records(self, hook: str) -> dict[str, Any]:
        return {record.name: record for plugin in self.report.loaded for record in plugin.records[hook]}

    def _with(self, hook: str) -> list[LoadedPlugin]:
        return [plugin for plugin in self.report.loaded if plugin.implements(hook)]


def _names(records: Iterable[Any]) -> set[str]:
    return {record.name for record in records}


def load_plugins(names: Iterable[str], profiles: Sequence[Path] = ()) -> Hooks:
    """Load the named plugins, in that order. Refused ones are in ``report.refused``; the others are loaded.

    ``profiles`` are the user's program dialects.
    """
    return _load(list(names), list(importlib.metadata.entry_points(group=GROUP)), profiles)


def load_own() -> Hooks:
    """Load only the plugins of polishd's distribution, for commands without CELL."""
    own = [point for point in importlib.metadata.entry_points(group=GROUP) if _distribution(point) == OWN]
    return _load([point.name for point in own], own)


def installed() -> dict[str, list[str]]:
    """Return the names of all installed plugins, loaded or not, with the distributions that register them."""
    found: dict[str, list[str]] = {}
    for point in importlib.metadata.entry_points(group=GROUP):
        found.setdefault(point.name, []).append(_distribution(point))
    return found


def _load(names: Sequence[str], points: Sequence[EntryPoint], profiles: Sequence[Path] = ()) -> Hooks:
    loaded: list[LoadedPlugin] = []
    refused: list[RefusedPlugin] = []
    for name in names:
        found = _load_one(name, [point for point in points if point.name == name], points, profiles)
        if isinstance(found, LoadedPlugin):
            reason = _taken(found, loaded)
            found = RefusedPlugin(name, reason) if reason else found
        if isinstance(found, LoadedPlugin):
            loaded.append(found)
        else:
            refused.append(found)
            log.error("%s", found)
    return Hooks(PluginReport(tuple(loaded), tuple(refused)))


def _load_one(
    name: str, candidates: Sequence[EntryPoint], points: Sequence[EntryPoint], profiles: Sequence[Path]
) -> LoadedPlugin | RefusedPlugin:
    if not candidates and name in RENAMED:
        return RefusedPlugin(name, f"it is now {RENAMED[name]!r}. Write {RENAMED[name]!r} in plugins.load, once.")
    if not candidates:
        known = {point.name for point in points}
        return RefusedPlugin(name, f"it is not installed{did_you_mean(name, known)} Installed: {join_words(known)}")
    if len(candidates) > 1:
        owners = join_words(map(_distribution, candidates))
        return RefusedPlugin(name, f"more than one distribution registers that name ({owners}). Uninstall all but one.")
    (point,) = candidates
    try:
        plugin = point.load()
        reason = wrong_version(plugin) or misspelt_hooks(plugin)
        if reason:
            return RefusedPlugin(name, reason)
        manager = _manager(name, plugin)
        records = {hook: _declared(manager, hook, profiles) for hook in DECLARATIONS}
    except (Exception, SystemExit) as error:
        log.debug("plugin %s", name, exc_info=True)
        return RefusedPlugin(name, f"{_distribution(point)}, {point.value}: {type(error).__name__}: {error}")
    return LoadedPlugin(name, _distribution(point), point.dist.version if point.dist else "", records, manager)


def _manager(name: str, plugin: Any) -> pluggy.PluginManager:
    manager = pluggy.PluginManager(PROJECT)
    manager.add_hookspecs(hookspecs)
    manager.register(plugin, name)
    manager.check_pending()
    return manager


def _declared(manager: pluggy.PluginManager, hook: str, profiles: Sequence[Path]) -> tuple[Any, ...]:
    found: list[Any] = []
    caller = getattr(manager.hook, hook)
    answers = caller(profiles=profiles) if hook == "polishd_program_formats" else caller()
    if len(answers) < len(caller.get_hookimpls()):
        raise PluginError(f"{hook} returned None. Return a list.")
    for answer in answers:
        if reason := wrong_records(hook, answer):
            raise PluginError(reason)
        found += answer
    return tuple(found)


def _taken(plugin: LoadedPlugin, others: Sequence[LoadedPlugin]) -> str | None:
    """Return the reason to refuse a plugin that declares a name of an earlier one, or None."""
    for hook, records in plugin.records.items():
        for other in others:
            both = _names(records) & _names(other.records[hook])
            if both:
                return f"{hook}: plugin {other.name!r} already has {join_words(both)}. Load only one of the two."
    return None


def _violations(answers: Sequence[Any]) -> list[str]:
    if not answers:
        return ["returned None instead of a list of violations"]
    found: list[str] = []
    for answer in answers:
        if isinstance(answer, str):
            found.append(answer)
        elif isinstance(answer, Sequence) and all(isinstance(violation, str) for violation in answer):
            found += answer
        else:
            found.append(f"returned {type(answer).__name__} instead of a list of violations")
    return found


def _distribution(point: EntryPoint) -> str:
    return point.dist.name if point.dist else "unknown"


# A cell file with the plugins that it names.


def plugins_of(config: CellConfig) -> Hooks:
    """Load the plugins that a config names; refused ones are in the report."""
    return load_plugins(config.plugins.load, config.dialect_paths)


def load_cell(cell: Path, correction: str | None = None) -> tuple[CellConfig, Hooks]:
    """Load config and plugins; ConfigError or PluginError if anything that the config names is missing or invalid."""
    config = load_config(cell, {"process.correction": correction} if correction else None)
    hooks = plugins_of(config)
    hooks.report.require()
    return config, hooks


def hooks_of_job(cell: CellConfig, hooks: Hooks, job: CellConfig) -> Hooks:
    """Return the cell's plugins for a job's config, reloaded if the job names other dialects."""
    if job.dialect_paths == cell.dialect_paths:
        return hooks
    found = plugins_of(job)
    found.report.require()
    return found
