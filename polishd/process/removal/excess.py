"""Excess removal along a path: what points removed beyond their planned time, summed over the spot's footprint.

The sum is kept on a grid over the path, with a spot that is round: at each distance from its center it removes as fast
as the real one does in any direction there. The planned removal is summed with the same spot, so that a path that is
slow everywhere by a tenth shows a tenth of the planned removal, whatever the spot's true shape.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy

from polishd.model.program import IntArray, Program
from polishd.model.surface import BoolArray, FloatArray
from polishd.process.removal.measured_tif import SpotFigures

CELLS_PER_REACH = 8
"""Grid cells from the spot's center to its rim."""
MOST_CELLS = 2000
"""Grid cells along the longer side."""
NEGLIGIBLE = 1e-3
"""Share of the peak rate beyond which the spot ends."""


@dataclass(frozen=True, slots=True)
class Excess:
    """A place where the removal is beyond its limit."""

    excess_nm: float
    limit_nm: float
    x_mm: float
    y_mm: float
    """Position in the frame of the path."""


class ExcessMap:
    """Removal beyond the plan at each place of one pass, by the time that its points took."""

    def __init__(
        self,
        program: Program,
        expected_s: FloatArray,
        spot: SpotFigures,
        *,
        floor_nm: float,
        share: float = 0.0,
        on_part: Callable[[FloatArray, FloatArray], BoolArray] | None = None,
    ) -> None:
        """Set the limit at each place: the larger of ``floor_nm`` and ``share`` of the planned removal there.

        Args:
            program: the path; n timed points.
            expected_s: (n,) planned time of each point.
            spot: the spot's profiles and its peak rate.
            floor_nm: limit where little is planned.
            share: limit relative to the planned removal.
            on_part: which places (x, y), mm, are on the part: no others are judged. None: all are.
        """
        self.peak_nm_s = spot.peak_nm_s
        self.expected_s = expected_s
        radius_mm, rate_nm_s = _round_spot(spot)
        middle = (program.start_mm + program.end_mm)[:, :2] / 2
        extent_mm = float(np.ptp(middle, axis=0).max(initial=0.0))
        self._pitch_mm = max(float(radius_mm[-1]) / CELLS_PER_REACH, extent_mm / MOST_CELLS, 1e-6)
        self._half = int(np.ceil(radius_mm[-1] / self._pitch_mm))
        offset = np.arange(-self._half, self._half + 1) * self._pitch_mm
        self._spot_nm_s = np.interp(np.hypot(offset[:, None], offset[None, :]), radius_mm, rate_nm_s, right=0.0)
        self._origin_mm = middle.min(axis=0) - self._half * self._pitch_mm
        self._cell: IntArray = np.rint((middle - self._origin_mm) / self._pitch_mm).astype(np.int64)
        shape = self._cell.max(axis=0) + self._half + 1
        planned = np.zeros(shape)
        np.add.at(planned, (self._cell[:, 0], self._cell[:, 1]), expected_s)
        planned_nm = scipy.signal.fftconvolve(planned, self._spot_nm_s, mode="same")
        self._limit_nm: FloatArray = np.maximum(floor_nm, share * planned_nm)
        if on_part is not None:
            x, y = (self._origin_mm[axis] + np.arange(shape[axis]) * self._pitch_mm for axis in (0, 1))
            self._limit_nm[~on_part(x[:, None], y[None, :])] = np.inf
        self._excess_nm = np.zeros(shape)
        self._count_nm_s = np.zeros(shape)
        """Removal by the points so far, for each second that all of them took."""

    @property
    def n(self) -> int:
        """Number of timed points."""
        return int(self.expected_s.size)

    def add(self, point: int, excess_s: float, *, times: int = 1) -> None:
        """Count the time that a point took beyond its planned time; negative where it took less.

        ``times`` 0: its overhead does not count.
        """
        window = self._window(point)
        self._excess_nm[window] += excess_s * self._spot_nm_s
        if times:
            self._count_nm_s[window] += times * self._spot_nm_s

    def beyond(
        self, point: int, more_s: float = 0.0, *, allowed_nm: float = 0.0, overhead_s: float = 0.0
    ) -> Excess | None:
        """Return the worst place within the spot at that point, or None where all are within their limits.

        ``more_s`` is time that the tool has stood there besides, ``allowed_nm`` comes on top of the limit, and
        ``overhead_s`` is what each point may take beyond its planned time.
        """
        window = self._window(point)
        excess_nm = self._excess_nm[window] + more_s * self._spot_nm_s
        if overhead_s:
            excess_nm -= overhead_s * self._count_nm_s[window]
        over_nm = excess_nm - self._limit_nm[window]
        if (over_nm <= allowed_nm).all():
            return None
        row, column = np.unravel_index(int(over_nm.argmax()), over_nm.shape)
        corner = np.array([window[0].start + row, window[1].start + column])
        x_mm, y_mm = self._origin_mm + corner * self._pitch_mm
        limit_nm = float(self._limit_nm[window][row, column])
        return Excess(float(excess_nm[row, column]), limit_nm, float(x_mm), float(y_mm))

    def worst(self, overhead_s: float = 0.0) -> float:
        """Return the largest share of its limit that any place has used up."""
        return float(((self._excess_nm - overhead_s * self._count_nm_s) / self._limit_nm).max(initial=0.0))

    def far(self, point: int, other: int) -> bool:
        """Tell whether a point lies beyond what is judged at another."""
        return bool(np.abs(self._cell[point] - self._cell[other]).max() > self._half // 2)

    def fresh(self) -> ExcessMap:
        """Return a map of the same plan and limits without any excess."""
        other = object.__new__(ExcessMap)
        other.__dict__.update(self.__dict__)
        other._excess_nm, other._count_nm_s = np.zeros_like(self._excess_nm), np.zeros_like(self._excess_nm)
        return other

    def _window(self, point: int) -> tuple[slice, slice]:
        row, column = self._cell[point]
        return (
            slice(int(row) - self._half, int(row) + self._half + 1),
            slice(int(column) - self._half, int(column) + self._half + 1),
        )


def _round_spot(spot: SpotFigures) -> tuple[FloatArray, FloatArray]:
    """Radii from 0 (m,), mm, and the largest rate at that distance from the center or farther, (m,), nm/s."""
    reach = float(max(np.abs(spot.x_mm).max(), np.abs(spot.y_mm).max()))
    radius = np.linspace(0.0, reach, 4 * CELLS_PER_REACH + 1)
    sides = [
        np.interp(sign * radius, line, profile, left=0.0, right=0.0)
        for line, profile in ((spot.x_mm, spot.profile_x_nm_s), (spot.y_mm, spot.profile_y_nm_s))
        for sign in (1.0, -1.0)
    ]
    rate = np.maximum.accumulate(np.max(sides, axis=0)[::-1])[::-1]
    rate[0] = spot.peak_nm_s  # the profiles may miss the peak
    ends = int(np.flatnonzero(rate > NEGLIGIBLE * spot.peak_nm_s).max(initial=0)) + 1
    return radius[: ends + 1], rate[: ends + 1]
