"""Ripple of a path: what its lines and points leave on the surface at periods that the process grid averages away.

The removal is summed on fine patches of the part, spread over the path, on a lattice of a twentieth of the spot's
radius. In each patch the harmonics of the local line distance are fitted (period p / n across the lines; l / m along
them where the tool rests on points), of all lines that cross there, for the spot as modelled, for one that is wider or
narrower by what its radius is uncertain by, and for a tool that trails its path. The line distance is often chosen at a
null of the spot's transfer function (Dunn and Walker 2008): there the nominal ripple is next to nothing, and a spot
that is off by 3 % leaves several times as much.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal, NamedTuple

import numpy as np
import scipy

from polishd.model.surface import BoolArray, FloatArray, Grid
from polishd.process.checks import require_number
from polishd.process.removal.spread_effect import WIDTH, damping, spline
from polishd.process.removal.tif import HertzSpot, Spot, WiderSpot
from polishd.process.removal.tif_family import Indices, PathBlocks, reach_cells, windows
from polishd.process.removal.transfer_function import modulus_along

RADIUS_ERROR = 0.03
"""Default of what 95 % of spots stay within, of their radius: a TIF that was measured once."""
LINE_ERROR_MM = 0.02
"""Default of what 95 % of lines lie within, across them: a robot that repeats to 0.02 mm."""
LAG_MM = 0.05
"""Default of the distance that the tool trails its path by, at most."""
PATCHES = 40
"""Patches a path: the RMS is within 5 % of that with 400 on rasters of 100 mm whose removal varies by half."""
FINER = 20
"""Cells of a patch to the spot's radius."""
FINEST = 64
"""And at most: of lines that are so near to each other a spot leaves nothing."""
CELLS_A_PERIOD = 12
"""Cells of a patch to the shorter of line distance and point distance, at least."""
PERIODS = 3.0
"""Half the side of a patch, in the longer of both."""
HARMONICS = 3
SAME_PERIOD = 0.02
"""Lines of two passes whose periods differ by less, relative, are the same."""
EQUAL_PERIOD, EQUAL_DEG = 1e-3, 0.05
"""Lines of two passes whose periods and directions differ by less keep their phase over the part."""
STRAIGHT = 0.05
"""Lines have a phase where each lies within this share of their distance from its place in a regular row."""
SEAT_MM = 0.05
"""Distance across the lines that 95 % of passes lie within of their place on the part: its seat, and the frame."""
SIGMAS_OF_95 = 1.96
"""Standard deviations of a normal distribution within which 95 % lie."""
REGULAR = 0.2
"""Lines count as regular where their distances differ by less than this share of them."""
EXACT = 0.03
"""Lines of several passes repeat where those a period apart differ by less than this share of it."""
MOST_PASSES = 3
"""Lines in a period, at most: of a program that makes its path so many times, each time beside the last."""
MOSTLY = 2 / 3
"""Share of the patches with regular lines from which these count alone: in the others, lines are farther apart."""
LEAST_LINES = 4
ACROSS = 4.0
"""Mean line distances across a line within which others are looked for."""
ALIGNED = 0.94
"""Cosine of the angle to a line from which a block counts to another direction."""
STEADY = 0.996
"""Cosine of the angle that the lines of one direction stay within where others cross them."""
APART = 0.25
"""Waves of a patch whose frequencies differ by less, over half its side, are one."""
RAREST = 0.25
"""Least share of the blocks near by that run as a line does: more distant ones are looked for by its inverse."""
CROSSED = 2.0
"""Mean line distances within which one of the lines that cross a place is looked for."""
OPEN = 2.5
"""Lines do not run at a place between two of them that are farther apart than this many mean distances."""
RATIO_STEP, AZIMUTH_STEP, BEND_STEP = 0.01, np.radians(3.0), 0.01
"""Spots of a patch that differ by less share one window; RATIO_STEP moves a spot's rim by 0.5 % of its radius."""
RESTING = 0.2
"""Blocks are points at rest where they are shorter than this share of the distance between them."""
JUMP = 3.0
"""Points that are farther apart than this many mean distances follow no line."""
LONG = 1.5
"""Periods beyond this many line distances count as figure, where no line is regular."""
AGAIN = 2.5
"""A path that comes back to a place after this many diagonals of the part makes another pass."""
SQUARES = 128
"""Squares across a modelled spot: their width must not show beside a patch's cells."""

FREQUENCIES = 48
"""Frequencies of the spectrum of lines that are out of place."""
SHORTEST = 0.4
"""Shortest period of that spectrum, over the spot's radius: a Hertz spot has 1 % of its mean square beyond."""

Direction = Literal["across", "along", "every"]
Cause = Literal["path", "line_error", "lag"]


@dataclass(frozen=True, slots=True)
class PathErrors:
    """Limits within which 95 % of spots, lines and passes are."""

    radius: float = RADIUS_ERROR
    """Of the spot's radius, relative."""
    line_mm: float = 0.0
    """Of each line's place across it, independent of the other lines'."""
    lag_mm: float = 0.0
    """Distance along the path that the tool trails the programmed point by: friction, backlash, a soft bonnet.

    A delay in time alone is none: the tool passes the same points as long. Lines that run to and fro are shifted
    against each other by twice the distance."""

    @property
    def words(self) -> str:
        """Return the limits as text."""
        found = [f"a radius that is off by {100 * self.radius:g} %"] if self.radius else []
        found += [f"lines out of place by {self.line_mm:g} mm"] if self.line_mm else []
        found += [f"a lag of {self.lag_mm:g} mm"] if self.lag_mm else []
        return " and ".join(found) or "no errors"


MODELLED = PathErrors()
"""Of a spot that was measured once, on a path without errors."""


@dataclass(frozen=True, slots=True)
class RippleLine:
    """A harmonic of the pattern that a path leaves."""

    direction: Direction
    """"across" the lines, "along" them (distance of points at rest), or "every" where lines have no common distance."""
    period_mm: float
    amplitude_nm: float
    """Zero to peak, as modelled: the RMS over the patches."""
    rms_nm: float
    """RMS over the clear aperture, as modelled; 0 of what errors alone leave."""
    rms_high_nm: float
    """95 % value: with the errors of `PathErrors`, the worse sign of the radius; at least ``rms_nm``."""
    on_grid: float
    """Share of its mean square that the process grid's cells keep."""
    cause: Cause = "path"
    """"path": lines and points as programmed; "line_error": lines out of place, a band about the period; "lag"."""
    azimuth_deg: float | None = None
    """Direction of straight lines on the part, counterclockwise from x, 0 to 180; None: they are not straight."""
    phase: float | None = None
    """Periods from the part's center to a crest, across straight lines to their left; None: unknown."""

    def is_same(self, other: RippleLine) -> bool:
        """Return whether another pass leaves the same line."""
        alike = abs(self.period_mm - other.period_mm) <= SAME_PERIOD * self.period_mm
        return alike and (self.direction, self.cause) == (other.direction, other.cause) and not self.crosses(other)

    def crosses(self, other: RippleLine) -> bool:
        """Return whether another line runs at an angle to this one: over the part, they meet in all phases."""
        if self.azimuth_deg is None or other.azimuth_deg is None:
            return False
        return bool(abs(np.cos(np.radians(self.azimuth_deg - other.azimuth_deg))) < ALIGNED)

    def is_aligned(self, other: RippleLine) -> bool:
        """Return whether another pass leaves the same line with a known phase to this one."""
        if self.azimuth_deg is None or other.azimuth_deg is None or self.phase is None or other.phase is None:
            return False
        parallel = abs(self.azimuth_deg - other.azimuth_deg) <= EQUAL_DEG
        return parallel and abs(self.period_mm - other.period_mm) <= EQUAL_PERIOD * self.period_mm

    def kept(self, sample_mm: float) -> float:
        """Return the share of its mean square that samples which average over their distance keep."""
        return float(np.sinc(sample_mm / self.period_mm)) ** 2


@dataclass(frozen=True, slots=True)
class Ripple:
    """Forecast of the ripple that one pass adds."""

    lines: tuple[RippleLine, ...] = ()
    errors: PathErrors = MODELLED

    @property
    def rms_nm(self) -> float:
        """RMS of all lines, as modelled."""
        return float(np.sqrt(sum(one.rms_nm**2 for one in self.lines)))

    @property
    def rms_high_nm(self) -> float:
        """RMS of all lines, 95 % value."""
        return float(np.sqrt(sum(one.rms_high_nm**2 for one in self.lines)))

    @property
    def finer_nm(self) -> float:
        """RMS of what the process grid averages away, as modelled."""
        return float(np.sqrt(sum(one.rms_nm**2 * (1 - one.on_grid) for one in self.lines)))

    def shown_nm(self, sample_mm: float | None, *, high: bool = False) -> float:
        """RMS that a map's samples show beyond the process grid; ``sample_mm`` None: all of it."""
        square = 0.0
        for one in self.lines:
            rms = one.rms_high_nm if high else one.rms_nm
            kept = 1.0 if sample_mm is None else one.kept(sample_mm)
            square += max(kept * rms**2 - one.on_grid * one.rms_nm**2, 0.0)
        return float(np.sqrt(square))

    def without_phase(self) -> Ripple:
        """Return the ripple whose lines add up with those of any other pass."""
        return replace(self, lines=tuple(replace(one, phase=None) for one in self.lines))

    @property
    def words(self) -> str:
        """Return the largest line as text."""
        if not self.lines:
            return "no lines"
        one = max(self.lines, key=lambda line: line.rms_high_nm)
        return f"{one.period_mm:.2f} mm {one.direction}, amplitude {one.amplitude_nm:.2f} nm"

    def facts(self) -> list[dict[str, Any]]:
        """Return the lines for JSON."""
        return [asdict(one) for one in self.lines]


NO_RIPPLE = Ripple()


def sum_ripples(passes: Sequence[Ripple]) -> Ripple:
    """Return the ripple of several passes of one tool.

    Straight parallel lines of one distance add with their phase: those of a pass between the lines of another cancel.
    The mean squares of straight lines that cross add up, the amplitudes of all other lines of one period, as those of
    one path that is made twice do.
    """
    same = list[list[RippleLine]]()
    for line in (line for one in passes for line in one.lines):
        known = next((lines for lines in same if lines[0].is_same(line)), None)
        if known is None:
            same.append([line])
        else:
            known.append(line)
    errors = next((one.errors for one in passes if one.lines), passes[-1].errors if passes else MODELLED)
    return Ripple(tuple(_sum_lines(lines) for lines in same), errors)


def _sum_lines(lines: Sequence[RippleLine]) -> RippleLine:
    """Sum of one line over passes."""
    first = lines[0]
    if len(lines) == 1:
        return first
    values = np.array([(one.amplitude_nm, one.rms_nm, one.rms_high_nm) for one in lines])
    if first.cause == "line_error":  # out of place anew in each pass
        total = np.linalg.norm(values, axis=0)
    elif all(first.is_aligned(one) for one in lines):
        turn = np.exp(2j * np.pi * np.array([one.phase for one in lines]))
        total = np.abs(turn @ values)
        off = 2 * np.pi * SEAT_MM / first.period_mm * float(np.linalg.norm(values[:, 2]))
        total[2] = min(max(total[2] + off, total[1]), float(values[:, 2].sum()))
    else:
        total = values.sum(axis=0)
    amplitude, rms, high = map(float, total)
    # a sum over more passes starts from their lines, not from this one, which has no phase
    return replace(first, amplitude_nm=amplitude, rms_nm=rms, rms_high_nm=high, azimuth_deg=None, phase=None)


@dataclass(frozen=True, slots=True)
class ActingSpots:
    """The spots of a program's n timed points as they act: all that a ripple follows from but the dwell."""

    spot: Spot
    blocks: PathBlocks


def ripple_of(
    acting: ActingSpots,
    time_s: FloatArray,
    grid: Grid,
    clear: BoolArray,
    *,
    errors: PathErrors = MODELLED,
    patches: int = PATCHES,
) -> Ripple:
    """Forecast the ripple of a dwell.

    Args:
        acting: n spots along the path.
        time_s: (n,) dwell.
        grid: process grid; what it keeps of each harmonic is stated.
        clear: (ny, nx) clear aperture.
        errors: what the 95 % value contains.
        patches: number of patches.

    Returns:
        The harmonics that have any amplitude; none where no block lies in the clear aperture.

    Raises:
        ComputeError: an error that cannot be.
    """
    require_number("the error of the spot's radius", errors.radius, "", above=-1e-12, below=0.5)
    for what, value in (("the error of a line's place", errors.line_mm), ("the lag", errors.lag_mm)):
        require_number(what, value, "mm", above=-1e-12)
    frames = _frames(acting, time_s, grid, clear, patches)
    if not frames:
        return Ripple(errors=errors)
    factors = (1.0,) if errors.radius == 0 else (1.0, 1.0 - errors.radius, 1.0 + errors.radius)
    spots = [_widened(acting.spot, factor) for factor in factors]
    shift_mm = errors.lag_mm * _travel(acting.blocks) if errors.lag_mm else None
    found = [_patches(spots, acting.blocks, time_s, frame, shift_mm) for frame in frames]
    regular = [k for k, frame in enumerate(frames) if frame.own.pitch_mm is not None]
    some = regular if len(regular) >= MOSTLY * len(frames) else None
    chosen = list(range(len(frames))) if some is None else some
    frames, found = [frames[k] for k in chosen], [found[k] for k in chosen]
    own = [of[: len(spots)] for of in found]
    lines = _broad(frames, own, grid.pitch_mm) if some is None else _harmonics(frames, own, grid.pitch_mm)
    if shift_mm is not None:
        lines += _lagging(frames, [(of[0], of[-1]) for of in found], grid.pitch_mm, regular=some is not None)
    if errors.line_mm:
        across_mm = 2 * float(np.sqrt(np.count_nonzero(clear) / np.pi)) * grid.pitch_mm
        lines += _out_of_place(acting, frames, [of[0] for of in found], errors.line_mm, (across_mm, grid.pitch_mm))
    return Ripple(lines, errors)


def _widened(spot: Spot, factor: float) -> Spot:
    fine = HertzSpot(spot.process, max(SQUARES, spot.squares)) if isinstance(spot, HertzSpot) else spot
    return fine if factor == 1.0 else WiderSpot(fine, factor)


def _travel(blocks: PathBlocks) -> FloatArray:
    """(n, 2) unit vector of the travel in each block: its own, or from the block before to the one after."""
    own = blocks.end_mm - blocks.start_mm
    middle = (blocks.start_mm + blocks.end_mm) / 2
    around = np.gradient(middle, axis=0) if blocks.n > 1 else np.zeros_like(middle)
    length = np.linalg.norm(own, axis=1)
    way = np.where((length > RESTING * np.linalg.norm(around, axis=1))[:, None], own, around)
    size = np.linalg.norm(way, axis=1, keepdims=True)
    return np.asarray(np.divide(way, size, out=np.zeros_like(way), where=size > 0), dtype=np.float64)


class _Lines(NamedTuple):
    """Lines in a patch that run one way."""

    along: FloatArray
    """(2,) unit vector."""
    pitch_mm: float | None
    """Distance after which they repeat; None: there is none."""
    rest_mm: float | None
    """Distance of points at rest on a line; None: the tool moves."""
    a_pitch: int = 1
    """Lines in that distance."""

    @property
    def across(self) -> FloatArray:
        return np.array([-self.along[1], self.along[0]])


class _Frame(NamedTuple):
    """A patch: where it is, and the lines in it."""

    at: int
    """Its block."""
    centre_mm: FloatArray
    """(2,)"""
    own: _Lines
    """Through its centre."""
    crossing: tuple[_Lines, ...]
    """Others, in other directions."""
    line_mm: float
    """Area over length of the path: mean distance of the lines, of all directions and passes."""
    half_mm: float
    cell_mm: float
    near: Indices
    """Blocks whose spots reach into it, rising."""

    @property
    def lines(self) -> tuple[_Lines, ...]:
        return self.own, *self.crossing

    @property
    def cells(self) -> int:
        """Cells from the centre to each side."""
        return int(np.ceil(self.half_mm / self.cell_mm))


def _frames(acting: ActingSpots, time_s: FloatArray, grid: Grid, clear: BoolArray, patches: int) -> list[_Frame]:
    blocks = acting.blocks
    middle = (blocks.start_mm + blocks.end_mm) / 2
    room_mm = scipy.ndimage.distance_transform_edt(np.pad(clear, 1))[1:-1, 1:-1] * grid.pitch_mm
    row = np.round((grid.y_mm[0] - middle[:, 1]) / grid.pitch_mm).astype(np.int64)
    column = np.round((middle[:, 0] - grid.x_mm[0]) / grid.pitch_mm).astype(np.int64)
    on_grid = (row >= 0) & (row < grid.ny) & (column >= 0) & (column < grid.nx)
    room = np.zeros(blocks.n)
    room[on_grid] = room_mm[row[on_grid], column[on_grid]]
    inside = np.flatnonzero((room > 0) & (time_s > 0) & (blocks.factor > 0))
    if inside.size < LEAST_LINES:
        return []
    step_mm = np.linalg.norm(np.diff(middle, axis=0), axis=1)
    length_mm = float(step_mm[inside[inside < blocks.n - 1]].sum())
    area_mm2 = float(np.count_nonzero(clear)) * grid.pitch_mm**2
    # the distance of lines, or of points that no line joins
    mean_mm = max(area_mm2 / max(length_mm, grid.pitch_mm), (area_mm2 / inside.size) ** 0.5)
    wanted = np.flatnonzero(room >= PERIODS * mean_mm)
    some = np.intersect1d(inside, wanted)
    some = inside[room[inside] >= 0.9 * room[inside].max()] if some.size < LEAST_LINES else some
    count = min(patches, some.size)
    offsets = np.random.default_rng(0).uniform(size=count)
    chosen = some[((np.arange(count) + offsets) * some.size / count).astype(np.int64)]
    tree = scipy.spatial.cKDTree(middle)
    move_mm = float(np.median(step_mm))
    again = AGAIN * float(np.linalg.norm(np.ptp(middle[inside], axis=0))) / move_mm if move_mm > 0 else np.inf
    again = again if move_mm <= JUMP * mean_mm else np.inf
    reach_mm = float(blocks.reach_mm(acting.spot)[time_s > 0].max()) * (1 + RADIUS_ERROR)
    found = [_frame(acting, _Places(tree, mean_mm, move_mm, again), int(k), reach_mm) for k in chosen]
    return [one for one in found if one is not None]


class _Places(NamedTuple):
    """Where the blocks are."""

    tree: scipy.spatial.cKDTree
    """Of the (n, 2) middles."""
    mean_mm: float
    """Mean distance of the lines of all passes, or of points that no line joins."""
    move_mm: float
    """Median distance of blocks."""
    again: float
    """Blocks after which the path is in another pass where it comes back to a place."""

    @property
    def middle_mm(self) -> FloatArray:
        """Return the (n, 2) middles."""
        return np.asarray(self.tree.data)

    def near(self, centre_mm: FloatArray, radius_mm: float) -> Indices:
        """Return the blocks whose middle is near a place, rising."""
        return np.sort(np.array(self.tree.query_ball_point(centre_mm, radius_mm), dtype=np.int64))


def _frame(acting: ActingSpots, places: _Places, at: int, reach_mm: float) -> _Frame | None:
    """The patch about one block; None where the path has no direction there.

    ``reach_mm``: how far from its middle any block polishes.
    """
    middle, blocks = places.middle_mm, acting.blocks
    centre = middle[at]
    own = _lines_of(blocks, places, centre, at)
    if own is None:
        return None
    around = places.near(centre, ACROSS * places.mean_mm)
    passes = 1 + np.count_nonzero(np.diff(around) > places.again)
    crossing = () if own.pitch_mm is None else _crossing(blocks, places, at, own)
    if any(one.pitch_mm is None for one in crossing):
        own, crossing = own._replace(pitch_mm=None), ()
    lines = (own, *crossing)
    pitches = [one.pitch_mm for one in lines if one.pitch_mm is not None] or [passes * places.mean_mm]
    rests = [one.rest_mm for one in lines if one.rest_mm is not None]
    radius = float(acting.spot.half_width_mm(blocks.depth_ratio[at : at + 1])[0])
    half = PERIODS * max(pitches + rests)
    dense = [one.a_pitch / one.pitch_mm for one in lines if one.pitch_mm is not None] or [1 / places.mean_mm]
    cell = max(min(radius / FINER, min(pitches + rests) / CELLS_A_PERIOD), radius / FINEST)
    return _Frame(at, centre, own, crossing, 1 / sum(dense), half, cell, places.near(centre, 2**0.5 * half + reach_mm))


def _crossing(blocks: PathBlocks, places: _Places, at: int, own: _Lines) -> tuple[_Lines, ...]:
    """The lines of other passes that run at an angle to those of a block, over its middle."""
    middle = places.middle_mm
    centre_mm = middle[at]
    near = places.near(centre_mm, CROSSED * places.mean_mm + places.move_mm / 2)
    near = near[np.abs(near - at) > places.again]  # a path that bends does not cross itself
    nearest = near[np.argsort(np.linalg.norm(middle[near] - centre_mm, axis=1))]
    way = _ways(middle, nearest)
    found = [own]
    other = way.any(axis=1) & (np.abs(way @ own.along) <= ALIGNED)
    while other.any():
        first = int(np.argmax(other))
        other[first] = False
        lines = _lines_of(blocks, places, centre_mm, int(nearest[first]))
        if lines is not None:
            found.append(lines)
            other &= np.abs(way @ lines.along) <= ALIGNED
    return tuple(one for one in found[1:] if one.a_pitch)


def _ways(middle: FloatArray, which: Indices) -> FloatArray:
    """(m, 2) unit vectors from the block before to the one after some blocks; 0 where they are at one place."""
    last = np.minimum(which + 1, len(middle) - 1)
    way = middle[last] - middle[np.maximum(which - 1, 0)]
    size = np.linalg.norm(way, axis=1, keepdims=True)
    return np.asarray(np.divide(way, size, out=np.zeros_like(way), where=size > 0), dtype=np.float64)


def _lines_of(blocks: PathBlocks, places: _Places, centre_mm: FloatArray, of: int) -> _Lines | None:
    """The lines about a place that are parallel to a block near it; None where the block has no direction.

    Without lines on both sides of the place, ``a_pitch`` is 0: a path that bends there has no others that cross it.
    """
    middle = places.middle_mm
    before, after = max(of - 1, 0), min(of + 1, blocks.n - 1)
    own = blocks.end_mm[of] - blocks.start_mm[of]
    length = float(np.linalg.norm(own))
    gap = float(np.linalg.norm(middle[after] - middle[before])) / max(after - before, 1)
    way = own if length > RESTING * gap else middle[after] - middle[before]
    if not np.linalg.norm(way) > 0:
        return None
    along = np.asarray(way / np.linalg.norm(way), dtype=np.float64)
    rests = length <= RESTING * gap <= RESTING * JUMP * places.mean_mm
    pitch, a_pitch = _line_distance(places, centre_mm, along, max(gap, places.mean_mm / 2))
    return _Lines(along, pitch, gap if rests else None, a_pitch)


def _line_distance(
    places: _Places, centre_mm: FloatArray, along: FloatArray, gap_mm: float
) -> tuple[float | None, int]:
    """Distance after which the parallel lines about a place repeat, and the lines in it.

    The distance is None where they do not repeat, the number 0 where they are not on both sides of the place.
    ``gap_mm``: how far along the lines blocks are looked for.
    """
    middle, reach_mm = places.middle_mm, ACROSS * places.mean_mm
    a_pitch, share = 0, 1.0
    for _ in range(2):
        near = places.near(centre_mm, gap_mm + reach_mm / share)
        parallel = np.abs(_ways(middle, near) @ along) > ALIGNED
        place = middle[near] - centre_mm
        strip = near[parallel & (np.abs(place @ along) <= 0.75 * gap_mm)]
        runs = np.split(strip, np.flatnonzero(np.diff(strip) > 1) + 1) if strip.size else []
        # the point of a run that is nearest to the cut across the lines: on a curved line the mean lies beside it
        cut = [run[np.argmin(np.abs((middle[run] - centre_mm) @ along))] for run in runs]
        lines = np.sort((middle[cut] - centre_mm) @ np.array([-along[1], along[0]])) if cut else np.zeros(0)
        pitch, a_pitch = _repeat(lines)
        if pitch is not None or parallel.all():
            return pitch, a_pitch
        share = max(float(parallel.mean()), RAREST)  # lines that others cross may be farther apart than the mean
    return None, a_pitch


def _repeat(lines_mm: FloatArray) -> tuple[float | None, int]:
    """Distance after which (n,) rising places of lines repeat, and the lines in it, as of `_line_distance`."""
    if lines_mm.size < LEAST_LINES or lines_mm[0] > 0 or lines_mm[-1] < 0:
        return None, 0
    mean_mm = float(lines_mm[-1] - lines_mm[0]) / (lines_mm.size - 1)
    if lines_mm[lines_mm >= 0].min() - lines_mm[lines_mm <= 0].max() > OPEN * mean_mm:
        return None, 0
    for a_pitch in range(1, min(MOST_PASSES, lines_mm.size - LEAST_LINES + 1) + 1):
        distance = lines_mm[a_pitch:] - lines_mm[:-a_pitch]
        pitch = float(np.median(distance))
        if pitch > 0 and np.abs(distance - pitch).max() <= (REGULAR if a_pitch == 1 else EXACT) * pitch:
            return pitch, a_pitch
    return None, 1


class _Patch(NamedTuple):
    """The removal on a patch."""

    height_nm: FloatArray
    """(m, m), row 0 at the largest y."""
    at_mm: FloatArray
    """(m,) of its columns, from its centre; rows fall from the largest."""


def _patches(
    spots: Sequence[Spot], blocks: PathBlocks, time_s: FloatArray, frame: _Frame, shift_mm: FloatArray | None
) -> list[_Patch]:
    """Sum the removal of the blocks near by: with each spot, and with the first one on a path shifted by (n, 2) back.

    The dwell is laid on the lattice once for all spots.
    """
    near = blocks.part(frame.near).seen_from(frame.centre_mm)
    bent, h, cells = near.bent, frame.cell_mm, frame.cells
    wider = 1.0 if bent is None else float(bent[:, :2].max())
    kinds, kind = _kinds(near)
    reach = max(reach_cells(spot, h, kinds.depth_ratio, kinds.azimuth_rad, wider) for spot in spots)
    size, edge = 2 * cells + 1, cells + reach + 1
    fast = scipy.fft.next_fast_len(2 * edge + 1, real=True)
    seconds = near.factor * time_s[frame.near]
    dwell = _on_lattice(near, seconds, kind, spots[0], (h, edge))
    at = np.asarray((np.arange(size) - cells) * h, dtype=np.float64)
    undamped = 1 / (damping(scipy.fft.fftfreq(fast))[:, None] * damping(scipy.fft.rfftfreq(fast)))
    middle = slice(2 * reach + 1, 2 * reach + 1 + size)
    spectrum = scipy.fft.rfft2(dwell, (fast, fast))
    kernels = []
    for spot in spots:
        window = windows(spot, h, kinds.depth_ratio, kinds.azimuth_rad, reach, bent=kinds.bent)
        kernels.append(scipy.fft.rfft2(window.reshape(-1, 2 * reach + 1, 2 * reach + 1), (fast, fast)) * undamped)
    pairs = [(spectrum, kernel) for kernel in kernels]
    if shift_mm is not None:
        back = shift_mm[frame.near]
        trailing = replace(near, start_mm=near.start_mm - back, end_mm=near.end_mm - back)
        late = scipy.fft.rfft2(_on_lattice(trailing, seconds, kind, spots[0], (h, edge)), (fast, fast))
        pairs.append((late, kernels[0]))
    total = [scipy.fft.irfft2(np.einsum("kij,kij->ij", *pair), (fast, fast))[middle, middle] for pair in pairs]
    return [_Patch(np.asarray(height, dtype=np.float64), at) for height in total]


def _on_lattice(
    near: PathBlocks, seconds: FloatArray, kind: Indices, spot: Spot, lattice: tuple[float, int]
) -> FloatArray:
    """(kinds, nodes, nodes) seconds of the blocks on the nodes of a lattice, for each kind of spot.

    ``lattice``: distance of its nodes, and their number from the centre to each side.
    """
    h, edge = lattice
    nodes = 2 * edge + 1
    block, place, share = near.positions(spot)
    inside = (np.abs(place) < (edge - 1) * h).all(axis=1)  # the rest does not reach the patch
    block, place, share = block[inside], place[inside], share[inside]
    (row, down), (column, side) = (spline(v) for v in (edge - place[:, 1] / h, place[:, 0] / h + edge))
    weight = (share * seconds[block])[:, None, None] * down[:, :, None] * side[:, None]
    node = (kind[block] * nodes + row)[:, None, None] * nodes + column[:, None, None]
    node = node + np.arange(WIDTH)[:, None] * nodes + np.arange(WIDTH)
    count = int(kind.max(initial=0)) + 1
    total = np.bincount(node.ravel(), weight.ravel(), count * nodes * nodes)
    return np.asarray(total, dtype=np.float64).reshape(count, nodes, nodes)


def _kinds(blocks: PathBlocks) -> tuple[PathBlocks, Indices]:
    """Blocks that represent others with nearly the same spot, and (n,) which of them represents each."""
    keys = [np.log(blocks.depth_ratio) / RATIO_STEP, blocks.azimuth_rad / AZIMUTH_STEP]
    keys += [] if blocks.bent is None else list(blocks.bent.T / BEND_STEP)
    step = np.zeros(blocks.n, dtype=np.int64)
    for key in keys:
        whole = np.round(key).astype(np.int64)
        step = step * (np.ptp(whole) + 1) + whole - whole.min()
    _, first, kind = np.unique(step, return_index=True, return_inverse=True)
    return blocks.part(first), kind.ravel()


_Kind = tuple[int, Direction, int]
"""Which of the directions of the path's lines a harmonic belongs to, its direction, and its number."""


class _Wave(NamedTuple):
    """A harmonic of the lines of a patch."""

    direction: Direction
    number: int
    way: FloatArray
    """(2,) unit vector."""
    period_mm: float
    along: FloatArray = np.zeros(2)
    """(2,) unit vector of its lines."""


def _harmonics(frames: Sequence[_Frame], found: Sequence[Sequence[_Patch]], grid_mm: float) -> tuple[RippleLine, ...]:
    """The harmonics across the lines, and along them where the tool rests on points; ``found``: by frame and spot."""
    squares: dict[_Kind, list[FloatArray]] = {}
    periods: dict[_Kind, list[float]] = {}
    shares: dict[_Kind, list[float]] = {}
    ways = _directions(frames)

    def nearest(along: FloatArray) -> int:
        return int(np.argmax(np.abs(ways @ along)))

    for frame, patches in zip(frames, found, strict=True):
        waves = _waves(frame)
        for wave, values in zip(waves, _fitted(frame, patches, waves), strict=True):
            kind = (nearest(wave.along), wave.direction, wave.number)
            periods.setdefault(kind, []).append(wave.period_mm)
            shares.setdefault(kind, []).append(float(_kept(wave.way / wave.period_mm, grid_mm) ** 2))
            squares.setdefault(kind, []).append(values**2)
    rows = [_row([frame for frame in frames if nearest(frame.own.along) == way]) for way in range(len(ways))]
    lines = []
    for kind, values in squares.items():
        way, direction, number = kind
        # over all patches: what is not in some of them leaves nothing there
        rms = [float(v) for v in np.sqrt(np.sum(values, axis=0) / len(frames) / 2)]
        period, share, row = float(np.median(periods[kind])), float(np.mean(shares[kind])), rows[way]
        line = RippleLine(direction, period, rms[0] * 2**0.5, rms[0], max(rms), share)
        if direction == "across" and row is not None:
            line = replace(line, azimuth_deg=row.azimuth_deg, phase=(number * row.phase) % 1.0)
        lines.append(line)
    if any(kind[1] == "along" for kind in squares):
        # points of several lines make patterns askew, by how those of one line lie beside those of the next
        every = _short_of(frames, found, grid_mm)
        known = np.sum([np.sum(values, axis=0) for values in squares.values()], axis=0) / len(frames) / 2
        left = np.maximum(every[:, 0] - known, 0.0)
        if left[0] > 0:
            on_grid = every[0, 1] - sum(one.on_grid * one.rms_nm**2 for one in lines)
            share = float(np.clip(on_grid / left[0], 0.0, 1.0))
            lines.append(_broad_line(left, float(every[0, 0] / every[0, 2]), share))
    return tuple(lines)


def _directions(frames: Sequence[_Frame]) -> FloatArray:
    """(k, 2) unit vectors of lines that cross, where those of each keep their direction over the part; else one."""
    found: list[FloatArray] = []
    if any(frame.crossing for frame in frames):
        for line in (line for frame in frames for line in frame.lines):
            if not any(abs(line.along @ one) > STEADY for one in found):
                found.append(line.along)
    apart = all(abs(one @ two) < ALIGNED for k, one in enumerate(found) for two in found[:k])
    return np.array(found) if found and apart else np.eye(1, 2)


class _Row(NamedTuple):
    """A regular row of straight lines."""

    azimuth_deg: float
    phase: float
    """Line distances from the part's center to a line."""


def _row(frames: Sequence[_Frame]) -> _Row | None:
    """The row of the lines through the patches' centres; None where they are bent, or not equally far apart."""
    pitches = [frame.own.pitch_mm for frame in frames if frame.own.pitch_mm is not None]
    if not pitches or len(pitches) < len(frames):
        return None
    ways = np.array([frame.own.along[0] + 1j * frame.own.along[1] for frame in frames])
    azimuth_deg = round(float(np.degrees(np.angle((ways**2).sum()) / 2)), 3) % 180.0
    along = np.exp(1j * np.radians(azimuth_deg))
    if np.abs((ways * along.conjugate()).imag).max() > np.radians(EQUAL_DEG):
        return None
    at = np.array([frame.centre_mm for frame in frames]) @ np.array([-along.imag, along.real])
    pitch = float(np.median(pitches))
    number = np.round((at - at[np.argmin(np.abs(at))]) / pitch)
    if np.ptp(number) > 0:
        pitch, first = np.polyfit(number, at, 1)
    else:
        first = float(at.mean())
    if np.abs(at - first - number * pitch).max() > STRAIGHT * pitch:
        return None
    return _Row(azimuth_deg, float(first / pitch))


def _waves(frame: _Frame) -> list[_Wave]:
    """The harmonics of a patch."""
    found = list[_Wave]()
    for lines in frame.lines:
        for direction, way, period, count in (
            ("across", lines.across, lines.pitch_mm, HARMONICS * lines.a_pitch),
            ("along", lines.along, lines.rest_mm, HARMONICS),
        ):
            if period is not None:
                found += [_Wave(direction, n, way, period / n, lines.along) for n in range(1, count + 1)]  # type: ignore[arg-type]
    return _apart(found, frame.half_mm)


def _apart(waves: Sequence[_Wave], half_mm: float) -> list[_Wave]:
    """Return the waves that a patch can tell from those before them: points at rest may lie on lines that cross."""
    found = list[_Wave]()
    for wave in waves:
        own = wave.way / wave.period_mm
        others = [sign * one.way / one.period_mm for one in found for sign in (1, -1)]
        if all(np.linalg.norm(own - other) > APART / half_mm for other in others):
            found.append(wave)
    return found


def _fitted(frame: _Frame, patches: Sequence[_Patch], waves: Sequence[_Wave]) -> FloatArray:
    """(waves, patches) amplitude, zero to peak, nm, of each wave, beside a smooth surface.

    The fit of the waves of lines is weighted towards the centre of the patch, in a strip across these lines that is
    short along them: there a curved line is still straight, and the amplitude about the same.
    """
    amplitude = np.zeros((len(waves), len(patches)))
    for lines in frame.lines:
        mine = [k for k, wave in enumerate(waves) if wave.along is lines.along]
        amplitude[mine] = _fitted_across(frame, lines, patches, waves)[mine]
    kept = np.array([_kept(wave.way / wave.period_mm, frame.cell_mm) for wave in waves])
    return np.asarray(amplitude / kept[:, None], dtype=np.float64)


def _fitted_across(frame: _Frame, lines: _Lines, patches: Sequence[_Patch], waves: Sequence[_Wave]) -> FloatArray:
    """(waves, patches) amplitude of each wave as the patch's cells have it, nm, in a strip across some of its lines."""
    at = patches[0].at_mm
    half = frame.half_mm
    longest = max([lines.pitch_mm or half / PERIODS, *(one.pitch_mm for one in frame.crossing if one.pitch_mm)])
    strip = min(max(longest, 1.5 * (lines.rest_mm or 0.0)), half / 2)
    x, y = np.meshgrid(at, at[::-1])
    along, across = (x * w[0] + y * w[1] for w in (lines.along, lines.across))
    held = (np.abs(across) <= half) & (np.abs(along) <= strip)
    s, v = along[held] / half, across[held] / half
    where = np.column_stack([x[held], y[held]])
    height = np.column_stack([patch.height_nm[held] for patch in patches])
    terms = [v**k for k in range(5)] + [s, s**2, s * v, s * v**2]
    terms += [part(2 * np.pi * (where @ wave.way) / wave.period_mm) for wave in waves for part in (np.cos, np.sin)]
    weight = np.cos(np.pi * v / 2)[:, None]
    basis = np.column_stack(terms) * weight
    wanted = (height - height.mean(axis=0)) * weight
    try:  # polynomials of few orders beside waves: the normal equations are well conditioned, and half as long
        found = scipy.linalg.cho_solve(scipy.linalg.cho_factor(basis.T @ basis), basis.T @ wanted)
    except scipy.linalg.LinAlgError:
        found = np.linalg.lstsq(basis, wanted, rcond=None)[0]
    own = found[-2 * len(waves) :].reshape(len(waves), 2, -1)
    return np.asarray(np.hypot(own[:, 0], own[:, 1]), dtype=np.float64)


def _kept(frequency: FloatArray, cell_mm: float) -> float:
    """Share of a wave's amplitude that cells keep; ``frequency`` (2,) per mm."""
    return float(np.prod(np.sinc(frequency * cell_mm)))


def _broad(frames: Sequence[_Frame], found: Sequence[Sequence[_Patch]], grid_mm: float) -> tuple[RippleLine, ...]:
    """Whatever has periods of up to LONG line distances, as one line at its mean frequency."""
    squares = _short_of(frames, found, grid_mm)
    if not squares[0, 0] > 0:
        return ()
    return (_broad_line(squares[:, 0], float(squares[0, 0] / squares[0, 2]), float(squares[0, 1] / squares[0, 0])),)


def _broad_line(squares: FloatArray, period_mm: float, on_grid: float) -> RippleLine:
    """A line in all directions; ``squares`` (spots,) nm^2."""
    rms = np.sqrt(squares)
    return RippleLine("every", period_mm, float(rms[0] * 2**0.5), float(rms[0]), float(rms.max()), on_grid)


def _short_of(frames: Sequence[_Frame], found: Sequence[Sequence[_Patch]], grid_mm: float) -> FloatArray:
    """(spots, 3) mean over the patches of `_short`, of periods of up to LONG line distances."""
    each = [
        [_short(patch, frame.cell_mm, LONG * frame.half_mm / PERIODS, grid_mm) for patch in patches]
        for frame, patches in zip(frames, found, strict=True)
    ]
    return np.asarray(np.mean(each, axis=0), dtype=np.float64)


def _lagging(
    frames: Sequence[_Frame], found: Sequence[tuple[_Patch, _Patch]], grid_mm: float, *, regular: bool
) -> tuple[RippleLine, ...]:
    """What a tool that trails its path adds: the difference of both patches.

    Lines to and fro alternate: odd multiples of half the lines' frequency. Without lines, all periods as of `_broad`.
    """
    squares, periods = [], []
    for frame, (prompt, late) in zip(frames, found, strict=True):
        change = _Patch(late.height_nm - prompt.height_nm, prompt.at_mm)
        if regular and frame.own.pitch_mm is not None:
            twice = _apart(
                [
                    _Wave("across", n, one.across, 2 * one.pitch_mm / one.a_pitch / n, one.along)
                    for one in frame.lines
                    if one.pitch_mm is not None
                    for n in (1, 3)
                ],
                frame.half_mm,
            )
            amplitude = _fitted(frame, [change], twice)[:, 0]
            periods.append(twice[0].period_mm)
            squares.append((float(amplitude @ amplitude) / 2, _kept(twice[0].way / periods[-1], grid_mm) ** 2))
        else:
            own = _short(change, frame.cell_mm, LONG * frame.half_mm / PERIODS, grid_mm)
            periods.append(float(own[0] / own[2]) if own[2] > 0 else frame.half_mm)
            squares.append((float(own[0]), float(own[1] / own[0]) if own[0] > 0 else 0.0))
    square, share = np.mean(squares, axis=0)
    if not square > 0:
        return ()
    direction: Direction = "across" if regular else "every"
    high = float(np.sqrt(square))
    return (RippleLine(direction, float(np.median(periods)), 0.0, 0.0, high, float(share), "lag"),)


def _out_of_place(
    acting: ActingSpots,
    frames: Sequence[_Frame],
    found: Sequence[_Patch],
    line_mm: float,
    extent_mm: tuple[float, float],
) -> tuple[RippleLine, ...]:
    """What lines leave that are out of place independently of each other.

    A line whose profile across is s, out of place by d, adds ``-d s'``. Lines at a distance p therefore add a mean
    square of ``sigma^2 / p`` times the integral of ``(2 pi f |S(f)|)^2`` over all frequencies, S the spectrum of s.

    Args:
        acting: the spots.
        frames: patches; where lines have no common distance, the mean one counts.
        found: removal on them.
        line_mm: 95 % limit of the place.
        extent_mm: mean width of the clear aperture, and the process grid's pitch.
    """
    sigma_mm = line_mm / SIGMAS_OF_95
    sums, fine = np.zeros(2), _widened(acting.spot, 1.0)
    pitches, periods = [], []
    for frame, patch in zip(frames, found, strict=True):
        pitch, across = frame.line_mm, frame.own.across
        ratio, azimuth = (v[frame.at : frame.at + 1] for v in (acting.blocks.depth_ratio, acting.blocks.azimuth_rad))
        squares = fine.patch(ratio, azimuth)[0]
        half = float(fine.half_width_mm(ratio)[0])
        frequency = (np.arange(FREQUENCIES) + 0.5) / FREQUENCIES / (SHORTEST * half)
        angle = float(np.arctan2(across[1], across[0]))
        share = modulus_along(squares, 2 * half / len(squares), frequency, angle) / squares.sum()
        step = 1 / (FREQUENCIES * SHORTEST * half)
        power = 2 * step * (2 * np.pi * frequency * share * sigma_mm * float(patch.height_nm.mean())) ** 2 * pitch
        kept = np.array([_kept(across * f, extent_mm[1]) ** 2 for f in frequency])
        sums += [power.sum(), (power * kept).sum()]
        pitches.append(pitch)
        periods.append(1 / float(np.interp(power.sum() / 2, np.cumsum(power), frequency + frequency[0])))
    mean, on_grid = sums / len(frames)
    if not mean > 0:
        return ()
    lines = max(extent_mm[0] / float(np.median(pitches)), 1.0)
    scatter = float(np.sqrt(scipy.special.chdtri(lines, 0.05) / lines))  # 95 % of chi squared
    high = scatter * float(np.sqrt(mean))
    period = float(np.median(periods))  # half of the mean square is longer
    return (RippleLine("across", period, 0.0, 0.0, high, float(on_grid / mean), "line_error"),)


def _short(patch: _Patch, cell_mm: float, longest_mm: float, grid_mm: float) -> FloatArray:
    """(3,) mean square of the periods up to one, what a grid keeps of it, and the sum over frequency of it."""
    size = len(patch.at_mm)
    v = np.linspace(-1, 1, size)
    legendre = np.polynomial.legendre.legvander(v, 3)
    basis = np.linalg.qr(np.einsum("ik,jl->ijkl", legendre, legendre).reshape(size**2, -1))[0]
    flat = patch.height_nm.ravel()
    left = (flat - basis @ (basis.T @ flat)).reshape(size, size)
    window = np.hanning(size + 2)[1:-1]
    weight = window[:, None] * window
    power = np.abs(scipy.fft.fft2(left * weight)) ** 2 / (size**2 * np.sum(weight**2))
    f = scipy.fft.fftfreq(size, cell_mm)
    fy, fx = np.meshgrid(f, f, indexing="ij")
    frequency = np.hypot(fx, fy)
    some = np.where(frequency >= 1 / longest_mm, power, 0.0)
    kept = (np.sinc(fx * grid_mm) * np.sinc(fy * grid_mm)) ** 2
    return np.array([some.sum(), (some * kept).sum(), (some * frequency).sum()])


# The line distance that a spot whose radius is not known exactly leaves least ripple with.

MORE_PATH = 1.15
"""Path that a quieter line distance may cost, over that of the largest one."""
CANDIDATES = 301


@dataclass(frozen=True, slots=True)
class ContactAt:
    """A contact, and the lines that it follows."""

    depth_ratio: float
    """Gamma."""
    azimuth_rad: float
    """Where the spindle leans, counterclockwise from the part's x."""
    across_rad: float = np.pi / 2
    """Direction across the lines, counterclockwise from the part's x."""


@dataclass(frozen=True, slots=True)
class QuietPitch:
    """A line distance, and the ripple that it leaves, RMS over the mean removal."""

    pitch_mm: float
    share: float
    """With the spot as modelled."""
    share_high: float
    """With a spot whose radius is off, the worse of both signs."""
    radius_error: float = RADIUS_ERROR

    @property
    def words(self) -> str:
        """Return the distance and its ripple as text."""
        high = f"{100 * self.share_high:.1f} % with a radius that is off by {100 * self.radius_error:g} %"
        return f"lines {self.pitch_mm:.3g} mm apart, ripple {100 * self.share:.1f} % of the mean removal, {high}"


def ripple_shares(
    spot: Spot, contact: ContactAt, pitch_mm: FloatArray, radius_error: float = RADIUS_ERROR
) -> tuple[FloatArray, FloatArray]:
    """RMS ripple of straight lines of even removal, over its mean, for (m,) line distances.

    Each harmonic has twice the share that the spot's spectrum has at its frequency, zero to peak.

    Args:
        spot: the spot.
        contact: how it acts, and where the lines run.
        pitch_mm: (m,) distances.
        radius_error: share of the radius that the spot may be off by.

    Returns:
        (m,) as modelled, and (m,) the largest for a spot as modelled, narrower and wider.
    """
    ratio = np.array([contact.depth_ratio])
    fine = _widened(spot, 1.0)
    patch = fine.patch(ratio, np.array([contact.azimuth_rad]))[0]
    side = 2 * float(fine.half_width_mm(ratio)[0]) / len(patch)
    order = np.arange(1, HARMONICS + 1)[:, None]
    factors = (1.0, 1.0 - radius_error, 1.0 + radius_error)
    found = []
    for factor in factors:
        frequency = (factor * order / pitch_mm).ravel()
        share = modulus_along(patch, side, frequency, contact.across_rad).reshape(HARMONICS, -1) / patch.sum()
        found.append(np.sqrt(2 * np.sum(share**2, axis=0)))
    return found[0], np.max(found, axis=0)


def quiet_pitch(
    spot: Spot,
    contacts: Sequence[ContactAt],
    at_most_mm: float,
    *,
    radius_error: float = RADIUS_ERROR,
    more_path: float = MORE_PATH,
) -> QuietPitch:
    """Find the line distance up to ``at_most_mm`` with the least ripple of a spot whose radius may be off.

    Its path is at most ``more_path`` times as long as that with the largest distance. Several contacts count in the
    mean square: lines of a spiral run in all directions.
    """
    require_number("the largest line distance", at_most_mm, "mm", above=0.0)
    pitch = np.linspace(at_most_mm / more_path, at_most_mm, CANDIDATES)
    each = [ripple_shares(spot, contact, pitch, radius_error) for contact in contacts]
    share, high = (np.sqrt(np.mean(np.square(of), axis=0)) for of in zip(*each, strict=True))
    best = int(np.argmin(high))
    return QuietPitch(float(pitch[best]), float(share[best]), float(high[best]), radius_error)


LEAST_PITCH = 0.3
"""Smallest line distance that is looked at for less ripple, as a share of the present one."""


def quieter_pitch_mm(acting: ActingSpots, ripple: Ripple, share: float) -> float | None:
    """Find the largest line distance whose ripple, 95 % value, is at most a share of a forecast one.

    It counts with the spot at the middle gamma, across the lines of most blocks. None: there is none down to
    LEAST_PITCH, or the forecast has no line distance.
    """
    now = next((one for one in ripple.lines if (one.direction, one.cause) == ("across", "path")), None)
    if now is None or acting.blocks.n < LEAST_LINES:
        return None
    blocks = acting.blocks
    travel = _travel(blocks)
    double = np.arctan2(travel[:, 1], travel[:, 0]) * 2  # lines to and fro have one direction
    along = float(np.angle(np.exp(1j * double).sum())) / 2
    azimuth = float(np.angle(np.exp(1j * blocks.azimuth_rad).sum()))
    contact = ContactAt(float(np.median(blocks.depth_ratio)), azimuth, along + np.pi / 2)
    pitch = np.linspace(LEAST_PITCH, 1.0, CANDIDATES) * now.period_mm
    _, high = ripple_shares(acting.spot, contact, pitch, ripple.errors.radius)
    quiet = np.flatnonzero(high <= share * high[-1])
    return float(pitch[quiet[-1]]) if quiet.size else None
