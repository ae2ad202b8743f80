"""A map explained by another: turned, negated and moved, how well does it fit?"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import scipy

from polishd.model.surface import BoolArray, FloatArray
from polishd.process.orientation import ORIENTATIONS, ArrayOrientation, orientations

REACH_MM = 5.0
"""Largest shift that is looked for."""
OVERLAP = 0.5
"""Share of the smaller mask that must overlap for a shift to count."""


@dataclass(frozen=True, slots=True)
class Explanation:
    """One map turned one way, and how it fits another where it fits best."""

    orientation: ArrayOrientation
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


def correlations(a: FloatArray, a_mask: BoolArray, b: FloatArray, b_mask: BoolArray, reach: int) -> FloatArray:
    """Correlation of b with a moved by (row, column) shifts up to ``reach`` samples, over where the masks overlap.

    The mean of the overlap is taken out for each shift, so that nothing outside the masks weighs in
    (D. Padfield, IEEE Trans. Image Processing 21, 2012).

    Returns:
        (2 reach + 1, 2 reach + 1); [reach + i, reach + j] is for a moved down by i and right by j. 0 where too
        little overlaps, or where either is even.
    """
    shape = [scipy.fft.next_fast_len(n + reach, real=True) for n in a.shape]
    ones_a, ones_b = (scipy.fft.rfft2(mask.astype(np.float64), shape) for mask in (a_mask, b_mask))
    a, b = np.where(a_mask, a, 0.0), np.where(b_mask, b, 0.0)
    fa, fb = scipy.fft.rfft2(a, shape), scipy.fft.rfft2(b, shape)

    def over_shifts(first: FloatArray, second: FloatArray) -> FloatArray:
        """Sum over x of first(x - s) second(x)."""
        all_shifts = scipy.fft.irfft2(np.conj(first) * second, shape)
        near = np.arange(-reach, reach + 1)
        return np.asarray(all_shifts[np.ix_(near, near)])

    count = np.maximum(over_shifts(ones_a, ones_b), 1.0)
    sum_a, sum_b = over_shifts(fa, ones_b), over_shifts(ones_a, fb)
    cross = over_shifts(fa, fb) - sum_a * sum_b / count
    square_a = over_shifts(scipy.fft.rfft2(a**2, shape), ones_b) - sum_a**2 / count
    square_b = over_shifts(ones_a, scipy.fft.rfft2(b**2, shape)) - sum_b**2 / count
    least_a, least_b = 1e-9 * (a**2).sum(), 1e-9 * (b**2).sum()
    fair = (square_a > least_a) & (square_b > least_b)
    fair &= count >= OVERLAP * min(a_mask.sum(), b_mask.sum())
    found = np.where(fair, cross / np.sqrt(np.where(fair, square_a * square_b, 1.0)), 0.0)
    return np.asarray(np.clip(found, -1.0, 1.0), dtype=np.float64)


def peak(found: FloatArray) -> tuple[float, float, float]:
    """Value and (row, column) shift, in samples, of the largest magnitude; between samples by a parabola each way."""
    reach = found.shape[0] // 2
    i, j = np.unravel_index(int(abs(found).argmax()), found.shape)
    value, size = float(found[i, j]), abs(found)
    row = _vertex(size[max(i - 1, 0) : i + 2, j])
    column = _vertex(size[i, max(j - 1, 0) : j + 2])
    return value, float(i - reach + row), float(j - reach + column)


def _vertex(three: FloatArray) -> float:
    if three.size < 3:
        return 0.0  # at the border of what was searched
    curvature = three[0] - 2 * three[1] + three[2]
    return float(0.5 * (three[0] - three[2]) / curvature) if curvature < 0 else 0.0
