"""``polishd init``: a new cell from answers.

Where a part lies before the robot of a new cell is assumed, or it is the nearest place that the robot reaches.
"""

from __future__ import annotations

import io
import shlex
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from itertools import product
from pathlib import Path

import numpy as np
import typer
from rich.table import Table

from polishd.commissioning.calibration.fits import SpotPlace, tif_of_maps
from polishd.commissioning.init.answers import Answers, SpotKeys, read_answers
from polishd.commissioning.init.connected import SampleMap, look, profile_text, read_sample
from polishd.commissioning.init.draft import PROFILE, CellDraft, cell_text, draft_cell
from polishd.commissioning.init.questions import ANSWERS, Question, ask_questions
from polishd.commissioning.init.steps import SetupStep, lines, steps
from polishd.config.cell import CellConfig
from polishd.config.fields import OUTLINES
from polishd.config.table_files import read_tif, tif_bytes
from polishd.maps.map_files import MapSource
from polishd.model.errors import ComputeError, ConfigError, PolishdError
from polishd.model.process import HybridRobot, MeasuredCompliance, MeasuredTif, Placement, SerialRobot, Vector
from polishd.model.surface import FloatArray
from polishd.plugin_loader import load_own, plugins_of
from polishd.process.frames import points_to_base
from polishd.process.removal.measured_tif import preston_from_tif
from polishd.process.robot.compliance import reachable
from polishd.process.robot.hybrid import geometry_of, solve_pose
from polishd.process.robot.serial import reach_mm
from polishd.process.toolpath.apertures import on_optic, tool_axes
from polishd.programs.make import make_program, quiet_lines
from polishd.programs.options import MakeOptions
from polishd.rendering.terminal import emit, key_table, stderr, stdout
from polishd.util.files import make_folder, named_path, write_together
from polishd.util.serialization import toml

# Where a part may lie before the robot.

BEYOND_MM = 10.0
"""How far beyond the part's rim the tool has to come: overrun and landing of a made path are 6 mm, and some room."""
OFF_AXIS_MM = 30.0
"""A tool that leans towards the base's z axis turns round over it: a part stays so far off it."""
CLEAR_DEG = 0.5
"""So far a hybrid robot's wrist stays off A = 0: points of a path lie between those that are looked at."""
FINE_MM, COARSE_MM = 5.0, 40.0
"""Distance of the points of a part that are looked at: before a hybrid robot, whose wrist is singular at places only
some mm wide, and before another, whose inverse kinematics takes time."""
FINEST_MM, FEW = 1.0, 8
"""The same where no place is clear of singular poses: then so many are looked at as finely as a path goes."""
RIM_POINTS = 8
"""Looked at first: a place that is out of reach mostly is so at the rim."""
STEP_MM = 50.0, 100.0
"""From one place to the next, away from the base's z axis and along it."""
FAR_MM = 600.0
"""How far from the first place others are looked for."""
SHARES = tuple(share / 10 for share in range(9, 0, -1))
"""Of a part's size, tried in turn where all of it lies nowhere within reach."""
NEAREST = 30, 4
"""Places at which an arm is tried with all of a part, and with each share of it: each out of reach takes a second."""


@dataclass(frozen=True, slots=True)
class Seat:
    """A place of the part's centre in the robot's base frame, and how much of the part is reached there."""

    origin_mm: Vector
    share: float = 1.0
    """Of the part's size that lies within reach."""


def find_seat(config: CellConfig) -> Seat | None:
    """The place nearest to the cell's own where the robot reaches the part, or as much of it as it reaches anywhere.

    None where it reaches nothing of a tenth of the size. The cell's own is taken where it will do.
    """
    reach_check = _ReachCheck(config)
    origins = tuple(_places(config))
    quick = not isinstance(config.robot_model(), SerialRobot)
    for share in (1.0, *SHARES):
        possible = [origin for origin in origins if reach_check.may_reach(origin, share)]
        for origin in possible if quick else possible[: NEAREST[share < 1.0]]:
            if reach_check.reached(origin, share):
                return Seat(origin, share)
        if share == 1.0 and quick and (just := reach_check.just_reached(possible)):
            return Seat(just)
    return None


def reached(config: CellConfig) -> bool:
    """Whether the robot reaches the part where the cell has it."""
    return _ReachCheck(config).reached(config.part.origin_mm, 1.0)


def _places(config: CellConfig) -> Iterator[Vector]:
    """The cell's own first, then others, the nearest to it first."""
    first = np.asarray(config.part.origin_mm, dtype=np.float64)
    yield config.part.origin_mm
    robot = config.robot_model()
    if isinstance(robot, MeasuredCompliance):
        x, y, z = (float(value) for value in robot.tip_mm.mean(axis=0).round(1))
        yield x, y, z
        return
    away = float(np.hypot(*first[:2]))
    bearing = first[:2] / away if away else np.array([1.0, 0.0])
    sides = [np.arange(-FAR_MM, FAR_MM + step / 2, step) for step in STEP_MM]
    moves = sorted(product(*sides), key=lambda move: (np.hypot(move[0], move[1]), move))
    for out, along in moves:
        if away + out >= 0:
            x, y = bearing * (away + out)
            yield round(float(x), 1), round(float(y), 1), round(float(first[2] + along), 1)


class _ReachCheck:
    """A cell's part as points, and whether its robot comes to them with the tool leaning as the cell dips."""

    def __init__(self, config: CellConfig) -> None:
        self._optic, self._options = config.optic(), config.compliance_options()
        self._dip_deg = config.process.dip_deg
        self._rotation = config.placement().rotation
        self._robot = config.robot_model()
        outline = config.outline()
        wider = 1 + BEYOND_MM / outline.radius_mm
        corners = outline.corners()
        self._rim = wider * corners[:: max(1, len(corners) // RIM_POINTS)]
        self._outline, self._wider = outline, wider * corners
        self._all = self._lattice(FINE_MM if isinstance(self._robot, HybridRobot) else COARSE_MM)
        self._clear_deg = CLEAR_DEG

    def _lattice(self, step_mm: float) -> FloatArray:
        """(n, 2) mm: points over the part and somewhat beyond its rim, and on that."""
        half_x, half_y = (half + BEYOND_MM for half in self._outline.half_mm)
        x, y = np.meshgrid(np.arange(-half_x, half_x, step_mm), np.arange(-half_y, half_y, step_mm))
        inside = self._outline.contains(x, y, -BEYOND_MM)
        return np.vstack([self._wider, np.column_stack([x[inside], y[inside]])])

    def just_reached(self, origins: Sequence[Vector]) -> Vector | None:
        """The first of these where the hybrid robot reaches all, however near the wrist comes to a singular pose."""
        self._clear_deg = 0.0
        possible = [origin for origin in origins if self.reached(origin, 1.0)][:FEW]
        self._all = self._lattice(FINEST_MM) if possible else self._all
        return next((origin for origin in possible if self.reached(origin, 1.0)), None)

    def may_reach(self, origin_mm: Vector, share: float) -> bool:
        """Whether an arm as long as this one could: its flange above the rim, whatever its joints bear."""
        if not isinstance(self._robot, SerialRobot):
            return True
        try:
            tip, axis = self._poses(Placement(origin_mm, self._rotation), share * self._rim)
        except ComputeError:
            return False
        tool_mm = self._robot.tool_length_mm
        away = np.linalg.norm(tip + tool_mm * axis, axis=1)
        return bool((away < reach_mm(self._robot) - tool_mm).all())

    def reached(self, origin_mm: Vector, share: float) -> bool:
        """Whether the robot comes to so large a share of the part that lies there."""
        if not self.may_reach(origin_mm, share):
            return False
        lies = Placement(origin_mm, self._rotation)
        try:
            return self._reaches(lies, share * self._rim) and self._reaches(lies, share * self._all)
        except ComputeError:  # the lean has no direction there, or the optic ends
            return False

    def _reaches(self, lies: Placement, seen_mm: FloatArray) -> bool:
        tip, axis = self._poses(lies, seen_mm)
        leans = self._dip_deg > 0 and self._options.dip_direction == "inward"
        if leans and np.hypot(tip[:, 0], tip[:, 1]).min() < OFF_AXIS_MM:
            return False
        if isinstance(self._robot, HybridRobot):
            sine = solve_pose(self._robot, geometry_of(self._robot), tip.T, axis.T).sine
            if sine.min() < np.sin(np.radians(self._clear_deg)):
                return False
        return bool(reachable(self._robot, tip, axis).all())

    def _poses(self, lies: Placement, seen_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(n, 3) tool tips, mm, and (n, 3) tool axes in the base frame over (n, 2) points of the part."""
        points = on_optic(self._optic, seen_mm)
        axis = tool_axes(points, self._optic, self._dip_deg, self._options, lies)
        return points_to_base(lies, points), axis @ self._rotation.T


# A removal spot that was measured, for a new cell: two maps, an ``.npz``, or an array.

SPOT = "spot.npz"


def add_spot(draft: CellDraft, given: SpotKeys, config: CellConfig) -> None:
    """The measured TIF beside the cell, which names it and the Preston constant that goes with it."""
    tif = _tif(given, draft.answers.folder)
    preston = preston_from_tif(config.tool_process(), tif.depth_ratio, tif)
    draft.raw["process"] |= {"removal_model": "measured_tif", "tif": SPOT, "preston": f"{preston:.5g} cm2/N"}
    draft.files[SPOT] = tif_bytes(tif)
    draft.assumed.pop("process.preston", None)


def _tif(given: SpotKeys, folder: Path) -> MeasuredTif:
    if given.file is None:
        maps = (folder / str(given.before), folder / str(given.after))
        place = SpotPlace(given.depth_ratio, given.azimuth_deg, None)
        return tif_of_maps(MapSource.of(), maps, given.seconds or 0.0, place)[0]
    path = named_path(folder, given.file)
    if path.suffix == ".npz":
        return read_tif(path)
    rate = _array(path)
    return MeasuredTif(rate, given.pitch_mm or 0.0, given.azimuth_deg, given.depth_ratio)


def _array(path: Path) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    """(ny, nx) nm/s; ConfigError where the file holds no such array."""
    try:
        content = path.read_bytes()
        if path.suffix == ".npy":
            rate = np.load(io.BytesIO(content), allow_pickle=False)
        else:
            rate = np.loadtxt(io.StringIO(content.decode()), delimiter="," if b"," in content else None, ndmin=2)
    except (OSError, ValueError, EOFError) as error:
        raise ConfigError(f"{path}: is no array of a spot ({error}); give rows of nm/s, row 0 the top") from error
    found = np.asarray(rate, dtype=np.float64) if rate.dtype.kind in "fiu" else np.zeros(0)
    if found.ndim != 2 or not np.isfinite(found).all() or not found.sum() > 0:
        raise ConfigError(f"{path}: must be a table of finite rates, nm/s, that remove something; mend it")
    return found


# The verb ``polishd init``: answers, a cell in a folder, and what is still to be done.

CELL = "cell.toml"
LOOKED = "Connected devices (none was opened):"
LEFT_OUT = "-"
"""Typed where an answer is left out."""
NO_DIALOG = (
    "the input ended before all questions were answered. Nothing was written. Write the answers into a file: "
    "polishd init DIR --from ANSWERS.toml"
)
PITCH_MM = 1.0
"""Most distance of a made program's lines, and the length of its moves."""
RANDOM_PITCH = 0.5
"""Mean line distance of a pseudo-random path, over that of a raster (docs/explanation/ripple.md)."""


@dataclass(frozen=True, slots=True)
class NewCell:
    """What `polishd init` makes; nothing of it is written yet."""

    folder: Path
    files: Mapping[str, bytes]
    """By name in the folder."""
    assumed: Mapping[str, str]
    """By dotted key of the cell's file: why it has to be looked at."""
    blank: tuple[str, ...]
    """Dotted keys that have to be filled in before anything else."""
    program: str
    """What was made, or why none was."""


def init_verb(folder: Path, answers: Path | None, *, dry_run: bool, force: bool, as_json: bool) -> None:
    """Make a cell from answers, with questions where no file has them; write it, and show assumptions and steps.

    Raises:
        ConfigError: answers that are wrong, and maps that they name, with file, line and key; files that are there
            already, without ``force``.
    """
    with stderr.status("looking at what is connected"):
        connected = look(Path())
    if not as_json:
        for line in (LOOKED, *connected.lines()):
            stderr.print(line, markup=False, highlight=False, soft_wrap=True)
    if answers is None:
        _require_new(folder, [ANSWERS], force=force)  # before anybody answers
        help_text = f"Press Enter to accept the value in [ ]. Type {LEFT_OUT} to leave the key out."
        stderr.print(help_text, markup=False, highlight=False)
        given = ask_questions(folder, connected, load_own(), _prompt)
        if not dry_run:
            _write(folder, {ANSWERS: given.source.text.encode()})  # whatever comes of them
    else:
        given = read_answers(answers)
    with stderr.status("making the cell"):
        made = new_cell(given, folder)
    if not dry_run:
        write_cell(made, force=force)
    cell = folder / CELL
    todo = [] if dry_run else steps(cell)
    answer = {
        "cell": str(cell),
        "connected": asdict(connected),
        "written": [] if dry_run else sorted(made.files),
        "texts": {name: text.decode() for name, text in made.files.items() if name.endswith(".toml")},
        "look": dict(made.assumed),
        "fill_in": list(made.blank),
        "program": made.program,
        "todo": [asdict(step) for step in todo],
    }
    emit(answer, as_json=as_json, table=lambda: _table(made, cell, dry_run=dry_run))
    if not as_json:
        _print_result(made, cell, todo, dry_run=dry_run)


def _prompt(question: Question, problem: str) -> str:
    if problem:
        stderr.print(problem, style="red", markup=False, highlight=False, soft_wrap=True)
    among = f" ({', '.join(question.choices)})" if question.choices else ""
    default = question.default if isinstance(question.default, str) else toml(question.default)
    stderr.print(question.why, style="dim", markup=False, highlight=False, soft_wrap=True)
    try:
        reply: str = typer.prompt(question.key.lstrip("?") + among, default or LEFT_OUT, err=True, show_default=True)
    except typer.Abort as error:
        if not isinstance(error.__context__, EOFError):
            raise  # Ctrl-C
        stderr.print()
        raise typer.BadParameter(NO_DIALOG) from error
    return "" if reply == LEFT_OUT else reply


def new_cell(answers: Answers, folder: Path) -> NewCell:
    """The files of a cell of these answers; errors: the verb's. Nothing is written."""
    own = answers.own.instrument
    with _blamed(answers, "instrument.sample"):
        path = None if own.sample is None else named_path(answers.folder, own.sample)
        shown = None if path is None else read_sample(path, own.sample_units, own.sample_pitch_mm)
    draft = draft_cell(answers, folder, load_own(), shown)
    config = draft.judged()
    if shown is not None:
        _require_size_of_part(answers, shown, config)
    if answers.own.spot is not None:
        with _blamed(answers, "spot"):
            add_spot(draft, answers.own.spot, config)
    if draft.raw["instrument"]["profile"] == PROFILE and "profile" not in answers.cell.get("instrument", {}):
        draft.files[PROFILE] = profile_text(shown).encode()
    if _makes_program(draft):
        config = _within_reach(draft, config)
    draft.rebase()
    text = cell_text(draft)
    program_note = _add_program(draft, config)
    files = {CELL: text.encode(), **draft.files}
    return NewCell(draft.folder, files, draft.assumed, draft.blank, program_note)


OTHER_SIZE = 5.0
"""Ratio of the sizes of sample and part beyond which the answered unit or pitch is wrong: no unit is so close to mm."""


def _require_size_of_part(answers: Answers, sample: SampleMap, config: CellConfig) -> None:
    """ConfigError where, with the answered units or pitch, the sample is no map of a part of this size."""
    if sample.pitch_mm is None and sample.coordinate_unit_mm is None:
        return
    shown_mm, part_mm = max(sample.surface.grid.shape) * sample.surface.grid.pitch_mm, max(config.outline().size_mm)
    if not part_mm / OTHER_SIZE <= shown_mm <= part_mm * OTHER_SIZE:
        key = "sample_pitch_mm" if answers.own.instrument.sample_units is None else "sample_units"
        raise answers.own.error(
            f"instrument.{key}",
            f"{sample.name} is then {shown_mm:.4g} mm wide, and the part {part_mm:.4g} mm. Correct {key}, or the size "
            "of the part",
        )


@contextmanager
def _blamed(answers: Answers, key: str) -> Iterator[None]:
    """Report an error of a file at the answer that names it."""
    try:
        yield
    except PolishdError as error:
        raise answers.own.error(key, str(error)) from error


def _makes_program(draft: CellDraft) -> bool:
    """Return whether the answers request a program over the part, and describe the robot well enough to make one."""
    is_requested = draft.answers.own.program.make != "none" and "path" not in draft.answers.cell.get("program", {})
    return is_requested and not draft.blank


def _within_reach(draft: CellDraft, config: CellConfig) -> CellConfig:
    """The cell with its part where the robot reaches all of it: where that was assumed, at the nearest such place.

    ConfigError where there is none. A place that was answered stays as it is.
    """
    if "part.origin_mm" not in draft.assumed:
        return config
    place = _reached_at(draft, config)
    if place != config.part.origin_mm:
        draft.raw["part"]["origin_mm"] = list(place)
        draft.assumed["part.origin_mm"] += ", moved to where the robot reaches all of it"
    return draft.judged()


def _reached_at(draft: CellDraft, config: CellConfig) -> Vector:
    """The nearest place of the part where the robot reaches all of it; ConfigError where there is none."""
    seat = find_seat(config)
    if seat is not None and seat.share == 1.0:
        return seat.origin_mm
    name = next(key for key in OUTLINES if key in draft.raw["part"])
    fits = "nor a tenth of it"
    if seat is not None:
        fits = f"one of {seat.share:.0%} of that size fits at part.origin_mm = {toml(list(seat.origin_mm))}"
    raise draft.answers.own.error(
        f"part.{name}",
        f"the robot reaches {config.outline()}, off singular poses, at no place near "
        f"{toml(list(config.part.origin_mm))} (base frame, mm) with the part turned by part.rotation_rpy_deg = "
        f"{toml(list(config.part.rotation_rpy_deg))} and process.dip_deg = {config.process.dip_deg:g}; {fits}. Nothing "
        "was written. Give a robot with more reach ([kinematics] arm, or your robot's own numbers), another dip, or a "
        'smaller part; [program] make = "none" writes the cell without a program',
    )


def _add_program(draft: CellDraft, config: CellConfig) -> str:
    """The program over the part, where the answers name none; what was made, or why not.

    ConfigError where the robot does not reach the part at the place that was answered: with one where it does.
    """
    shape = draft.answers.own.program.make
    if "path" in draft.answers.cell.get("program", {}):
        return "yours"
    if shape == "none":
        return "none was wanted"
    if draft.blank:
        return "none: the arm is not known yet"
    by_tool = {"removal_model": "hertz_preston", "tif": None}  # of a measured spot only the place counts here
    config = config.model_copy(update={"process": config.process.model_copy(update=by_tool)})
    (name,) = config.program.paths
    try:
        quiet = quiet_lines(config, PITCH_MM, shape=shape)
        section = draft.answers.own.program
        options = MakeOptions(
            shape,
            Path(name),
            pitch_mm=quiet.pitch_mm * (RANDOM_PITCH if shape == "random" else 1.0),
            step_mm=PITCH_MM,
            **section.model_dump(include={"cross_deg", "phase", "seed"}),
        )
        if draft.maker is not None:
            options = replace(options, encoding=draft.maker.encoding, dwell_s=draft.maker.dwell_s)
        made = make_program(options, config, plugins_of(config))
    except PolishdError as error:
        if "part.origin_mm" in draft.assumed or reached(config):  # of another cause
            return f"none: {error}"
        place = toml(list(_reached_at(draft, config)))
        problem = f"the robot does not reach all of {config.outline()} there; it does at part.origin_mm = {place}"
        raise draft.answers.own.error(
            "part.origin_mm", f"{problem}. Nothing was written. Move the part there, or mend [kinematics]"
        ) from error
    draft.files[name] = made.text
    if shape == "random":  # whose lines have no common distance that could be quiet
        return f"random, {made.answer['points']} points, lines {options.pitch_mm:.3g} mm apart in the mean"
    return f"{shape}, {made.answer['points']} points, {quiet.words}"


def write_cell(made: NewCell, *, force: bool) -> None:
    """Write all files, each whole; ConfigError where one is there already, unless ``force``, and where it cannot be."""
    _require_new(made.folder, made.files, force=force)
    _write(made.folder, made.files)


def _require_new(folder: Path, names: Iterable[str], *, force: bool) -> None:
    there = [name for name in names if (folder / name).exists()]
    if there and not force:
        raise ConfigError(
            f"{folder}: {', '.join(there)}: there already, and nothing was written; name another folder, or "
            "overwrite with --force"
        )


def _write(folder: Path, files: Mapping[str, bytes]) -> None:
    try:
        make_folder(folder)
        write_together(folder, files)
    except OSError as error:
        raise ConfigError(
            f"{error.filename or folder}: cannot be written: {error.strerror}; nothing was written. Make room, or name "
            "another folder"
        ) from error


def _table(made: NewCell, cell: Path, *, dry_run: bool) -> Table:
    rows = [(f"[{key.replace('.', '] ', 1)}", why) for key, why in made.assumed.items()]
    rows += [(f"[{key.replace('.', '] ', 1)}", "TO BE FILLED IN") for key in made.blank]
    rows += [("program", made.program)]
    written = "nothing was written" if dry_run else f"written: {', '.join(sorted(made.files))}"
    return key_table(f"{cell}: {written}; assumed, look at each:", rows)


def _print_result(made: NewCell, cell: Path, todo: list[SetupStep], *, dry_run: bool) -> None:
    """The cell itself where nothing was written; else what is to be done, whole lines: commands can be copied."""
    if dry_run:
        stdout.print(made.files[CELL].decode(), markup=False, highlight=False, soft_wrap=True)
        return
    for line in lines(todo):
        stdout.print(line, markup=False, highlight=False, soft_wrap=True)
    stdout.print(f"show the steps again: polishd init --status {shlex.quote(str(cell))}", markup=False, soft_wrap=True)
