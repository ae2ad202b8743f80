"""A first touch: tracks all over a witness part, with their times and their program."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from polishd.config.cell import CellConfig
from polishd.model.dwell import AS_PROGRAMMED
from polishd.model.errors import ComputeError, ConfigError
from polishd.model.program import Program
from polishd.model.surface import BoolArray, FloatArray
from polishd.plugins.removal_models import measured_spot_of, modelled_spot_of
from polishd.plugins.removal_models.along_path import path_of
from polishd.plugins.removal_models.machine import BELIEVED, blocks_along
from polishd.plugins.rnc_robot.dialect import dialect
from polishd.plugins.rnc_robot.formats import read
from polishd.plugins.rnc_robot.make import path_program
from polishd.process import motion
from polishd.process.conditioning import process_grid
from polishd.process.frames import directions_to_base, points_to_base
from polishd.process.identification.forward import ForwardModel, forward
from polishd.process.identification.parameters import PriorKnowledge, unlearned, usual_parameters
from polishd.process.identification.touch import after, design
from polishd.process.paths.tracks import BETWEEN, Joined, Track, join_tracks
from polishd.process.paths.wrist import largest_turn_deg, tool_axes
from polishd.process.robot import reachable
from polishd.process.spot import HertzSpot
from polishd.recipe import steps
from polishd.recipe.recipe import Recipe
from polishd.workbench.programs.contact import contact_radius_mm
from polishd.workbench.programs.make import dialect_of, in_program_frame

SPOTS = MappingProxyType({"hertz_preston": modelled_spot_of, "measured_tif": measured_spot_of})
"""Of polishd's own removal models, which identification can read."""
NOISE_NM = 0.5
"""Of a map where the instrument's profile does not say."""
MODEL = 0.002
"""Of the removal (docs/identification.md)."""
LENGTH = 4.0
"""Of a track, in radii of the contact."""
APART = 1.0
"""Of neighbouring places, in lengths of a track, at least."""
ACROSS = 5
"""Places across the part, at most."""
LEANS_DEG = (0.0, -45.0, 45.0, 180.0)
"""Of the spindle, from where it leans by itself, where the robot can: an offset of the spot turns with it, a seat's
error does not."""
ALONG_DEG = (0.0, 90.0)
STEP_NM, MOST_NM = 100.0, 300.0
"""By how much a track grows deeper at a time, and most that is removed anywhere; at most half of
``limits.max_removal_nm``. Where a machine stops at a corner it stays for some hundredths of a second, which no block
tells of: half a nanometre."""
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
    """In contact."""
    tracks: int


@dataclass(frozen=True, slots=True)
class _Cell:
    """What a touch is planned for."""

    config: CellConfig
    recipe: Recipe
    radius_mm: float
    """Of the contact."""

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
        feed = 60 * speed_mm_s[path.track]  # BETWEEN is the last one
        text = path_program(points, own, feed, "first touch", to=dialect_of(self.config))
        program = read(dialect(dialect_of(self.config)), text, NAME)
        if program.n != len(path.track):
            raise ComputeError(f"the touch's program has {program.n} timed moves, its path {len(path.track)}")
        return text, program, path

    def forward(self, program: Program, seconds: FloatArray) -> ForwardModel:
        """The forward model that identification would have of such a pass."""
        recipe = self.recipe
        grid = process_grid(recipe.outline, max(recipe.grid_mm, SAMPLES * self.radius_mm))
        mask = recipe.outline.contains(*grid.axes_mm, recipe.part.edge_mm)
        request = steps.request_of(recipe, program, grid, steps.initial_estimates(recipe))
        spot, reference = SPOTS[recipe.model.name](request)
        path = path_of(request, spot, reference)
        return forward(
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
    return replace(recipe, dwell=recipe.dwell.model_copy(update={"choose": AS_PROGRAMMED, "cross_check": ""}))


def plan_touch(config: CellConfig, recipe: Recipe, wanted: Mapping[str, float], within_s: float) -> FirstTouchPlan:
    """Tracks, their times and their program, and what is expected to be known after it. ComputeError, ConfigError."""
    cell = _Cell(config, recipe, contact_radius_mm(config))
    pool = _pool(cell)
    slow = config.machine.min_feed_mm_s
    _, program, path = cell.program(pool, np.full(len(pool) + 1, slow))
    spread = _shares(path, program)
    model, owner = cell.forward(program, spread), path.track[spread > 0]
    deepest = np.array([_deepest(model, owner == c) for c in range(len(pool))])
    most_nm = min(MOST_NM, config.limits.max_removal_nm / 2)
    longest = np.array([track.length_mm for track in pool]) / slow
    known = unlearned(model.parameters)
    lasts_s = design(
        model,
        owner,
        _without_wear(known),
        noise_nm=cell.noise_nm,
        wanted=wanted,
        step_s=min(STEP_NM, most_nm) / deepest,
        most_s=longest,
        most_nm=most_nm,
        within_s=within_s,  # of which the ways between take some
    )
    order = _in_order(pool, lasts_s)
    if not order:
        raise ComputeError("no track is worth its time: the time is too short, or what is wanted is known already")
    order.append(order[0])  # half of it at the begin, half at the end: it tells of wear
    seconds = lasts_s[order]
    seconds[[0, -1]] /= 2
    speed = np.array([pool[c].length_mm for c in order]) / seconds
    speed = np.append(speed, BETWEEN_SHARE * config.machine.max_feed_mm_s)
    text, program, _ = cell.program([pool[c] for c in order], speed)
    lasts = motion.delivered_time_s(program, program.time_s, steps.envelope_of(recipe, program))
    if lasts.sum() > within_s:
        whole, between = lasts.sum() / 60, (lasts.sum() - seconds.sum()) / 60
        raise ComputeError(
            f"the touch takes {whole:.1f} min, {between:.1f} of them from track to track, and {within_s / 60:.1f} are "
            "allowed; allow more (--minutes), or want less (--want)"
        )
    learned = after(cell.forward(program, lasts), known, cell.noise_nm)
    return FirstTouchPlan(text, program, known, learned, float(lasts.sum()), len(order))


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


def _without_wear(known: PriorKnowledge) -> PriorKnowledge:
    """For the choice of tracks: none of them knows when it will be polished."""
    still = np.array([name != "wear" for name in known.names])
    return replace(known, covariance=np.where(np.outer(still, still), known.covariance, 1e-12 * np.eye(len(still))))


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
