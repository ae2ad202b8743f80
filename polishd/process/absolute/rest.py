"""What Zernike terms leave of the maps, sample by sample: the instrument's in the map's frame, the part's in its own.

Each is in turn the mean of what the maps leave without the other. It begins with nothing for the instrument, so that
what no pose tells (means over azimuth, folds that all turns share, waves much longer than a shift) stays in the part.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import scipy.ndimage

from polishd.model.surface import BoolArray, FloatArray
from polishd.process.absolute.poses import Pose

SWEEPS = 12
"""Of both means. A wave of which each sweep finds half is known to 1/4096 after them."""
LEAST_MAPS = 2
"""Maps that must show a sample."""
Way = Callable[[FloatArray, FloatArray], tuple[FloatArray, FloatArray]]
"""From coordinates in one frame, mm about the axis, to those in the other."""


@dataclass(frozen=True, slots=True)
class Rest:
    """Two maps of (ny, nx) on the grid of the maps, NaN where fewer than two show a sample."""

    instrument_nm: FloatArray
    part_nm: FloatArray
    """About the axis, as it lies at 0 deg without a shift."""
    noise_nm: float | None
    """Of one sample of one map, from what both leave; None where nothing is over to tell it by."""


@dataclass(frozen=True, slots=True)
class _Turned:
    """Where the samples of one frame lie in the other."""

    at: FloatArray
    """(2, ny, nx) rows and columns."""

    def take(self, height_nm: FloatArray, valid: BoolArray) -> tuple[FloatArray, BoolArray]:
        """(ny, nx) cubic splines through the data, with the nearest where there is none; where that is data."""
        nearest = scipy.ndimage.distance_transform_edt(~valid, return_distances=False, return_indices=True)
        there = scipy.ndimage.map_coordinates(valid.astype(np.float64), self.at, order=1, cval=0.0) > 0.5
        return scipy.ndimage.map_coordinates(height_nm[tuple(nearest)], self.at, order=3, mode="nearest"), there


def split(
    heights_nm: Sequence[FloatArray], poses: Sequence[Pose], axis_px: tuple[float, float], pitch_mm: float
) -> Rest:
    """Part and instrument of maps that piston, tilt and the low terms were taken off.

    Args:
        heights_nm: (ny, nx) of each map, NaN = no data.
        poses: of the part in each.
        axis_px: (row, column) about which the part is turned.
        pitch_mm: of all.
    """
    valid = [np.isfinite(height) for height in heights_nm]
    heights = [np.where(there, height, 0.0) for there, height in zip(valid, heights_nm, strict=True)]
    onto = [_way(pose.in_map, heights[0].shape, axis_px, pitch_mm) for pose in poses]
    back = [_way(pose.on_part, heights[0].shape, axis_px, pitch_mm) for pose in poses]
    seen = np.sum(valid, axis=0)
    instrument, part, shown = np.zeros(seen.shape), np.zeros(seen.shape), np.zeros(seen.shape)
    off: list[FloatArray] = []
    for sweep in range(SWEEPS + 1):
        taken = [way.take(z - instrument, there) for way, z, there in zip(onto, heights, valid, strict=True)]
        part, shown = _mean(taken)
        lies = shown > 0
        both = [way.take(part, lies) for way in back]
        off = [np.where(there & its[1], z - its[0], np.nan) for z, there, its in zip(heights, valid, both, strict=True)]
        if sweep < SWEEPS:
            instrument = _mean([(np.nan_to_num(one), np.isfinite(one)) for one in off])[0]
    enough = seen >= LEAST_MAPS
    left = np.concatenate([(one - instrument)[np.isfinite(one) & enough] for one in off])
    freedom = left.size - np.count_nonzero(enough) - np.count_nonzero(shown >= LEAST_MAPS)
    return Rest(
        instrument_nm=np.where(enough, instrument, np.nan),
        part_nm=np.where(shown >= LEAST_MAPS, part, np.nan),
        noise_nm=float(np.sqrt((left**2).sum() / freedom)) if freedom > 0.1 * left.size else None,
    )


def _mean(taken: Sequence[tuple[FloatArray, BoolArray]]) -> tuple[FloatArray, FloatArray]:
    """(ny, nx) mean of the data, 0 where there is none, and how many maps have it."""
    count = np.sum([there for _, there in taken], axis=0).astype(np.float64)
    total = np.sum([np.where(there, height, 0.0) for height, there in taken], axis=0)
    return total / np.maximum(count, 1.0), count


def _way(to: Way, shape: tuple[int, ...], axis_px: tuple[float, float], pitch_mm: float) -> _Turned:
    """Rows and columns of ``to`` of each sample."""
    rows, columns = np.indices(shape)
    x, y = to((columns - axis_px[1]) * pitch_mm, (axis_px[0] - rows) * pitch_mm)
    return _Turned(np.stack([axis_px[0] - y / pitch_mm, axis_px[1] + x / pitch_mm]))
