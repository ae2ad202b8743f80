"""Reference for the cell averages of patches: divides each square by area, position by position."""

from __future__ import annotations

import numpy as np

from polishd.model.surface import FloatArray, Grid
from polishd.process.removal.dynamic_tif import Indices
from polishd.process.removal.tif import PATCH, cell_shares


def overlap(
    centre_mm: FloatArray, half_mm: FloatArray, pitch_mm: float, squares: int = PATCH
) -> tuple[FloatArray, FloatArray]:
    """How squares of the patch fall on cells of a row, along one coordinate.

    ``centre_mm`` (n,) is the patch's centre, measured from the row's outer edge; ``half_mm`` (n,) half its side.
    Returns the (n,) first cell (whole numbers, may lie outside the row) and the (n, cells, squares) shares: how much of
    each square lies in each cell; over the cells they add up to 1.
    """
    first = np.floor((centre_mm - half_mm) / pitch_mm)
    cells = int(np.ceil(2 * half_mm.max(initial=0.0) / pitch_mm)) + 1
    return first, cell_shares(centre_mm - first * pitch_mm, half_mm, pitch_mm, cells, squares)


def shared_out(
    grid: Grid, patch: FloatArray, half_mm: FloatArray, count: Indices, position_mm: FloatArray
) -> FloatArray:
    """(ny, nx, n) what `laying.lay` is to say, of (n, squares, squares) patches."""
    found, owner = np.zeros((*grid.shape, len(patch))), np.repeat(np.arange(len(patch)), count)
    for k, (x_mm, y_mm) in zip(owner, position_mm, strict=True):
        across, down = x_mm + grid.nx * grid.pitch_mm / 2, grid.ny * grid.pitch_mm / 2 - y_mm
        (column, right), (row, below) = (
            overlap(np.array([at]), half_mm[k : k + 1], grid.pitch_mm, patch.shape[1]) for at in (across, down)
        )
        content = below[0] @ patch[k] @ right[0].T / grid.pitch_mm**2 / count[k]
        for j, line in enumerate(content, int(row[0])):
            for i, rate in enumerate(line, int(column[0])):
                if 0 <= j < grid.ny and 0 <= i < grid.nx:
                    found[j, i, k] += rate
    return found
