"""The effect of dwell points on the grid's nodes as a low-rank sum of convolutions: ``sum_k Conv(U_k) diag(c_k)``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from polishd.model.program import Program
from polishd.model.surface import FloatArray, Grid
from polishd.process.checks import refuse_where
from polishd.process.removal.dynamic_tif import lean_azimuth_rad
from polishd.process.removal.tif import Spot
from polishd.process.removal.tif_family import tif_family

NODE_TOLERANCE = 1e-6
"""Largest distance of a dwell point from a node, over the pitch."""
TOLERANCE = 1e-4

Index = FloatArray | NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class ConvolutionEffect:
    """An Effect (paper eq. 47) by FFT: each point's exact TIF but for the truncation; made by `convolution_effect`."""

    grid: Grid
    truncation: float
    """Largest relative error of a column (Euclidean norm)."""
    node: NDArray[np.int64]
    """(n,) index of each point on the lattice that holds grid and points, C order."""
    lattice: tuple[int, int]
    corner: tuple[int, int]
    """Row and column of the grid's first sample in a full convolution of the lattice with the kernels."""
    coefficients: FloatArray
    """(n, k) nm/s: the learned or corrected factor is in them."""
    spectra: NDArray[np.complex128]
    """(k, ...) transforms of the kernels."""
    size: tuple[int, int]
    """Shape of what is transformed: so large that nothing wraps round into the grid."""

    @property
    def n(self) -> int:
        """Number of timed points."""
        return int(self.node.size)

    @property
    def rank(self) -> int:
        """Number of convolutions."""
        return int(self.coefficients.shape[1])

    def removal_nm(self, time_s: FloatArray) -> FloatArray:
        """(n,) s -> (ny, nx) nm."""
        rows, columns = self.lattice
        total = np.zeros(self.spectra.shape[1:], dtype=np.complex128)
        for k in range(self.rank):
            dwell = np.bincount(self.node, self.coefficients[:, k] * time_s, rows * columns).reshape(self.lattice)
            total += self.spectra[k] * scipy.fft.rfft2(dwell, self.size)
        return np.asarray(scipy.fft.irfft2(total, self.size)[self.on_grid], dtype=np.float64)

    def adjoint(self, weight: FloatArray) -> FloatArray:
        """(ny, nx) -> (n,)."""
        spread = np.zeros(self.size)
        spread[self.on_grid] = weight
        spectrum = scipy.fft.rfft2(spread)
        total = np.zeros(self.n)
        for k in range(self.rank):
            back = scipy.fft.irfft2(self.spectra[k].conj() * spectrum, self.size)[: self.lattice[0], : self.lattice[1]]
            total += self.coefficients[:, k] * back.ravel()[self.node]
        return total

    @property
    def on_grid(self) -> tuple[slice, slice]:
        """Slices of the grid in the transformed array."""
        row, column = self.corner
        return slice(row, row + self.grid.ny), slice(column, column + self.grid.nx)


def convolution_effect(
    grid: Grid,
    spot: Spot,
    program: Program,
    depth_ratio: FloatArray,
    factor: FloatArray,
    *,
    tolerance: float = TOLERANCE,
) -> ConvolutionEffect:
    """The effect of dwells at rest on nodes of the grid, or of its lattice beyond its edge.

    ``depth_ratio`` and ``factor`` (n,) as of `tif_at_point`. Raises ComputeError for a point that moves or lies off
    the nodes; use `effect_matrix` there.
    """
    refuse_where(~((factor >= 0) & np.isfinite(factor)), factor, "the factor on the removal", "", "it must be finite")
    moved = program.length_mm
    refuse_where(
        moved > NODE_TOLERANCE * grid.pitch_mm, moved, "the block's length", "mm", "a convolution needs dwells at rest"
    )
    row, column, off = _nearest_nodes(grid, program)
    refuse_where(
        ~(off <= NODE_TOLERANCE), off * grid.pitch_mm, "the distance to the grid's nearest node", "mm", "it must be 0"
    )
    family = tif_family(spot, grid.pitch_mm, depth_ratio, lean_azimuth_rad(program), tolerance)
    coefficients = family.coefficients * factor[:, None]
    return sum_of_convolutions(grid, (row, column), family.kernels, coefficients, family.truncation)


def sum_of_convolutions(
    grid: Grid,
    place: tuple[Index, Index],
    kernels: FloatArray,
    coefficients: FloatArray,
    truncation: float = 0.0,
) -> ConvolutionEffect:
    """The effect of points on nodes with (k, ...) kernels of odd sides, row 0 the top, and (n, k) coefficients, nm/s.

    ``place`` is each point's (n,) row and column on the grid's lattice, whole but for rounding; it may lie beyond it.
    """
    found = layout(grid.shape, place, (kernels.shape[1], kernels.shape[2]))
    row, column = (np.round(at).astype(np.int64) - first for at, first in zip(place, found.first, strict=True))
    return ConvolutionEffect(
        grid=grid,
        truncation=truncation,
        node=row * found.lattice[1] + column,
        lattice=found.lattice,
        corner=found.corner,
        coefficients=coefficients,
        spectra=np.asarray(scipy.fft.rfft2(kernels, found.size), dtype=np.complex128),
        size=found.size,
    )


class Layout(NamedTuple):
    """Layout of a grid and a lattice of dwells about it in a transform."""

    first: tuple[int, int]
    """Row and column of the lattice's first node, counted from the grid's first sample."""
    lattice: tuple[int, int]
    corner: tuple[int, int]
    """Row and column of the grid's first sample in a full convolution of the lattice with the kernels."""
    size: tuple[int, int]
    """Shape of what is transformed: so large that nothing wraps round into the grid."""


def layout(shape: tuple[int, int], place: tuple[Index, Index], sides: tuple[int, int]) -> Layout:
    """The layout of a grid of this shape, of nodes in these rows and columns of its lattice, and of kernels this wide.

    ``place`` is whole but for rounding, and may lie beyond the grid; the sides are odd.
    """
    (top, rows), (left, columns) = (_lattice(at, n) for at, n in zip(place, shape, strict=True))
    down, across = (side // 2 for side in sides)
    corner = (down - top, across - left)
    # of a full convolution, rows + 2 reach, as much may wrap round as lies before the grid's first row
    high, wide = (
        scipy.fft.next_fast_len(max(n, n + 2 * reach - first, first + grid_n), True)
        for n, reach, first, grid_n in zip((rows, columns), (down, across), corner, shape, strict=True)
    )
    return Layout((top, left), (rows, columns), corner, (high, wide))


def are_on_nodes(grid: Grid, program: Program) -> bool:
    """Return whether all points rest on different nodes of the grid or of its lattice beyond the edge."""
    row, column, off = _nearest_nodes(grid, program)
    resting = bool((program.length_mm <= NODE_TOLERANCE * grid.pitch_mm).all()) and bool((off <= NODE_TOLERANCE).all())
    return resting and len(np.unique(np.round(np.stack([row, column])), axis=1).T) == program.n


def _nearest_nodes(grid: Grid, program: Program) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(n,) row and column of each point on the grid's lattice, and how far it lies from a node, over the pitch."""
    column = (program.end_mm[:, 0] - grid.x_mm[0]) / grid.pitch_mm
    row = (grid.y_mm[0] - program.end_mm[:, 1]) / grid.pitch_mm
    return row, column, np.maximum(np.abs(row - np.round(row)), np.abs(column - np.round(column)))


def _lattice(index: Index, n: int) -> tuple[int, int]:
    """First index and length of a row of nodes that holds the points' and the grid's n."""
    nodes = np.round(index).astype(np.int64)
    first = min(0, int(nodes.min(initial=0)))
    return first, max(n - 1, int(nodes.max(initial=0))) - first + 1
