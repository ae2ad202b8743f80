"""Values of a new cell: answers, and defaults with a note on what to check."""

from __future__ import annotations

import os
import re
import textwrap
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel
from scipy.spatial.transform import Rotation

from polishd.commissioning.init.answers import Answers
from polishd.commissioning.init.arms import ARMS, UNKNOWN_N_MM_PER_RAD, as_if_rigid
from polishd.commissioning.init.connected import SampleMap
from polishd.commissioning.init.makers import MAKERS, WHERE, RobotMaker
from polishd.config.cell import FILES, PORTS, CellConfig, consistent, device_options
from polishd.config.fields import LONGEST_NAME, OUTLINES
from polishd.config.process_sections import HybridSection, MeasuredSection, SerialSection
from polishd.config.toml_loader import TomlDocument, in_words, meanings, section_of, toml_type
from polishd.drivers.cia402.device_types import SIMULATED_EDS, SIMULATED_SPINDLE
from polishd.model.process import SerialRobot
from polishd.plugin_loader import Hooks
from polishd.process.robot.serial import chain
from polishd.process.toolpath.apertures import on_optic
from polishd.util.files import named_path
from polishd.util.serialization import toml

ALWAYS = ("rnc_robot", "interferometer", "removal_models", "dwell_solvers", "plan_checks", "run_report")
"""Plugins that every cell needs."""
PROGRAM = "program.rnc"
PROFILE = "instrument.toml"
PART = "PART-1"
EDS = "drive.eds"
OF_A_TYPE = ("address", "eds", "node", "rpm_per_unit")
"""Keys that are assumed for the usual type of a device only."""
AROUND_MM = 15.0
"""How far beside the part the tool goes: turns and landing of a path, and some room."""
ABOVE_MM = 60.0
BLANK_ARM = ("dh", "joint_limits_deg", "home_deg")
"""Values of an arm that only its data sheet has."""
STIFFNESS = "kinematics.joint_stiffness_n_mm_per_rad"
NOT_MEASURED = "not the arm's: as if nearly rigid; polishd calibrate stiffness fits them"

DATA_SHEET = "from the machine's data sheet, on the safe side"
PAPER = "the paper's; your tool's is another"
UNMEASURED = (
    "without loading tests and a measured rate a correction costs more than it brings "
    "(docs/explanation/correction.md). Next: the "
    "rate of a witness spot, polishd calibrate tif"
)
ASSUMED: Mapping[str, tuple[Any, str]] = {
    "cell.state_dir": ("state", ""),
    "robot.type": ("robot_link", "link to the robot's controller"),
    "robot.address": ("tcp://robot-controller:28500", "address of the robot's controller"),
    "actuator.type": ("voice_coil_modbus", "protocol of the actuator"),
    "actuator.address": ("serial:/dev/ttyUSB0?baud=115200", "port of the actuator"),
    "spindle.type": ("cia402_spindle", "protocol of the spindle's drive"),
    "spindle.address": ("slcan:/dev/ttyACM0?bitrate=500000", "port of the spindle's drive"),
    "spindle.eds": (EDS, "the simulated drive's. Replace it by the EDS file of your drive, from its maker"),
    "spindle.node": (SIMULATED_SPINDLE["node"], "CANopen node number of your drive"),
    "spindle.rpm_per_unit": (SIMULATED_SPINDLE["rpm_per_unit"], "unit of your drive's speeds, as it is parametrized"),
    "metrology.type": ("watched_folder", ""),
    "metrology.folder": ("maps", "folder into which the instrument writes its maps"),
    "part.edge_mm": (3.0, "edge zone that the drawing excludes"),
    "kinematics.type": ("hybrid", "the paper's robot, which is not yours"),
    "process.removal_model": ("hertz_preston", ""),
    "process.correction": ("none", UNMEASURED),
    "process.tool_radius_mm": (20.0, PAPER),
    "process.tool_modulus_mpa": (29.6, PAPER),
    "process.force_n": (12.0, PAPER),
    "process.rpm": (1000.0, PAPER),
    "process.dip_deg": (15.0, PAPER),
    "process.preston": ("1.49e-9 cm2/N", PAPER + ": polishd calibrate tif measures it"),
    "process.grid_mm": (0.5, ""),
    "machine.max_feed_mm_s": (50.0, DATA_SHEET),
    "machine.min_feed_mm_s": (0.5, DATA_SHEET),
    "machine.accel_mm_s2": (800.0, DATA_SHEET),
    "job.tolerance_nm": (5.0, "tolerance of the drawing"),
    "job.max_cycles": (4, ""),
}
"""By dotted key: a value that a cell may begin with, and what has to be looked at about it; empty: nothing."""
ORDER = (
    "cell", "plugins", "robot", "actuator", "spindle", "metrology", "loader", "force_sensor", "monitor", "signals",
    "roles", "instrument", "part", "kinematics", "compliance", "process", "program", "machine", "dwell", "touch_off",
    "part_handling", "job", "tolerance", "limits", "notify",
)  # fmt: skip
"""Of the sections, as in examples/cell.toml."""


class _ArmDocument(TomlDocument):
    """Values that are needed to place a part in front of an arm."""

    kinematics: SerialSection


@dataclass(slots=True)
class CellDraft:
    """A cell that is being made in a folder."""

    answers: Answers
    folder: Path
    """Where it will stand, absolute."""
    hooks: Hooks
    raw: dict[str, Any] = field(default_factory=dict)
    """Its values by section, as a cell's file has them."""
    assumed: dict[str, str] = field(default_factory=dict)
    """Defaults by dotted key, with the note on what to check."""
    blank: tuple[str, ...] = ()
    """Dotted keys that a person has to fill in; meanwhile comments show those of some arm."""
    files: dict[str, bytes] = field(default_factory=dict)
    """What is written beside the cell, by name."""

    @property
    def maker(self) -> RobotMaker | None:
        """The robot's maker, if it is answered."""
        name = self.answers.own.robot.maker
        return None if name is None else MAKERS[name]

    @property
    def arm(self) -> str | None:
        """The arm of the answers, or the usual one of the maker without an answer."""
        arm, kinematics = self.answers.own.kinematics.arm, self.answers.cell.get("kinematics", {})
        if arm is None and self.maker is not None and "type" not in kinematics:
            return next(iter(self.maker.arms), None)
        return arm

    def has(self, key: str) -> bool:
        """Whether a dotted key has a value."""
        section, _, name = key.partition(".")
        return name in self.raw.get(section, {})

    def assume(self, key: str, value: Any, why: str = "") -> None:
        """Set a default if there is no answer; ``why`` is the note on what to check."""
        if not self.has(key):
            section, _, name = key.partition(".")
            self.raw.setdefault(section, {})[name] = value
            if why:
                self.assumed[key] = why

    def judged(self) -> CellConfig:
        """The cell as far as it is; ConfigError with lines of the answers where they are wrong."""
        config = consistent(CellConfig.of(self.raw, self.answers.source))
        for device in config.devices:
            device_options(config, device, self.hooks.device_types())
        return config

    def rebase(self) -> None:
        """Paths of files, which start from the answers' folder, start from the cell's."""
        named = [*FILES, *(f"{port}.{key}" for port in PORTS for key in ("eds", "profile"))]
        for key in named:
            section, _, name = key.partition(".")
            given = self.answers.cell.get(section, {})
            if isinstance(given, Mapping) and name in given:
                value = given[name]
                many = isinstance(value, list)
                moved = [self._moved(one) for one in (value if many else [value])]
                self.raw[section][name] = moved if many else moved[0]

    def _moved(self, given: str) -> str:
        path = named_path(Path(), given)
        there = self.answers.folder / path
        if path.is_absolute() or not there.exists():  # a name of polishd's own, or what its reader will miss
            return given
        return Path(os.path.relpath(there, self.folder)).as_posix()


def draft_cell(answers: Answers, folder: Path, hooks: Hooks, sample: SampleMap | None = None) -> CellDraft:
    """The cell of these answers, its files' paths still from the answers' folder; ConfigError as of `judged`.

    ``hooks`` has the plugins among which the answers choose: polishd's own.
    """
    draft = CellDraft(answers, folder.absolute(), hooks)
    for name, section in answers.cell.items():
        draft.raw[name] = dict(section) if isinstance(section, Mapping) else section
    for section in dict.fromkeys(key.partition(".")[0] for key in (*ASSUMED, "plugins.load", "instrument.profile")):
        if not isinstance(given := draft.raw.setdefault(section, {}), dict):
            raise answers.own.error(section, f"must be a section, [{section}], not {given!r}")
    _assume_maker(draft)
    _assume_names(draft, sample)
    _assume_robot(draft)
    robot = draft.hooks.device_types().get(draft.raw["robot"].get("type"))
    draft.assume("program.format", (robot and robot.program_format) or "rs274")
    for key, (value, why) in ASSUMED.items():
        port, _, name = key.partition(".")
        if name in OF_A_TYPE and f"{port}.type" not in draft.assumed and not _is_usual(draft, port):
            continue  # of another type, whose own check names what is missing
        if not _is_answered_elsewhere(draft, key):
            draft.assume(key, value, why)
    if "spindle.eds" in draft.assumed:
        draft.files[EDS] = SIMULATED_EDS.read_bytes()
    draft.assume("plugins.load", _plugins(draft))
    _assume_ranges(draft)
    return draft


def _assume_maker(draft: CellDraft) -> None:
    """Driver, program and frame of a robot of a known maker."""
    own, maker = draft.answers.own, draft.maker
    if maker is None:
        return
    if "type" in draft.raw["robot"]:
        raise own.error("robot.type", "maker names the driver; remove one of both")
    for key, value in maker.device.items():
        draft.assume(f"robot.{key}", value, WHERE if key in ("address", "delivery", "program_dir") else "")
    draft.assume("program.format", maker.format)
    draft.assume("program.path", maker.program)
    for key, (value, why) in maker.assumed.items():
        draft.raw.setdefault(key.partition(".")[0], {})
        draft.assume(key, value, why)
    if own.kinematics.arm is None and draft.arm is not None:
        draft.assumed["kinematics.type"] = f"a usual arm; others: {', '.join(ARMS)}, or your arm's rows"
    if (given := own.robot.given_frame) is not None:
        form, values = given
        for key, value in zip(("origin_mm", "rotation_rpy_deg"), form.placement(values), strict=True):
            if draft.has(f"part.{key}"):
                raise own.error(f"robot.{form.key}", f"is the part's place, as is part.{key}; remove one of both")
            draft.raw["part"][key] = value


def _is_usual(draft: CellDraft, port: str) -> bool:
    return bool(draft.raw[port].get("type") == ASSUMED[f"{port}.type"][0])


def _is_answered_elsewhere(draft: CellDraft, key: str) -> bool:
    """Return whether another answer already determines this key."""
    if key == "job.tolerance_nm":
        return "tolerance" in draft.raw
    if key.endswith(".type") and (port := key.partition(".")[0]) in PORTS:
        return any(isinstance(value, Mapping) for value in draft.raw[port].values())  # several, by names
    return False


def _assume_names(draft: CellDraft, sample: SampleMap | None) -> None:
    part = draft.raw["part"]
    if sample is not None:
        if not any(key in part for key in OUTLINES):
            draft.assume("part.aperture_mm", sample.aperture_mm, f"as wide as {sample.name} shows data")
        if sample.part_id:
            draft.assume("part.id", sample.part_id, f"as {sample.name} names it")
    draft.assume("part.id", PART, "the name that its maps must give")
    draft.assume("cell.name", _as_name(draft.folder.name) or "cell")
    draft.assume("job.id", _as_name(str(part["id"])) or "job")
    draft.assume("program.path", PROGRAM)
    draft.assume("instrument.profile", PROFILE)


def _as_name(text: str) -> str:
    """Return a text in the characters of names of cells and jobs; empty if it has none of them."""
    return re.sub(r"[^\w.-]+", "-", text, flags=re.ASCII).strip("-._")[:LONGEST_NAME]


def _assume_robot(draft: CellDraft) -> None:
    """Its geometry, and a place of the part that it reaches."""
    kinematics = draft.raw["kinematics"]
    arm = draft.arm
    if arm is not None and kinematics.get("type", "serial") != "serial":
        raise draft.answers.own.error("kinematics.arm", 'goes with type = "serial", and says that itself; drop type')
    if arm is None and kinematics.get("type") == "serial" and "dh" not in kinematics:
        arm = next(iter(ARMS))
        unknown = [f"kinematics.{key}" for key in BLANK_ARM if key not in kinematics]
        draft.blank = (*unknown, *(() if draft.has("part.origin_mm") else ("part.origin_mm",)))
    if arm is not None:
        for key, value in ARMS[arm].keys().items():
            draft.assume(f"kinematics.{key}", value)
    where = "measured in the robot's base frame, on the real part's seat"
    if kinematics.get("type") == "serial":
        draft.assume("kinematics.tool_length_mm", 150.0, "measured: flange to the tool's tip")
        draft.assume(STIFFNESS, _rigid(draft), NOT_MEASURED)
        draft.assume("part.origin_mm", _home_mm(draft), f"{where}; here: under the tool with the arm at home")
        draft.assume("part.rotation_rpy_deg", [0.0, 0.0, 0.0], f"{where}; here: facing up, base z up")
    else:
        draft.assume("part.origin_mm", [300.0, 220.0, 2315.0], where)
        draft.assume("part.rotation_rpy_deg", [180.0, 0.0, 0.0], f"{where}; here: facing up, base z down")


def _rigid(draft: CellDraft) -> tuple[float, ...]:
    """Return stiffnesses of an unmeasured arm, from its rows if they are known and valid."""
    dh, tool_mm = draft.raw["kinematics"].get("dh"), draft.raw["kinematics"].get("tool_length_mm")
    numbers = [tool_mm, *(value for row in dh for value in row)] if _are_rows(dh) else []
    if "kinematics.dh" in draft.blank or not numbers or not all(isinstance(value, int | float) for value in numbers):
        return (UNKNOWN_N_MM_PER_RAD,) * 6
    return as_if_rigid(dh, tool_mm)


def _are_rows(dh: Any) -> bool:
    """Return whether these are rows of four; the cell's validation reports other faults."""
    return isinstance(dh, list | tuple) and all(isinstance(row, list | tuple) and len(row) == 4 for row in dh)


def _home_mm(draft: CellDraft) -> list[float]:
    """The tool's tip with the arm at home."""
    arm = _ArmDocument.of({"kinematics": draft.raw["kinematics"]}, draft.answers.source)
    robot = SerialRobot(**{name: value for name, value in arm.kinematics if name != "type"})
    tip = chain(robot, np.radians([robot.home_deg])).tip_mm[0]
    return [round(float(value), 1) + 0.0 for value in tip]


def _plugins(draft: CellDraft) -> list[str]:
    """Those that every cell needs, and those that bring the device types that were named."""
    types = draft.hooks.device_types()
    named = [
        one.get("type")
        for port in PORTS
        for one in (draft.raw.get(port, {}), *_tables(draft.raw.get(port, {})))
        if isinstance(one, Mapping)
    ]
    plugins = [draft.hooks.plugin_of("polishd_device_types", name) for name in named if name in types]
    notifiers = ["notifications"] if "notify" in draft.raw else []
    return list(dict.fromkeys([ALWAYS[0], *plugins, *ALWAYS[1:], *notifiers]))


def _tables(section: Any) -> list[Any]:
    return list(section.values()) if isinstance(section, Mapping) else []


def _assume_ranges(draft: CellDraft) -> None:
    """Where the tool may go, from the part."""
    provisional = {**draft.raw["machine"], **{f"{axis}_mm": [-1.0, 1.0] for axis in "xyz"}}
    machine, draft.raw["machine"] = draft.raw["machine"], provisional
    config = draft.judged()
    draft.raw["machine"] = machine
    outline, optic = config.outline(), config.optic()
    seen = np.vstack([np.zeros((1, 2)), outline.corners(), outline.corners() * (1 + AROUND_MM / outline.radius_mm)])
    back = Rotation.from_euler("z", -config.program.rotation_deg, degrees=True)
    there = back.apply(on_optic(optic, seen) - np.asarray(config.program.offset_mm))  # in the program's frame
    room = np.array([[-1.0, -1.0, -1.0], [1.0, 1.0, ABOVE_MM]])
    low, high = np.floor(there.min(axis=0)) + room[0], np.ceil(there.max(axis=0)) + room[1]
    for at, axis in enumerate("xyz"):
        limits = [float(low[at]), float(high[at])]
        draft.assume(f"machine.{axis}_mm", limits, "range of the part with a margin")


# A new cell as text: each key with its meaning behind it, and above it what has to be looked at.

FILL_IN = "to be filled in, from the arm's data sheet; here that of another arm"
WIDTH = 120
COLUMN = 36
"""In which meanings begin, where a value leaves room."""
ASSUMED_MARK = "# TODO: assumed, check: "
KINDS: Mapping[str, type[BaseModel]] = {"hybrid": HybridSection, "serial": SerialSection, "measured": MeasuredSection}
ROW = "a_mm, alpha_deg, d_mm, theta_deg with joint {} at 0"


def cell_text(draft: CellDraft) -> str:
    """The cell's file."""
    lines = [
        "# A polishd cell, made by polishd init. Relative paths start from this file's folder. TODO: the next key is",
        "# assumed: correct it, remove the TODO line. All keys with unit, default and range: docs/reference/cell.md",
        *(f"{name} = {toml(value)}" for name, value in draft.raw.items() if not _is_section(value)),
    ]
    places = {name: place for place, name in enumerate(ORDER)}
    for name, section in sorted(draft.raw.items(), key=lambda item: places.get(item[0], len(places))):
        if isinstance(section, Mapping):
            if section:
                lines += ["", f"[{name}]", *_keys(draft, name, section)]
        elif _is_section(section):
            for one in section:
                lines += ["", f"[[{name}]]", *(f"{key} = {toml(value)}" for key, value in one.items())]
    return "\n".join(lines) + "\n"


def _is_section(value: Any) -> bool:
    return isinstance(value, Mapping) or (
        isinstance(value, list) and bool(value) and all(isinstance(one, Mapping) for one in value)
    )


def _keys(draft: CellDraft, name: str, section: Mapping[str, Any]) -> Iterator[str]:
    docs = _meanings(draft, name, section)
    if (arm := draft.arm) and name == "kinematics":
        yield f"# {ARMS[arm].title}. Rows: {ARMS[arm].source}"
    for key, value in sorted(section.items(), key=lambda item: item[0] != "type"):
        blank = f"{name}.{key}" in draft.blank
        why = FILL_IN if blank else draft.assumed.get(f"{name}.{key}")
        if why:
            yield f"{ASSUMED_MARK}{why}"
        lines = _key_lines(key, value, in_words(docs.get(key, "")))
        yield from (f"# {line}" if blank and not line.startswith("#") else line for line in lines)


def _key_lines(key: str, value: Any, meaning: str) -> Iterator[str]:
    """A key's lines: what it means behind it, or above it where there is no room."""
    if key == "dh" and isinstance(value, list | tuple):
        yield from textwrap.wrap(meaning, WIDTH - 2, initial_indent="# ", subsequent_indent="# ")
        yield "dh = ["
        for joint, row in enumerate(value, 1):
            yield f"{f'  {toml(row)},':<{COLUMN}} # {ROW.format(joint)}"
        yield "]"
        return
    line = f"{key} = {toml(value)}"
    beside = f"{line:<{COLUMN}} # {meaning}" if meaning else line
    if len(beside) > WIDTH:
        yield from textwrap.wrap(meaning, WIDTH - 2, initial_indent="# ", subsequent_indent="# ")
        yield line
    else:
        yield beside


def _meanings(draft: CellDraft, name: str, section: Mapping[str, Any]) -> Mapping[str, str]:
    return {} if (model := _model(draft, name, section)) is None else meanings(model)


def _model(draft: CellDraft, name: str, section: Mapping[str, Any]) -> type[BaseModel] | None:
    """Who judges a section; None for a table of several by name."""
    if name in PORTS:
        kind = draft.hooks.device_types().get(section.get("type", ""))
        return None if kind is None else kind.options
    if name == "kinematics":
        return KINDS[section.get("type", "hybrid")]
    return section_of(toml_type(CellConfig.model_fields[name].annotation))
