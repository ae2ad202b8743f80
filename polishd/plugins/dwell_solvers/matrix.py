"""An effect as a sparse matrix over the samples that count: what a QP backend needs."""

from __future__ import annotations

import numpy as np
from scipy import fft, sparse

from polishd.api import ComputeError, DwellProblem, SparseEffect
from polishd.process.convolution import ConvolutionEffect

MOST_ENTRIES = 20_000_000
"""Of a matrix made from convolutions: a quarter of a gigabyte; what a backend makes of it is several times that."""
NEGLIGIBLE = 1e-12
"""Share of the largest value below which a kernel's entry is a transform's rounding."""


def matrix_of(problem: DwellProblem) -> sparse.csr_array:
    """(m, n) nm/s: R at the m samples of ``solve_mask``.

    Raises:
        ComputeError: the effect is neither a matrix nor a sum of convolutions, or its matrix would be too large.
    """
    effect = problem.effect
    if isinstance(effect, SparseEffect):
        matrix = effect.matrix
    elif isinstance(effect, ConvolutionEffect):
        matrix = _written_out(effect)
    else:
        raise ComputeError(f"a QP needs the effect as a matrix, not as {type(effect).__name__}: use newton_cg")
    return sparse.csr_array(sparse.csr_array(matrix)[np.flatnonzero(problem.solve_mask.ravel())])


def _written_out(effect: ConvolutionEffect) -> sparse.csr_array:
    """(ny nx, n) nm/s: the kernels laid down at each point."""
    grid, columns, (top, left) = effect.grid, effect.lattice[1], effect.corner
    # the corner is the kernels' reach, or more where the lattice goes beyond the grid: it holds them whole
    kernels = fft.irfft2(effect.spectra, effect.size)[:, : 2 * top + 1, : 2 * left + 1]
    size = np.abs(kernels).max(axis=0)
    down, across = np.nonzero(size > NEGLIGIBLE * size.max())
    if effect.n * down.size > MOST_ENTRIES:
        raise ComputeError(
            f"{effect.n} points of {down.size} samples each are too many for a QP: use douglas_rachford, "
            "and cross-check on fewer points"
        )
    value = effect.coefficients @ kernels[:, down, across]
    row = np.add.outer(effect.node // columns - top, down)
    column = np.add.outer(effect.node % columns - left, across)
    point = np.broadcast_to(np.arange(effect.n)[:, None], row.shape)
    on = (row >= 0) & (row < grid.ny) & (column >= 0) & (column < grid.nx)
    entries = (value[on], ((row * grid.nx + column)[on], point[on]))
    return sparse.csr_array(sparse.coo_array(entries, shape=(grid.ny * grid.nx, effect.n)))
