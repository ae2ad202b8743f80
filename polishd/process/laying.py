"""Patches laid on the cells of a grid, by their integral: exact, and at a few reads a cell.

A patch is even within each of its squares, so that its integral from one corner is bilinear between the squares'
corners. What of it lies in a cell is the second difference of that integral at the cell's corners. To share each square
out among cells (`spot.shares`) comes to the same, and takes ten times the time.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polishd.model.surface import FloatArray, Grid

Indices = NDArray[np.int64]

NOTHING = 2e-14
"""Of a patch: what differences of its integral leave where nothing is. They round to about 1e-15."""


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
    """Of n patches the cells that all positions of each lie in, one window after the other."""

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
