"""The effect of dwells at arbitrary points from samples of a TIF, on a map given by its axes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage, sparse

from polishd.model.errors import ComputeError
from polishd.model.surface import BoolArray, FloatArray, Grid
from polishd.process.checks import refuse_where, require_number
from polishd.process.removal.convolution import ConvolutionEffect, sum_of_convolutions
from polishd.process.removal.effect import Effect, SparseEffect

Indices = NDArray[np.int64]

UNEVEN = 1e-3
"""How far a sample may lie from its place on an even axis, over the pitch."""
ON_NODE = 1e-6
MATRIX_ENTRIES = 20_000_000
"""Above it (half a GB with its transpose), points on the map's own samples are a convolution instead of a matrix."""
MOST_ENTRIES = 150_000_000
CHUNK = 2_000_000


@dataclass(frozen=True, slots=True)
class MapAxes:
    """Where the samples of a map lie; ``grid`` only for their number and pitch, not for their coordinates."""

    x_mm: FloatArray
    """(nx,)"""
    y_mm: FloatArray
    """(ny,)"""
    grid: Grid

    @property
    def first_mm(self) -> FloatArray:
        """(2,) x and y of the first sample."""
        return np.array([self.x_mm[0], self.y_mm[0]])

    @property
    def step_mm(self) -> FloatArray:
        """(2,) from column to column and from row to row, with its sign."""
        return np.array([self.x_mm[-1] - self.x_mm[0], self.y_mm[-1] - self.y_mm[0]]) / (
            self.grid.nx - 1,
            self.grid.ny - 1,
        )

    def box(self, mask: BoolArray) -> tuple[FloatArray, FloatArray]:
        """Least and largest (x, y) of the samples in (ny, nx) ``mask``, mm."""
        x, y = self.x_mm[mask.any(axis=0)], self.y_mm[mask.any(axis=1)]
        return np.array([x.min(), y.min()]), np.array([x.max(), y.max()])


def map_axes(x_mm: FloatArray, y_mm: FloatArray, shape: tuple[int, ...]) -> MapAxes:
    """The axes of a map of this shape, from vectors or from meshgrids.

    Raises:
        ComputeError: they do not fit the map, are uneven, or not of one pitch.
    """
    if len(shape) != 2 or min(shape) < 2:
        raise ComputeError(f"height_nm has the shape {shape}, it must be (ny, nx) with two samples each way at least")
    x = _axis("x_mm", np.asarray(x_mm, dtype=np.float64), shape, 1)
    y = _axis("y_mm", np.asarray(y_mm, dtype=np.float64), shape, 0)
    pitch = abs(x[-1] - x[0]) / (x.size - 1)
    other = abs(y[-1] - y[0]) / (y.size - 1)
    if abs(pitch - other) > UNEVEN * pitch or pitch == 0:
        raise ComputeError(f"the samples are {pitch:.6g} mm apart in x and {other:.6g} mm in y: resample to one pitch")
    return MapAxes(x, y, Grid(shape[0], shape[1], float(pitch)))


def _axis(name: str, value: FloatArray, shape: tuple[int, ...], axis: int) -> FloatArray:
    if value.shape == shape:
        line = value[0] if axis == 1 else value[:, 0]
        if not np.allclose(value, line if axis == 1 else line[:, None], rtol=0, atol=UNEVEN * abs(line[1] - line[0])):
            raise ComputeError(f"{name} is no meshgrid: it must be the same in each {'row' if axis == 1 else 'column'}")
        value = line
    if value.shape != (shape[axis],):
        raise ComputeError(f"{name} is {value.shape}, it must be ({shape[axis]},) or {shape}, as height_nm")
    even = np.linspace(value[0], value[-1], value.size)
    refuse_where(
        ~(np.abs(value - even) <= UNEVEN * np.abs(even[1] - even[0])), value, name, "mm", "it must be finite and even"
    )
    return value


def check_tif(tif_nm_s: FloatArray, pitch_mm: float) -> FloatArray:
    """The samples as float64; ComputeError names the one that is no rate of removal."""
    require_number("tif_pitch_mm", pitch_mm, "mm", above=0)
    tif = np.asarray(tif_nm_s, dtype=np.float64)
    if tif.ndim != 2 or min(tif.shape) < 4:
        raise ComputeError(f"tif_nm_s has the shape {tif.shape}, it must be two-dimensional, 4 x 4 samples at least")
    for trouble, wrong in (("is not finite", ~np.isfinite(tif)), ("is negative", tif < 0)):
        if wrong.any():
            row, column = np.argwhere(wrong)[0]
            raise ComputeError(
                f"tif_nm_s {trouble} at row {row}, column {column}: {tif[row, column]:.6g} nm/s "
                f"({int(wrong.sum())} such samples); it is a rate of removal, clean its rim first"
            )
    if not tif.any():
        raise ComputeError("tif_nm_s is zero everywhere: such a tool removes nothing")
    return tif


def check_points(points_mm: FloatArray) -> FloatArray:
    """The (n, 2) points as float64; ComputeError where they are none, or not finite."""
    points = np.asarray(points_mm, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 2 or len(points) == 0:
        raise ComputeError(
            f"points_mm has the shape {points.shape}, it must be (n, 2), x and y, with one point at least"
        )
    for axis, name in enumerate(("x of points_mm", "y of points_mm")):
        refuse_where(~np.isfinite(points[:, axis]), points[:, axis], name, "mm", "it must be finite")
    return points


def sampled_effect(axes: MapAxes, tif_nm_s: FloatArray, tif_pitch_mm: float, points_mm: FloatArray) -> Effect:
    """The effect of dwells at (n, 2) points: the TIF's cubic spline at each sample of the map, less the point.

    The TIF is taken at the samples, not integrated over their cells: where it bends much within a cell, give the map a
    finer pitch. The spline is cut at 0 below, and is 0 beyond the outermost samples and where all samples about are 0.
    A matrix, unless the points are many samples of the map itself: then a convolution with the same values.

    Raises:
        ComputeError: the matrix would not fit into memory.
    """
    coefficients = ndimage.spline_filter(tif_nm_s, order=3, mode="mirror")
    spline = _Spline(coefficients, (tif_nm_s > 0).astype(np.float64), tif_pitch_mm)
    reach = spline.reach_mm
    place = (points_mm - axes.first_mm) / axes.step_mm
    width = np.floor(2 * reach / axes.grid.pitch_mm + 2 * ON_NODE).astype(int) + 1
    entries = len(points_mm) * int(width.prod())
    if entries > MATRIX_ENTRIES and bool((np.abs(place - np.rint(place)) < ON_NODE).all()):
        return _convolution(axes.grid, np.rint(place).astype(np.int64), spline)
    if entries > MOST_ENTRIES:
        raise ComputeError(
            f"{len(points_mm)} points of {width[1]} x {width[0]} samples each are too many for a matrix: "
            "put them on samples of the map, or resample it to a coarser pitch"
        )
    pitch = axes.grid.pitch_mm
    first = np.ceil(place - reach / pitch - ON_NODE).astype(np.int64)
    size = max(1, CHUNK // int(width.prod()))
    parts = []
    for k in range(0, len(place), size):
        here = slice(k, k + size)
        row, column = (first[here, axis, None] + np.arange(width[axis]) for axis in (1, 0))
        dx, dy = (column - place[here, 0, None]) * pitch, (row - place[here, 1, None]) * pitch
        patch = spline.at(dx[:, None, :], dy[:, :, None])
        parts.append(_columns(axes.grid, row, column, patch))
    return SparseEffect(axes.grid, sparse.csr_array(sparse.hstack(parts, format="csr")))


@dataclass(frozen=True, slots=True)
class _Spline:
    """A TIF between its samples."""

    coefficients: FloatArray
    support: FloatArray
    """1 where a sample is above 0: where none near is, a spline would ring about a TIF that is cut off."""
    pitch_mm: float

    @property
    def reach_mm(self) -> FloatArray:
        """(2,) from the middle to the outermost sample, in x and y."""
        return np.asarray((np.array(self.support.shape[::-1]) - 1) / 2 * self.pitch_mm)

    def at(self, dx_mm: FloatArray, dy_mm: FloatArray) -> FloatArray:
        """nm/s at these distances from the dwell point along rows and columns, broadcast against each other."""
        place = []
        for distance, samples in ((dy_mm, self.support.shape[0]), (dx_mm, self.support.shape[1])):
            at = distance / self.pitch_mm + (samples - 1) / 2
            beyond = (at < -ON_NODE) | (at > samples - 1 + ON_NODE)
            place.append(np.where(beyond, -1.0, np.clip(at, 0, samples - 1)))  # rounding costs no sample on the rim
        where = np.stack(np.broadcast_arrays(*place))
        value = ndimage.map_coordinates(self.coefficients, where, order=3, mode="constant", prefilter=False)
        near = ndimage.map_coordinates(self.support, where, order=1, mode="constant")
        return np.where(near > ON_NODE, np.maximum(value, 0.0), 0.0)


def _columns(grid: Grid, row: Indices, column: Indices, patch: FloatArray) -> sparse.csc_array:
    """The columns of c points: ``patch`` (c, rows, columns) at these rows and columns (c, .) of the grid."""
    inside = ((row >= 0) & (row < grid.ny))[:, :, None] & ((column >= 0) & (column < grid.nx))[:, None, :]
    keep = inside & (patch > 0)
    sample = (row[:, :, None] * grid.nx + column[:, None, :])[keep]
    return sparse.csc_array((patch[keep], (sample, np.nonzero(keep)[0])), shape=(grid.ny * grid.nx, len(patch)))


def _convolution(grid: Grid, node: Indices, spline: _Spline) -> ConvolutionEffect:
    """The same for points on (n, 2) samples, column and row, of the map's lattice."""
    half = np.floor(spline.reach_mm / grid.pitch_mm + ON_NODE).astype(int)
    dx, dy = (np.arange(-n, n + 1) * grid.pitch_mm for n in half)
    kernel = spline.at(dx[None, :], dy[:, None])
    return sum_of_convolutions(grid, (node[:, 1], node[:, 0]), kernel[None], np.ones((len(node), 1)))
