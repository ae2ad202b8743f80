"""The iteration of `douglas_rachford` compiled by numba, in a quarter of the time of numpy's."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from polishd.process.dwell.splitting_iteration import Array, SplitProblem, firmness, misfit_share, relaxation
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

Floats = NDArray[np.float32]

_ONE, _NONE = np.float32(1), np.float32(0)


class IterationBuffers(NamedTuple):
    """Arrays of the compiled functions; fields in the layout of `plane`, of rank k."""

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
    """Scalars of an iteration, each a float32."""

    relaxation: np.float32
    mu: np.float32
    price: np.float32
    ratio: np.float32
    """rho over mu."""
    scale: np.float32
    """Divisor of unnormalized transforms."""


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
        numbers = (relaxation((ny, nx)), work.mu, work.price, work.rho / work.mu, 1 / (2 * ny * nx))
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
