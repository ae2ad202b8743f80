"""Questions for the answers, one by one: each has a default, and one line that gives its reason."""

from __future__ import annotations

import os
import tomllib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from polishd.commissioning.init.answers import Answers, MakerKeys, answers_of
from polishd.commissioning.init.arms import ARMS
from polishd.commissioning.init.connected import Connected, missing_of
from polishd.commissioning.init.draft import ASSUMED, PART, draft_cell
from polishd.commissioning.init.makers import MAKERS, WHERE
from polishd.config.cell_sections import JobSection, PartSection
from polishd.config.process_sections import MeasuredSection, ProcessSection, SerialSection
from polishd.config.toml_loader import in_words, meanings
from polishd.maps.map_files import MapSource
from polishd.model.errors import ConfigError, SurfaceError
from polishd.plugin_loader import Hooks
from polishd.util.files import named_path
from polishd.util.serialization import toml

ANSWERS = "answers.toml"
SKIP = ""
"""The default of what may be left out."""
PATHS = ("instrument.sample", "part.polygon_file", "kinematics.table", "actuator.eds", "spindle.eds", "spot.file",
         "spot.before", "spot.after")  # fmt: skip
"""Answers that name existing files: typed relative to the present folder, stored relative to the answers' folder."""
SHAPES = {"round": "aperture_mm", "rectangle": "rectangle_mm", "hexagon": "hexagon_mm", "polygon": "polygon_file"}
USUAL: Mapping[str, Any] = {
    "aperture_mm": 100.0,
    "rectangle_mm": [40.0, 24.0],
    "hexagon_mm": 30.0,
    "polygon_file": "corners.csv",
}
SURFACES = ("flat", "sphere", "asphere")
OTHER = "other"
"""A robot of another maker."""
MAKER_KEYS = ("address", "delivery", "program_dir")
SPOTS = ("none", "maps", "file")


@dataclass(frozen=True, slots=True)
class Question:
    """One thing to be answered."""

    key: str
    """Dotted, of the answers; one that begins with a ``?`` only chooses the next questions."""
    why: str
    default: Any = SKIP
    choices: tuple[str, ...] = ()
    text: bool = False
    """Taken as it is written; else what TOML reads as a value is one."""
    needed: bool = False
    """It cannot be left out."""


Prompt = Callable[[Question, str], str]
"""(question, problem of the last answer) -> the answer as it was typed."""


def ask_questions(folder: Path, connected: Connected, hooks: Hooks, prompt: Prompt) -> Answers:
    """Return all answers; each is checked as those of a file, and the question is repeated where it is wrong."""
    answers: dict[str, Any] = {}
    for question in questions(answers, connected, hooks, folder):
        problem = ""
        while True:
            value = _value(question, prompt(question, problem), folder)
            if value != SKIP:
                _set_answer(answers, question.key, value)
            problem = _problem(answers, question, value, folder, hooks)
            if not problem:
                break
            _set_answer(answers, question.key, None)
    return answers_of(answers_text(_without_defaults(answers)), folder / ANSWERS)


def _without_defaults(answers: Mapping[str, Any]) -> dict[str, Any]:
    """Without the defaults of `polishd init`: a value taken with Return still has to be checked."""
    changed: dict[str, Any] = {}
    for name, section in answers.items():
        own = ASSUMED.get(f"{name}.type", (None,))[0]
        if isinstance(section, str) or section.get("type", own) != own:  # the default of one type is given for another
            changed[name] = section
        else:
            changed[name] = {key: value for key, value in section.items() if _unusual(f"{name}.{key}", value)}
    return changed


def _unusual(key: str, value: Any) -> bool:
    return key not in ASSUMED or ASSUMED[key][0] != value


def questions(
    answers: Mapping[str, Any], connected: Connected, hooks: Hooks, folder: Path = Path()
) -> Iterator[Question]:
    """Yield each question; which one is next depends on the ``answers`` so far, which the caller completes in between.

    ``folder``: where files that answers name are looked for.
    """
    yield from _of_robot(answers)
    first = connected.serial[0].path if connected.serial else ""
    serial = f"serial:{first}?baud=115200" if first else ASSUMED["actuator.address"][0]
    can = f"socketcand://127.0.0.1:29536/{connected.can[0]}" if connected.can else ASSUMED["spindle.address"][0]
    connected_to = {"": serial, "slcan": can}
    for port in ("robot", "actuator", "spindle") if answers["?maker"] == OTHER else ("actuator", "spindle"):
        yield from _of_device(port, answers, hooks, connected_to)
    sample = str(connected.maps[0].sample) if connected.maps else SKIP
    maps = str(connected.maps[0].folder.absolute()) if connected.maps else ASSUMED["metrology.folder"][0]
    yield Question("instrument.sample", "A map of the instrument: its profile is begun from it.", sample, text=True)
    yield from _of_sample(answers, folder)
    yield Question("metrology.folder", "Where the instrument leaves its maps.", maps, text=True)
    yield from _of_part(answers)
    yield from _of_process(answers)
    yield _of("job.tolerance_nm", JobSection, ASSUMED["job.tolerance_nm"][0])


def _of_sample(answers: Mapping[str, Any], folder: Path) -> Iterator[Question]:
    """What its file does not say, and no map can be used without."""
    name = answers.get("instrument", {}).get("sample")
    if not name:
        return
    try:
        surface = MapSource.of().read(Path(os.path.normpath(folder.absolute() / name)))  # the folder is not there yet
    except SurfaceError:  # the check of the answers reports it
        return
    match missing_of(surface):
        case "sample_units":
            why = f"{Path(name).name} does not say its units: of its places and its heights."
            yield Question("instrument.sample_units", why, "mm,nm", text=True, needed=True)
        case "sample_pitch_mm":
            why = f"{Path(name).name} has no lateral scale: width of a pixel on the part, mm."
            yield Question("instrument.sample_pitch_mm", why, needed=True)


def _of(key: str, model: type[BaseModel], default: Any = SKIP, *, text: bool = False) -> Question:
    return Question(key, in_words(meanings(model)[key.rpartition(".")[2]]), default, text=text)


def _of_robot(answers: Mapping[str, Any]) -> Iterator[Question]:
    makers = tuple(MAKERS)
    yield Question("?maker", "Maker of the robot; other: you name geometry and driver.", OTHER, (*makers, OTHER))
    maker = None if answers["?maker"] == OTHER else MAKERS[answers["?maker"]]
    kinds = ("hybrid", *ARMS, "serial", "measured") if maker is None or not maker.arms else (*maker.arms, "serial")
    yield Question("?robot", "Its geometry; serial: an arm whose rows you fill in; measured: a table.", kinds[0], kinds)
    if answers["?robot"] == "measured":
        yield _of("kinematics.table", MeasuredSection, "compliance.csv", text=True)
    elif answers["?robot"] != "hybrid":
        yield _of("kinematics.tool_length_mm", SerialSection, 150.0)
    if maker is None:
        return
    for name, value in maker.device.items():
        if name in MAKER_KEYS:
            yield Question(f"robot.{name}", WHERE.capitalize() + ".", value, text=True)
    if maker.frame is not None:
        yield _of(f"robot.{maker.frame.key}", MakerKeys)


def _of_device(
    port: str, answers: Mapping[str, Any], hooks: Hooks, connected_to: Mapping[str, str]
) -> Iterator[Question]:
    """Type of a port's device and the required keys of that type; ``connected_to``: address by scheme."""
    types = {name: kind for name, kind in hooks.device_types().items() if kind.port == port}
    proposed, why = ASSUMED[f"{port}.type"]
    yield Question(f"{port}.type", why.capitalize() + ".", proposed, tuple(sorted(types)))
    kind = types[answers[port]["type"]]
    docs = meanings(kind.options)
    for name, field in kind.options.model_fields.items():
        if field.is_required():
            key, usual = f"{port}.{name}", kind.usual_address
            assumed = ASSUMED.get(key, (SKIP,))[0] if kind.name == proposed else SKIP
            connected = connected_to.get(usual.partition(":")[0], usual)
            default = connected if name == "address" else SKIP if key in PATHS else assumed
            why = in_words(docs.get(name, ""))
            yield Question(key, why, default, text=field.annotation is str, needed=assumed == SKIP or name == "address")


def _of_part(answers: Mapping[str, Any]) -> Iterator[Question]:
    sample = "sample" in answers.get("instrument", {})
    yield _of("part.id", PartSection, SKIP if sample else PART, text=True)
    yield Question("?shape", "Its outline.", "round", tuple(SHAPES))
    name = SHAPES[answers["?shape"]]
    size = SKIP if sample and name == "aperture_mm" else USUAL[name]
    yield _of(f"part.{name}", PartSection, size, text=name == "polygon_file")
    if name == "aperture_mm":
        yield _of("part.hole_mm", PartSection)
    yield Question("?surface", "What is polished.", "flat", SURFACES)
    if answers["?surface"] != "flat":
        yield _of("part.curvature_radius_mm", PartSection, 800.0)
    if answers["?surface"] == "asphere":
        yield _of("part.conic", PartSection, -1.0)
        yield _of("part.even", PartSection)
    if answers["?surface"] != "flat":
        yield _of("part.off_axis_mm", PartSection)
    yield _of("part.origin_mm", PartSection)


def _of_process(answers: Mapping[str, Any]) -> Iterator[Question]:
    for name in ("tool_radius_mm", "tool_modulus_mpa", "force_n", "rpm", "dip_deg"):
        yield _of(f"process.{name}", ProcessSection, ASSUMED[f"process.{name}"][0])
    yield Question("?spot", "Whether a removal spot was measured: two maps, or a file of its rate.", "none", SPOTS)
    if answers["?spot"] == "maps":
        yield Question("spot.before", "Map before the spot.", "before.dat", text=True)
        yield Question("spot.after", "Map after it.", "after.dat", text=True)
        yield Question("spot.seconds", "Time on the spot, s.", 60.0)
    elif answers["?spot"] == "file":
        yield Question("spot.file", ".npz of polishd calibrate tif, or rows of nm/s.", "spot.npz", text=True)
        if not answers["spot"]["file"].endswith(".npz"):
            yield Question("spot.pitch_mm", "Its pitch, mm.", 0.1)
    else:
        yield _of("process.preston", ProcessSection, ASSUMED["process.preston"][0], text=True)


def _value(question: Question, typed: str, folder: Path) -> Any:
    typed = typed.strip()
    if question.key in PATHS and typed:
        return Path(os.path.relpath(named_path(Path.cwd(), typed), folder.absolute())).as_posix()
    if question.text or question.choices or not typed:
        return typed
    try:
        return tomllib.loads(f"value = {typed}")["value"]
    except tomllib.TOMLDecodeError:
        return typed


def _set_answer(answers: dict[str, Any], key: str, value: Any) -> None:
    """Lay a value into its section; None takes it out."""
    if key.startswith("?"):
        answers[key] = value
        if key == "?maker" and value not in (None, OTHER):
            answers["robot"] = {"maker": value}
        if key == "?robot" and value is not None:
            answers["kinematics"] = {"arm": value} if value in ARMS else {"type": value}
        return
    section, _, name = key.partition(".")
    table = answers.setdefault(section, {})
    table.pop(name, None)
    if value is not None:
        table[name] = value


def _problem(answers: Mapping[str, Any], question: Question, value: Any, folder: Path, hooks: Hooks) -> str:
    """What is wrong with this answer; empty where nothing is. What others lack is not its fault."""
    if value == SKIP:
        return "cannot be left out" if question.needed else ""
    if question.choices:
        return "" if value in question.choices else f"{value!r} is none of {', '.join(question.choices)}"
    try:
        draft_cell(answers_of(answers_text(answers), folder / ANSWERS), folder, hooks).judged()
    except ConfigError as error:
        here = [line for line in str(error).splitlines() if f" {question.key}: " in line]
        return "\n".join(line.partition(f" {question.key}: ")[2] for line in here)
    return ""


def answers_text(answers: Mapping[str, Any]) -> str:
    """As a file of answers."""
    lines = ["# Answers of polishd init; repeat: polishd init DIR --from this file (docs/how-to/new-cell.md)"]
    for name, section in answers.items():
        if name.startswith("?") or not section:
            continue
        lines += ["", f"[{name}]", *(f"{key} = {toml(value)}" for key, value in section.items())]
    return "\n".join(lines) + "\n"
