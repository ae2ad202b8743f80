"""Devices of a rehearsal's cell: addresses on this computer, and substitutes for types that are not simulated."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

from polishd.commissioning.rehearsal.draft import (
    LOOPBACK,
    REQUEST,
    SIM_STATE,
    RehearsalDraft,
    lay_address,
    move_address,
)
from polishd.commissioning.rehearsal.simulated_cell import free_port
from polishd.config.controller_profile import CONTROLLER_PROFILE_DIR, ControllerProfile, load_controller_profile
from polishd.config.simulator_cell import KINDS, SENSOR_PROFILE
from polishd.drivers.cia402.device_types import SIMULATED_EDS, SIMULATED_SPINDLE
from polishd.model.devices import port_of
from polishd.util.serialization import toml

MOST_N = 50.0
TOUCH_MM = 5.0
"""Where the simulated actuator meets the part, half-way of its stroke."""
CIA402_ACTUATOR = {"n_per_permille": 0.05, "mm_per_increment": 0.001, "rest_increments": 0, "balance_n": 2.0}
CIA402_SPINDLE = {"rpm_per_unit": SIMULATED_SPINDLE["rpm_per_unit"]}
"""What the simulated drive's numbers mean."""


SUBSTITUTE_KEYS: Mapping[str, Mapping[str, Any]] = {
    "robot": {},
    "actuator": {"address": f"serial:{SIM_STATE}/actuator?baud=115200"},
    "spindle": {"address": f"slcan:{SIM_STATE}/spindle?bitrate=500000", "eds": str(SIMULATED_EDS), **SIMULATED_SPINDLE},
    "metrology": {"request_file": REQUEST, "stable_s": 0.3, "poll_s": 0.1},
    "loader": {"address": f"serial:{SIM_STATE}/loader"},
    "force_sensor": {"address": f"serial:{SIM_STATE}/force_sensor", "profile": SENSOR_PROFILE},
    "monitor": {"address": f"serial:{SIM_STATE}/monitor"},
}
"""By port the keys of its substitute, which replaces a device whose type names no simulated device."""


def is_simulated(draft: RehearsalDraft, device: str, **keys: Any) -> bool:
    """Return True for a type that names its simulated device. Replace others by the substitute with these keys."""
    port, options = port_of(device), draft.options(device)
    has_profile = port == "force_sensor" and "profile" in options
    if draft.device_type(device).simulated_by and (not has_profile or options["profile"] == SENSOR_PROFILE):
        return True
    draft.replace_device(device, **SUBSTITUTE_KEYS[port], **keys)
    return False


def add_line(draft: RehearsalDraft, device: str) -> None:
    """Add a loader, a force sensor or a monitor."""
    if is_simulated(draft, device):
        move_address(draft, device, draft.options(device)["address"])


def add_actuator(draft: RehearsalDraft, device: str) -> None:
    """Add the actuator; raise ConfigError if the simulated one cannot apply the force of the process."""
    if draft.config.process.force_n > MOST_N:
        raise draft.config.error("process.force_n", f"the simulated actuator presses with {MOST_N:g} N at most")
    kind, stroke_mm = draft.config.devices[device].type, 10.0
    if is_simulated(draft, device):
        options = draft.options(device)
        address, stroke_mm = options["address"], float(options.get("stroke_mm") or stroke_mm)
        if kind == "voice_coil_serial" and not address.startswith("serial:"):
            draft.notes.append(
                f"{device}.address: the simulated actuator has its lines of text on a serial line, not on TCP"
            )
            address = "serial:none?baud=115200"
        move_address(draft, device, address)
        _adopt_files(draft, device, options)
        _adopt_scales(draft, device, options, CIA402_ACTUATOR if kind == "cia402_actuator" else {})
    touch_off = draft.config.touch_off
    given_mm = None if touch_off is None else touch_off.position_mm or stroke_mm / 2
    if given_mm not in {None, TOUCH_MM}:
        draft.instead("touch_off.position_mm", TOUCH_MM, "the simulated actuator meets the part half-way of its 10 mm")


def add_spindle(draft: RehearsalDraft, device: str) -> None:
    """Add the spindle."""
    if is_simulated(draft, device):
        options = draft.options(device)
        move_address(draft, device, options["address"])
        _adopt_files(draft, device, options)
        is_drive = draft.config.devices[device].type == "cia402_spindle"
        _adopt_scales(draft, device, options, CIA402_SPINDLE if is_drive else {})


def _adopt_files(draft: RehearsalDraft, device: str, options: Mapping[str, Any]) -> None:
    """Use the cell's EDS file and device profile."""
    for key in ("eds", "profile"):
        if (key == "eds" and key in options) or (options.get(key) or "").endswith(".toml"):
            draft.laid[f"{device}.{key}"] = str(draft.config.resolve(options[key]).absolute())


def _adopt_scales(draft: RehearsalDraft, device: str, options: Mapping[str, Any], simulated: Mapping[str, Any]) -> None:
    """Units of the simulated drive."""
    for key, value in simulated.items():
        if options[key] != value:
            draft.instead(f"{device}.{key}", value, f"is {options[key]:g} at your drive; the simulated one has its own")


# The robot: its program's language, its controller's address and folders.

NOT_SIMULATED = (
    "controller_dir", "user", "password", "certificate", "private_key", "server_certificate", "delivery_password",
    "known_hosts",
)  # fmt: skip
"""Keys of a PLC robot: its simulated controller accepts every client, and reads a folder."""
OTHER_LANGUAGES = ("fanuc-tp", "krl", "rapid", "urscript")
WINDOW, MOST_SPEED = 16384, 60
"""Blocks that a simulated controller holds ahead, and up to which speed that is enough."""
FIRST_REGISTER = 24
TIMES = (
    "report_ms", "link_ms", "heartbeat_ms", "watchdog_s", "silence_s", "stop_s", "pulse_ms", "load_s",
    "in_motion_wired",
)  # fmt: skip


def add_robot(draft: RehearsalDraft, device: str) -> None:
    """Add the robot; raise ConfigError if no simulated controller reads the cell's program."""
    kind, address = str(draft.config.devices[device].type), f"tcp://{LOOPBACK}:{free_port()}"
    _require_language(draft, device)
    add = {"linuxcnc": _linuxcnc, "universal_robots": _universal_robots, "plc_robot": _plc_robot}
    if simulated := is_simulated(draft, device, address=address):
        lay_address(draft, device, address)
    if kind in add:
        add[kind](draft, device)
    elif kind in KINDS or not simulated or draft.sim["robot"]["kind"][0] == "link":
        why = f"{WINDOW} blocks at --speed 1 last as long as these at {MOST_SPEED}"
        draft.put("robot", "window", WINDOW * MOST_SPEED, why)


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


def _linuxcnc(draft: RehearsalDraft, device: str) -> None:
    draft.laid |= {
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
    options = draft.options(device)
    if options["tool_z"] != "into_part":
        raise draft.config.error(f"{device}.tool_z", "the simulated arm's tool frame has its z into the part only")
    draft.laid |= {
        f"{device}.dashboard_port": free_port(),
        f"{device}.primary_port": free_port(),
    }
    if options["first_register"] != FIRST_REGISTER:
        draft.instead(f"{device}.first_register", FIRST_REGISTER, "the simulated arm is watched at that register")


def _plc_robot(draft: RehearsalDraft, device: str) -> None:
    options, port = draft.options(device), free_port()
    profile = load_controller_profile(options["profile"], draft.config.base_dir)
    usual = load_controller_profile(f"plc-{profile.link}", CONTROLLER_PROFILE_DIR)
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


_NO_NAME = re.compile(r"[^A-Za-z0-9._-]")


def add_monitors(draft: RehearsalDraft, devices: Sequence[str]) -> None:
    """One simulated box has the signals of all monitors of the cell."""
    first, *others = devices
    add_line(draft, first)
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
            why = "a name at the simulated monitor has no such characters"
            draft.instead(f"signals.{name}.signal", _NO_NAME.sub("_", channel), why)
