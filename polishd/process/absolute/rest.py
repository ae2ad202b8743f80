"""What Zernike terms leave of the maps, sample by sample: the instrument's in the map's frame, the part's in its own.

Each is in turn the mean of what the maps leave without the other. It begins with nothing for the instrument, so that
what no pose tells (means over azimuth, folds that all turns share, waves much longer than a shift) stays in the part.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import scipy.ndimage
from numpy.typing import NDArray

from polishd.model.surface import BoolArray, FloatArray
from polishd.process.absolute.poses import PartPose

SWEEPS = 12
"""Of both means. A wave of which each sweep finds half is known to 1/4096 after them."""
LEAST_MAPS = 2
"""Maps that must show a sample."""
SETTLED = 1e-3
"""Change of the instrument's map, of itself, at which it is done."""
LEAST_SHARE = 0.1
"""Of the samples that must be more than the unknowns for the noise to be told."""
Way = Callable[[FloatArray, FloatArray], tuple[FloatArray, FloatArray]]
"""From coordinates in one frame, mm about the axis, to those in the other."""


@dataclass(frozen=True, slots=True)
class PixelRemainder:
    """Two maps of (ny, nx) on the grid of the maps, NaN where fewer than two show a sample."""

    instrument_nm: FloatArray
    part_nm: FloatArray
    """About the axis, as it lies at 0 deg without a shift."""
    noise_nm: float | None
    """Of one sample of one map, from what both leave; None where nothing is over to tell it by."""


@dataclass(frozen=True, slots=True)
class _Turned:
    """A frame's samples in the other: what does not change from sweep to sweep."""

    at: FloatArray
    """(2, ny, nx) rows and columns of where each lies in the other."""
    nearest: NDArray[np.int32]
    """(2, ny, nx) of each sample of the other the nearest with data."""
    there: BoolArray
    """(ny, nx) where the other has data."""

    @classmethod
    def of(cls, way: Way, valid: BoolArray, axis_px: tuple[float, float], pitch_mm: float) -> _Turned:
        """By coordinates about the axis, of a frame with data where ``valid``."""
        rows, columns = np.indices(valid.shape, dtype=np.float64)
        x, y = way(np.asarray((columns - axis_px[1]) * pitch_mm), np.asarray((axis_px[0] - rows) * pitch_mm))
        at = np.stack([axis_px[0] - y / pitch_mm, axis_px[1] + x / pitch_mm])
        nearest = scipy.ndimage.distance_transform_edt(~valid, return_distances=False, return_indices=True)
        there = scipy.ndimage.map_coordinates(valid.astype(np.float64), at, order=1, cval=0.0) > 0.5
        return cls(at, nearest, there)

    def take(self, height_nm: FloatArray) -> FloatArray:
        """(ny, nx) by cubic splines through the data and, where there is none, the nearest."""
        found = scipy.ndimage.map_coordinates(height_nm[tuple(self.nearest)], self.at, order=3, mode="nearest")
        return np.where(self.there, found, np.nan)


def split(
    heights_nm: Sequence[FloatArray], poses: Sequence[PartPose], axis_px: tuple[float, float], pitch_mm: float
) -> PixelRemainder:
    """Part and instrument of maps that piston, tilt and the low terms were taken off.

    Args:
        heights_nm: (ny, nx) of each map, NaN = no data.
        poses: of the part in each.
        axis_px: (row, column) about which the part is turned.
        pitch_mm: of all.
    """
    valid = [np.isfinite(height) for height in heights_nm]
    onto = [_Turned.of(pose.in_map, there, axis_px, pitch_mm) for pose, there in zip(poses, valid, strict=True)]
    shown, seen = np.sum([way.there for way in onto], axis=0), np.sum(valid, axis=0)
    back = [_Turned.of(pose.on_part, shown > 0, axis_px, pitch_mm) for pose in poses]
    instrument = np.zeros(seen.shape)
    for _ in range(SWEEPS):
        before = instrument
        part = _part(heights_nm, instrument, onto)
        instrument = _mean([height - way.take(part) for height, way in zip(heights_nm, back, strict=True)])
        if np.linalg.norm(instrument - before) <= SETTLED * np.linalg.norm(instrument):
            break
    part = _part(heights_nm, instrument, onto)
    enough = seen >= LEAST_MAPS
    off = [(height - way.take(part) - instrument)[enough] for height, way in zip(heights_nm, back, strict=True)]
    left = np.concatenate([one[np.isfinite(one)] for one in off])
    freedom = left.size - np.count_nonzero(enough) - np.count_nonzero(shown >= LEAST_MAPS)
    return PixelRemainder(
        instrument_nm=np.where(enough, instrument, np.nan),
        part_nm=np.where(shown >= LEAST_MAPS, part, np.nan),
        noise_nm=float(np.sqrt((left**2).sum() / freedom)) if freedom > LEAST_SHARE * left.size else None,
    )


def _part(heights_nm: Sequence[FloatArray], instrument_nm: FloatArray, onto: Sequence[_Turned]) -> FloatArray:
    return _mean([way.take(height - instrument_nm) for height, way in zip(heights_nm, onto, strict=True)])


def _mean(heights_nm: Sequence[FloatArray]) -> FloatArray:
    """(ny, nx) of what has data, 0 where nothing has."""
    count = np.sum([np.isfinite(height) for height in heights_nm], axis=0)
    return np.asarray(np.nansum(heights_nm, axis=0) / np.maximum(count, 1))
