"""The lines of a path in patches that are spread over it: their directions and distances.

Lines that cross are found by direction, and those of several passes by the distance after which they repeat.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy

from polishd.model.surface import BoolArray, FloatArray, Grid
from polishd.process.removal.ripple import ALIGNED, RADIUS_ERROR, ActingSpots
from polishd.process.removal.tif_family import Indices, PathBlocks

FINER = 20
"""Cells of a patch to the spot's radius."""
FINEST = 64
"""And at most: of lines that are so near to each other a spot leaves nothing."""
MOST_CELLS = 96
"""And at most from its centre to a side: lines that are farther apart than a spot is wide, as the tracks of a first
touch, need no finer ones (175 s of CPU for a forecast; 24 s with this, and the same ripple to 0.3 %)."""
CELLS_A_PERIOD = 12
"""Cells of a patch to the shorter of line distance and point distance, at least."""
PERIODS = 3.0
"""Half the side of a patch, in the longer of both."""
REGULAR = 0.2
"""Lines count as regular where their distances differ by less than this share of them."""
EXACT = 0.03
"""Lines of several passes repeat where those a period apart differ by less than this share of it."""
MOST_PASSES = 3
"""Lines in a period, at most: of a program that makes its path so many times, each time beside the last."""
LEAST_LINES = 4
ACROSS = 4.0
"""Mean line distances across a line within which others are looked for."""
RAREST = 0.25
"""Least share of the blocks near by that run as a line does: more distant ones are looked for by its inverse."""
CROSSED = 2.0
"""Mean line distances within which one of the lines that cross a place is looked for."""
OPEN = 2.5
"""Lines do not run at a place between two of them that are farther apart than this many mean distances."""
RESTING = 0.2
"""Blocks are points at rest where they are shorter than this share of the distance between them."""
JUMP = 3.0
"""Points that are farther apart than this many mean distances follow no line."""
AGAIN = 2.5
"""A path that comes back to a place after this many diagonals of the part makes another pass."""


class ParallelLines(NamedTuple):
    """Lines in a patch that run one way."""

    along: FloatArray
    """(2,) unit vector."""
    pitch_mm: float | None
    """Distance after which they repeat; None: there is none."""
    rest_mm: float | None
    """Distance of points at rest on a line; None: the tool moves."""
    a_pitch: int = 1
    """Lines in that distance; 0: none run at the place that they were looked for."""

    @property
    def across(self) -> FloatArray:
        """Return the (2,) unit vector to the left of the lines."""
        return np.array([-self.along[1], self.along[0]])


class PatchFrame(NamedTuple):
    """A patch: where it is, and the lines in it."""

    at: int
    """Its block."""
    centre_mm: FloatArray
    """(2,)"""
    own: ParallelLines
    """Through its centre."""
    crossing: tuple[ParallelLines, ...]
    """Others, in other directions."""
    line_mm: float
    """Area over length of the path: mean distance of the lines, of all directions and passes."""
    half_mm: float
    cell_mm: float
    near: Indices
    """Blocks whose spots reach into it, rising."""

    @property
    def lines(self) -> tuple[ParallelLines, ...]:
        """Return the lines of all directions, those through the centre first."""
        return self.own, *self.crossing

    @property
    def cells(self) -> int:
        """Return the number of cells from the centre to each side."""
        return int(np.ceil(self.half_mm / self.cell_mm))


def patch_frames(
    acting: ActingSpots, time_s: FloatArray, grid: Grid, clear: BoolArray, patches: int
) -> list[PatchFrame]:
    """Spread patches over the path in the clear aperture.

    Args:
        acting: n spots along the path.
        time_s: (n,) dwell.
        grid: process grid.
        clear: (ny, nx) clear aperture.
        patches: number of patches, at most.

    Returns:
        The patches; none where fewer than LEAST_LINES blocks polish in the clear aperture.
    """
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


def _frame(acting: ActingSpots, places: _Places, at: int, reach_mm: float) -> PatchFrame | None:
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
    cell = max(min(radius / FINER, min(pitches + rests) / CELLS_A_PERIOD), radius / FINEST, half / MOST_CELLS)
    return PatchFrame(
        at, centre, own, crossing, 1 / sum(dense), half, cell, places.near(centre, 2**0.5 * half + reach_mm)
    )


def _crossing(blocks: PathBlocks, places: _Places, at: int, own: ParallelLines) -> tuple[ParallelLines, ...]:
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


def _lines_of(blocks: PathBlocks, places: _Places, centre_mm: FloatArray, of: int) -> ParallelLines | None:
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
    return ParallelLines(along, pitch, gap if rests else None, a_pitch)


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


def travel_ways(blocks: PathBlocks) -> FloatArray:
    """(n, 2) unit vector of the travel in each block: its own, or from the block before to the one after."""
    own = blocks.end_mm - blocks.start_mm
    middle = (blocks.start_mm + blocks.end_mm) / 2
    around = np.gradient(middle, axis=0) if blocks.n > 1 else np.zeros_like(middle)
    length = np.linalg.norm(own, axis=1)
    way = np.where((length > RESTING * np.linalg.norm(around, axis=1))[:, None], own, around)
    size = np.linalg.norm(way, axis=1, keepdims=True)
    return np.asarray(np.divide(way, size, out=np.zeros_like(way), where=size > 0), dtype=np.float64)
