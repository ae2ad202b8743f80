"""Points in any order onto the regular grid that they lie on."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from polishd.api import MapError
from polishd.model.surface import FloatArray

SAME_WITHIN = 1e-4
"""Coordinates closer than this part of the mean spacing are one row or column: rounding, not a step."""
OFF_GRID_PX = 0.1
CELLS_PER_POINT = 4
"""A grid of more places than so many per point is no measured map (and would be allocated)."""
ORIENTATION = "by the file's own coordinates: row 0 is the largest y, column 0 the smallest x"


class GridResult(NamedTuple):
    """Values on the grid (row 0 = largest y) and its two pitches, in the units of the coordinates."""

    z: FloatArray
    pitch_x: float
    pitch_y: float


def gridded(path: Path, x: FloatArray, y: FloatArray, z: FloatArray, *, in_lines: bool = False) -> GridResult:
    """Put (n,) points on the grid that x and y span; places without a point are NaN.

    BadMap where the coordinates are not finite, lie more than 0.1 pixel off any regular grid, fall on one another, or
    leave most of the grid empty. ``in_lines``: and where the list stops short in the last of its rows or columns.
    """
    if not (np.isfinite(x).all() and np.isfinite(y).all()):
        raise MapError(f"{path}: some points have no coordinates")
    if x.size < 4 or not (np.ptp(x) > 0 and np.ptp(y) > 0):
        raise MapError(f"{path}: its {x.size} points make no grid of at least two rows and columns")
    spacing = float(np.sqrt(np.ptp(x) / x.size) * np.sqrt(np.ptp(y)))
    columns, pitch_x = _places(path, "x", x, spacing)
    rows, pitch_y = _places(path, "y", y, spacing)
    ny, nx = int(rows.max()) + 1, int(columns.max()) + 1
    if ny * nx > CELLS_PER_POINT * x.size + 64:
        raise MapError(f"{path}: {x.size} points for {ny} x {nx} places: not on a regular grid")
    place = (ny - 1 - rows) * nx + columns
    counts = np.bincount(place, minlength=ny * nx)
    if counts.max() > 1:
        raise MapError(f"{path}: {int((counts > 1).sum())} places have more than one point: not one map")
    if in_lines:
        _require_end(path, np.argwhere(counts.reshape(ny, nx) == 0), divmod(int(place[-1]), nx))
    grid = np.full(ny * nx, np.nan)
    grid[place] = z
    return GridResult(grid.reshape(ny, nx), pitch_x, pitch_y)


def _require_end(path: Path, empty: NDArray[np.int64], last: tuple[int, int]) -> None:
    """BadMap where all (n, 2) empty places are of the row, or of the column, of the point that was listed last."""
    for axis, name in enumerate(("row", "column")):
        if len(empty) and (empty[:, axis] == last[axis]).all() and np.ptp(empty[:, 1 - axis]) == len(empty) - 1:
            raise MapError(f"{path}: its last {name} lacks {len(empty)} points: torn, or still being written")


def _places(path: Path, axis: str, values: FloatArray, spacing: float) -> tuple[NDArray[np.int64], float]:
    """Index of each value on the axis, (n,), and the axis' pitch."""
    order = np.argsort(values, kind="stable")
    gaps = np.diff(values[order])
    new = gaps > SAME_WITHIN * spacing
    steps = gaps[new]
    if not steps.size:
        raise MapError(f"{path}: all points have nearly the same {axis}: no grid")
    with np.errstate(over="ignore"):  # what is infinite is no grid
        index = np.concatenate([[0.0], np.cumsum(np.round(steps / np.median(steps[steps < 1.5 * steps.min()])))])
    levels = values[order][np.concatenate([[True], new])]
    if index[-1] > CELLS_PER_POINT * values.size or (np.diff(index) < 1).any():
        raise MapError(f"{path}: {axis} is not evenly spaced: not on a regular grid")
    pitch = float((levels[-1] - levels[0]) / index[-1])
    place = (values - levels[0]) / pitch
    nearest = np.round(place)
    worst = float(np.abs(place - nearest).max())
    if worst > OFF_GRID_PX:
        raise MapError(f"{path}: {axis} lies up to {worst:.2f} pixel off a regular grid of {pitch:.6g}")
    return nearest.astype(np.int64), pitch
