"""How the part lies in each map, and what that makes of its Zernike terms.

A pose is a turn about the axis, then a lateral shift: the part's point p is seen at ``R(angle) p + shift``. Angles are
counter-clockwise as the map is displayed (row 0 at the top, x right, y up).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from polishd.model.surface import FloatArray
from polishd.process.metrics.zernike_terms import order, values

LEVEL = 3
"""Piston and tilts, the first terms of any map: each map has its own, so that they tell nothing."""


@dataclass(frozen=True, slots=True)
class PartPose:
    """Of the part in one map."""

    angle_deg: float
    """Counter-clockwise as displayed."""
    x_mm: float = 0.0
    """By which the part lies further to the right ..."""
    y_mm: float = 0.0
    """... and up, after the turn."""

    def __str__(self) -> str:
        shift = f", shifted {self.x_mm:g},{self.y_mm:g} mm" if self.x_mm or self.y_mm else ""
        return f"{self.angle_deg:g} deg{shift}"

    def on_part(self, x_mm: FloatArray, y_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Coordinates on the part of points in the map, all from the axis."""
        turn = np.radians(self.angle_deg)
        x, y = x_mm - self.x_mm, y_mm - self.y_mm
        return np.cos(turn) * x + np.sin(turn) * y, np.cos(turn) * y - np.sin(turn) * x

    def in_map(self, x_mm: FloatArray, y_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The inverse: where points of the part are seen."""
        turn = np.radians(self.angle_deg)
        x, y = np.cos(turn) * x_mm - np.sin(turn) * y_mm, np.sin(turn) * x_mm + np.cos(turn) * y_mm
        return x + self.x_mm, y + self.y_mm


def terms(degree: int) -> tuple[tuple[int, int], ...]:
    """(n, m) of all Zernike terms up to this radial order, piston and tilts first."""
    return order("ansi", (degree + 1) * (degree + 2) // 2)


def moved(degree: int, pose: PartPose, radius_mm: float) -> FloatArray:
    """What a pose makes of terms, (k, k): ``seen = moved @ part``, both of RMS norm over the unit circle.

    Exact: a polynomial that is turned and shifted is one of the same degree. Solved on a lattice of points.
    """
    x, y, inverse = _lattice(degree)
    there = (along / radius_mm for along in pose.on_part(x * radius_mm, y * radius_mm))
    return np.asarray(inverse @ values(terms(degree), "rms", *there).T)


@cache
def _lattice(degree: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(p,) x and y of points in the unit circle, and (k, p) what finds the terms of values there."""
    radius = np.sqrt((np.arange(degree + 2) + 0.5) / (degree + 2))[:, None]
    angle = 2 * np.pi * np.arange(2 * degree + 3)[None, :] / (2 * degree + 3)
    x: FloatArray = (radius * np.cos(angle)).ravel()
    y: FloatArray = (radius * np.sin(angle)).ravel()
    return x, y, np.asarray(np.linalg.pinv(values(terms(degree), "rms", x, y).T), dtype=np.float64)
