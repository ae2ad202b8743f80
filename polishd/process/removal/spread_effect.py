"""The effect of any path without a matrix: ``R = B sum_k Conv(U_k) S' diag(c_k)``.

S' lays a block down on nodes of a grid ``finer`` times as fine, Conv gives averages over its cells, and B averages
those over the cells of the process grid: an entry keeps its meaning, the removal rate averaged over a sample's cell.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray
from scipy import sparse

from polishd.model.errors import ComputeError
from polishd.model.program import Program
from polishd.model.surface import FloatArray, Grid
from polishd.process.checks import require_number
from polishd.process.removal.convolution import Layout, layout
from polishd.process.removal.tif import Spot
from polishd.process.removal.tif_family import Family, PathBlocks, blocks_of, effect_errors, meshed_family, sampled_rows

# Weights of places between the nodes of a lattice on the nodes about them: those of quadratic splines.

WIDTH = 3
CHUNK = 8192
"""Blocks worked on at a time: bounds memory."""


def spline(place: FloatArray) -> tuple[NDArray[np.int64], FloatArray]:
    """(m,) first node of places that are given in units of the lattice, and (m, WIDTH) weights from it on."""
    nearest = np.floor(place + 0.5).astype(np.int64)
    off = place - nearest
    weight = np.stack([(0.5 - off) ** 2 / 2, 0.75 - off**2, (0.5 + off) ** 2 / 2], axis=1)
    return nearest - WIDTH // 2, weight


def damping(frequency: FloatArray) -> FloatArray:
    """(m,) factor of `spline` on a wave of ``frequency`` cycles a node along one axis: between 1 and 1/2."""
    return np.asarray(0.75 + 0.25 * np.cos(2 * np.pi * frequency))


def outermost_nodes(grid: Grid, blocks: PathBlocks) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """(2,) first and last row, and column, of the nodes that n > 0 blocks weigh on."""
    found = []
    for at in _rows_and_columns(grid, np.concatenate([blocks.start_mm, blocks.end_mm])):
        first, _ = spline(np.array([at.min(), at.max()]))
        found.append(first + np.array([0, WIDTH - 1]))
    return found[0], found[1]


def spread_weights(grid: Grid, spot: Spot, blocks: PathBlocks, where: Layout) -> sparse.csr_array:
    """(n, nodes) weight of each block on each node of the layout's lattice, C order; a row's sum is 1."""
    nodes = where.lattice[0] * where.lattice[1]
    parts = [sparse.csr_array((0, nodes))]
    for chunk in range(0, blocks.n, CHUNK):
        some = blocks.part(slice(chunk, chunk + CHUNK))
        block, place, share = some.positions(spot)
        (row, down), (column, across) = (spline(at) for at in _rows_and_columns(grid, place))
        weight = share[:, None, None] * down[:, :, None] * across[:, None, :]
        rows = row[:, None, None] - where.first[0] + np.arange(WIDTH)[:, None]
        columns = column[:, None, None] - where.first[1] + np.arange(WIDTH)
        node = rows * where.lattice[1] + columns
        owner = np.broadcast_to(block[:, None, None], node.shape)
        entries = weight.ravel(), (owner.ravel().astype(np.int32), node.ravel().astype(np.int32))
        parts.append(sparse.csr_array(sparse.coo_array(entries, shape=(some.n, nodes))))
    return sparse.csr_array(sparse.vstack(parts, format="csr"))


def _rows_and_columns(grid: Grid, place_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(m,) rows and columns of the grid's lattice, not whole."""
    return (grid.y_mm[0] - place_mm[:, 1]) / grid.pitch_mm, (place_mm[:, 0] - grid.x_mm[0]) / grid.pitch_mm


TOLERANCE = 1e-3
FINER = (1, 2, 3, 4)
"""Nodes to a sample's side that are tried: each product costs their square."""
MISSED = (10.0, 3.0, 1.0)
"""What the family may miss of a spot (Euclidean norm), over the tolerance, as it is tried: where gamma ranges widely 10
takes 25 convolutions and 3 takes 41, for the same error of the removal."""
COARSE_CELLS = 5.0
"""Cells to half a spot's width, at least, of the effect that a solver's steps are found with: with 4.5 a solve takes
half as many steps again, with 3 they lead astray."""
COARSE_TOLERANCE = 1e-2
"""Largest error of its family for a spot."""


@dataclass(frozen=True, slots=True)
class SpreadEffect:
    """An Effect (paper eq. 47) whose memory goes with points plus samples; made by `spread_effect`."""

    grid: Grid
    finer: int
    """Nodes to a sample's side."""
    weights: scipy.sparse.csr_array
    """(n, nodes) of each block on each node of the layout's lattice; a row's sum is 1."""
    where: Layout
    coefficients: FloatArray
    """(n, k) nm/s: the learned or corrected factor is in them."""
    spectra: NDArray[np.complexfloating[Any, Any]]
    """(k, ...) transforms of the kernels, averages over cells of the finer grid; all transforms are of their type."""
    error: float = np.nan
    """Error of the removal against the matrix, over its peak: `effect_errors`."""
    entry_error: float = np.nan
    """Largest of a single entry at these samples, over the largest entry."""
    coarse: SpreadEffect | None = None
    """About the same on a coarser grid and of fewer convolutions, in float32: for the way to a dwell, not for what
    becomes of it. None where it would be no quicker."""

    @property
    def n(self) -> int:
        """Number of timed points."""
        return len(self.coefficients)

    @property
    def rank(self) -> int:
        """Number of convolutions."""
        return int(self.coefficients.shape[1])

    @property
    def note(self) -> str:
        """Note for a certificate."""
        return (
            f"no matrix: {self.rank} convolutions on {self.finer} x {self.finer} nodes a sample; from the matrix, at "
            f"samples, the removal is off by up to {self.error:.1e} of its peak, an entry by {self.entry_error:.1e}"
        )

    def single(self) -> SpreadEffect:
        """Return the effect in float32: half its time and memory, accurate to about 1e-6 of the peak."""
        if self.spectra.dtype == np.complex64:
            return self
        return replace(
            self,
            weights=self.weights.astype(np.float32),
            coefficients=self.coefficients.astype(np.float32),
            spectra=self.spectra.astype(np.complex64),
        )

    def coarsely(self, values: FloatArray) -> FloatArray:
        """(ny, nx) -> (rows, columns) of the coarser effect's grid: the sum over the samples of each of its cells."""
        grid = self.grid if self.coarse is None else self.coarse.grid
        times = round(grid.pitch_mm / self.grid.pitch_mm)
        whole = np.zeros((grid.ny * times, grid.nx * times))
        whole[: self.grid.ny, : self.grid.nx] = values
        return np.asarray(whole.reshape(grid.ny, times, grid.nx, times).sum(axis=(1, 3)))

    def removal_nm(self, time_s: FloatArray) -> FloatArray:
        """(n,) s -> (ny, nx) nm."""
        total, times = np.zeros_like(self.spectra[0]), time_s.astype(self.coefficients.dtype, copy=False)
        for k in range(self.rank):
            dwell = (self.weights.T @ (self.coefficients[:, k] * times)).reshape(self.where.lattice)
            total += self.spectra[k] * scipy.fft.rfft2(dwell, self.where.size)
        fine = scipy.fft.irfft2(total, self.where.size, overwrite_x=True)[self.on_grid]
        cells = fine.reshape(self.grid.ny, self.finer, self.grid.nx, self.finer)
        return np.asarray(cells.mean(axis=(1, 3), dtype=np.float64))

    def adjoint(self, weight: FloatArray) -> FloatArray:
        """(ny, nx) -> (n,)."""
        fine = np.zeros(self.where.size, self.spectra.real.dtype)
        fine[self.on_grid] = np.repeat(np.repeat(weight / self.finer**2, self.finer, axis=0), self.finer, axis=1)
        spectrum = scipy.fft.rfft2(fine)
        (rows, columns), total = self.where.lattice, np.zeros(self.n)
        for k in range(self.rank):
            back = scipy.fft.irfft2(self.spectra[k].conj() * spectrum, self.where.size)[:rows, :columns]
            total += self.coefficients[:, k] * (self.weights @ back.ravel())
        return total

    @property
    def on_grid(self) -> tuple[slice, slice]:
        """Slices of the finer grid in the transformed array."""
        row, column = self.where.corner
        return slice(row, row + self.finer * self.grid.ny), slice(column, column + self.finer * self.grid.nx)


def spread_effect(
    grid: Grid,
    spot: Spot,
    program: Program,
    depth_ratio: FloatArray,
    factor: FloatArray,
    *,
    tolerance: float = TOLERANCE,
    bent: FloatArray | None = None,
) -> SpreadEffect:
    """The effect of blocks at rest or in motion, on nodes of the grid or off them, as `effect_matrix` has it.

    The coarsest of the FINER grids and the smallest family are taken with which the removal's error, sampled, is within
    the tolerance.

    Args:
        grid: the process grid.
        spot: the spot as depth and azimuth change it.
        program: n timed points, the axes as seen where the surface lies level.
        depth_ratio: (n,) as of `tif_at_point`, sunk where the bonnet hangs over the rim: nothing else is done there.
        factor: (n,) on the removal.
        tolerance: largest ``error``.
        bent: (n, 3) how much wider along x and y, and how askew the contacts are on a curved part, as of `Curved`;
            None: as on a flat.

    Raises:
        ComputeError: an impossible depth ratio or factor, no block that touches the grid, or the tolerance is out of
            reach: a spot with a sharp rim that few others overlap needs the matrix.
    """
    require_number("the tolerance of the effect", tolerance, "", above=0.0, below=1.0)
    require_number("the grid's pitch", grid.pitch_mm, "mm", above=0.0)
    blocks = blocks_of(program, depth_ratio, factor, bent)
    rows = sampled_rows(grid, spot, blocks)
    if not rows:
        raise ComputeError("no block touches the grid at a sample: path and part do not meet")
    error = np.inf
    for finer, share in product(FINER, MISSED):
        family = meshed_family(
            spot, grid.pitch_mm / finer, depth_ratio, blocks.azimuth_rad, share * tolerance, bent=bent
        )
        trials = (_laid_down(row.grid, finer, spot, row.blocks, family.part(row.which)) for row in rows)
        found = (trial.adjoint(row.only_sample) for trial, row in zip(trials, rows, strict=True))
        error, entry = effect_errors(rows, found)
        if error <= tolerance:
            whole = _laid_down(grid, finer, spot, blocks, family)
            return replace(whole, error=error, entry_error=entry, coarse=_coarse(whole, spot, blocks, depth_ratio))
    raise ComputeError(
        f"without a matrix the removal is off by {error:.1e} of its peak on a grid {FINER[-1]} times as fine, "
        f"{tolerance:.1e} is wanted. Use the matrix, or a larger tolerance"
    )


def _coarse(whole: SpreadEffect, spot: Spot, blocks: PathBlocks, depth_ratio: FloatArray) -> SpreadEffect | None:
    """See `SpreadEffect.coarse`."""
    fine = whole.grid
    half_cells = float(np.median(spot.half_width_mm(depth_ratio))) / fine.pitch_mm
    times = max(int(half_cells / COARSE_CELLS), 1)
    grid = Grid(-(-fine.ny // times), -(-fine.nx // times), times * fine.pitch_mm)
    family = meshed_family(spot, grid.pitch_mm, depth_ratio, blocks.azimuth_rad, COARSE_TOLERANCE, bent=blocks.bent)
    if times * whole.finer == 1 and len(family.kernels) >= whole.rank:
        return None
    return _laid_down(grid, 1, spot, blocks, family).single()


def _laid_down(grid: Grid, finer: int, spot: Spot, blocks: PathBlocks, family: Family) -> SpreadEffect:
    """The effect of these blocks, of a family on the finer grid; its error not yet known."""
    fine = Grid(grid.ny * finer, grid.nx * finer, grid.pitch_mm / finer)
    side = family.kernels.shape[1]
    where = layout(fine.shape, outermost_nodes(fine, blocks), (side, side))
    damped = damping(scipy.fft.fftfreq(where.size[0]))[:, None] * damping(scipy.fft.rfftfreq(where.size[1]))
    return SpreadEffect(
        grid=grid,
        finer=finer,
        weights=spread_weights(fine, spot, blocks, where),
        where=where,
        coefficients=family.coefficients * blocks.factor[:, None],
        spectra=np.asarray(scipy.fft.rfft2(family.kernels, where.size) / damped, dtype=np.complex128),
    )
