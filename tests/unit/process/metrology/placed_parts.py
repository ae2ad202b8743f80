"""Parts laid into maps at a known place, for the tests of registration, gate and commissioning."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from polishd.model.surface import FloatArray, Grid
from polishd.process.metrology.commissioning import ArtefactBump

MARKS_MM = ((-40.0, -24.0), (36.0, -33.0), (31.0, 36.0), (-20.0, 43.0))
"""Four marks that no turn or flip lays onto themselves."""
BUMPS = (ArtefactBump(18, 12, 6, 3.5, 200, 30), ArtefactBump(-12, 20, 4, 4, 90), ArtefactBump(-5, -22, 5, 3, -60))
"""An artefact that looks like itself in no other orientation."""


def seen_px(
    points_mm: ArrayLike, grid: Grid, turn_deg: float = 0.0, shift_mm: Sequence[float] | FloatArray = (0, 0)
) -> FloatArray:
    """(n, 2) row and column where points of the part are seen in a map of this grid."""
    turn = np.radians(turn_deg)
    p = np.asarray(points_mm, dtype=np.float64)
    x = np.cos(turn) * p[:, 0] - np.sin(turn) * p[:, 1] + shift_mm[0]
    y = np.sin(turn) * p[:, 0] + np.cos(turn) * p[:, 1] + shift_mm[1]
    return np.column_stack([(grid.ny - 1) / 2 - y / grid.pitch_mm, (grid.nx - 1) / 2 + x / grid.pitch_mm])


def on_part(grid: Grid, turn_deg: float = 0.0, shift_mm: Sequence[float] = (0, 0)) -> tuple[FloatArray, FloatArray]:
    """(ny, nx) x and y on the part of each sample of a map in which the part lies so."""
    turn = np.radians(turn_deg)
    x, y = np.meshgrid(grid.x_mm - shift_mm[0], grid.y_mm - shift_mm[1])
    return np.cos(turn) * x + np.sin(turn) * y, -np.sin(turn) * x + np.cos(turn) * y


def disc(grid: Grid, diameter_mm: float, turn_deg: float = 0.0, shift_mm: Sequence[float] = (0, 0)) -> FloatArray:
    """(ny, nx) some figure inside a disc, NaN outside."""
    x, y = on_part(grid, turn_deg, shift_mm)
    return np.where(np.hypot(x, y) <= diameter_mm / 2, 50 * np.sin(x / 11 + 0.3) * np.cos(y / 8) + x, np.nan)


def punched(height_nm: FloatArray, marks_px: FloatArray, diameter_px: float) -> FloatArray:
    """The map with a round hole at each mark."""
    rows, columns = np.indices(height_nm.shape)
    near = [np.hypot(rows - row, columns - column) <= diameter_px / 2 for row, column in marks_px]
    return np.where(np.any(near, axis=0), np.nan, height_nm)
