"""``polishd calibrate first-touch``: a touch on a witness part, planned for the most information per contact time."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from rich.table import Table

from polishd.config.cell import CellConfig
from polishd.model.dwell import AS_PROGRAMMED
from polishd.model.errors import ComputeError, ConfigError
from polishd.model.program import Encoding, Program
from polishd.model.surface import BoolArray, FloatArray
from polishd.pipeline import precheck, steps
from polishd.pipeline.build_recipe import make_recipe
from polishd.pipeline.recipe import Recipe
from polishd.plugin_loader import load_cell
from polishd.plugins.removal_models import BELIEVED, blocks_along, measured_spot_of, modelled_spot_of, path_of
from polishd.plugins.rnc_robot.dialect import AnyDialect, dialect
from polishd.plugins.rnc_robot.formats import made_like, path_program, read
from polishd.plugins.rnc_robot.languages.profile import LanguageProfile
from polishd.process.frames import directions_to_base, points_to_base
from polishd.process.identification.experiment_design import (
    FIELD_WANTED,
    WANTED,
    design_track_times,
    knowledge_after_pass,
)
from polishd.process.identification.forward_model import ForwardModel, build_forward_model
from polishd.process.identification.identify import confounding_of, covariance_at_mid_pass
from polishd.process.identification.parameters import ABERRATIONS, PriorKnowledge, initial_knowledge, usual_parameters
from polishd.process.metrology.conditioning import process_grid
from polishd.process.removal.tif import HertzSpot
from polishd.process.robot import motion
from polishd.process.robot.compliance import reachable
from polishd.process.toolpath.apertures import largest_turn_deg, tool_axes
from polishd.process.toolpath.paths import BETWEEN, Joined, Track, join_tracks
from polishd.programs.make import contact_radius_mm, dialect_of, in_program_frame
from polishd.programs.show import program_picture
from polishd.rendering.terminal import emit, record_table, stderr
from polishd.util.files import require_new, unwritable_message, write_together

# A first touch: tracks all over a witness part, with their times and their program.

SPOTS = MappingProxyType({"hertz_preston": modelled_spot_of, "measured_tif": measured_spot_of})
"""Of polishd's own removal models, which identification can read."""
NOISE_NM = 0.5
"""Of a map where the instrument's profile does not say."""
MODEL = 0.002
"""Of the removal (docs/explanation/identification.md)."""
LENGTH = 4.0
"""Of a track, in radii of the contact."""
APART = 1.0
"""Of neighbouring places, in lengths of a track, at least."""
ACROSS = 5
"""Places across the part, at most."""
LEANS_DEG = (0.0, -45.0, 45.0, 180.0)
"""Turns of the spindle's inclination that the robot may reach: an offset of the spot turns with it, a seat error does
not."""
ALONG_DEG = (0.0, 90.0)
STEP_NM, MOST_NM = 100.0, 300.0
"""Depth step of a track, and largest removal at any point, at most half of ``limits.max_removal_nm``. A machine that
stops at a corner stays for some hundredths of a second, which no block reports: half a nanometer."""
BETWEEN_SHARE = 0.6
"""Of the machine's largest feed, from track to track."""
LANDING_MM = 6.0
SAMPLES = 0.5
"""Of the contact's radius: the pitch at which a removal is looked at."""
NAME = "touch.rnc"


@dataclass(frozen=True, slots=True)
class FirstTouchPlan:
    """A planned first touch."""

    text: bytes
    program: Program
    before: PriorKnowledge
    after: PriorKnowledge
    seconds: float
    """Time in contact."""
    tracks: int


@dataclass(frozen=True, slots=True)
class _Cell:
    """What a touch is planned for."""

    config: CellConfig
    recipe: Recipe
    radius_mm: float
    """Of the contact."""
    dialect: AnyDialect
    """Of the program, for the tool and the frame that the cell's own program names."""

    @property
    def encoding(self) -> Encoding:
        """Times of the moves where the language has them: steps of a speed are coarser."""
        timed = isinstance(self.dialect, LanguageProfile) and self.dialect.move_time
        return "time" if timed and timed.time else "feed"

    @property
    def noise_nm(self) -> float:
        """Of a removal: that of two maps, and what the model of a track is off by."""
        instrument = self.recipe.instrument
        one = None if instrument is None else instrument.repeatability_nm
        return float(np.hypot(2**0.5 * (one or NOISE_NM), MODEL * MOST_NM))

    def joined(self, tracks: Sequence[Track]) -> tuple[Joined, FloatArray]:
        """The path over them, and its tool axes. ComputeError where the wrist cannot follow."""
        config, optic = self.config, self.config.optic()
        path = join_tracks(optic, tracks, config.outline().radius_mm + LANDING_MM, self.radius_mm / 2)
        dip, lean, at = config.process.dip_deg, config.compliance_options(), config.placement()
        axes = path.axes(optic, tool_axes(path.points_mm, optic, dip, lean, at))
        largest_turn_deg(axes)
        return path, axes

    def reaches(self, tracks: Sequence[Track]) -> list[bool]:
        """Of each track whether the robot can lean so along it."""
        path, axes = self.joined(tracks)
        at = self.recipe.placement
        tips, ways = points_to_base(at, path.points_mm), directions_to_base(at, axes)
        can = reachable(self.recipe.robot, tips, ways)
        return [bool(can[1:][path.track == c].all()) for c in range(len(tracks))]

    def program(self, tracks: Sequence[Track], speed_mm_s: FloatArray) -> tuple[bytes, Program, Joined]:
        """Its text, with (C + 1,) mm/s of each track and, last, between them; as it is read back."""
        path, axes = self.joined(tracks)
        points, own = in_program_frame(self.config, path.points_mm, axes)
        feed = 60 * self.written_mm_s(speed_mm_s)[path.track]  # BETWEEN is the last one
        text = path_program(points, own, feed, "first touch", encoding=self.encoding, to=self.dialect)
        program = read(self.dialect, text, NAME)
        if program.n != len(path.track):
            raise ComputeError(f"the touch's program has {program.n} timed moves, its path {len(path.track)}")
        return text, program, path

    def written_mm_s(self, speed_mm_s: FloatArray) -> FloatArray:
        """The nearest speeds that the language can write, at least one step."""
        own = self.dialect
        if self.encoding == "time" or not isinstance(own, LanguageProfile) or own.move_time is None:
            return speed_mm_s
        rules = own.move_time
        step = rules.speed_quantum * own.feed_units_mm_min[rules.speed_unit] / 60
        return np.asarray(np.maximum(np.round(speed_mm_s / step), 1.0) * step)

    def forward(self, program: Program, seconds: FloatArray) -> ForwardModel:
        """The forward model that identification would have of such a pass."""
        recipe = self.recipe
        grid = process_grid(recipe.outline, max(recipe.grid_mm, SAMPLES * self.radius_mm))
        mask = recipe.outline.contains(*grid.axes_mm, recipe.part.edge_mm)
        request = steps.request_of(recipe, program, grid, steps.initial_estimates(recipe))
        spot, reference = SPOTS[recipe.model.name](request)
        path = path_of(request, spot, reference)
        return build_forward_model(
            blocks_along(path, seconds),
            grid,
            mask,
            spot,
            recipe.process,
            parameters=usual_parameters(turns=not isinstance(spot, HertzSpot)),
            projection=BELIEVED,
            radius_mm=path.radius_mm,
        )


def as_touched(recipe: Recipe) -> Recipe:
    """The recipe of a pass that is polished as programmed, to teach."""
    return replace(recipe, dwell=recipe.dwell.model_copy(update={"objective": AS_PROGRAMMED, "cross_check": ""}))


def plan_touch(config: CellConfig, recipe: Recipe, wanted: Mapping[str, float], within_s: float) -> FirstTouchPlan:
    """Plan the tracks, their times, their program, and the expected knowledge after it. ComputeError, ConfigError."""
    own = dialect(dialect_of(config))
    if isinstance(own, LanguageProfile) and config.program_path.is_file():
        own = made_like(own, config.program_path.read_bytes(), config.program_path.name)
    cell = _Cell(config, recipe, contact_radius_mm(config), own)
    pool = _pool(cell)
    slow = config.machine.min_feed_mm_s
    _, program, path = cell.program(pool, np.full(len(pool) + 1, slow))
    spread = _shares(path, program)
    model, owner = cell.forward(program, spread), path.track[spread > 0]
    deepest = np.array([_deepest(model, owner == c) for c in range(len(pool))])
    most_nm = min(MOST_NM, config.limits.max_removal_nm / 2)
    shortest_s = recipe.envelope.least_point_s * np.bincount(path.track[path.track != BETWEEN], minlength=len(pool))
    longest = np.array([track.length_mm for track in pool]) / slow
    prior = initial_knowledge(model.parameters)
    lasts_s = design_track_times(
        model,
        owner,
        _without_wear(prior),
        noise_nm=cell.noise_nm,
        wanted=wanted,
        step_s=np.maximum(min(STEP_NM, most_nm) / deepest, shortest_s),
        most_s=longest,
        most_nm=most_nm,
        within_s=within_s,  # of which the ways between take some
    )
    order = _in_order(pool, lasts_s)
    if not order:
        raise ComputeError(
            "no track is worth its time: the time is too short, or the wanted errors are reached already"
        )
    order.append(order[0])  # half at the start, half at the end: shows wear
    seconds = lasts_s[order]
    seconds[[0, -1]] = np.maximum(seconds[[0, -1]] / 2, shortest_s[order[0]])
    speed = np.array([pool[c].length_mm for c in order]) / seconds
    speed = np.append(speed, _between_mm_s(cell, program.length_mm[path.track == BETWEEN]))
    text, program, _ = cell.program([pool[c] for c in order], speed)
    lasts = motion.delivered_time_s(program, program.time_s, steps.envelope_of(recipe, program))
    if lasts.sum() > within_s:
        total_min, between_min = lasts.sum() / 60, (lasts.sum() - seconds.sum()) / 60
        raise ComputeError(
            f"the touch takes {total_min:.1f} min, {between_min:.1f} of them from track to track, and "
            f"{within_s / 60:.1f} are allowed; allow more (--minutes), or want less (--want)"
        )
    learned = knowledge_after_pass(cell.forward(program, lasts), prior, cell.noise_nm)
    return FirstTouchPlan(text, program, prior, learned, float(lasts.sum()), len(order))


def _between_mm_s(cell: _Cell, length_mm: FloatArray) -> float:
    """Speed from track to track along moves of these lengths: none may take less than ``machine.least_point_s``."""
    config = cell.config
    usual_mm_s = BETWEEN_SHARE * config.machine.max_feed_mm_s
    if not cell.recipe.envelope.least_point_s:
        return usual_mm_s
    most_mm_s = float(length_mm.min()) / cell.recipe.envelope.least_point_s
    return min(usual_mm_s, max(most_mm_s, config.machine.min_feed_mm_s))


def _pool(cell: _Cell) -> list[Track]:
    """Tracks along x and y at places all over the clear aperture, at each lean."""
    outline, length = cell.config.outline(), LENGTH * cell.radius_mm
    margin = cell.config.part.edge_mm + length / 2 + cell.radius_mm
    reach = outline.radius_mm - margin
    pitch = max(2 * reach / (ACROSS - 1), APART * length)
    lattice = pitch * np.arange(-(ACROSS // 2), ACROSS // 2 + 1)
    x, y = (axis.ravel() for axis in np.meshgrid(lattice, lattice))
    inside = outline.contains(x, y, margin) if reach > 0 else np.zeros(x.shape, dtype=np.bool_)
    if np.count_nonzero(inside) <= 1:
        raise ConfigError(
            f"{cell.config.path}: part: {outline} has no room for tracks of {length:.1f} mm apart from one another; "
            "take a larger witness part (part.aperture_mm), or a smaller spot"
        )
    places = list(zip(x[inside].tolist(), y[inside].tolist(), strict=True))
    every = [Track(place, along, length, turn) for turn in LEANS_DEG for place in places for along in ALONG_DEG]
    can = cell.reaches(every)
    return [track for track, reached in zip(every, can, strict=True) if reached]


def _without_wear(prior: PriorKnowledge) -> PriorKnowledge:
    """For the choice of tracks: none of them knows when it will be polished."""
    still = np.array([name != "wear" for name in prior.names])
    return replace(prior, covariance=np.where(np.outer(still, still), prior.covariance, 1e-12 * np.eye(len(still))))


def _shares(path: Joined, program: Program) -> FloatArray:
    """(n,) of a second on each track, what each of its moves has; 0 between them."""
    on = path.track != BETWEEN
    whole = np.bincount(path.track[on], weights=program.length_mm[on])
    return np.where(on, program.length_mm / whole[path.track], 0.0)


def _deepest(model: ForwardModel, own: BoolArray) -> float:
    """Deepest removal of a second on a track, nm."""
    return float((model.matrix(np.zeros(len(model.parameters))) @ (model.weight_s * own)).max())


def _in_order(pool: Sequence[Track], seconds: FloatArray) -> list[int]:
    """Those with a time, one lean after the other, each track the nearest to the one before."""
    left = [int(c) for c in np.flatnonzero(seconds)]
    order: list[int] = []
    while left:
        at = pool[order[-1] if order else left[0]]

        def away(c: int, at: Track = at) -> tuple[float, float]:
            return pool[c].turn_deg, float(np.hypot(*np.subtract(pool[c].middle_mm, at.middle_mm)))

        order.append(min(left, key=away))
        left.remove(order[-1])
    return order


NOT_IN_MINUTES = {
    "wear": "a tool wears in hours; passes estimate it",
    "exponent": "it cannot be separated from rate and compliance",
}
JOB, FRAGMENT, PICTURE, FIGURES = "job.toml", "fragment.toml", "touch.png", "touch.json"
JOB_TEXT = """\
# A first touch, made by polishd calibrate first-touch: {use}.
[job]
id = "first-touch-{part}"
max_cycles = 1

[part]
id = "{part}"                        # what the maps of the witness part must name

[program]
path = "{program}"
coverage = "zone"

[dwell]
objective = "as_programmed"
cross_check = ""
"""


@dataclass(frozen=True, slots=True)
class TouchOptions:
    """Options of a first touch."""

    part: str
    within_min: float
    wanted: Mapping[str, float]


def touch_verb(cell: Path, out: Path, options: TouchOptions, *, as_json: bool) -> None:
    """Plan it, and write program, job, picture and figures into ``out``. ConfigError, ComputeError, ProgramError."""
    config, hooks = load_cell(cell)
    require_new(out)
    recipe = _recipe(config, make_recipe(config, hooks))
    wanted = _wanted(options.wanted)
    with stderr.status("choosing tracks"):
        touch = plan_touch(config, recipe, wanted, options.within_min * 60)
    if refused := precheck.precheck_plan(recipe, touch.program, hooks.check_plan):
        raise ComputeError("plan or run would refuse the touch:\n" + "\n".join(f"  {line}" for line in refused))
    rows = _rows(touch, wanted)
    complete = all(row["wanted"] is None or row["after"] <= row["wanted"] for row in rows)
    answer = {
        "part": options.part,
        "contact_min": touch.seconds / 60,
        "tracks": touch.tracks,
        "complete": complete,
        "parameters": rows,
        "out": str(out),
    }
    _write(config, out, touch, answer, options.part)
    emit(answer, as_json=as_json, table=lambda: _table(touch, rows), lines=_lines(config, out, complete=complete))


def _recipe(config: CellConfig, recipe: Recipe) -> Recipe:
    """As the touch is run; ConfigError where what it teaches cannot be learned."""
    if config.process.removal_model not in SPOTS:
        known = " or ".join(SPOTS)
        raise config.error("process.removal_model", f"a touch is planned for {known}; set one of them")
    if config.process.estimates != "machine":
        raise config.error("process.estimates", 'is not "machine": a touch would estimate only the rate; set it')
    return as_touched(recipe)


def _wanted(own: Mapping[str, float]) -> dict[str, float]:
    names = {p.name for p in usual_parameters() if p.name not in {*ABERRATIONS, *NOT_IN_MINUTES}}
    for name, sigma in own.items():
        if name in NOT_IN_MINUTES:
            raise ConfigError(f"--want {name}: a touch cannot estimate it: {NOT_IN_MINUTES[name]}; remove it")
        if name not in names:
            raise ConfigError(f"--want {name}: no such parameter; there are {', '.join(sorted(names))}")
        if not sigma > 0:
            raise ConfigError(f"--want {name}={sigma:g}: must be above 0")
    return {**WANTED, **own}


def _rows(touch: FirstTouchPlan, wanted: Mapping[str, float]) -> list[dict[str, Any]]:
    parameters = touch.before.parameters
    prior, learned = (covariance_at_mid_pass(known, touch.seconds / 7200) for known in (touch.before, touch.after))
    confounding = confounding_of(parameters, prior, learned)
    errors = zip(parameters, np.sqrt(np.diag(prior)), np.sqrt(np.diag(learned)), strict=True)
    return [
        {
            "name": p.name,
            "unit": p.unit,
            "before": float(before),
            "after": float(after),
            "wanted": wanted.get(p.name, FIELD_WANTED if p.name.startswith("field_") else None),
            "confounded_with": list(confounding[p.name].confounded_with),
        }
        for p, before, after in errors
        if p.name not in ABERRATIONS
    ]


def _table(touch: FirstTouchPlan, rows: Sequence[Mapping[str, Any]]) -> Table:
    title = f"first touch: {touch.tracks} tracks, {touch.seconds / 60:.1f} min in contact"
    cells = [
        (
            str(row["name"]),
            f"{row['before']:.2g}",
            f"{row['after']:.2g}",
            "" if row["wanted"] is None else f"{row['wanted']:.2g}",
            str(row["unit"]),
            ", ".join(row["confounded_with"]),
        )
        for row in rows
    ]
    columns = ("parameter", "error before", "expected after", "wanted", "unit", "confounded with")
    return record_table(title, columns, cells)


def _lines(config: CellConfig, out: Path, *, complete: bool) -> list[str]:
    short = "not all wanted errors are reached: more contact brings little, or is not allowed (--minutes)"
    place = "put a witness part of the same shape, glass and slurry in"
    queue = f"polishd queue add {config.path} {out / JOB} in a cell with a queue"
    include = f'include = ["{config.relative(out / FRAGMENT)}"]'
    single = f"{include} in the first line of a copy of {config.path.name}, and polishd run of that"
    return [
        *([] if complete else [short]),
        f"written to {out}: {NAME}, {JOB}, {FRAGMENT}, {PICTURE}, {FIGURES}",
        f"next: {place}; {queue}, or {single}; the next job starts with its estimates",
    ]


def _write(config: CellConfig, out: Path, touch: FirstTouchPlan, answer: Mapping[str, Any], part: str) -> None:
    single = JOB_TEXT.format(use="a fragment that a cell includes", part=part, program=config.relative(out / NAME))
    made = {
        NAME: touch.text,
        JOB: JOB_TEXT.format(use="a job for polishd queue add", part=part, program=NAME).encode(),
        FRAGMENT: single.encode(),
        PICTURE: program_picture(touch.program),
        FIGURES: (json.dumps(answer, indent=1) + "\n").encode(),
    }
    try:
        out.mkdir(parents=True, exist_ok=True)
        write_together(out, made)
    except OSError as error:
        raise unwritable_message(out, error) from error
