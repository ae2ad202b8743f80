"""Build cells and jobs from a config and its plugins. Opens no device."""

from __future__ import annotations

import asyncio
import logging
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from itertools import chain, count
from pathlib import Path
from typing import Any, cast

from polishd import __version__
from polishd.config.cell import PORTS, CellConfig, device_options, notifier_options
from polishd.config.cell_sections import ForceSensorSection, RobotSection
from polishd.daemon.cell.cell import Cell, MonotonicClock, Signals
from polishd.daemon.cell.device_polling import missing_members
from polishd.daemon.cell.time_limits import ActionTimeLimit, stays_on, too_short
from polishd.daemon.contact.safety import ContactLimits
from polishd.daemon.contact.stall_removal import require_stall_depth
from polishd.daemon.job.job import Job
from polishd.daemon.job.resume_checks import require_same, terms_of
from polishd.daemon.job.tool_sequence import ToolSequence, ToolStepState
from polishd.daemon.journal.journal import Journal
from polishd.daemon.notifications.sender import Notifier
from polishd.daemon.queue.queue import Queue, QueueEntry
from polishd.daemon.queue.requests import require_unchanged
from polishd.daemon.runtime.compute import Compute
from polishd.hookspecs import DeviceContext
from polishd.interfaces import Device, ForceActuator, Monitor
from polishd.model.devices import port_of
from polishd.model.errors import ConfigError, PluginError, PolishdError
from polishd.model.estimates import Finding
from polishd.model.events import Event
from polishd.model.program import Program
from polishd.model.states import Severity
from polishd.pipeline.acceptance import require_acceptable
from polishd.pipeline.build_recipe import instrument_of, make_recipes, require_commissioned
from polishd.pipeline.precheck import read_programs, require_fit
from polishd.pipeline.recipe import Recipe
from polishd.pipeline.run_folder import RunFolder
from polishd.plugin_loader import Hooks, hooks_of_job
from polishd.util.address_claims import KeptClaims


def build_cell(config: CellConfig, hooks: Hooks) -> Cell:
    """Build the devices that the config names, not yet open; each has all members of its port.

    Raises:
        ConfigError: a section is wrong; names file, line and key.
        PluginError: a plugin raises another error, or its device lacks a member of the port.
    """
    context = _context(config, hooks)
    devices = {name: _built(config, hooks, name, context) for name in config.devices}
    claims = KeptClaims(config.cell.name)
    return Cell(devices, config.used, MonotonicClock(), signals=_signals(config, devices), claims=claims)


def _signals(config: CellConfig, devices: Mapping[str, Device]) -> Signals:
    monitors = {name: cast(Monitor, device) for name, device in devices.items() if port_of(name) == "monitor"}
    limits = [section.limits(name) for name, section in config.signals.items()]
    return Signals(limits, {name: device.times.silence_s for name, device in monitors.items()})


async def bind_part_to_devices(cell: Cell, config: CellConfig, hooks: Hooks) -> None:
    """Build the devices that depend on the part anew, for part and instrument of that config's job.

    They are opened if the cell is open. Errors as of ``build_cell``, and DeviceError if a device does not answer.
    """
    context = await asyncio.to_thread(_context, config, hooks)
    for name in [name for name in cell.devices if PORTS[port_of(name)].of_part]:
        await cell.exchange(name, _built(config, hooks, name, context))


def _context(config: CellConfig, hooks: Hooks) -> DeviceContext:
    return DeviceContext(
        base_dir=config.base_dir,
        state_dir=config.state_dir,
        part_id=config.part.id,
        readers=tuple(hooks.surface_readers().values()),
        instrument=instrument_of(config),
    )


def build_notifiers(config: CellConfig, hooks: Hooks) -> list[Notifier]:
    """Build the notifiers of the config, ready to send; nothing is sent. Raises as ``build_cell``."""
    found = []
    for name, section in config.notify.items():
        kind, options = notifier_options(config, name, hooks.notifiers())
        who = f"plugin {hooks.plugin_of('polishd_notifiers', kind.name)!r}, notifier type {kind.name!r}"
        with _blaming(config, f"notify.{name}", options, who):
            send = kind.build(options, config.base_dir)
            if not callable(send):
                raise TypeError(f"{type(send).__name__} cannot be called")
        found.append(Notifier(name, section.type, Severity(section.severity), section.remind_after_s, send))
    return found


def _built(config: CellConfig, hooks: Hooks, name: str, context: DeviceContext) -> Device:
    kind, options = device_options(config, name, hooks.device_types())
    who = f"plugin {hooks.plugin_of('polishd_device_types', kind.name)!r}, device type {kind.name!r}"
    with _blaming(config, name, options, who):
        device = kind.build(options, context)
    port = PORTS[port_of(name)].protocol
    if lacks := missing_members(device, port):
        raise _broken(config, name, who, f"{type(device).__name__} is not a {port.__name__}: {'; '.join(lacks)}")
    return device


@contextmanager
def _blaming(config: CellConfig, section: str, options: Any, who: str) -> Iterator[None]:
    """Convert an error of a plugin that builds from a section: ConfigError with its key, or PluginError."""
    try:
        yield
    except ConfigError as error:
        raise config.error(_blamed(section, options, str(error)), str(error)) from error
    except PolishdError:
        raise
    except Exception as error:  # a plugin may raise anything
        reason = " ".join(f"{type(error).__name__}: {error}".split())
        raise _broken(config, section, who, f"cannot be built: {reason}") from error


def _blamed(section: str, options: Any, problem: str) -> str:
    """Return the key whose value the problem quotes, or the section."""
    quoted = (key for key, value in options if isinstance(value, str) and repr(value) in problem)
    return ".".join([section, *list(quoted)[:1]])


def _broken(config: CellConfig, section: str, who: str, what: str) -> PluginError:
    problem = f"{who}: {what}. Correct the plugin; nothing was opened"
    return PluginError(str(config.error(f"{section}.type", problem)))


def require_time_limits(config: CellConfig, cell: Cell) -> tuple[ActionTimeLimit, ...]:
    """Return the job's chain of time limits; ConfigError with each limit that is too short."""
    graces: dict[str, float] = {}
    if cell.force_sensor is not None:
        contact = contact_limits(config)
        graces = {"apart_s": contact.apart_s, "force_s": contact.alarm_delay_s}
    limits = cell.limits.chain(config.job.stream_ahead_s, **graces)
    chain = tuple(replace(limit, key=_of_role(cell, limit.key)) for limit in limits)
    tools = {name: cast(ForceActuator, cell.devices[name]).times for name in cell.at("actuator")}
    unpowered = [
        (f"{name}.unpowered", why) for name, tool in tools.items() if (why := stays_on(tool, cell.robot.times))
    ]
    if found := [str(config.error(key, problem)) for key, problem in (*too_short(chain), *unpowered)]:
        raise ConfigError("\n".join(found))
    return chain


def require_accepted_by_robot(config: CellConfig, hooks: Hooks, program: Program) -> None:
    """Raise ConfigError if the job's robot cannot run such a program, by the check of its device type.

    Also if the lines that its driver adds have another meaning in the program's format.
    """
    name = config.used["robot"]
    kind, options = device_options(config, name, hooks.device_types())
    if kind.takes is not None and (why := kind.takes(program.blocks)):
        raise config.error("program.format", f"{program.name}: {name} ({kind.name}) does not take it: {why}")
    if kind.own_lines is None:
        return
    misreads = hooks.program_formats()[config.program.format].misreads
    lines = kind.own_lines(options, _context(config, hooks))
    wrong = misreads(lines) if misreads is not None and not lines.format else ""
    if lines.format not in ("", config.program.format):
        wrong = f"they are lines of {lines.format!r}"
    if wrong:
        raise config.error(
            "program.format",
            f"{config.program.format!r} does not go with {lines.source}: {name} ({kind.name}) adds lines to the "
            f"program, and {wrong}. Set the format in which the controller reads programs, or name a controller "
            "profile whose [program] pause, dwell and end are written in this one",
        )


def _of_role(cell: Cell, key: str) -> str:
    """Replace the port in a key, as in ``robot.stop_s``, by the name of the job's device."""
    port = port_of(key)
    return key.replace(port, cell.used.get(port, port), 1)


def contact_limits(config: CellConfig) -> ContactLimits:
    """Return the limits in contact."""
    sensor = config.devices.get(config.used.get("force_sensor", ""))
    robot = config.devices[config.used["robot"]]
    apart = (
        (sensor.max_difference_n, sensor.alarm_delay_s) if isinstance(sensor, ForceSensorSection) else (math.inf, 0.0)
    )
    return ContactLimits(
        force_n=config.process.force_n,
        rpm=config.process.rpm,
        force_band=config.limits.force_band,
        alarm_delay_s=config.limits.force_alarm_delay_s,
        force_max_n=config.process.most_force_n,
        apart_n=apart[0],
        apart_s=apart[1],
        least_override=robot.least_override if isinstance(robot, RobotSection) else 0.0,
        no_progress_s=robot.no_progress_s if isinstance(robot, RobotSection) else None,
        excess_nm=config.limits.excess_nm,
    )


# From a recipe to a job with its run folder.

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class NoJob:
    """State of a daemon between jobs: the journal of its cell."""

    journal: Journal
    findings: tuple[Finding, ...] = ()

    def names(self) -> dict[str, str]:
        """Return empty names of job and part."""
        return {"job": "", "part": ""}

    def cycles(self) -> list[dict[str, Any]]:
        """Return no cycles."""
        return []

    def summary(self) -> dict[str, Any]:
        """Return an empty summary."""
        return {"cycles": []}


def read_recipes(config: CellConfig, hooks: Hooks) -> tuple[Recipe, ...]:
    """Return the recipe of each tool in polishing order; ConfigError for several tools without [touch_off]."""
    if config.tools and config.touch_off is None:
        raise config.error(
            "tools",
            "several tools need [touch_off], which detects a wrong tool by its contact position. Add [touch_off]",
        )
    return make_recipes(config, hooks)


def turns_of(
    config: CellConfig, recipes: Sequence[Recipe], programs: Sequence[Sequence[Program]]
) -> tuple[ToolStepState, ...]:
    """Return the step of each tool; with several tools it reads the files that their keys name."""
    return tuple(
        ToolStepState(
            recipe,
            tuple(each),
            contact_limits(own),
            terms_of(own, *(program.sha256 for program in each)) if config.tools else None,
        )
        for own, recipe, each in zip(config.turns, recipes, programs, strict=True)
    )


def make_job(
    config: CellConfig,
    hooks: Hooks,
    recipes: Sequence[Recipe],
    programs: Sequence[Sequence[Program]],
    *,
    journal: Journal,
    folder: RunFolder,
    compute: Compute,
    publish: Callable[[Event], None],
) -> Job:
    """Make the job of that config; ``Job.load`` then restores the state of an earlier run.

    ``programs``: of each tool, in the order in which they take turns.
    """
    return Job(
        ToolSequence(turns_of(config, recipes, programs), journal),
        journal=journal,
        folder=folder,
        compute=compute,
        publish=publish,
        check_plan=hooks.check_plan,
        max_cycles=config.job.max_cycles,
        stream_ahead_s=config.job.stream_ahead_s,
    )


def figures(job: Job | NoJob) -> dict[str, Any]:
    """Return the measurements and passes for a summary; empty if the journal is lost."""
    try:
        found = job.summary()
    except PolishdError as lost:
        log.error("the journal cannot be read: %s", lost)
        return {"cycles": []}
    for cycle in found["cycles"]:
        if cycle["how"] == "begun":
            cycle["how"] = "interrupted"  # the pass has ended; the next start closes it in the journal
    return {**found, "version": __version__}


def run_folder(config: CellConfig, journal: Journal, job_text: str | None = None) -> RunFolder:
    """Return the folder of the job that goes on, or a new one; a job of the queue gets a copy of its file."""
    if journal.begun and journal.run_dir:
        path = config.resolve(journal.run_dir)
    else:
        several = config.state_dir / "runs" if config.run_dir is None or job_text is None else config.run_dir
        path = config.run_dir if config.run_dir and job_text is None else _new_folder(several, config.job.id)
        journal.record_run_dir(path)
    folder = RunFolder(path)
    try:
        folder.bytes("cell.toml", config.path.read_bytes())
        if job_text is not None:
            folder.bytes("job.toml", job_text.encode())
        if config.profile_path is not None:
            folder.bytes("instrument.toml", config.profile_path.read_bytes())
    except OSError as error:
        why = f"{folder.path}: the run folder cannot be written: {error.strerror}"
        if not journal.begun:
            raise ConfigError(f"{why}. Correct its permissions or name another folder") from error
        log.error("%s; the job goes on without it", why)
    return folder


def _new_folder(among: Path, job: str) -> Path:
    """Return a new folder named by job and time, which differs from all existing ones."""
    path = among / f"{job}-{datetime.now(UTC):%Y%m%dT%H%M%S}"
    others = (path.with_name(f"{path.name}-{number}") for number in count(2))
    return next(one for one in chain([path], others) if not one.exists())


# From an entry of the queue to a job on a cell that may be open.


@dataclass(frozen=True, slots=True)
class JobMaker:
    """Makes the jobs of one cell. Its devices stay, except those that depend on the part."""

    config: CellConfig
    hooks: Hooks
    cell: Cell
    compute: Compute

    async def __call__(
        self, entry: QueueEntry, queue: Queue, journal: Journal, publish: Callable[[Event], None]
    ) -> tuple[Job, RunFolder]:
        """Make the job and journal it as under way; restore the state of an earlier run that began it.

        PolishdError if anything in it is wrong; nothing has moved then. Numerical work runs in the compute worker and
        files are read in threads, because other cells of this process may be in contact.
        """
        lay = require_unchanged if entry.begun_s is None else _laid_over
        config = await asyncio.to_thread(lay, self.config, entry)
        hooks = await asyncio.to_thread(hooks_of_job, self.config, self.hooks, config)
        recipes = await asyncio.to_thread(read_recipes, config, hooks)
        require_commissioned(config, recipes[0].instrument)
        require_acceptable(recipes[0])
        programs = []
        for tool, recipe in zip(config.turns, recipes, strict=True):
            programs.append(await self.compute(read_programs, tool, recipe))
            for program in programs[-1]:
                await self.compute(require_fit, tool, recipe, program)
            require_stall_depth(tool, self.cell, recipe)
        require_time_limits(config, self.cell)
        terms = await asyncio.to_thread(terms_of, config, *(one.sha256 for one in programs[0]))
        queue.require_held(entry)  # otherwise the shop could assign this job to another cell
        own = journal.of_job(entry.name, entry.part_id, terms, queue.begin_row(entry))
        require_same(config, terms, own)
        queue.begin(entry, own.number)
        await bind_part_to_devices(self.cell, config, hooks)
        folder = run_folder(config, own, entry.content)
        job = make_job(
            config, hooks, recipes, programs, journal=own, folder=folder, compute=self.compute, publish=publish
        )
        await job.load()
        return job, folder


def _laid_over(cell: CellConfig, entry: QueueEntry) -> CellConfig:
    """Return the config of a job under way; ``require_same`` checks what may have changed since."""
    return entry.file.laid_over(cell)
