"""Where a part lies in a map."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from polishd.model.surface import FloatArray, Grid

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
        """Of the part's centre from the centre of the map's array."""
        return float(np.hypot(*self.shift_mm))

    def on_part_mm(self, grid: Grid) -> tuple[FloatArray, FloatArray]:
        """(ny, nx) x and y on the part of each sample of a map with this grid."""
        turn = np.radians(self.rotation_deg)
        right, up = grid.x_mm[None, :] - self.shift_mm[0], grid.y_mm[:, None] - self.shift_mm[1]
        return np.cos(turn) * right + np.sin(turn) * up, np.cos(turn) * up - np.sin(turn) * right

    def drift_mm(self, last: Registration) -> float:
        """How far the part's centre has moved since another map."""
        return float(np.hypot(self.shift_mm[0] - last.shift_mm[0], self.shift_mm[1] - last.shift_mm[1]))

    def __str__(self) -> str:
        x, y = self.shift_mm
        return f"centre at ({x:+.3f}, {y:+.3f}) mm, turned {self.rotation_deg:+.3f} deg (by {self.by})"
