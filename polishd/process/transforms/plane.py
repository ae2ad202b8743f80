"""Transforms of real fields in two dimensions, in the layout that `butterflies` works on.

A field's rows are taken 2 COUNT at a time (a slab): COUNT of them are real parts, the next COUNT imaginary parts, of
what is transformed along the rows. Of its spectrum the columns are taken COUNT at a time (a block), half of them: the
others are their mirror images. In between nothing is moved but tiles of COUNT x COUNT.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from polishd.process.transforms.butterflies import Length, forward_fft, inline, inverse_fft, length
from polishd.process.transforms.lanes import COUNT, gather_difference, gather_sum, loads, scatter, stores

Field = NDArray[np.float32]
"""(2, slabs, nx, COUNT): a real field as it is kept here; see `Plane.packed`."""
Columns = NDArray[np.float32]
"""(2, 2 COUNT slabs, COUNT): real and imaginary parts of a block's columns."""

_PAIR = 2 * COUNT
_TILE = (0,) * COUNT


class FftPlanArrays(NamedTuple):
    """What compiled functions need of a plane."""

    row: Length
    column: Length
    slabs: int
    blocks: int
    at: NDArray[np.int64]
    """(blocks * COUNT,) where each column's frequency is along a row."""
    mirrored: NDArray[np.int64]
    """The same of the frequency's negative."""


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
