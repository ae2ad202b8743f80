"""What a plugin must be before it is used. Each check gives the reason to refuse it, or None."""

from __future__ import annotations

import inspect
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from polishd import hookspecs
from polishd.config.cell import PORTS
from polishd.config.places import did_you_mean, join_words
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

HOOKS = frozenset(name for name in vars(hookspecs) if name.startswith(f"{PROJECT}_"))
DECLARATIONS: dict[str, type[Any]] = {
    "polishd_device_types": DeviceType,
    "polishd_program_formats": ProgramFormat,
    "polishd_surface_readers": SurfaceReader,
    "polishd_removal_models": RemovalModel,
    "polishd_dwell_solvers": DwellSolver,
    "polishd_notifiers": NotifierType,
}
"""Hooks that declare records, and the kind of record."""


@dataclass(frozen=True, slots=True)
class RefusedPlugin:
    """A plugin that was not loaded, and why."""

    name: str
    reason: str

    def __str__(self) -> str:
        """For people."""
        return f"plugin {self.name!r} refused: {self.reason}"


def wrong_version(plugin: Any) -> str | None:
    """The plugin must say for which API it was written."""
    said = getattr(plugin, "POLISHD_API", None)
    if said is None:
        return f"it does not say which API it was written for; add POLISHD_API = {API_VERSION}"
    if said != API_VERSION or isinstance(said, bool):
        return f"it was written for API {said!r}, this polishd has API {API_VERSION}; install a version that fits"
    return None


def misspelt_hooks(plugin: Any) -> str | None:
    """Anything named like a hook must be one, and be marked as one."""
    for name in dir(plugin):
        member = inspect.getattr_static(plugin, name)
        function = inspect.unwrap(member) if callable(member) else getattr(member, "__func__", None)
        marked = hasattr(function, f"{PROJECT}_impl")
        if name not in HOOKS and (marked or (name.startswith(f"{PROJECT}_") and inspect.isfunction(function))):
            return f"{name} is no hook{did_you_mean(name, HOOKS)} Hooks: {join_words(HOOKS)}"
        if name in HOOKS and not marked:
            return f"{name} is not marked; put @hookimpl from polishd.api before it"
    return None


def wrong_records(hook: str, records: Any) -> str | None:
    """What a declaring hook returned must be a sequence of its record, each name once."""
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
