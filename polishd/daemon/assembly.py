"""Build a cell from a config and its plugins. Opens no device."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from typing import Any, cast

from polishd.config.cell import PORTS, CellConfig, device_options, notifier_options
from polishd.config.cell_sections import ForceSensorSection, RobotSection
from polishd.daemon.cell.cell import Cell, MonotonicClock, Signals
from polishd.daemon.cell.device_polling import missing_members
from polishd.daemon.cell.time_limits import ActionTimeLimit, stays_on, too_short
from polishd.daemon.contact.safety import ContactLimits
from polishd.daemon.notifications.sender import Notifier
from polishd.hookspecs import DeviceContext, DeviceType
from polishd.interfaces import Device, ForceActuator, Monitor
from polishd.model.devices import port_of
from polishd.model.errors import ConfigError, PluginError, PolishdError
from polishd.model.program import Program
from polishd.model.states import Severity
from polishd.pipeline.build_recipe import instrument_of
from polishd.plugin_loader import Hooks
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


DATA_FILE_STAYS = (
    "the driver delivers the program without the file beside it. Have it posted with its positions and speeds, and "
    "move that file to another folder."
)
"""Why a robot takes no program with ``beside``, where its driver does not deliver it."""


def require_accepted_by_robot(config: CellConfig, hooks: Hooks, program: Program) -> None:
    """Raise ConfigError if the job's robot cannot run such a program, by the check of its device type.

    Also if the lines that its driver adds have another meaning in the program's format.
    """
    name = config.used["robot"]
    kind, options = device_options(config, name, hooks.device_types())
    if why := _refusal(kind, program):
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


def _refusal(kind: DeviceType, program: Program) -> str:
    """Return why a robot of that type cannot run the program; empty if it can."""
    if kind.takes_with_data_file is not None:
        return kind.takes_with_data_file(program.blocks, program.beside)
    if program.beside:
        return DATA_FILE_STAYS
    return "" if kind.takes is None else kind.takes(program.blocks)


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
