"""Values that the simulator reads from a cell's file: part, tool, robot, and the link of each device."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, urlsplit

from polishd.config.cell import CellConfig
from polishd.config.cell_sections import BoundsSection, SignalSection
from polishd.config.controller_profile import load_controller_profile
from polishd.config.device_profile import DeviceProfile
from polishd.config.device_profile_checks import DEVICE_PROFILE_DIR, profile_of
from polishd.config.fields import OUTLINES, OpticKeys, as_keys
from polishd.config.instrument_profile import ProfileFile
from polishd.config.process_sections import ContactKeys
from polishd.config.toml_loader import Location, load_toml
from polishd.model.devices import LoaderTimes, SensorTimes, SpindleTimes, port_of
from polishd.model.errors import ConfigError

PART = ("edge_mm", "origin_mm", "rotation_rpy_deg", *OpticKeys.__annotations__)
TOOL = tuple(name for name in ContactKeys.__annotations__ if name != "preston")
MACHINE = ("corner_deg", "max_feed_mm_s", "x_mm", "y_mm", "z_mm")
MORE_ACCEL = 1.25
"""True acceleration of the robot over `machine.accel_mm_s2`, which is on the safe side."""
FINEST_MM, COARSEST_MM = 0.2, 1.0
"""Range of the pitch of simulated maps that is computed in acceptable time."""
USUAL_ARTEFACT_MM = 100.0
LANDS_S, LIFTS_S, SPINS_S, USUAL_RPM = 2.0, 4.0, 3.0, 3000
LOADS_S, UNLOADS_S, FILTER_S, RANGE_N = 30.0, 20.0, 0.03, 60.0
DRIVE_TIME_SHARE = 0.8
"""Share of the longest time that the cell allows that a simulated device takes if it is slower."""
LOADER_TIME_SHARE = 0.4
"""Share of the longest change that loading, or unloading, takes if the simulated loader is slower."""
NO_WATCHDOG_S = 600.0
"""Watchdog of a simulated controller if the real one has none."""
SIGNAL_MARGIN = 0.1
"""How far a signal is inside a bound, relative to it."""


@dataclass(slots=True)
class CellValues:
    """Values of the sections of sim.toml that come from the cell."""

    cell: CellConfig
    folder: Path
    """Of sim.toml: paths start there."""
    given: Mapping[str, Any]
    """Values of sim.toml, which replace those of the cell."""
    sections: dict[str, dict[str, Any]] = field(default_factory=dict)
    locations: list[tuple[Location, Location]] = field(default_factory=list)
    """Each key with the key of the cell that it comes from."""
    not_simulated: dict[str, ConfigError] = field(default_factory=dict)
    """By section, why the cell's device cannot be simulated."""

    def put(self, section: str, key: str, value: Any, source: str, *, inner: tuple[str, ...] = ()) -> None:
        """Put a value other than None into a section or its table ``inner``; ``source`` is the cell's dotted key."""
        if value is not None:
            table = self.sections.setdefault(section, {})
            for name in inner:
                table = table.setdefault(name, {})
            table[key] = value
            self.locations.append(((section, *inner, key), tuple(source.split("."))))

    def take(self, section: str, keys: tuple[str, ...], source: str) -> None:
        """Put the values of the cell's section ``source`` with the same names."""
        for key in keys:
            self.put(section, key, getattr(getattr(self.cell, source), key), f"{source}.{key}")

    def given_keys(self, section: str) -> Mapping[str, Any]:
        """Return the keys of a section of sim.toml."""
        found = self.given.get(section, {})
        return found if isinstance(found, Mapping) else {}

    def path(self, file: Path) -> str:
        """Return a file's path relative to sim.toml."""
        return Path(os.path.relpath(file.absolute(), self.folder.absolute())).as_posix()

    def options(self, device: str) -> dict[str, Any]:
        """Return a device's keys as written in the cell's file."""
        return dict(self.cell.devices[device].model_extra or {})

    def number(self, device: str, key: str, usual: float) -> float:
        """Return a number of a device's section; raise ConfigError if it is not a number."""
        value = self.options(device).get(key, usual)
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise self.cell.error(f"{device}.{key}", f"must be a number, not {value!r}. Correct it.")
        return float(value)


def add_physics(values: CellValues) -> None:
    """Add part, tool, robot and instrument: the values of a plant without links."""
    _add_part(values)
    _add_process(values)
    _add_kinematics(values)
    _add_machine(values)
    _add_instrument(values)


def _add_part(values: CellValues) -> None:
    cell = values.cell
    values.put("plant", "part_id", cell.part.id, "part.id")
    if not any(key in values.given_keys("plant") for key in (*OUTLINES, "hole_mm")):
        for key, value in as_keys(cell.outline()).items():
            values.put("plant", key, value, f"part.{cell.part.outline_key}")
    values.take("plant", PART, "part")
    for key in ("offset_mm", "rotation_deg"):
        values.put("plant", f"program_{key}", getattr(cell.program, key), f"program.{key}")


def _add_process(values: CellValues) -> None:
    process = values.cell.process
    values.take("process", TOOL, "process")
    values.put("process", "preston", f"{process.preston!r} cm2/N", "process.preston")
    values.put("process", "projection", values.cell.compliance.projection, "compliance.projection")
    if process.removal_model == "measured_tif" and process.tif is not None:
        values.put("process", "tif", values.path(values.cell.resolve(process.tif)), "process.tif")
        values.take("process", ("force_n", "rpm", "dip_deg"), "process")


def _add_kinematics(values: CellValues) -> None:
    section = values.cell.kinematics
    if values.given_keys("kinematics").get("type", section.type) == section.type:
        for key, value in section.model_dump(mode="json", exclude_none=True).items():
            used = values.path(values.cell.resolve(value)) if key == "table" else value
            values.put("kinematics", key, used, f"kinematics.{key}")


def _add_machine(values: CellValues) -> None:
    """Add the machine's limits, its first position and its true acceleration."""
    cell, machine = values.cell, values.cell.machine
    values.take("robot", MACHINE, "machine")
    lean_deg = most_lean_deg(cell)
    values.put("robot", "a_deg", (-lean_deg, lean_deg), "process.dip_deg")
    values.put("robot", "home", home(cell), "machine.z_mm")
    values.put("hidden_truth", "accel_mm_s2", MORE_ACCEL * machine.accel_mm_s2, "machine.accel_mm_s2")
    values.put("hidden_truth", "overhead_s", machine.block_overhead_s or None, "machine.block_overhead_s")


def home(cell: CellConfig) -> tuple[float, float, float, float, float]:
    """Return X Y Z A C of the program's frame over the part's center at the top of the range."""
    (dx, dy, _), turn, machine = cell.program.offset_mm, math.radians(cell.program.rotation_deg), cell.machine
    x = -(math.cos(turn) * dx + math.sin(turn) * dy)
    y = math.sin(turn) * dx - math.cos(turn) * dy
    x, y = (min(max(round(at, 6), least), most) + 0.0 for at, (least, most) in ((x, machine.x_mm), (y, machine.y_mm)))
    return x, y, machine.z_mm[1], 0.0, 0.0


def most_lean_deg(cell: CellConfig) -> float:
    """Return the largest lean of the tool on the part: dip, slope of the part and a margin."""
    part, slope_deg = cell.part, 0.0
    if part.curvature_radius_mm is not None:
        share = (cell.outline().radius_mm + math.hypot(*part.off_axis_mm)) / abs(part.curvature_radius_mm)
        slope_deg = math.degrees(math.asin(min(share, 1.0)))
    return max(60.0, math.ceil(cell.process.dip_deg + slope_deg + 15.0))


def _add_instrument(values: CellValues) -> None:
    """Add the errors of the maps that the instrument's profile corrects, and the artefact that proves it."""
    if values.cell.profile_path is None:
        return
    profile = ProfileFile.of(*load_toml(values.cell.profile_path))
    put = partial(values.put, source="instrument.profile")
    if profile.lateral.pitch_mm is not None and FINEST_MM <= profile.lateral.pitch_mm <= COARSEST_MM:
        put("plant", "pitch_mm", profile.lateral.pitch_mm)
    turn, height = profile.orientation, profile.height
    back_deg = turn.rotation_deg if turn.mirror else -turn.rotation_deg % 360
    faults = {"mirror": turn.mirror, "rotation_deg": back_deg, "sign": height.sign, "factor": 1.0 / height.factor}
    for key, value in faults.items():
        put("interferometer", key, value, inner=("faults",))
    if profile.artefact is not None and not any(bump.angle_deg for bump in profile.artefact.bumps):
        bumps = [bump.model_dump(exclude={"angle_deg"}) for bump in profile.artefact.bumps]
        far_mm = max(max(abs(b["x_mm"]), abs(b["y_mm"])) + 3 * max(b["sigma_x_mm"], b["sigma_y_mm"]) for b in bumps)
        put("interferometer", "bumps", bumps, inner=("artefact",))
        put("interferometer", "diameter_mm", max(USUAL_ARTEFACT_MM, 2.0 * far_mm), inner=("artefact",))


# Devices: protocol, address on this computer, and times within the limits of the cell.

CAN, PROFILE, LINE = ("slcan", "socketcand"), ("profile", "profile_tcp"), ("serial", "tcp")
KINDS: Mapping[str, tuple[str, str]] = {
    "robot_link": ("", "link"),
    "linuxcnc": ("", "linuxcnc"),
    "universal_robots": ("", "universal_robots"),
    "fanuc_rmi": ("", "fanuc_rmi"),
    "kuka_kvp": ("", "kuka_kvp"),
    "plc_robot": ("", "opcua"),
    "abb_rws": ("", "abb_rws"),
    "voice_coil_modbus": ("modbus_rtu", "modbus_tcp"),
    "voice_coil_serial": ("serial", ""),
    "cia402_actuator": CAN,
    "actuator_profile": PROFILE,
    "cia402_spindle": CAN,
    "spindle_profile": PROFILE,
    "watched_folder": ("watched_folder", "watched_folder"),
    "loader_line": LINE,
    "force_sensor_profile": LINE,
    "monitor_line": LINE,
}
"""By device type the `kind` of its simulated device on a serial line and on TCP; empty: none. `plc_robot` has the kind
of its profile. A type of another plugin needs its `kind` in sim.toml: `polishd rehearse` writes it if the type names
its simulated device."""
SHIPPED = {kind for pair in KINDS.values() for kind in pair}
SECTIONS: Mapping[str, str] = {"metrology": "interferometer"}
"""Sections of sim.toml with another name than the port."""
SENSOR_PROFILE = "force_sensor_line"
"""Profile of the simulated force sensor."""


def add_devices(values: CellValues) -> None:
    """Add the cell's devices on their links; errors of devices that cannot be simulated go to ``not_simulated``."""
    add: Mapping[str, Callable[[CellValues, str, str], None]] = {
        "robot": _add_robot,
        "actuator": _add_actuator,
        "spindle": _add_spindle,
        "metrology": _add_folder,
        "loader": _add_loader,
        "force_sensor": _add_force_sensor,
        "monitor": _add_signals,
    }
    used = dict(values.cell.used)
    if monitors := [name for name in values.cell.devices if port_of(name) == "monitor"]:
        used["monitor"] = monitors[0]
    for port, device in used.items():
        section, kind = SECTIONS.get(port, port), str(values.cell.devices[device].type)
        values.sections.setdefault(section, {})
        written = values.given_keys(section).get("kind")
        if written is not None and (kind in KINDS or written not in SHIPPED):
            continue
        try:
            if written is None and kind not in KINDS:
                raise _unlike(values, f"{device}.type", f"no simulated {port} is a {kind!r}")
            if written is None and port != "metrology":
                _add_link(values, device, *KINDS[kind])
            add[port](values, device, kind)
        except ConfigError as error:
            values.not_simulated[section] = error


def _unlike(values: CellValues, key: str, problem: str) -> ConfigError:
    return values.cell.error(
        key, f"{problem}, so it is not simulated. Write a rehearsal: polishd rehearse {values.cell.path}"
    )


def _add_link(values: CellValues, device: str, serial: str, tcp: str) -> None:
    """Add kind, port and baud; raise ConfigError if the address is of another link or another computer."""
    text, key, section = str(values.options(device).get("address", "")), f"{device}.address", port_of(device)
    try:
        url = urlsplit(text)
        host, port, query = url.hostname or "", url.port, parse_qs(url.query)
        baud = int(query["baud"][0]) if "baud" in query else None
    except ValueError as error:
        raise values.cell.error(key, f"is not an address: {text!r}: {error}. Correct it.") from error
    is_serial = url.scheme in {"serial", "slcan"}
    if url.path.startswith("/dev/") if is_serial else not (host == "localhost" or host.startswith("127.")):
        raise _unlike(values, key, f"{text!r} is not on this computer")
    if not (kind := serial if is_serial else tcp):
        raise _unlike(values, key, f"{text!r} is no link of the simulated {section}")
    if url.scheme == "ads":  # one TCP port only: the address is the number
        _, high, low, _ = map(int, host.split("."))
        port = 256 * high + low
    values.put(section, "kind", kind, key)
    values.put(section, "port", None if is_serial else port, key)
    if section != "spindle":
        values.put(section, "baud", baud, key)


def _add_robot(values: CellValues, device: str, kind: str) -> None:
    options = values.options(device)
    if kind == "plc_robot":
        profile = load_controller_profile(str(options.get("profile")), values.cell.base_dir)
        values.put("robot", "kind", profile.link, f"{device}.profile")
        values.put("robot", "report_ms", profile.report_ms, f"{device}.profile")
        values.put("robot", "watchdog_s", profile.watchdog_s or NO_WATCHDOG_S, f"{device}.profile")
        return
    none_s = NO_WATCHDOG_S if kind == "linuxcnc" else None
    values.put("robot", "watchdog_s", options.get("watchdog_s", none_s), f"{device}.watchdog_s")
    if kind == "abb_rws":
        values.put("robot", "rws", options.get("version"), f"{device}.version")
    if kind == "universal_robots":
        is_fast = values.number(device, "rate_hz", 125.0) > 125.0
        values.put("robot", "dashboard_port", options.get("dashboard_port", 29999), f"{device}.dashboard_port")
        values.put("robot", "primary_port", options.get("primary_port", 30001), f"{device}.primary_port")
        values.put("robot", "cycle_hz", 500 if is_fast else 125, f"{device}.rate_hz")


def _add_actuator(values: CellValues, device: str, kind: str) -> None:
    options = values.options(device)
    if kind == "actuator_profile":
        profile = _add_profile(values, device)
        table = profile.actuator.model_dump() if profile.actuator is not None else {}
        options = {"unit": None if profile.modbus is None else profile.modbus.unit, **table, **options}
        if "baud" not in values.sections["actuator"]:
            values.put("actuator", "baud", profile.serial.baud, f"{device}.profile")
    for key in ("unit", "node", "unpowered"):
        values.put("actuator", key, options.get(key), f"{device}.{key}")
    for key, usual_s, allowed in (("land_s", LANDS_S, "landing_s"), ("lift_s", LIFTS_S, "retract_s")):
        allowed_s = values.number(device, allowed, options.get(allowed, usual_s / DRIVE_TIME_SHARE))
        values.put("actuator", key, min(usual_s, DRIVE_TIME_SHARE * allowed_s), f"{device}.{allowed}")


def _add_profile(values: CellValues, device: str) -> DeviceProfile:
    """Add the profile of a device."""
    name = str(values.options(device).get("profile", ""))
    profile = profile_of(name, values.cell.base_dir)
    file = values.cell.resolve(name) if name.endswith(".toml") else DEVICE_PROFILE_DIR / f"{name}.toml"
    values.put(port_of(device), "profile", values.path(file), f"{device}.profile")
    return profile


def _add_spindle(values: CellValues, device: str, kind: str) -> None:
    options, rpm = values.options(device), values.cell.process.rpm
    if kind == "spindle_profile":
        table = _add_profile(values, device).spindle
        options = {**(table.model_dump() if table is not None else {}), **options}
    for key in ("unit", "pole_pairs", "node", "watchdog_s"):
        values.put("spindle", key, options.get(key), f"{device}.{key}")
    most_rpm = values.number(device, "max_rpm", options.get("max_rpm", USUAL_RPM))
    values.put("spindle", "max_rpm", math.ceil(max(most_rpm, rpm)), f"{device}.max_rpm")
    allowed_s = values.number(device, "spin_s", options.get("spin_s", SpindleTimes().spin_s))
    values.put("spindle", "spin_s", min(SPINS_S, DRIVE_TIME_SHARE * allowed_s * 1000.0 / rpm), f"{device}.spin_s")


def _add_folder(values: CellValues, device: str, _: str) -> None:
    request = values.options(device).get("request_file")
    if request is not None and Path(request).name != request:
        raise _unlike(values, f"{device}.request_file", f"{request!r} is not a name in the folder of the maps")
    values.put("interferometer", "request_file", request, f"{device}.request_file")


def _add_loader(values: CellValues, device: str, _: str) -> None:
    change_s = LOADER_TIME_SHARE * values.number(device, "change_s", LoaderTimes().change_s)
    values.put("loader", "load_s", min(LOADS_S, change_s), f"{device}.change_s")
    values.put("loader", "unload_s", min(UNLOADS_S, change_s), f"{device}.change_s")


def _add_force_sensor(values: CellValues, device: str, kind: str) -> None:
    if kind in KINDS and (profile := values.options(device).get("profile")) != SENSOR_PROFILE:
        raise _unlike(values, f"{device}.profile", f"no simulated force sensor has the profile {profile!r}")
    delay_s = values.number(device, "delay_s", SensorTimes().delay_s)
    values.put("force_sensor", "latency_s", min(FILTER_S, delay_s / 2), f"{device}.delay_s")
    values.put("force_sensor", "range_n", max(RANGE_N, 3.0 * values.cell.process.force_n), "process.force_n")


def _add_signals(values: CellValues, _device: str, _kind: str) -> None:
    """Add the signals of all monitors of the cell, each well inside its bounds, to one simulated monitor."""
    for name, signal in values.cell.signals.items():
        reported = ("signals", signal.signal or name)
        values.put("monitor", "value", inside(signal), f"signals.{name}", inner=reported)


def inside(signal: SignalSection) -> float | bool:
    """Return a value inside the bounds before contact, in contact and at a start."""
    given = (signal.before, signal.in_contact, signal.on_start)
    bounds: list[BoundsSection] = [one for one in given if one is not None]
    states = [one.state for one in bounds if one.state is not None]
    if states:
        return states[0]
    low = max((one.min for one in bounds if one.min is not None), default=None)
    high = min((one.max for one in bounds if one.max is not None), default=None)
    if low is not None and high is not None:
        return (low + high) / 2.0
    if low is not None:
        return low + (SIGNAL_MARGIN * abs(low) or 1.0)
    return 0.0 if high is None else high - (SIGNAL_MARGIN * abs(high) or 1.0)
