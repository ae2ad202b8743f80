"""A map explained by another: turned, negated and moved, how well does it fit?"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from polishd.model.surface import BoolArray, FloatArray
from polishd.process.masked_correlation import correlations, peak
from polishd.process.orientation import ORIENTATIONS, Orientation, orientations

REACH_MM = 5.0
"""Largest shift that is looked for."""


@dataclass(frozen=True, slots=True)
class Explanation:
    """One map turned one way, and how it fits another where it fits best."""

    orientation: Orientation
    negated: bool
    correlation: float
    """At the best shift; not negative: ``negated`` holds the sign."""
    shift_mm: tuple[float, float]
    """(x, y) by which the turned map must be moved."""

    @property
    def name(self) -> str:
        """What was done to the map, in words: "as it is", "negated", "turned 90 and negated"."""
        if not self.negated:
            return self.orientation.name
        return "negated" if self.orientation == ORIENTATIONS[0] else f"{self.orientation.name} and negated"

    @property
    def as_it_is(self) -> bool:
        """Whether nothing was done to the map but moving it."""
        return self.orientation == ORIENTATIONS[0] and not self.negated

    def turn(self, height_nm: FloatArray) -> FloatArray:
        """The map turned and signed, not moved."""
        return np.asarray(self.orientation.turn(-height_nm if self.negated else height_nm), dtype=np.float64)

    def turn_mask(self, mask: BoolArray) -> BoolArray:
        """Its mask, turned."""
        return np.asarray(self.orientation.turn(mask), dtype=np.bool_)

    def samples(self, pitch_mm: float) -> tuple[int, int]:
        """(down, right) the shift in whole samples."""
        x, y = self.shift_mm
        return round(-y / pitch_mm), round(x / pitch_mm)


def explanations(
    height_nm: FloatArray, seen_nm: FloatArray, mask: BoolArray, seen_mask: BoolArray, pitch_mm: float
) -> Iterator[Explanation]:
    """Each turn and flip that keeps the array's shape, plain and negated, at the shift where it fits best.

    Args:
        height_nm: (ny, nx) the map to be turned, without piston.
        seen_nm: (ny, nx) the one to be explained.
        mask: (ny, nx) of the first.
        seen_mask: (ny, nx) of the second.
        pitch_mm: of both.
    """
    reach = max(1, round(REACH_MM / pitch_mm))
    for orientation in orientations(mask.shape):
        turned_mask = np.asarray(orientation.turn(mask), dtype=np.bool_)
        found = correlations(orientation.turn(height_nm), turned_mask, seen_nm, seen_mask, reach)
        for negated in (False, True):
            value, row, column = peak(np.maximum(-found if negated else found, 0.0))
            yield Explanation(orientation, negated, value, (column * pitch_mm, -row * pitch_mm))
