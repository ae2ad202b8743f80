"""The removal spot along a path, as the robot's compliance changes it, and its effect matrix (paper eq. 45-49)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import scipy
from numpy.typing import NDArray

from polishd.model.errors import ComputeError
from polishd.model.process import Correction
from polishd.model.program import Program
from polishd.model.surface import FloatArray, Grid
from polishd.process.checks import refuse_where
from polishd.process.removal.tif import PATCH, Spot, tilt_spot

# Patches laid on the cells of a grid, by their integral: exact, and at a few reads a cell.

Indices = NDArray[np.int64]

NOTHING = 2e-14
"""Rounding of a patch's integral differences where it is 0; they round to about 1e-15."""


@dataclass(frozen=True, slots=True)
class CellAverages:
    """Columns of an effect matrix, one after the other, by what is in them."""

    count: Indices
    """(n,) entries of each."""
    sample: Indices
    """(e,) of the grid in C order, rising within a column."""
    rate: FloatArray
    """(e,) above 0."""


def integrals(patch: FloatArray) -> FloatArray:
    """(squares + 1, squares + 1, n) of (n, squares, squares): what is above and left of each corner of a square.

    Patches come last, so that to add up is to add long rows.
    """
    n, squares, _ = patch.shape
    found = np.zeros((squares + 1, squares + 1, n))
    for k in range(squares):
        np.add(found[k, 1:], patch[:, k].T, out=found[k + 1, 1:])
    for k in range(squares):
        found[1:, k + 1] += found[1:, k]
    return found


def average_over_cells(
    grid: Grid, integral: FloatArray, half_mm: FloatArray, count: Indices, position_mm: FloatArray
) -> CellAverages:
    """Columns of n patches, the mean of each at its positions: its content of each cell over the cell's area.

    Args:
        grid: of the cells; what falls beyond it is lost.
        integral: (squares + 1, squares + 1, n) of `integrals`.
        half_mm: (n, 2) half the sides of each patch, along x and y.
        count: (n,) positions of each patch, at least one.
        position_mm: (s, 2) x and y of these, patch by patch.
    """
    n, pitch, squares = len(count), grid.pitch_mm, len(integral) - 1
    patch = np.repeat(np.arange(n), count)
    half = half_mm[patch]
    cells = int(np.ceil(2 * half_mm.max(initial=0.0) / pitch)) + 1
    column, across, right = _edges(position_mm[:, 0] + grid.nx * pitch / 2, half[:, 0], pitch, squares, cells)
    row, down, below = _edges(grid.ny * pitch / 2 - position_mm[:, 1], half[:, 1], pitch, squares, cells)
    corner = (down * (squares + 1) * n + patch[:, None])[:, :, None] + (across * n)[:, None, :]
    content = _bilinear(integral, corner, below[:, :, None], right[:, None, :])
    content[:, 1:] -= content[:, :-1]
    content[:, :, 1:] -= content[:, :, :-1]
    windows = _Windows.about(row, column, content.shape[1], count)
    summed = np.bincount(windows.places(row, column, content.shape[1], patch).ravel(), content.ravel(), windows.size)
    least = np.repeat(NOTHING * integral[-1, -1], windows.cells)
    found = np.flatnonzero(summed > least)
    owner, rows, columns = windows.cells_at(found)
    on = (rows >= 0) & (rows < grid.ny) & (columns >= 0) & (columns < grid.nx)
    owner = owner[on]
    rate = summed[found[on]] / (pitch**2 * count)[owner]
    return CellAverages(np.bincount(owner, minlength=n), rows[on] * grid.nx + columns[on], rate)


def _edges(
    centre_mm: FloatArray, half_mm: FloatArray, pitch_mm: float, squares: int, cells: int
) -> tuple[Indices, Indices, FloatArray]:
    """Where the far edges of cells cut (s,) patches along one coordinate; the centre is from the outermost edge.

    Returns the (s,) first cell that a patch lies in, and of it and the next ones (s, cells) the square in which the
    cell's far edge lies, and the share of the square before it.
    """
    first = np.floor((centre_mm - half_mm) / pitch_mm)
    side = 2 * half_mm / squares
    start = (first * pitch_mm - (centre_mm - half_mm)) / side
    edge = np.clip(start[:, None] + (pitch_mm / side)[:, None] * np.arange(1, cells + 1), 0, squares)
    square = np.minimum(edge.astype(np.int64), squares - 1)
    return first.astype(np.int64), square, edge - square


def _bilinear(integral: FloatArray, corner: Indices, below: FloatArray, right: FloatArray) -> FloatArray:
    """(s, cells, cells) the integral so far below and right of the (flat) corners."""
    _, across, n = integral.shape
    flat = integral.ravel()

    def along(first: int) -> FloatArray:
        left, step = flat[first:].take(corner), flat[first + n :].take(corner)
        step -= left
        step *= right
        left += step
        return left

    upper, step = along(0), along(across * n)
    step -= upper
    step *= below
    upper += step
    return upper


@dataclass(frozen=True, slots=True)
class _Windows:
    """Windows of n patches: the cells at all positions of each, one after the other."""

    row: Indices
    """(n,) the first."""
    column: Indices
    """(n,)"""
    wide: Indices
    """(n,) cells across."""
    cells: Indices
    """(n,) in all."""

    @classmethod
    def about(cls, row: Indices, column: Indices, across: int, count: Indices) -> _Windows:
        """Windows about the (s,) first rows and columns of positions, each ``across`` cells wide and tall."""
        first = np.cumsum(count) - count

        def least_and_size(cell: Indices) -> tuple[Indices, Indices]:
            least = np.minimum.reduceat(cell, first)
            return least, np.maximum.reduceat(cell, first) - least + across

        (low, tall), (left, wide) = least_and_size(row), least_and_size(column)
        return cls(low, left, wide, tall * wide)

    @property
    def first(self) -> Indices:
        """(n,) where each window begins."""
        return np.cumsum(self.cells) - self.cells

    @property
    def size(self) -> int:
        """Cells of all."""
        return int(self.cells.sum())

    def places(self, row: Indices, column: Indices, across: int, patch: Indices) -> Indices:
        """(s, across, across) where the cells of (s,) positions are in the windows of their patches."""
        wide, cells = self.wide[patch], np.arange(across)
        corner = self.first[patch] + (row - self.row[patch]) * wide + column - self.column[patch]
        return (corner[:, None] + wide[:, None] * cells)[:, :, None] + cells

    def cells_at(self, place: Indices) -> tuple[Indices, Indices, Indices]:
        """(e,) the patch, the row and the column of places in the windows."""
        patch = np.repeat(np.arange(len(self.cells)), self.cells)[place]
        row, column = np.divmod(place - self.first[patch], self.wide[patch])
        return patch, self.row[patch] + row, self.column[patch] + column


CHUNK = 1024
"""Positions of a spot of PATCH squares across that are worked on at a time: bounds memory. With four times as many each
takes twice as long where others want the cache, too; with a quarter numpy's calls do."""
PATCH_POSITIONS = 4
"""Number of positions at which placing a patch costs as much as computing it."""


@dataclass(frozen=True, slots=True)
class CorrectedSpot:
    """Spot under a correction at n points."""

    depth_ratio: FloatArray
    """(n,) depth of the contact over the rigid robot's."""
    factor: FloatArray
    """(n,) on its removal."""
    divide_by: FloatArray | None = None
    """(n,) what the solved dwell is divided by; None: nothing."""


def tif_at_point(
    correction: Correction, gamma: FloatArray, exponent: float = 1.5, reference: float = 1.0
) -> CorrectedSpot:
    """Return the spot of a correction at (n,) depth ratios gamma (eq. 48).

    "exact" takes each point's own depth (eq. 45). The others take one spot for all, that of the depth ratio
    ``reference`` (1: the rigid robot's R_0): "none" as it is, "linear" times gamma (eq. 49 as printed), "power" times
    ``gamma^exponent``, "pointwise" as it is with the solved dwell over gamma (ref. 17); gamma over the reference's.
    """
    fixed, one = np.full_like(gamma, reference), np.ones_like(gamma)
    match correction:
        case "exact":
            return CorrectedSpot(gamma, one)
        case "none":
            return CorrectedSpot(fixed, one)
        case "linear":
            return CorrectedSpot(fixed, gamma / reference)
        case "power":
            return CorrectedSpot(fixed, (gamma / reference) ** exponent)
        case "pointwise":
            return CorrectedSpot(fixed, one, gamma / reference)
        case _:
            raise ComputeError(f"no correction {correction!r}; use exact, power, linear, pointwise or none")


def effect_matrix(
    grid: Grid,
    spot: Spot,
    program: Program,
    depth_ratio: FloatArray,
    factor: FloatArray,
    *,
    wider: float | FloatArray = 1.0,
    correlation: FloatArray | None = None,
) -> scipy.sparse.csr_array:
    """(ny * nx, n) removal rate of each timed point averaged over each sample's cell, nm/s (eq. 47).

    ``depth_ratio`` and ``factor``, (n,), as of `tif_at_point`; ``wider`` as of `Lie`, ``correlation`` (n,) as of
    `spot.askew`. A block that moves spreads its removal evenly from start to end. What falls beyond the grid is lost; a
    spot that does not touch it leaves an empty column.
    A column's sum is exact; the paper's Hertz spot, at rest or in motion, is right in each cell of 0.5 mm within 1.2 %
    of the peak (half of the spots within 0.6 %), of 1 mm within 0.6 %.
    """
    ends = (program.start_mm[:, :2], program.end_mm[:, :2])
    azimuth, lies = lean_azimuth_rad(program), [PointLocation(ends, wider)]
    (matrix,) = effects_columns(
        grid, spot, lies, azimuth, depth_ratio=depth_ratio, factor=factor, correlation=correlation
    )
    return matrix


@dataclass(frozen=True, slots=True)
class PointLocation:
    """Positions of n blocks whose spots are equal up to shift and width."""

    ends_mm: tuple[FloatArray, FloatArray]
    """(n, 2) where each begins and ends."""
    wider: float | FloatArray = 1.0
    """Factor on their spots' width, volume kept; (n, 2) for different factors along x and y."""


def effect_columns(
    grid: Grid,
    spot: Spot,
    ends_mm: tuple[FloatArray, FloatArray],
    azimuth_rad: FloatArray,
    *,
    depth_ratio: FloatArray,
    factor: FloatArray,
) -> scipy.sparse.csr_array:
    """`effect_matrix` of blocks from (n, 2) to (n, 2) mm, the spindle leaning towards (n,) ``azimuth_rad``."""
    return effects_columns(grid, spot, [PointLocation(ends_mm)], azimuth_rad, depth_ratio=depth_ratio, factor=factor)[0]


def effects_columns(
    grid: Grid,
    spot: Spot,
    lies: Sequence[PointLocation],
    azimuth_rad: FloatArray,
    *,
    depth_ratio: FloatArray,
    factor: FloatArray,
    correlation: FloatArray | None = None,
) -> list[scipy.sparse.csr_array]:
    """`effect_columns` of the same blocks as they lie in one way and another: their patches are made once."""
    refuse_where(~((factor >= 0) & np.isfinite(factor)), factor, "the factor on the removal", "", "it must be finite")
    impossible = ~((depth_ratio > 0) & np.isfinite(depth_ratio))
    refuse_where(impossible, depth_ratio, "the depth ratio gamma", "", "it must be above 0")
    half, step = spot.half_width_mm(depth_ratio), spot.step_mm(depth_ratio)
    offset = spot.offset_mm(depth_ratio, azimuth_rad)
    squares = spot.patch(depth_ratio[:1], azimuth_rad[:1]).shape[-1]
    wider = [np.broadcast_to(lie.wider, (len(half), 2)) for lie in lies]
    length = [
        np.linalg.norm(lie.ends_mm[1] - lie.ends_mm[0], axis=1) / wide.min(axis=1)
        for lie, wide in zip(lies, wider, strict=True)
    ]
    pieces = np.ceil(np.array(length) / step).astype(np.int64)
    most = np.maximum(2 * pieces.max(axis=0), PATCH_POSITIONS)
    parts: list[list[CellAverages]] = [[] for _ in lies]
    for part in _chunks(most * max(1, round(squares / PATCH))):
        patch = spot.patch(depth_ratio[part], azimuth_rad[part])
        integral = integrals(patch if correlation is None else tilt_spot(patch, correlation[part]))
        for found, lie, wide, cut in zip(parts, lies, wider, pieces[:, part], strict=True):
            start, end = (at[part] + offset[part] for at in lie.ends_mm)
            block, position = positions(start, end, cut)
            found.append(
                average_over_cells(grid, integral, wide[part] * half[part, None], np.bincount(block), position)
            )
    return [_matrix(grid, found, factor) for found in parts]


def lean_azimuth_rad(program: Program) -> FloatArray:
    """(n,) where the spindle leans at each timed point, counterclockwise from the part's x."""
    return np.asarray(np.arctan2(program.axis[:, 1], program.axis[:, 0]), dtype=np.float64)


def _chunks(count: NDArray[np.int64]) -> Iterator[slice]:
    """Cut blocks that hold as much as (n,) positions of a spot of PATCH squares across into runs of about CHUNK."""
    chunk = (np.cumsum(count) - count) // CHUNK
    edges = [0, *(np.flatnonzero(np.diff(chunk)) + 1).tolist(), len(count)]
    for first, last in pairwise(edges):
        if last > first:
            yield slice(first, last)


def positions(
    start_mm: FloatArray, end_mm: FloatArray, pieces: NDArray[np.int64]
) -> tuple[NDArray[np.int64], FloatArray]:
    """Spot positions of blocks: the block (s,) each belongs to, and (s, 2) x and y in mm.

    Two Gauss points to each of a block's ``pieces`` (n,), each at most a step of the spot long; one at rest.
    """
    count = np.maximum(2 * pieces, 1)
    block = np.repeat(np.arange(len(count)), count)
    k = np.arange(len(block)) - np.repeat(np.cumsum(count) - count, count)
    gauss = np.where(k % 2 == 0, -1, 1) / np.sqrt(12)
    share = np.where(pieces[block] > 0, (k // 2 + 0.5 + gauss) / np.maximum(pieces[block], 1), 0.0)
    return block, start_mm[block] + share[:, None] * (end_mm - start_mm)[block]


def _matrix(grid: Grid, parts: list[CellAverages], factor: FloatArray) -> scipy.sparse.csr_array:
    """(ny * nx, n) of the columns of all parts, times (n,) factors; what comes to nothing is left out."""
    shape = (grid.ny * grid.nx, len(factor))
    if not parts:
        return scipy.sparse.csr_array(shape)
    count = np.concatenate([part.count for part in parts])
    rate = np.concatenate([part.rate for part in parts]) * np.repeat(factor, count)
    sample = np.concatenate([part.sample for part in parts])
    first = np.concatenate([[0], np.cumsum(count)])
    matrix = scipy.sparse.csr_array(scipy.sparse.csc_array((rate, sample, first), shape=shape))
    if not factor.all():
        matrix.eliminate_zeros()
    return matrix
