"""The effect of dwell on the surface: a linear map from seconds at n points to nanometres at (ny, nx) samples."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import scipy

from polishd.model.surface import FloatArray, Grid


class Effect(Protocol):
    """Paper eq. 47, ``h = R t``; rows are surface samples in C order of the grid, columns timed points."""

    @property
    def grid(self) -> Grid:
        """The process grid of the rows."""
        ...

    @property
    def n(self) -> int:
        """Number of timed points."""
        ...

    def removal_nm(self, time_s: FloatArray) -> FloatArray:
        """(n,) s -> (ny, nx) nm, positive = material removed."""
        ...

    def adjoint(self, weight: FloatArray) -> FloatArray:
        """(ny, nx) -> (n,): R transposed."""
        ...


@dataclass(frozen=True, slots=True)
class SparseEffect:
    """An effect matrix stored column by column: any path, any TIF a point, for spots small against the part."""

    grid: Grid
    matrix: scipy.sparse.csr_array
    """(ny * nx, n) nm/s."""

    @property
    def n(self) -> int:
        """Number of timed points."""
        return int(self.matrix.shape[1])

    def removal_nm(self, time_s: FloatArray) -> FloatArray:
        """(n,) s -> (ny, nx) nm."""
        return np.asarray(self.matrix @ time_s, dtype=np.float64).reshape(self.grid.shape)

    def adjoint(self, weight: FloatArray) -> FloatArray:
        """(ny, nx) -> (n,)."""
        return np.asarray(self.matrix.T @ weight.ravel(), dtype=np.float64)
