"""The robot of a cell, as the simulator has it: which controller, its limits and its watchdog."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from polishd.config.controller_profile import CONTROLLER_PROFILE_DIR, ControllerProfile, load_controller_profile
from polishd.console.demo_files import free_port
from polishd.console.rehearsal.draft import LOOPBACK, SIM_STATE, RehearsalDraft
from polishd.console.rehearsal.part import home, most_a_deg
from polishd.plain import toml

SPEED = {"linuxcnc": 1.0, "universal_robots": 4.0, "handover": 8.0}
USUAL_SPEED = 10.0
"""Process seconds per wall second: what each controller's own clock, and the daemon's looks at it, bear."""
NOT_SIMULATED = (
    "controller_dir", "user", "password", "certificate", "private_key", "server_certificate", "delivery_password",
    "known_hosts",
)  # fmt: skip
"""Keys of a handover: its simulated controller lets everybody in, and reads a folder."""
OTHER_LANGUAGES = ("fanuc-tp", "krl", "rapid", "urscript")
WINDOW, MOST_SPEED = 16384, 60
"""Blocks that a simulated controller holds ahead, and up to which speed that is enough."""
NO_WATCHDOG_S = 600.0
FIRST_REGISTER = 24
TIMES = (
    "report_ms", "link_ms", "heartbeat_ms", "watchdog_s", "silence_s", "stop_s", "pulse_ms", "load_s",
    "in_motion_wired",
)  # fmt: skip


def speed_of(type_name: str | None) -> float:
    """At which a cell with such a robot is rehearsed, where nobody says another."""
    return SPEED.get(type_name or "", USUAL_SPEED)


def add_robot(draft: RehearsalDraft, device: str) -> None:
    """``[robot]``; ConfigError where no simulated controller reads the cell's program."""
    kinds: dict[str, Callable[[RehearsalDraft, str], None]] = {
        "robot_link": _link,
        "linuxcnc": _linuxcnc,
        "universal_robots": _universal_robots,
        "handover": _handover,
    }
    kind = str(draft.config.devices[device].type)
    _require_language(draft, kind)
    if kind in kinds:
        kinds[kind](draft, device)
    else:
        _stand_in(draft, device, kind)
    machine = draft.config.machine
    draft.take("robot", ("corner_deg", "max_feed_mm_s", "x_mm", "y_mm", "z_mm"), "machine", machine)
    draft.put("robot", "a_deg", (-most_a_deg(draft), most_a_deg(draft)), "process.dip_deg, the part's slope, and room")
    draft.put("robot", "home", home(draft), "over the part's centre, at the top of machine.z_mm")


def _require_language(draft: RehearsalDraft, kind: str) -> None:
    """Only an arm of Universal Robots reads another language than G-code."""
    named = draft.config.program.format
    if kind == "universal_robots":
        if named != "urscript":
            raise draft.config.error("program.format", f"is {named!r}; the simulated controller reads urscript only")
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


def _stand_in(draft: RehearsalDraft, device: str, kind: str) -> None:
    port = free_port()
    draft.put("robot", "kind", "link", f"stands in for {kind}")
    draft.put("robot", "port", port, "free on this computer")
    _add_window(draft)
    address = f"tcp://{LOOPBACK}:{port}"
    draft.replace_device(device, {"type": "robot_link", "address": address}, f"there is no simulated {kind!r}")
    draft.plugin("rnc_robot")


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
        f"{device}: a real LinuxCNC, in real time, in a network of its own: simulator and polishd run are started as "
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
