"""The iteration of `douglas_rachford`: its problem in two parts, and the way by numpy that needs no compiler."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import scipy
from numpy.typing import NDArray

LARGE_NODES = 20_000
"""Nodes of a domain from which on relaxation is stronger: it saves 5 % of the iterations on parts of 300 and 450 mm,
and takes up to 60 % more on those of 50 to 80 mm."""

Array = NDArray[Any]


@dataclass(slots=True)
class SplitProblem:
    """The problem in two parts, and the iterate. Of (ny, nx) a field is as its `Iteration` keeps it."""

    spectra: Array
    """(k, ny, nx // 2 + 1) K_k, times the balance."""
    coefficient: Array
    """(k, ny, nx) c_k on the domain; 0 where no dwell point lies."""
    pull: Array
    """(ny, nx) misfit's curvature of a sample, ``2 weight / N_r``; 0 where none counts."""
    target: Array
    """(ny, nx) removal wanted; 0 where no sample counts."""
    bounds: tuple[Array, Array]
    """(ny, nx) least and most dwell."""
    regularisation: float
    price: float
    rho: float
    """Step parameter of y."""
    mu: float
    """Step parameter of w."""
    y: Array
    """(ny, nx) the iterate; with w it is what a warm start needs."""
    w: Array
    """(k, ny, nx)."""
    dwell: Array
    """(ny, nx) t of the last iteration: within the bounds, whenever one stops."""

    @property
    def rank(self) -> int:
        """Number of convolutions."""
        return len(self.spectra)


class Iteration(Protocol):
    """A way to compute it, and how it likes its fields to be kept."""

    def kept(self, field: Array) -> Array:
        """(..., ny, nx) as it is kept."""

    def shown(self, field: Array) -> Array:
        """The way back."""

    def begin(self, work: SplitProblem) -> None:
        """Make ready: the step parameters or the iterate are other ones."""

    def advance(self, work: SplitProblem) -> None:
        """One iteration: y, w and dwell change in place."""


class NumpyIteration:
    """By scipy's transforms, in either precision, fields as they are.

    y and each w lie in one array: they are transformed in one call, because a call takes longer than the transform of a
    small part.
    """

    def __init__(self, size: tuple[int, int]) -> None:
        self._size = size
        self._fixed: dict[str, Array] = {}

    def kept(self, field: Array) -> Array:
        """See Iteration."""
        return field

    def shown(self, field: Array) -> Array:
        """See Iteration."""
        return field

    def begin(self, work: SplitProblem) -> None:
        """See Iteration."""
        real = work.y.dtype.type
        kept, firm, relaxed = misfit_share(work), firmness(work), relaxation(self._size)
        strength = (np.abs(work.spectra.astype(np.complex128)) ** 2).sum(axis=0)
        self._fixed = {
            "gain": (1 / (1 + strength * (work.rho / work.mu))).astype(real),
            "back": (work.spectra.conj() * (work.rho / work.mu)).astype(work.spectra.dtype),
            "y_keep": (1 - relaxed * kept).astype(real),
            "y_change": (relaxed * (2 * kept - 1)).astype(real),
            "y_add": (relaxed * kept * work.target).astype(real),
            "t_gain": (work.mu * firm * work.coefficient).astype(real),
            "t_price": (work.price * firm).astype(real),
            "relaxed": real(relaxed),
            "scratch": np.empty_like(work.dwell),
            "all": np.concatenate([work.y[None], work.w]),
            "met": np.empty_like(work.w),
        }
        work.y, work.w = self._fixed["all"][0], self._fixed["all"][1:]

    def advance(self, work: SplitProblem) -> None:
        """See Iteration."""
        fixed = self._fixed
        spectra = scipy.fft.rfft2(fixed["all"])
        spectra[1:] *= work.spectra
        spectrum = spectra[0]
        for part in spectra[1:]:
            spectrum -= part
        spectrum *= fixed["gain"]
        np.multiply(fixed["back"], spectrum, out=spectra[1:])
        changes = scipy.fft.irfft2(spectra, self._size, overwrite_x=True)
        change, moved, met = changes[0], changes[1:], fixed["met"]
        np.add(work.w, moved, out=met)  # with y they fulfil y = sum K w
        moved += met  # the reflection
        self._dwell_nearest_to(moved, work)
        np.multiply(work.dwell, work.coefficient, out=moved)
        moved -= met
        moved *= fixed["relaxed"]
        work.w += moved
        change *= fixed["y_change"]
        work.y *= fixed["y_keep"]
        work.y += change
        work.y += fixed["y_add"]

    def _dwell_nearest_to(self, wanted: Array, work: SplitProblem) -> None:
        """The dwell within its bounds, point by point, where each w's (ny, nx), regularisation and price agree."""
        gain, scratch = self._fixed["t_gain"], self._fixed["scratch"]
        np.multiply(wanted[0], gain[0], out=work.dwell)
        for k in range(1, work.rank):
            np.multiply(wanted[k], gain[k], out=scratch)
            work.dwell += scratch
        if work.price:
            work.dwell -= self._fixed["t_price"]
        np.clip(work.dwell, *work.bounds, out=work.dwell)


def relaxation(size: tuple[int, int]) -> float:
    """Relaxation of the iteration on a domain of (ny, nx) nodes, above 1 and below 2."""
    return 1.9 if size[0] * size[1] >= LARGE_NODES else 1.8


def misfit_share(work: SplitProblem) -> Array:
    """The misfit's share in a sample's step."""
    pull = work.pull.astype(np.float64)
    return np.asarray(pull / (pull + work.rho))


def firmness(work: SplitProblem) -> Array:
    """One over the curvature in each point's dwell; 0 where none lies."""
    square = (work.coefficient.astype(np.float64) ** 2).sum(axis=0)
    return np.asarray(1 / np.where(square > 0, 2 * work.regularisation + work.mu * square, np.inf))
