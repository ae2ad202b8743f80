"""Functions over lanes, compiled and kept."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numba import njit
from numba.extending import overload
from numpy.typing import NDArray

from polishd.process.fft import simd
from polishd.process.fft.simd import (
    COUNT,
    gather_difference,
    gather_sum,
    loads,
    rotate_complex,
    scatter,
    splats,
    stores,
)
from polishd.util.jit import compile_cached, no_refcount_option

# Transforms along one axis of COUNT columns at once, in place.

F = TypeVar("F", bound=Callable[..., Any])


def inline(function: F) -> F:
    """Compiled where compiled code calls it."""
    return _njit(function)


def inline_deep(function: F) -> F:
    """Inline a function called for each block into its caller, because numba calls pass every field of each array."""
    return _njit(function, forceinline=True)


def _njit(function: F, **options: Any) -> F:
    made: F = njit(error_model="numpy", nogil=True, **no_refcount_option(), **options)(function)
    return made


RADICES = (8, 5, 3, 4, 2)
"""Radices in the order of use: large ones first, because they need the fewest passes."""
_TWO, _THREE, _FOUR, _FIVE, _EIGHT = ((0,) * radix for radix in (2, 3, 4, 5, 8))

_HALF, _SIN_60, _SIN_45 = (np.float32(value) for value in (0.5, math.sqrt(0.75), math.sqrt(0.5)))
_COS_72, _COS_144 = (np.float32(math.cos(times * math.tau / 5)) for times in (1, 2))
_SIN_72, _SIN_144 = (np.float32(math.sin(times * math.tau / 5)) for times in (1, 2))

Lanes = Any
"""A tuple of lanes."""


class Length(NamedTuple):
    """Tables of a transform of one length; made by `length`."""

    n: int
    radices: NDArray[np.int64]
    at: NDArray[np.int64]
    """Start of each radix' twiddle factors."""
    cos: NDArray[np.float32]
    sin: NDArray[np.float32]


def length(n: int) -> tuple[Length, NDArray[np.int64]]:
    """A transform of n values, n a product of 2, 3 and 5 only, and (n,) the frequencies in their order."""
    radices: list[int] = []
    rest = n
    for radix in RADICES:
        while rest % radix == 0:
            radices.append(radix)
            rest //= radix
    if rest > 1:
        raise ValueError(f"{n} has a factor that is none of 2, 3, 5")
    at, turns, whole = [], [np.zeros(0)], n
    for radix in radices:
        at.append(sum(part.size for part in turns))
        step = whole // radix
        turns.append((np.outer(np.arange(step), np.arange(1, radix)) / whole).ravel())
        whole = step
    frequency = np.zeros(1, dtype=np.int64)
    for radix in reversed(radices):
        frequency = (np.arange(radix)[:, None] + radix * frequency).ravel()
    angle = -math.tau * np.concatenate(turns)
    cos, sin = np.cos(angle).astype(np.float32), np.sin(angle).astype(np.float32)
    return Length(n, np.array(radices, np.int64), np.array(at, np.int64), cos, sin), frequency


@inline
def forward_fft(re: NDArray[np.float32], im: NDArray[np.float32], plan: Length) -> None:
    """Transform the first ``plan.n`` rows of (rows, COUNT), each column for itself."""
    whole = plan.n
    for k in range(plan.radices.size):
        radix = plan.radices[k]
        if radix == 8:
            _stage_forth(re, im, plan, whole, plan.at[k], _EIGHT)
        elif radix == 5:
            _stage_forth(re, im, plan, whole, plan.at[k], _FIVE)
        elif radix == 4:
            _stage_forth(re, im, plan, whole, plan.at[k], _FOUR)
        elif radix == 3:
            _stage_forth(re, im, plan, whole, plan.at[k], _THREE)
        else:
            _stage_forth(re, im, plan, whole, plan.at[k], _TWO)
        whole //= radix


@inline
def inverse_fft(re: NDArray[np.float32], im: NDArray[np.float32], plan: Length) -> None:
    """Undo `forth`, but for a factor of n: its stages in reverse, real and imaginary parts in each other's place."""
    whole = 1
    for k in range(plan.radices.size - 1, -1, -1):
        radix = plan.radices[k]
        whole *= radix
        if radix == 8:
            _stage_back(im, re, plan, whole, plan.at[k], _EIGHT)
        elif radix == 5:
            _stage_back(im, re, plan, whole, plan.at[k], _FIVE)
        elif radix == 4:
            _stage_back(im, re, plan, whole, plan.at[k], _FOUR)
        elif radix == 3:
            _stage_back(im, re, plan, whole, plan.at[k], _THREE)
        else:
            _stage_back(im, re, plan, whole, plan.at[k], _TWO)


@inline
def _stage_forth(
    re: NDArray[np.float32], im: NDArray[np.float32], plan: Length, whole: int, at: int, like: tuple[int, ...]
) -> None:
    radix = len(like)
    step = whole // radix
    for q in range(step):
        cos, sin = (
            splats(plan.cos, at + q * (radix - 1), like),
            splats(plan.sin, at + q * (radix - 1), like),
        )
        for row in range(q, plan.n, whole):
            x, y = butterfly(loads(re, row, step, like), loads(im, row, step, like))
            x, y = rotate_complex(x, y, cos, sin)
            stores(re, row, step, x)
            stores(im, row, step, y)


@inline
def _stage_back(
    re: NDArray[np.float32], im: NDArray[np.float32], plan: Length, whole: int, at: int, like: tuple[int, ...]
) -> None:
    radix = len(like)
    step = whole // radix
    for q in range(step):
        cos, sin = (
            splats(plan.cos, at + q * (radix - 1), like),
            splats(plan.sin, at + q * (radix - 1), like),
        )
        for row in range(q, plan.n, whole):
            x, y = rotate_complex(loads(re, row, step, like), loads(im, row, step, like), cos, sin)
            x, y = butterfly(x, y)
            stores(re, row, step, x)
            stores(im, row, step, y)


def butterfly(x: Lanes, y: Lanes) -> tuple[Lanes, Lanes]:
    """The transform of as many complex values as the tuples are long; compiled code only."""
    raise NotImplementedError(f"a butterfly of {len(x)} and {len(y)} values outside compiled code")


@overload(butterfly, strict=False)
def _butterfly(x: Lanes, _y: Lanes) -> Any:
    of = {2: _of_two, 3: _of_three, 4: _of_four, 5: _of_five, 8: _of_eight}[len(x)]
    return lambda x, y: of(x, y)


@inline
def _of_two(x: Lanes, y: Lanes) -> tuple[Lanes, Lanes]:
    return (x[0] + x[1], x[0] - x[1]), (y[0] + y[1], y[0] - y[1])


@inline
def _of_three(x: Lanes, y: Lanes) -> tuple[Lanes, Lanes]:
    a, b = x[1] + x[2], y[1] + y[2]
    c, d = x[0] - _HALF * a, y[0] - _HALF * b
    e, f = _SIN_60 * (y[1] - y[2]), _SIN_60 * (x[2] - x[1])
    return (x[0] + a, c + e, c - e), (y[0] + b, d + f, d - f)


@inline
def _of_four(x: Lanes, y: Lanes) -> tuple[Lanes, Lanes]:
    a, b, c, d = x[0] + x[2], y[0] + y[2], x[0] - x[2], y[0] - y[2]
    e, f, g, h = x[1] + x[3], y[1] + y[3], x[1] - x[3], y[1] - y[3]
    return (a + e, c + h, a - e, c - h), (b + f, d - g, b - f, d + g)


@inline
def _of_five(x: Lanes, y: Lanes) -> tuple[Lanes, Lanes]:
    a, b, c, d = x[1] + x[4], y[1] + y[4], x[1] - x[4], y[1] - y[4]
    e, f, g, h = x[2] + x[3], y[2] + y[3], x[2] - x[3], y[2] - y[3]
    p, q = x[0] + _COS_72 * a + _COS_144 * e, y[0] + _COS_72 * b + _COS_144 * f
    r, s = x[0] + _COS_144 * a + _COS_72 * e, y[0] + _COS_144 * b + _COS_72 * f
    t, u = _SIN_72 * d + _SIN_144 * h, _SIN_72 * c + _SIN_144 * g
    v, w = _SIN_144 * d - _SIN_72 * h, _SIN_144 * c - _SIN_72 * g
    return (x[0] + a + e, p + t, r + v, r - v, p - t), (y[0] + b + f, q - u, s - w, s + w, q + u)


@inline
def _of_eight(x: Lanes, y: Lanes) -> tuple[Lanes, Lanes]:
    a, b = _of_four((x[0], x[2], x[4], x[6]), (y[0], y[2], y[4], y[6]))
    c, d = _of_four((x[1], x[3], x[5], x[7]), (y[1], y[3], y[5], y[7]))
    e, f = _SIN_45 * (c[1] + d[1]), _SIN_45 * (d[1] - c[1])
    g, h = _SIN_45 * (d[3] - c[3]), _SIN_45 * (c[3] + d[3])
    return (
        (a[0] + c[0], a[1] + e, a[2] + d[2], a[3] + g, a[0] - c[0], a[1] - e, a[2] - d[2], a[3] - g),
        (b[0] + d[0], b[1] + f, b[2] - c[2], b[3] - h, b[0] - d[0], b[1] - f, b[2] + c[2], b[3] + h),
    )


# Transforms of real fields in two dimensions, in the layout that `butterflies` works on.

Field = NDArray[np.float32]
"""(2, slabs, nx, COUNT): a real field as it is kept here; see `Plane.packed`."""
Columns = NDArray[np.float32]
"""(2, 2 COUNT slabs, COUNT): real and imaginary parts of a block's columns."""

_PAIR = 2 * COUNT
_TILE = (0,) * COUNT


class FftPlanArrays(NamedTuple):
    """Arguments of the compiled functions for a plane."""

    row: Length
    column: Length
    slabs: int
    blocks: int
    at: NDArray[np.int64]
    """(blocks * COUNT,) where each column's frequency is along a row."""
    mirrored: NDArray[np.int64]
    """Index of the negative frequency."""


@dataclass(frozen=True)
class FftFields:
    """Fields of one size, (ny, nx); made by `plane`."""

    size: tuple[int, int]
    order: FftPlanArrays
    frequency: tuple[NDArray[np.int64], NDArray[np.int64]]
    """(ny,) of the rows of a block, and (blocks * COUNT,) of its columns; the last is repeated to fill a block."""

    def packed(self, field: NDArray[np.floating]) -> Field:
        """(ny, nx) -> as it is kept here."""
        ny, nx = self.size
        whole = np.zeros((self.order.slabs * _PAIR, nx), np.float32)
        whole[:ny] = field
        return np.ascontiguousarray(whole.reshape(-1, 2, COUNT, nx).transpose(1, 0, 3, 2))

    def unpacked(self, field: Field) -> NDArray[np.float32]:
        """The way back."""
        ny, nx = self.size
        return np.ascontiguousarray(field.transpose(1, 0, 3, 2).reshape(-1, nx)[:ny])

    def places(self) -> NDArray[np.int64]:
        """(ny, nx) where each value of a field is kept, in a flat array."""
        ny, nx = self.size
        kept = np.arange(2 * self.order.slabs * nx * COUNT).reshape(2, -1, nx, COUNT)
        return kept.transpose(1, 0, 3, 2).reshape(-1, nx)[:ny]

    def spectrum(self, half: NDArray[np.inexact]) -> NDArray[np.float32]:
        """(ny, nx // 2 + 1) as of rfft2 -> (2, blocks, ny, COUNT): real and imaginary parts, block by block."""
        rows, columns = self.frequency
        ordered = half[rows][:, columns].reshape(self.size[0], -1, COUNT).transpose(1, 0, 2)
        return np.ascontiguousarray([ordered.real, ordered.imag], dtype=np.float32)

    def columns(self, count: int) -> NDArray[np.float32]:
        """Room for the columns of a block of so many fields."""
        return np.zeros((count, 2, self.order.slabs * _PAIR, COUNT), np.float32)


def transform_plane(size: tuple[int, int]) -> FftFields:
    """Fields of that size, products of 2, 3 and 5 only."""
    ny, nx = size
    (row, along), (column, down) = length(nx), length(ny)
    where = np.argsort(along)
    blocks = -(-(nx // 2 + 1) // COUNT)
    frequency = np.minimum(np.arange(blocks * COUNT), nx // 2)
    order = FftPlanArrays(row, column, -(-ny // _PAIR), blocks, where[frequency], where[-frequency % nx])
    return FftFields(size, order, (down, frequency))


@inline
def rows_forth(field: Field, slab: int, order: FftPlanArrays) -> None:
    """Transform a slab along its rows."""
    forward_fft(field[0, slab], field[1, slab], order.row)


@inline
def rows_back(field: Field, slab: int, order: FftPlanArrays) -> None:
    """Undo `rows_forth`, but for a factor of nx."""
    inverse_fft(field[0, slab], field[1, slab], order.row)


@inline
def columns_forth(field: Field, block: int, columns: Columns, order: FftPlanArrays) -> None:
    """Twice the spectrum of a field whose rows are transformed, at a block's columns."""
    at, nx = block * COUNT, order.row.n
    for slab in range(order.slabs):
        base, row = slab * nx, slab * _PAIR
        stores(columns[0], row, 1, gather_sum(field[0], base, order.at, order.mirrored, at))
        stores(columns[1], row, 1, gather_difference(field[1], base, order.at, order.mirrored, at))
        stores(columns[0], row + COUNT, 1, gather_sum(field[1], base, order.at, order.mirrored, at))
        stores(columns[1], row + COUNT, 1, gather_difference(field[0], base, order.mirrored, order.at, at))
    forward_fft(columns[0], columns[1], order.column)


@inline
def columns_back(field: Field, block: int, columns: Columns, order: FftPlanArrays) -> None:
    """Undo `columns_forth`, but for its factor of 2 and one of ny; what lies below the field becomes 0."""
    inverse_fft(columns[0], columns[1], order.column)
    columns[:, order.column.n :] = 0
    at, nx = block * COUNT, order.row.n
    for slab in range(order.slabs):
        base, row = slab * nx, slab * _PAIR
        above, below = loads(columns[0], row, 1, _TILE), loads(columns[1], row + COUNT, 1, _TILE)
        scatter(field[0], base, order.at, order.mirrored, at, above, below)
        above, below = loads(columns[0], row + COUNT, 1, _TILE), loads(columns[1], row, 1, _TILE)
        scatter(field[1], base, order.mirrored, order.at, at, above, below)


@cache
def kernel(function: Callable[..., Any], *others: str) -> Callable[..., Any]:
    """The function by numba; ``others``: files of what it calls, but for this package and its own."""
    own = (function.__code__.co_filename, __file__, simd.__file__, __file__)
    return compile_cached(function, map(Path, (*own, *others)), error_model="numpy")
