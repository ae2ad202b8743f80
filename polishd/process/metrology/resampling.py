"""Pose of a part in a map, and resampling to it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from math import ceil

import numpy as np
import scipy
from numpy.typing import NDArray

from polishd.model.surface import BoolArray, FloatArray, Grid

Point = tuple[float, float]


@dataclass(frozen=True, slots=True)
class Registration:
    """Where the part's centre lies in the map, and how the part is turned there.

    A point p (x right, y up, mm) of the part is seen at ``R(rotation) p + shift`` from the centre of the map's array.
    """

    rotation_deg: float = 0.0
    """Counter-clockwise turn of the part in the map."""
    shift_mm: Point = (0.0, 0.0)
    """(x, y) of the part's centre, from the centre of the map's array."""
    residual_mm: float = 0.0
    """RMS distance of the marks, or of the rim, from the fit."""
    used: int = 0
    """Marks that were matched, or samples of the rim."""
    by: str = "none"
    scale: float = 1.0
    """Size of the part in the map by its marks (or outline), relative to what it should be: a check, never applied."""

    @property
    def distance_mm(self) -> float:
        """Offset of the part's center from the center of the map's array."""
        return float(np.hypot(*self.shift_mm))

    def on_part_mm(self, grid: Grid) -> tuple[FloatArray, FloatArray]:
        """(ny, nx) x and y on the part of each sample of a map with this grid."""
        turn = np.radians(self.rotation_deg)
        right, up = grid.x_mm[None, :] - self.shift_mm[0], grid.y_mm[:, None] - self.shift_mm[1]
        return np.cos(turn) * right + np.sin(turn) * up, np.cos(turn) * up - np.sin(turn) * right

    def drift_mm(self, last: Registration) -> float:
        """Return the movement of the part's center since another map."""
        return float(np.hypot(self.shift_mm[0] - last.shift_mm[0], self.shift_mm[1] - last.shift_mm[1]))

    def __str__(self) -> str:
        x, y = self.shift_mm
        return f"centre at ({x:+.3f}, {y:+.3f}) mm, turned {self.rotation_deg:+.3f} deg (by {self.by})"


# Area averages on another grid, of a map in which the part is shifted and turned: volume is conserved.

COVERED = 0.5
"""Share of a cell's area that must have data for the cell to be valid."""
FLAT_DEG = 1e-6
"""Turn below which rows stay rows."""


def resample_registered(
    height_nm: FloatArray, source: Grid, target: Grid, registration: Registration | None = None
) -> FloatArray:
    """Area average of a map onto a grid that is centred on the part.

    Without a turn each pixel's overlap with each cell is exact. With one, pixels are cut into pieces no larger than
    half a cell, each is moved as a whole and its overlap taken as if it had not turned: the volume stays exact, and
    a square's second moments do not depend on its turn, so that the error is of fourth order in its size.

    Args:
        height_nm: (source.ny, source.nx), NaN = no data.
        source: the map's own grid.
        target: the grid wanted, about the part's centre.
        registration: where the part lies in the map; None: in its centre, not turned.

    Returns:
        (target.ny, target.nx) mean of the data in each cell; NaN where they cover less than half of it.
    """
    placed = registration or Registration()
    valid = np.isfinite(height_nm)
    data = np.where(valid, height_nm, 0.0)
    if abs(placed.rotation_deg) <= FLAT_DEG:
        volume, area = _aligned(data, valid, source, target, placed)
    else:
        volume, area = _turned(data, valid, source, target, placed)
    enough = area >= COVERED * target.pitch_mm**2 * (1 - 1e-9)
    return np.where(enough, volume / np.where(enough, area, 1.0), np.nan)


def averaging_matrix(source: Grid, target: Grid, registration: Registration) -> scipy.sparse.csr_array:
    """`resample_registered` of a map with data everywhere, as a matrix (target.ny * target.nx, source.ny * source.nx).

    Each row is a cell's mean over the pixels that it covers; the row of a cell that lies beyond the map is empty.
    """
    if abs(registration.rotation_deg) <= FLAT_DEG:
        x, y = registration.shift_mm
        rows = _overlap(source.ny, source.pitch_mm, target.ny, target.pitch_mm, y)
        columns = _overlap(source.nx, source.pitch_mm, target.nx, target.pitch_mm, -x)
        covered = scipy.sparse.csr_array(scipy.sparse.kron(rows, columns))
    else:
        everywhere = np.ones(source.shape, dtype=np.bool_)
        shared = zip(*_shared(everywhere, source, target, registration), strict=True)
        pixel, cell, area = (np.concatenate(part) for part in shared)
        covered = scipy.sparse.csr_array(
            scipy.sparse.coo_array((area, (cell, pixel)), shape=(target.ny * target.nx, source.ny * source.nx))
        )
    total = covered.sum(axis=1)
    share = np.divide(1.0, total, out=np.zeros_like(total), where=total >= COVERED * target.pitch_mm**2 * (1 - 1e-9))
    return scipy.sparse.csr_array(scipy.sparse.diags_array(share) @ covered)


def _aligned(
    data: FloatArray, valid: BoolArray, source: Grid, target: Grid, placed: Registration
) -> tuple[FloatArray, FloatArray]:
    x, y = placed.shift_mm
    rows = _overlap(source.ny, source.pitch_mm, target.ny, target.pitch_mm, y)  # y is up, rows go down
    columns = _overlap(source.nx, source.pitch_mm, target.nx, target.pitch_mm, -x).T
    return rows @ (data @ columns), rows @ (valid.astype(np.float64) @ columns)


def _overlap(
    n_source: int, pitch_source: float, n_target: int, pitch_target: float, offset: float
) -> scipy.sparse.csr_array:
    """(n_target, n_source) mm: how much of each target cell's side each source cell covers, moved by the offset."""
    left_t = (np.arange(n_target) - n_target / 2) * pitch_target
    left_s = (np.arange(n_source) - n_source / 2) * pitch_source + offset
    start = np.maximum(left_t[:, None], left_s[None, :])
    end = np.minimum(left_t[:, None] + pitch_target, left_s[None, :] + pitch_source)
    return scipy.sparse.csr_array(np.maximum(end - start, 0.0))


def _turned(
    data: FloatArray, valid: BoolArray, source: Grid, target: Grid, placed: Registration
) -> tuple[FloatArray, FloatArray]:
    height = data.ravel()
    volume, area = np.zeros(target.ny * target.nx), np.zeros(target.ny * target.nx)
    for pixel, cell, covered in _shared(valid, source, target, placed):
        area += np.bincount(cell, covered, minlength=area.size)
        volume += np.bincount(cell, covered * height[pixel], minlength=area.size)
    return volume.reshape(target.shape), area.reshape(target.shape)


def _shared(
    valid: BoolArray, source: Grid, target: Grid, placed: Registration
) -> Iterator[tuple[NDArray[np.int64], NDArray[np.int64], FloatArray]]:
    """(n,) pixel, cell and the area, mm2, that they share: piece by piece of the n valid pixels."""
    pieces = max(1, ceil(2 * source.pitch_mm / target.pitch_mm - 1e-9))
    side = source.pitch_mm / pieces
    row, column = np.nonzero(valid)
    pixel = row * source.nx + column
    inner = (np.arange(pieces) + 0.5) / pieces * source.pitch_mm - source.pitch_mm / 2
    turn = np.radians(placed.rotation_deg)
    for dx in inner:
        for dy in inner:
            x = source.x_mm[column] + dx - placed.shift_mm[0]
            y = source.y_mm[row] + dy - placed.shift_mm[1]
            on_part_x = np.cos(turn) * x + np.sin(turn) * y
            on_part_y = -np.sin(turn) * x + np.cos(turn) * y
            for cell, covered in _cells(on_part_x, on_part_y, side, target):
                yield pixel, cell, covered


def _cells(x: FloatArray, y: FloatArray, side: float, target: Grid) -> Iterator[tuple[NDArray[np.int64], FloatArray]]:
    """(n,) cell and covered area, mm2, of each piece with centre (x, y), for the four cells that it may reach."""
    columns = _split(x / target.pitch_mm + target.nx / 2, side / target.pitch_mm, target.nx)
    rows = _split(target.ny / 2 - y / target.pitch_mm, side / target.pitch_mm, target.ny)
    for row, high in rows:
        for column, wide in columns:
            yield row * target.nx + column, high * wide * target.pitch_mm**2


def _split(centre: FloatArray, side: float, n: int) -> list[tuple[NDArray[np.int64], FloatArray]]:
    """The two cells of a line that each piece reaches, and how much of it lies there; nothing outside the line."""
    left = centre - side / 2
    first = np.floor(left)
    here = np.minimum(first + 1 - left, side)
    cells = []
    for cell, part in ((first, here), (first + 1, side - here)):
        inside = (cell >= 0) & (cell < n)
        cells.append((np.where(inside, cell, 0).astype(np.int64), np.where(inside, part, 0.0)))
    return cells
