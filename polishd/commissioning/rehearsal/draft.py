"""Differences between a rehearsal and its cell, before the files are written; its devices and its folder.

Devices get addresses on this computer; types that are not simulated get substitutes.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, MutableMapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import tomlkit

from polishd.commissioning.rehearsal.simulated_cell import free_port
from polishd.config.cell import FILES, CellConfig, device_options, overlay, tool_files
from polishd.config.controller_profile import CONTROLLER_PROFILE_DIR, ControllerProfile, load_controller_profile
from polishd.config.simulator_cell import KINDS, SECTIONS, SENSOR_PROFILE
from polishd.config.toml_loader import join_words
from polishd.drivers.cia402.device_types import SIMULATED_EDS, SIMULATED_SPINDLE
from polishd.drivers.transport.address import SerialLine, SlcanAddress, Tcp, parse_address
from polishd.hookspecs import DeviceType
from polishd.model.devices import port_of
from polishd.model.errors import ConfigError
from polishd.plugin_loader import Hooks, load_own
from polishd.util.files import require_writable
from polishd.util.serialization import toml

LOOPBACK = "127.0.0.1"
REQUEST = "measure.request"
"""File that asks the simulated instrument for a map."""
SIM_STATE = "sim"
"""The simulator's state folder, beside SIM.toml."""


@dataclass(slots=True)
class RehearsalDraft:
    """A rehearsal that is being made of a cell."""

    config: CellConfig
    hooks: Hooks
    sim: dict[str, dict[str, tuple[Any, str]]] = field(default_factory=dict)
    """sim.toml: by section and key a value, and the comment behind it."""
    overrides: dict[str, Any] = field(default_factory=dict)
    """Changed values of the rehearsal's cell by dotted key; None: the key is removed."""
    notes: list[str] = field(default_factory=list)
    """Differences between the simulated cell and the real one."""
    files: dict[str, bytes] = field(default_factory=dict)
    """Files that the rehearsal's cell names, by name in the folder."""

    def put(self, section: str, key: str, value: Any, comment: str) -> None:
        """A value of sim.toml, and the comment behind it."""
        self.sim.setdefault(section, {})[key] = (value, comment)

    def options(self, device: str) -> dict[str, Any]:
        """A device's options with their defaults, as its type judges them; ConfigError as of the cell."""
        _, options = device_options(self.config, device, self.hooks.device_types())
        return dict(options)

    def device_type(self, device: str) -> DeviceType:
        """The device's type. ConfigError as of the cell."""
        return device_options(self.config, device, self.hooks.device_types())[0]

    def replace_device(self, device: str, **keys: Any) -> None:
        """Replace a device that has no simulated one by the port's substitute with these keys. Keys of the port stay.

        Raises:
            ConfigError: no simulated device can take its place.
        """
        own, raw = load_own(), self.config.devices[device]
        substitute = own.substitute(port_of(device))
        if substitute is None:
            raise self.config.error(f"{device}.type", f"{raw.type!r} has no simulated device, and no other replaces it")
        options = {key: getattr(raw, key) for key in type(raw).model_fields if key != "type"}
        self.overrides[device] = {**options, "type": substitute.name, **keys}
        self.notes.append(f"{device}: there is no simulated {raw.type!r}; {substitute.name} replaces it")
        self._load_plugin(own.plugin_of("polishd_device_types", substitute.name))

    def instead(self, key: str, value: Any, why: str) -> None:
        """Replace a value of the cell, with a note; None: the key is left out."""
        self.overrides[key] = value
        state = "is left out" if value is None else f"is {json.dumps(value)} in the rehearsal"
        self.notes.append(f"{key}: {why}; it {state}")

    def _load_plugin(self, name: str) -> None:
        loaded = self.overrides.get("plugins.load", list(self.config.plugins.load))
        if name not in loaded:
            self.overrides["plugins.load"] = [*loaded, name]


def move_address(draft: RehearsalDraft, device: str, address: str) -> None:
    """Give a device an address of the same kind on this computer. Raise ConfigError if its own is not an address."""
    real = parse_address(address, draft.config.base_dir)
    query = urlsplit(address).query
    if isinstance(real, SerialLine | SlcanAddress):
        path = f"{address.partition(':')[0]}:{SIM_STATE}/{port_of(device)}"
        lay_address(draft, device, path + (f"?{query}" if query else ""))
        return
    at = f"{LOOPBACK}:{free_port()}"
    lay_address(draft, device, f"tcp://{at}" if isinstance(real, Tcp) else f"socketcand://{at}/{real.channel}")


def lay_address(draft: RehearsalDraft, device: str, address: str) -> None:
    """Give a device of the rehearsal's cell this address, and its simulated device what the cell does not say."""
    draft.overrides[f"{device}.address"] = address
    url = urlsplit(address)
    if put_kind(draft, device, is_serial=url.scheme in {"serial", "slcan"}) and url.port is not None:
        draft.put(port_of(device), "port", url.port, f"{device}.address")


def put_kind(draft: RehearsalDraft, device: str, *, is_serial: bool = False) -> bool:
    """Put the `kind` of another plugin's device into sim.toml. Return False for a type of polishd's.

    Raises:
        ConfigError: its type names a simulated device with several protocols.
    """
    own, one = load_own(), draft.device_type(device)
    if one.name in KINDS:
        return False
    same = [name for name, shipped in own.device_types().items() if is_like(shipped, one)]
    kinds = {KINDS[name][not is_serial] for name in same} - {""}
    if len(kinds) > 1 or (same and not kinds):
        several = sorted({kind for name in same for kind in KINDS[name]} - {""})
        raise draft.config.error(
            f"{device}.type",
            f"{one.name!r} is simulated by {one.simulated_by!r}, which has several protocols; the plugin must name one "
            f"as simulated_by: {join_words(several)}",
        )
    draft.put(SECTIONS.get(one.port, one.port), "kind", kinds.pop() if kinds else one.simulated_by, f"{device}.type")
    return True


def is_like(shipped: DeviceType, one: DeviceType) -> bool:
    """Return whether a type of polishd's has the simulated device of another."""
    return shipped.name in KINDS and (shipped.port, shipped.simulated_by) == (one.port, one.simulated_by)


# The two files as text: sim.toml, and the cell's own file with few of its values.

COLUMN = 45
"""In which comments begin, where a value leaves room."""


def sim_text(draft: RehearsalDraft, cell: str) -> str:
    """Return sim.toml for the rehearsal's cell, which has that file name."""
    lines = [
        f"# Made by polishd rehearse {draft.config.path}: the simulated cell of {draft.config.cell.name}.",
        "# Other values come from the cell. All keys: docs/reference/simulator.md",
        *(f"# {note}" for note in draft.notes),
        f"cell = {toml(cell)}",
    ]
    for section, values in draft.sim.items():
        lines += ["", f"[{section}]"]
        lines += [f"{f'{key} = {toml(value)}':<{COLUMN}} # {comment}" for key, (value, comment) in values.items()]
    return "\n".join(lines) + "\n"


def cell_text(draft: RehearsalDraft) -> str:
    """The rehearsal's cell: the cell with its fragments laid over it, its files by absolute paths, and its changes."""
    config = draft.config
    document = tomlkit.parse(config.source.text)
    if document.pop("include", None):  # what fragments say would replace what is changed here
        overlay(document, {key: value for key, value in config.raw.items() if key != "include"})
    for key, value in {**_files(draft), **draft.overrides}.items():
        _set(document, key.split("."), value)
    head = f"# Made by polishd rehearse {config.path}: the same cell, with simulated devices and separate folders.\n"
    return head + "".join(f"# {note}\n" for note in draft.notes) + tomlkit.dumps(document)


def _files(draft: RehearsalDraft) -> dict[str, Any]:
    """Keys of the cell that name files, with absolute paths: the rehearsal's cell lies in another folder."""
    found: dict[str, Any] = {}
    for key in (*FILES, *tool_files(draft.config.tools)):
        *sections, name = key.split(".")
        table: Mapping[str, Any] = draft.config.raw
        for section in sections:
            table = table.get(section, {})
        given = table.get(name)
        if isinstance(given, str):
            found[key] = str(draft.config.resolve(given).absolute())
        elif given:
            found[key] = [str(draft.config.resolve(one).absolute()) for one in given]
    return found


def _set(table: MutableMapping[str, Any], path: list[str], value: Any) -> None:
    """Set, or with None take out, what a dotted key names; tables on the way are made."""
    *way, last = path
    for name in way:
        if name not in table:
            if value is None:
                return
            table[name] = tomlkit.table()
        table = table[name]
    if value is None:
        table.pop(last, None)
    elif isinstance(value, Mapping):
        made = tomlkit.table()
        for key, one in value.items():
            made[key] = one
        table[last] = made
    else:
        table[last] = value


# Where a rehearsal is written: nowhere near what the real cell writes.

FOLDER_KEYS = ("folder", "claimed_dir", "refused_dir", "program_dir")
"""Options of devices that name folders for files of other programs."""


def usual_folder(config: CellConfig) -> Path:
    """Beside the state folder."""
    return config.state_dir.parent / f"{config.path.stem}-rehearsal"


def require_separate_folders(draft: RehearsalDraft, out: Path) -> None:
    """ConfigError where the folder holds, or lies in, what the real cell writes; or where something is in it."""
    mine = out.resolve()
    for what, folder in _of_the_cell(draft):
        theirs = folder.resolve()
        if mine == theirs or mine in theirs.parents or theirs in mine.parents:
            raise ConfigError(
                f"{out}: is, holds or lies in {what} of the real cell ({folder}), which a rehearsal never writes "
                "into; name another folder with --out"
            )
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise ConfigError(
            f"{out}: is there already; start that rehearsal with polishd sim {out / 'sim.toml'}, or name a new folder "
            "with --out"
        )
    require_writable(out)


def _of_the_cell(draft: RehearsalDraft) -> Iterator[tuple[str, Path]]:
    config = draft.config
    yield "the state folder", config.state_dir
    if config.run_dir is not None:
        yield "the run folder", config.run_dir
    for device in config.devices:
        options = draft.options(device)
        for key in FOLDER_KEYS:
            if options.get(key) is not None:
                yield f"{device}.{key}", _folder(config, device, key, options)
        kind, _, rest = str(options.get("delivery", "")).partition(":")
        if kind == "folder" and rest:
            yield f"{device}.delivery", config.resolve(rest)


def _folder(config: CellConfig, device: str, key: str, options: dict[str, Any]) -> Path:
    """What such a key names; folders of maps taken or refused lie in that of the maps."""
    named = str(options[key])
    if port_of(device) == "metrology" and key != "folder":
        return config.resolve(str(options["folder"])) / named
    return config.resolve(named)


# Devices: their addresses, and substitutes for types that are not simulated.

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
            draft.overrides[f"{device}.{key}"] = str(draft.config.resolve(options[key]).absolute())


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
OTHER_LANGUAGES = (
    "fanuc-tp", "heidenhain", "inform", "kawasaki-as", "krl", "melfa-basic", "rapid", "urscript", "val3",
)  # fmt: skip
CONTROLLER_LANGUAGES: Mapping[str, str] = {"inform": "yaskawa-inform", "val3": "staubli-val3"}
"""Languages that the simulated controller of plc_robot reads over opcua, with the profile of its variables."""
HSES_PROFILE = "yaskawa-hses"
"""Profile of its variables over hses."""
LANGUAGE_SPEED = 4.0
"""As of other robots with a move and a wait at each point."""
MOST_REPORT_MS = 160.0
"""Process time between two reports of a simulated controller up to which stops are seen soon enough."""
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
    add = {
        "linuxcnc": _linuxcnc,
        "universal_robots": _universal_robots,
        "abb_rws": _abb_rws,
        "fanuc_rmi": _fanuc_rmi,
        "plc_robot": _plc_robot,
        "kuka_kvp": _kuka_kvp,
    }
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
    elif kind == "plc_robot" and named in CONTROLLER_LANGUAGES:
        return  # by the file's ending
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
    draft.overrides |= {
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
    draft.overrides |= {
        f"{device}.dashboard_port": free_port(),
        f"{device}.primary_port": free_port(),
    }
    if options["first_register"] != FIRST_REGISTER:
        draft.instead(f"{device}.first_register", FIRST_REGISTER, "the simulated arm is watched at that register")


ABB_NAMES = {"task": "T_ROB1", "mechanical_unit": "ROB_1", "watch_task": "T_POLISHD", "home": "$HOME"}
"""Names in the simulated ABB controller."""


def _abb_rws(draft: RehearsalDraft, device: str) -> None:
    options = draft.options(device)
    draft.overrides |= {f"{device}.{key}": None for key in ("user", "password", "certificate")}
    for key, name in ABB_NAMES.items():
        if options[key] != name:
            draft.instead(f"{device}.{key}", name, "is the name in the simulated controller")


def _fanuc_rmi(draft: RehearsalDraft, device: str) -> None:
    draft.notes.append(f"{device}: in real time, because answers to instructions carry no clock of the controller")


def _kuka_kvp(draft: RehearsalDraft, device: str) -> None:
    draft.overrides[f"{device}.delivery"] = f"folder:{SIM_STATE}/programs"


def _plc_robot(draft: RehearsalDraft, device: str) -> None:
    options, port = draft.options(device), free_port()
    profile = load_controller_profile(options["profile"], draft.config.base_dir)
    language = draft.config.program.format
    named = CONTROLLER_LANGUAGES.get(language, f"plc-{profile.link}")
    if profile.link == "hses":
        if language != "inform":
            raise draft.config.error(
                "program.format", f"is {language!r}; the simulated controller reads inform only over hses"
            )
        named = HSES_PROFILE
    usual = load_controller_profile(named, CONTROLLER_PROFILE_DIR)
    if profile.link != usual.link:
        raise draft.config.error(
            f"{device}.profile", f"the simulated controller reads {language!r} over {usual.link} only. Post it as rs274"
        )
    most = LANGUAGE_SPEED if language in CONTROLLER_LANGUAGES else draft.sim["plant"]["speed"][0]
    speed = min(most, round(MOST_REPORT_MS / profile.report_ms, 1))
    why = f"--speed: reports every {profile.report_ms:g} ms of wall time are late by as much"
    if usual.variables.clock is None:
        speed, why = 1.0, f"--speed: {profile.link} carries no clock of the controller"
    draft.put("plant", "speed", speed, why)
    if profile.variables != usual.variables or profile.program != usual.program:
        draft.files["controller.toml"] = _with_its_times(profile, usual)
        why = f"{options['profile']}: the simulated controller has the variables of {named}, and the times of"
        draft.instead(f"{device}.profile", "controller.toml", f"{why} yours")
        if language not in ("rs274", *CONTROLLER_LANGUAGES):
            draft.instead("program.format", "rs274", f"the lines of {named} are RS274")
    elif options["profile"].endswith(".toml"):
        draft.overrides[f"{device}.profile"] = str(draft.config.resolve(options["profile"]).absolute())
    host = f"127.{port // 256}.{port % 256}.1"
    address = {
        "opcua": f"opc.tcp://{LOOPBACK}:{port}",
        "ads": f"ads://{host}/{host}.1.1:851",
        "hses": f"hses://{LOOPBACK}:{port}",
    }
    draft.overrides[f"{device}.address"] = address.get(profile.link, f"tcp://{LOOPBACK}:{port}")
    draft.overrides[f"{device}.delivery"] = f"folder:{SIM_STATE}/programs"
    for key in NOT_SIMULATED:
        draft.overrides[f"{device}.{key}"] = None
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
    address = draft.overrides.get(f"{first}.address") or draft.overrides[first]["address"]
    for device in others:
        if draft.device_type(device).simulated_by == draft.device_type(first).simulated_by:
            draft.overrides[f"{device}.address"] = address
        else:
            draft.replace_device(device, address=address)
    if others:
        draft.notes.append(f"{', '.join(devices)}: one simulated monitor has the signals of all, at one address")
    for name, signal in draft.config.signals.items():
        channel = signal.signal or name
        if _NO_NAME.search(channel):
            why = "a name at the simulated monitor has no such characters"
            draft.instead(f"signals.{name}.signal", _NO_NAME.sub("_", channel), why)
