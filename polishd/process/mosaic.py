"""Sub-apertures laid on one grid of samples: sums over them, where two meet, slopes of what they make."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy
import scipy.ndimage

from polishd.model.surface import BoolArray, FloatArray

REACH = 3
"""Samples to each side that are interpolated between."""
SAME_PLACE = 1e-6
"""Pixels below which a map lies on the grid's samples."""
NOISE_SLOPE = 1 / (8 * np.pi)
"""Variance of a slope per pixel, of white noise of variance 1: a Gaussian's derivative, 1 px wide."""
Window = tuple[slice, slice]


@dataclass(frozen=True, slots=True)
class SubAperture:
    """A map and where its centre lies on the part."""

    name: str
    height_nm: FloatArray
    """(ny, nx), NaN where there is no data."""
    x_mm: float
    y_mm: float


@dataclass(frozen=True, slots=True)
class PlacedMap:
    """A map at the samples of the grid that it covers."""

    name: str
    height_nm: FloatArray
    """(ny, nx) interpolated, NaN where a sample that it takes has no data."""
    valid: BoolArray
    corner: tuple[int, int]
    """(row, column) of its first sample."""
    centre: tuple[float, float]
    """(row, column) of its centre."""
    radius_px: float
    """From its centre to its furthest sample with data."""
    gain: float
    """Variance of a sample's noise, of that of the map's own samples: interpolation averages."""

    @property
    def window(self) -> Window:
        """Its samples in the grid."""
        (row, column), (ny, nx) = self.corner, self.height_nm.shape
        return slice(row, row + ny), slice(column, column + nx)

    def meeting(self, other: PlacedMap) -> tuple[Window, Window]:
        """The rectangle in which both lie, in the samples of each."""
        start = np.maximum(self.corner, other.corner)
        stop = np.minimum(np.add(self.corner, self.height_nm.shape), np.add(other.corner, other.height_nm.shape))
        stop = np.maximum(start, stop)
        here, there = (
            (slice(*(int(a[0] - one.corner[0]) for a in (start, stop))),
             slice(*(int(a[1] - one.corner[1]) for a in (start, stop)))) for one in (self, other)
        )  # fmt: skip
        return here, there

    def basis(self, *, power: bool, slope: tuple[FloatArray, FloatArray] | None) -> FloatArray:
        """(p, ny, nx): 1, x and y, and their squares' sum if asked, 1 at its radius; and the slopes if given."""
        ny, nx = self.height_nm.shape
        x = (self.corner[1] + np.arange(nx) - self.centre[1])[None, :] / self.radius_px
        y = (self.centre[0] - self.corner[0] - np.arange(ny))[:, None] / self.radius_px
        parts = [np.ones((ny, nx)), x + 0 * y, y + 0 * x]
        parts += [x**2 + y**2] if power else []
        parts += [along[self.window] for along in slope] if slope is not None else []
        return np.stack(parts)


@dataclass(frozen=True, slots=True)
class StitchSum:
    """What maps make together, on the grid."""

    mean: FloatArray
    """(ny, nx); 0 where no map has data."""
    count: FloatArray
    """(ny, nx) maps that have the sample."""


def place_map(maps: Sequence[SubAperture], found_px: FloatArray, pitch_mm: float) -> list[PlacedMap]:
    """Each map where it is said to lie, and by ``found_px`` (maps, 2), right and down, from there.

    The grid is the first map's. Others are interpolated by polynomials of degree 6 through 7 samples a direction, which
    keep 97.8 % of a wave of 4 px halfway between two samples and 99.99 % of one of 8 px (linear: 71 and 92 %).
    """
    first = maps[0]
    middle = np.array([np.divide(np.subtract(one.height_nm.shape, 1), 2) for one in maps])
    way = np.array([(first.y_mm - one.y_mm, one.x_mm - first.x_mm) for one in maps]) / pitch_mm
    centre = middle[0] + way + found_px[:, ::-1]
    corner = centre - middle
    whole = np.rint(corner).astype(np.int64)
    part = np.where(np.abs(corner - whole) < SAME_PLACE, 0.0, corner - whole)
    edge = whole.min(axis=0)
    laid = []
    for k, one in enumerate(maps):
        height, gain = _interpolated(one.height_nm, -part[k])
        row, column = np.nonzero(np.isfinite(one.height_nm))
        radius = float(np.hypot(row - middle[k, 0], column - middle[k, 1]).max(initial=1.0))
        at, mid = whole[k] - edge, centre[k] - edge
        places = (int(at[0]), int(at[1])), (float(mid[0]), float(mid[1]))
        laid.append(PlacedMap(one.name, height, np.isfinite(height), *places, radius, gain))
    return laid


def _interpolated(height_nm: FloatArray, way: FloatArray) -> tuple[FloatArray, float]:
    """(ny, nx) the map ``way`` (rows, columns, at most half a pixel) further, and the variance that is left of noise.

    The weights reach ``REACH`` samples, and no further: a missing sample takes those with it, and none else.
    """
    gain = 1.0
    for axis, off in enumerate(way):
        if off:
            nodes = np.arange(-REACH, REACH + 1)
            weights = np.asarray(scipy.interpolate.BarycentricInterpolator(nodes, np.eye(nodes.size))(off))
            height_nm = scipy.ndimage.correlate1d(height_nm, weights, axis=axis, mode="constant", cval=np.nan)
            gain *= float(weights @ weights)
    return height_nm, gain


def summed(laid: Sequence[PlacedMap], heights_nm: Sequence[FloatArray]) -> StitchSum:
    """Mean and count of maps' heights, each (ny, nx) as the map is laid."""
    shape = np.max([np.add(one.corner, one.height_nm.shape) for one in laid], axis=0)
    total, count = np.zeros(shape), np.zeros(shape)
    for one, height in zip(laid, heights_nm, strict=True):
        total[one.window] += np.where(one.valid, height, 0.0)
        count[one.window] += one.valid
    return StitchSum(total / np.maximum(count, 1), count)


def slopes(surface: StitchSum) -> tuple[FloatArray, FloatArray]:
    """(ny, nx) slopes to the right and down, nm per pixel; smoothed over a pixel, so that noise is no slope."""
    none = surface.count == 0
    nearest = scipy.ndimage.distance_transform_edt(none, return_distances=False, return_indices=True)
    whole = surface.mean[tuple(nearest)]
    right, down = (scipy.ndimage.gaussian_filter(whole, 1.0, order=order) for order in ((0, 1), (1, 0)))
    return right, down
