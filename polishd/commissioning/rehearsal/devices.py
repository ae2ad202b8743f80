"""Actuator and spindle of a cell, as the simulator has them."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from polishd.commissioning.rehearsal.draft import LOOPBACK, SIM_STATE, RehearsalDraft, wire
from polishd.commissioning.rehearsal.part import home, most_a_deg, require_force
from polishd.commissioning.rehearsal.simulated_cell import free_port
from polishd.config.cell_sections import BoundsSection, SignalSection
from polishd.config.controller_profile import CONTROLLER_PROFILE_DIR, ControllerProfile, load_controller_profile
from polishd.config.device_profile import DeviceProfile
from polishd.drivers.cia402.device_types import SIMULATED_EDS, SIMULATED_SPINDLE
from polishd.drivers.profile_device.build import DEVICE_PROFILE_DIR, address_of, profile_of
from polishd.drivers.transport.address import SerialLine, SlcanAddress, Tcp
from polishd.model.devices import port_of
from polishd.util.serialization import toml

MOST_N = 50.0
TOUCH_MM = 5.0
"""Where the simulated actuator meets the part, half-way of its stroke."""
LANDS_S, LIFTS_S, SPINS_S, USUAL_RPM = 2.0, 4.0, 3.0, 3000
DRIVE_TIME_SHARE = 0.8
"""Share of the longest time that the cell allows that a simulated device takes if it is slower."""
CIA402_ACTUATOR = {"n_per_permille": 0.05, "mm_per_increment": 0.001, "rest_increments": 0, "balance_n": 2.0}
CIA402_SPINDLE = {"rpm_per_unit": SIMULATED_SPINDLE["rpm_per_unit"]}
"""What the simulated drive's numbers mean."""


def add_actuator(draft: RehearsalDraft, device: str) -> None:
    """``[actuator]``; ConfigError where it cannot press as the process asks."""
    require_force(draft, MOST_N)
    kinds: dict[str, Callable[[RehearsalDraft, str, dict[str, Any]], Mapping[str, Any]]] = {
        "voice_coil_modbus": _voice_coil_modbus,
        "voice_coil_serial": _voice_coil_serial,
        "cia402_actuator": _cia402_actuator,
        "actuator_profile": _actuator_profile,
    }
    kind = str(draft.config.devices[device].type)
    if kind in kinds:
        times = kinds[kind](draft, device, draft.options(device))
    elif _is_simulated(draft, device):
        times = draft.options(device)
    else:
        draft.put("actuator", "kind", "modbus_rtu", f"replaces {kind}")
        draft.replace_device(device, address=f"serial:{SIM_STATE}/actuator?baud=115200")
        times = {}
    _add_times(draft, device, times)


def _add_times(draft: RehearsalDraft, device: str, times: Mapping[str, Any]) -> None:
    """What the simulated one takes, and where it touches."""
    for key, usual_s, allowed in (("land_s", LANDS_S, "landing_s"), ("lift_s", LIFTS_S, "retract_s")):
        if allowed in times:
            takes_s = min(usual_s, DRIVE_TIME_SHARE * float(times[allowed]))
            draft.put("actuator", key, takes_s, f"at most {DRIVE_TIME_SHARE:g} x {device}.{allowed}")
    if "unpowered" in times:
        draft.put("actuator", "unpowered", times["unpowered"], f"{device}.unpowered")
    touch_off = draft.config.touch_off
    given_mm = None if touch_off is None else touch_off.position_mm or float(times.get("stroke_mm", 10.0)) / 2
    if given_mm not in {None, TOUCH_MM}:
        draft.instead("touch_off.position_mm", TOUCH_MM, "the simulated actuator meets the part half-way of its 10 mm")


def _voice_coil_modbus(draft: RehearsalDraft, device: str, options: dict[str, Any]) -> Mapping[str, Any]:
    real = wire(draft, device, "actuator", options["address"])
    draft.put("actuator", "kind", "modbus_rtu" if isinstance(real, SerialLine) else "modbus_tcp", f"{device}.address")
    draft.put("actuator", "unit", options["unit"], draft.origin(f"{device}.unit"))
    _add_baud(draft, device, real)
    return options


def _voice_coil_serial(draft: RehearsalDraft, device: str, options: dict[str, Any]) -> Mapping[str, Any]:
    address = options["address"]
    if not address.startswith("serial:"):
        draft.notes.append(
            f"{device}.address: the simulated actuator has its lines of text on a serial line, not on TCP"
        )
        address = "serial:none?baud=115200"
    real = wire(draft, device, "actuator", address)
    draft.put("actuator", "kind", "serial", f"{device}.type")
    _add_baud(draft, device, real)
    return options


def _cia402_actuator(draft: RehearsalDraft, device: str, options: dict[str, Any]) -> Mapping[str, Any]:
    _add_can(draft, device, "actuator", options)
    _scale(draft, device, options, CIA402_ACTUATOR)
    return options


def _actuator_profile(draft: RehearsalDraft, device: str, options: dict[str, Any]) -> Mapping[str, Any]:
    profile = _add_profile(draft, device, "actuator", options)
    table: Any = profile.actuator
    given = {name: options[name] for name in ("landing_s", "retract_s", "stroke_mm") if options[name] is not None}
    unit = profile.modbus.unit if options["unit"] is None and profile.modbus is not None else options["unit"]
    draft.put("actuator", "unit", unit, f"{device}.unit, or that of its profile")
    return {**table.model_dump(), **given}


def add_spindle(draft: RehearsalDraft, device: str) -> None:
    """``[spindle]``."""
    kind, options = str(draft.config.devices[device].type), draft.options(device)
    if kind == "cia402_spindle":
        _add_can(draft, device, "spindle", options)
        _scale(draft, device, options, CIA402_SPINDLE)
    elif kind == "spindle_profile":
        table: Any = _add_profile(draft, device, "spindle", options).spindle
        options = {**table.model_dump(), **{key: value for key, value in options.items() if value is not None}}
        draft.put("spindle", "unit", options.get("unit"), f"{device}.unit")
        draft.put("spindle", "pole_pairs", options["pole_pairs"], draft.origin(f"{device}.pole_pairs"))
    elif not _is_simulated(draft, device):
        draft.put("spindle", "kind", "slcan", f"replaces {kind}")
        address = f"slcan:{SIM_STATE}/spindle?bitrate=500000"
        draft.replace_device(device, address=address, eds=str(SIMULATED_EDS), **SIMULATED_SPINDLE)
        options = {}
    rpm = draft.config.process.rpm
    most_rpm = max(float(options.get("max_rpm", USUAL_RPM)), rpm)
    draft.put("spindle", "max_rpm", math.ceil(most_rpm), f"{device}.max_rpm, or at least process.rpm")
    if "watchdog_s" in options:
        draft.put("spindle", "watchdog_s", options["watchdog_s"], draft.origin(f"{device}.watchdog_s"))
    if "spin_s" in options:
        spin_s = min(SPINS_S, DRIVE_TIME_SHARE * options["spin_s"] * 1000.0 / rpm)
        draft.put("spindle", "spin_s", spin_s, f"process.rpm in at most {DRIVE_TIME_SHARE:g} x {device}.spin_s")


def _is_simulated(draft: RehearsalDraft, device: str) -> bool:
    """Add a device whose type names its simulated device. False: it names none."""
    simulated_by, port = draft.device_type(device).simulated_by, port_of(device)
    if simulated_by:
        draft.put(port, "kind", simulated_by, f"{device}.type")
        wire(draft, device, port, draft.options(device)["address"])
    return bool(simulated_by)


def _add_baud(draft: RehearsalDraft, device: str, real: object) -> None:
    if isinstance(real, SerialLine):
        draft.put("actuator", "baud", real.baud, f"{device}.address")


def _add_can(draft: RehearsalDraft, device: str, port: str, options: Mapping[str, Any]) -> None:
    real = wire(draft, device, port, options["address"])
    draft.put(port, "kind", "slcan" if isinstance(real, SlcanAddress) else "socketcand", f"{device}.address")
    draft.put(port, "node", options["node"], draft.origin(f"{device}.node"))
    if "eds" in options:
        draft.laid[f"{device}.eds"] = str(draft.config.resolve(options["eds"]).absolute())


def _scale(draft: RehearsalDraft, device: str, options: Mapping[str, Any], simulated: Mapping[str, Any]) -> None:
    """Units of the simulated drive."""
    for key, value in simulated.items():
        if options[key] != value:
            draft.instead(f"{device}.{key}", value, f"is {options[key]:g} at your drive; the simulated one has its own")


def _add_profile(draft: RehearsalDraft, device: str, port: str, options: Mapping[str, Any]) -> DeviceProfile:
    """What it speaks, from a copy of its profile."""
    named = options["profile"]
    profile = profile_of(named, draft.config.base_dir)
    own = named.endswith(".toml")
    path = draft.config.resolve(named) if own else DEVICE_PROFILE_DIR / f"{named}.toml"
    if own:
        draft.laid[f"{device}.profile"] = str(path.absolute())
    real = wire(draft, device, port, options["address"])
    draft.put(port, "kind", "profile_tcp" if isinstance(real, Tcp) else "profile", f"{device}.address")
    draft.put(port, "profile", draft.copy(f"{port}.profile.toml", path), f"a copy of {device}.profile")
    if port == "actuator":
        _add_baud(draft, device, address_of(profile, options["address"], draft.config.base_dir))
    return profile


# The robot of a cell, as the simulator has it: which controller, its limits and its watchdog.

NOT_SIMULATED = (
    "controller_dir", "user", "password", "certificate", "private_key", "server_certificate", "delivery_password",
    "known_hosts",
)  # fmt: skip
"""Keys of a PLC robot: its simulated controller accepts every client, and reads a folder."""
OTHER_LANGUAGES = ("fanuc-tp", "krl", "rapid", "urscript")
WINDOW, MOST_SPEED = 16384, 60
"""Blocks that a simulated controller holds ahead, and up to which speed that is enough."""
NO_WATCHDOG_S = 600.0
FIRST_REGISTER = 24
TIMES = (
    "report_ms", "link_ms", "heartbeat_ms", "watchdog_s", "silence_s", "stop_s", "pulse_ms", "load_s",
    "in_motion_wired",
)  # fmt: skip


def add_robot(draft: RehearsalDraft, device: str) -> None:
    """``[robot]``; ConfigError where no simulated controller reads the cell's program."""
    kinds: dict[str, Callable[[RehearsalDraft, str], None]] = {
        "robot_link": _link,
        "linuxcnc": _linuxcnc,
        "universal_robots": _universal_robots,
        "plc_robot": _handover,
    }
    kind = str(draft.config.devices[device].type)
    _require_language(draft, device)
    if kind in kinds:
        kinds[kind](draft, device)
    elif not _is_simulated(draft, device):
        _replace_robot(draft, device, kind)
    machine = draft.config.machine
    draft.take("robot", ("corner_deg", "max_feed_mm_s", "x_mm", "y_mm", "z_mm"), "machine", machine)
    draft.put("robot", "a_deg", (-most_a_deg(draft), most_a_deg(draft)), "process.dip_deg, the part's slope, and room")
    draft.put("robot", "home", home(draft), "over the part's centre, at the top of machine.z_mm")


def _require_language(draft: RehearsalDraft, device: str) -> None:
    """ConfigError where no simulated controller of that type reads the cell's program."""
    named, kind = draft.config.program.format, str(draft.config.devices[device].type)
    if only := draft.device_type(device).program_format:
        if named != only:
            raise draft.config.error("program.format", f"is {named!r}; the simulated controller reads {only} only")
    elif named in OTHER_LANGUAGES:
        raise draft.config.error(
            "program.format",
            f"no simulated controller of {kind!r} reads {named!r}; post the program as rs274 to rehearse it",
        )
    elif named != "rs274" and kind != "linuxcnc":
        draft.notes.append(
            f"program.format = {named!r}: the simulated controller reads what docs/protocols/robot_link.md says, "
            "and refuses a line with other words by name"
        )


def _link(draft: RehearsalDraft, device: str) -> None:
    port, options = free_port(), draft.options(device)
    draft.put("robot", "kind", "link", f"{device}.type")
    draft.put("robot", "port", port, "free on this computer")
    draft.put("robot", "watchdog_s", options["watchdog_s"], draft.origin(f"{device}.watchdog_s"))
    _add_window(draft)
    draft.laid[f"{device}.address"] = f"tcp://{LOOPBACK}:{port}"


def _add_window(draft: RehearsalDraft) -> None:
    window = WINDOW * MOST_SPEED
    draft.put("robot", "window", window, f"{WINDOW} blocks at --speed 1 last as long as these at {MOST_SPEED}")


def _replace_robot(draft: RehearsalDraft, device: str, kind: str) -> None:
    port = free_port()
    draft.put("robot", "kind", "link", f"replaces {kind}")
    draft.put("robot", "port", port, "free on this computer")
    _add_window(draft)
    draft.replace_device(device, address=f"tcp://{LOOPBACK}:{port}")


def _linuxcnc(draft: RehearsalDraft, device: str) -> None:
    port, watchdog_s = free_port(), draft.options(device)["watchdog_s"]
    draft.put("robot", "kind", "linuxcnc", f"{device}.type")
    draft.put("robot", "port", port, "free on this computer")
    draft.put("robot", "watchdog_s", watchdog_s or NO_WATCHDOG_S, draft.origin(f"{device}.watchdog_s"))
    draft.laid |= {
        f"{device}.address": f"tcp://{LOOPBACK}:{port}",
        f"{device}.program_dir": f"{SIM_STATE}/linuxcnc/nc",
        f"{device}.controller_dir": "/mnt/nc",
        f"{device}.password": None,
        f"{device}.enable_password": None,
    }
    draft.notes.append(
        f"{device}: a real LinuxCNC, in real time, in a separate network: simulator and polishd run are started as "
        "docs/protocols/linuxcnc.md says under Simulated"
    )


def _universal_robots(draft: RehearsalDraft, device: str) -> None:
    rtde, dashboard, primary = free_port(), free_port(), free_port()
    options = draft.options(device)
    if options["tool_z"] != "into_part":
        raise draft.config.error(f"{device}.tool_z", "the simulated arm's tool frame has its z into the part only")
    draft.put("robot", "kind", "universal_robots", f"{device}.type")
    for key, port in (("port", rtde), ("dashboard_port", dashboard), ("primary_port", primary)):
        draft.put("robot", key, port, "free on this computer")
    draft.put("robot", "cycle_hz", 500 if options["rate_hz"] > 125.0 else 125, draft.origin(f"{device}.rate_hz"))
    draft.laid |= {
        f"{device}.address": f"tcp://{LOOPBACK}:{rtde}",
        f"{device}.dashboard_port": dashboard,
        f"{device}.primary_port": primary,
    }
    if options["first_register"] != FIRST_REGISTER:
        draft.instead(f"{device}.first_register", FIRST_REGISTER, "the simulated arm is watched at that register")


def _handover(draft: RehearsalDraft, device: str) -> None:
    options, port = draft.options(device), free_port()
    profile = load_controller_profile(options["profile"], draft.config.base_dir)
    usual = load_controller_profile(f"plc-{profile.link}", CONTROLLER_PROFILE_DIR)
    draft.put("robot", "kind", profile.link, f"link of {device}.profile")
    draft.put("robot", "port", port, "free on this computer")
    draft.put("robot", "report_ms", profile.report_ms, f"report_ms of {device}.profile")
    draft.put("robot", "watchdog_s", profile.watchdog_s or NO_WATCHDOG_S, f"watchdog_s of {device}.profile")
    if profile.variables != usual.variables or profile.program != usual.program:
        draft.files["controller.toml"] = _with_its_times(profile, usual)
        why = (
            f"{options['profile']}: the simulated controller has the variables of plc-{profile.link}, and the times of"
        )
        draft.instead(f"{device}.profile", "controller.toml", f"{why} yours")
        if draft.config.program.format != "rs274":
            draft.instead("program.format", "rs274", f"the lines of plc-{profile.link} are RS274")
    elif options["profile"].endswith(".toml"):
        draft.laid[f"{device}.profile"] = str(draft.config.resolve(options["profile"]).absolute())
    host = f"127.{port // 256}.{port % 256}.1"
    address = {"opcua": f"opc.tcp://{LOOPBACK}:{port}", "ads": f"ads://{host}/{host}.1.1:851"}
    draft.laid[f"{device}.address"] = address.get(profile.link, f"tcp://{LOOPBACK}:{port}")
    draft.laid[f"{device}.delivery"] = f"folder:{SIM_STATE}/programs"
    for key in NOT_SIMULATED:
        draft.laid[f"{device}.{key}"] = None
    if not options["delivery"].startswith("folder:"):
        draft.notes.append(f"{device}.delivery: the simulated controller reads a folder: nothing goes by FTP or SFTP")


def _with_its_times(profile: ControllerProfile, usual: ControllerProfile) -> bytes:
    """The profile of the simulated controller, with the times of the cell's own."""
    source: Mapping[str, Any] = {"name": f"{usual.name}, in place of {profile.name}", "link": profile.link}
    times = {name: value for name in TIMES if (value := getattr(profile, name)) is not None}
    text = usual.source.text
    tables = text[text.index("\n[") :]
    return ("\n".join(f"{key} = {toml(value)}" for key, value in {**source, **times}.items()) + "\n" + tables).encode()


# Loader, force sensor and monitor of a cell, as the simulator has them.

LOADS_S, UNLOADS_S, FILTER_S, RANGE_N = 30.0, 20.0, 0.03, 60.0
LOADER_TIME_SHARE = 0.4
"""Share of the longest change that loading, or unloading, takes if the simulated loader is slower."""
ROOM = 0.1
"""How far a signal is inside a bound, relative to it."""
_NO_NAME = re.compile(r"[^A-Za-z0-9._-]")


def add_loader(draft: RehearsalDraft, device: str) -> None:
    """``[loader]``."""
    options = _line(draft, device, "loader")
    change_s = float(options.get("change_s", 120.0))
    for key, usual_s in (("load_s", LOADS_S), ("unload_s", UNLOADS_S)):
        draft.put(
            "loader",
            key,
            min(usual_s, LOADER_TIME_SHARE * change_s),
            f"at most {LOADER_TIME_SHARE:g} x {device}.change_s",
        )


def add_force_sensor(draft: RehearsalDraft, device: str) -> None:
    """``[force_sensor]``."""
    options = _line(draft, device, "force_sensor", profile="force_sensor_line")
    latency_s = min(FILTER_S, float(options.get("delay_s") or 0.1) / 2)
    draft.put("force_sensor", "latency_s", latency_s, f"at most half of {device}.delay_s")
    most_n = max(RANGE_N, 3.0 * draft.config.process.force_n)
    draft.put("force_sensor", "range_n", most_n, "at least three times process.force_n")


def add_monitors(draft: RehearsalDraft, devices: Sequence[str]) -> None:
    """``[monitor]``: one box with the signals of all monitors of the cell, each well inside its bounds."""
    first, *others = devices
    _line(draft, first, "monitor")
    address = draft.laid.get(f"{first}.address") or draft.laid[first]["address"]
    for device in others:
        if draft.device_type(device).simulated_by == draft.device_type(first).simulated_by:
            draft.laid[f"{device}.address"] = address
        else:
            draft.replace_device(device, address=address)
    if others:
        draft.notes.append(f"{', '.join(devices)}: one simulated monitor has the signals of all, at one address")
    for name, signal in draft.config.signals.items():
        channel = signal.signal or name
        if _NO_NAME.search(channel):
            channel = _NO_NAME.sub("_", channel)
            draft.instead(f"signals.{name}.signal", channel, "a name at the simulated monitor has no such characters")
        draft.put(f"monitor.signals.{channel}", "value", inside(signal), f"inside the bounds of signals.{name}")


def inside(signal: SignalSection) -> float | bool:
    """A value that is as it should be before contact and in contact."""
    asked: list[BoundsSection] = [one for one in (signal.before, signal.in_contact) if one is not None]
    states = [one.state for one in asked if one.state is not None]
    if states:
        return states[0]
    low = max((one.min for one in asked if one.min is not None), default=None)
    high = min((one.max for one in asked if one.max is not None), default=None)
    if low is not None and high is not None:
        return (low + high) / 2.0
    if low is not None:
        return low + (ROOM * abs(low) or 1.0)
    return (high or 0.0) - (ROOM * abs(high or 0.0) or 1.0)


def _line(draft: RehearsalDraft, device: str, port: str, *, profile: str = "") -> dict[str, Any]:
    """Add a device on a line, simulated as its type (and profile) says or replaced. Return its options."""
    kind = draft.device_type(device)
    options = draft.options(device)
    if kind.simulated_by not in {"", port}:
        _is_simulated(draft, device)
        return options
    if not kind.simulated_by or options.get("profile", "") != profile:
        draft.put(port, "kind", "serial", f"replaces {kind.name}")
        keys = {"profile": profile} if profile else {}
        draft.replace_device(device, address=f"serial:{SIM_STATE}/{port}?baud=115200", **keys)
        return {}
    real = wire(draft, device, port, options["address"])
    draft.put(port, "kind", "serial" if isinstance(real, SerialLine) else "tcp", f"{device}.address")
    if isinstance(real, SerialLine):
        draft.put(port, "baud", real.baud, f"{device}.address")
    return options
