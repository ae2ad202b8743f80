"""How an iteration of `splitting` is computed: what is common to its two ways, and the one that needs no compiler."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from polishd.process.fft.simd import COUNT, least, load, most, splat, store
from polishd.process.fft.transforms import (
    FftFields,
    FftPlanArrays,
    columns_back,
    columns_forth,
    inline,
    kernel,
    rows_back,
    rows_forth,
    transform_plane,
)

RELAXATION = 1.9

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
    """By scipy's transforms, in either precision, fields as they are."""

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
        kept, firm = misfit_share(work), firmness(work)
        strength = (np.abs(work.spectra.astype(np.complex128)) ** 2).sum(axis=0)
        self._fixed = {
            "gain": (1 / (1 + strength * (work.rho / work.mu))).astype(real),
            "back": (work.spectra.conj() * (work.rho / work.mu)).astype(work.spectra.dtype),
            "y_keep": (1 - RELAXATION * kept).astype(real),
            "y_change": (RELAXATION * (2 * kept - 1)).astype(real),
            "y_add": (RELAXATION * kept * work.target).astype(real),
            "t_gain": (work.mu * firm * work.coefficient).astype(real),
            "t_price": (work.price * firm).astype(real),
            "scratch": np.empty_like(work.dwell),
        }

    def advance(self, work: SplitProblem) -> None:
        """See Iteration."""
        fixed, ranks = self._fixed, range(work.rank)
        spectrum = fft.rfft2(work.y)
        for response, w in zip(work.spectra, work.w, strict=True):
            part = fft.rfft2(w)
            part *= response
            spectrum -= part
        spectrum *= fixed["gain"]
        moved = [fft.irfft2(kernel * spectrum, self._size, overwrite_x=True) for kernel in fixed["back"]]
        met = [w + change for w, change in zip(work.w, moved, strict=True)]  # with y they fulfil y = sum K w
        for k in ranks:
            moved[k] += met[k]  # the reflection
        self._dwell_nearest_to(moved, work)
        for k in ranks:
            np.multiply(work.dwell, work.coefficient[k], out=moved[k])
            moved[k] -= met[k]
            moved[k] *= RELAXATION
            work.w[k] += moved[k]
        change = fft.irfft2(spectrum, self._size, overwrite_x=True)
        change *= fixed["y_change"]
        work.y *= fixed["y_keep"]
        work.y += change
        work.y += fixed["y_add"]

    def _dwell_nearest_to(self, wanted: list[Array], work: SplitProblem) -> None:
        """The dwell within its bounds, point by point, where each w's (ny, nx), regularisation and price agree."""
        gain, scratch = self._fixed["t_gain"], self._fixed["scratch"]
        np.multiply(wanted[0], gain[0], out=work.dwell)
        for k in range(1, work.rank):
            np.multiply(wanted[k], gain[k], out=scratch)
            work.dwell += scratch
        if work.price:
            work.dwell -= self._fixed["t_price"]
        np.clip(work.dwell, *work.bounds, out=work.dwell)


def misfit_share(work: SplitProblem) -> Array:
    """The misfit's share in a sample's step."""
    pull = work.pull.astype(np.float64)
    return np.asarray(pull / (pull + work.rho))


def firmness(work: SplitProblem) -> Array:
    """One over the curvature in each point's dwell; 0 where none lies."""
    square = (work.coefficient.astype(np.float64) ** 2).sum(axis=0)
    return np.asarray(1 / np.where(square > 0, 2 * work.regularisation + work.mu * square, np.inf))


# The iteration of `splitting` in compiled code, in a quarter of the time.

Floats = NDArray[np.float32]

_ONE, _NONE = np.float32(1), np.float32(0)


class IterationBuffers(NamedTuple):
    """What compiled functions read and write; fields as `plane` keeps them, of rank k."""

    fields: Floats
    """(k + 1, ...) y and each w, transformed along the rows."""
    columns: Floats
    """(k + 1, ...) room for a block's columns."""
    kernels: Floats
    """(k, 2, blocks, ny, COUNT) spectra."""
    y: Floats
    w: Floats
    """(k, ...)."""
    dwell: Floats
    coefficient: Floats
    """(k, ...)."""
    firm: Floats
    lower: Floats
    upper: Floats
    share: Floats
    target: Floats


class DouglasRachfordScalars(NamedTuple):
    """Those of an iteration, each a float32."""

    relaxation: np.float32
    mu: np.float32
    price: np.float32
    ratio: np.float32
    """rho over mu."""
    scale: np.float32
    """What the transforms leave to be divided by."""


def _not_begun() -> None:
    raise RuntimeError("an iteration begins with `begin`")


@dataclass
class CompiledIteration:
    """An Iteration in float32, by compiled code; made by `compiled_iteration`."""

    plane: FftFields
    kernels: Floats | None = None
    go: Callable[[], None] = _not_begun

    def kept(self, field: Array) -> Array:
        """See Iteration."""
        return self._each(self.plane.packed, field, 2)

    def shown(self, field: Array) -> Array:
        """See Iteration."""
        return self._each(self.plane.unpacked, field, 4)

    def begin(self, work: SplitProblem) -> None:
        """See Iteration."""
        if self.kernels is None:
            self.kernels = np.stack([self.plane.spectrum(kernel) for kernel in work.spectra])
        ny, nx = self.plane.size
        ready = IterationBuffers(
            fields=np.stack([work.y, *work.w]),
            columns=self.plane.columns(work.rank + 1),
            kernels=self.kernels,
            y=work.y,
            w=work.w,
            dwell=work.dwell,
            coefficient=work.coefficient,
            firm=firmness(work).astype(np.float32),
            lower=work.bounds[0],
            upper=work.bounds[1],
            share=misfit_share(work).astype(np.float32),
            target=work.target,
        )
        numbers = (RELAXATION, work.mu, work.price, work.rho / work.mu, 1 / (2 * ny * nx))
        kernel(_begin)(ready, self.plane.order)
        self.go = partial(kernel(_advance), ready, DouglasRachfordScalars(*map(np.float32, numbers)), self.plane.order)

    def advance(self, _work: SplitProblem) -> None:
        """See Iteration."""
        self.go()

    @staticmethod
    def _each(change: Callable[[Array], Array], field: Array, dimensions: int) -> Array:
        return change(field) if field.ndim == dimensions else np.stack([change(one) for one in field])


def compiled_iteration(size: tuple[int, int]) -> CompiledIteration:
    """For domains of that size."""
    return CompiledIteration(transform_plane(size))


def _begin(work: IterationBuffers, order: FftPlanArrays) -> None:
    for f in range(len(work.fields)):
        for slab in range(order.slabs):
            rows_forth(work.fields[f], slab, order)


def _advance(work: IterationBuffers, numbers: DouglasRachfordScalars, order: FftPlanArrays) -> None:
    for block in range(order.blocks):
        for f in range(len(work.fields)):
            columns_forth(work.fields[f], block, work.columns[f], order)
        _meet(work, numbers, block, order.column.n)
        for f in range(len(work.fields)):
            columns_back(work.fields[f], block, work.columns[f], order)
    for slab in range(order.slabs):
        for f in range(len(work.fields)):
            rows_back(work.fields[f], slab, order)
        for half in range(2):
            _keep_to_bounds(work, numbers, (half, slab), order.row.n)
            _fit(work, numbers, (half, slab), order.row.n)
        for f in range(len(work.fields)):
            rows_forth(work.fields[f], slab, order)


@inline
def _meet(work: IterationBuffers, numbers: DouglasRachfordScalars, block: int, ny: int) -> None:
    """Frequency by frequency: how y and each w must change so that ``y = sum K w``."""
    for row in range(ny):
        i = row * COUNT
        x, y, strength = load(work.columns[0, 0], i), load(work.columns[0, 1], i), splat(_NONE)
        for k in range(len(work.w)):
            a, b = load(work.kernels[k, 0, block], i), load(work.kernels[k, 1, block], i)
            c, d = load(work.columns[k + 1, 0], i), load(work.columns[k + 1, 1], i)
            x, y = x - (a * c - b * d), y - (a * d + b * c)
            strength = strength + (a * a + b * b)
        gain = splat(numbers.scale) / (splat(_ONE) + numbers.ratio * strength)
        x, y = x * gain, y * gain
        store(work.columns[0, 0], i, x)
        store(work.columns[0, 1], i, y)
        x, y = numbers.ratio * x, numbers.ratio * y
        for k in range(len(work.w)):
            a, b = load(work.kernels[k, 0, block], i), load(work.kernels[k, 1, block], i)
            store(work.columns[k + 1, 0], i, a * x + b * y)
            store(work.columns[k + 1, 1], i, a * y - b * x)


@inline
def _keep_to_bounds(work: IterationBuffers, numbers: DouglasRachfordScalars, where: tuple[int, int], nx: int) -> None:
    """Point by point: the dwell nearest to where each w is reflected to, and w drawn towards it."""
    for x in range(nx):
        i = x * COUNT
        dwell = splat(_NONE)
        for k in range(len(work.w)):
            change = load(work.fields[k + 1][where], i)
            dwell = dwell + load(work.coefficient[k][where], i) * (load(work.w[k][where], i) + change + change)
        dwell = load(work.firm[where], i) * (numbers.mu * dwell - splat(numbers.price))
        dwell = least(most(dwell, load(work.lower[where], i)), load(work.upper[where], i))
        store(work.dwell[where], i, dwell)
        for k in range(len(work.w)):
            w, change = load(work.w[k][where], i), load(work.fields[k + 1][where], i)
            w = w + numbers.relaxation * (load(work.coefficient[k][where], i) * dwell - w - change)
            store(work.w[k][where], i, w)
            store(work.fields[k + 1][where], i, w)


@inline
def _fit(work: IterationBuffers, numbers: DouglasRachfordScalars, where: tuple[int, int], nx: int) -> None:
    """Sample by sample: the removal drawn towards its target."""
    for x in range(nx):
        i = x * COUNT
        share, y = numbers.relaxation * load(work.share[where], i), load(work.y[where], i)
        change = (share + share - splat(numbers.relaxation)) * load(work.fields[0][where], i)
        y = y + share * (load(work.target[where], i) - y) + change
        store(work.y[where], i, y)
        store(work.fields[0][where], i, y)
