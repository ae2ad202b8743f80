"""Patches laid by their integral, against the same shared out square by square."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from polishd.model.process import ToolProcess
from polishd.model.surface import FloatArray, Grid
from polishd.process.removal.dynamic_tif import (
    CellAverages,
    PointLocation,
    average_over_cells,
    effect_columns,
    effects_columns,
    integrals,
)
from polishd.process.removal.tif import HertzSpot, WiderSpot
from tests.unit.process.area_reference import shared_out


def dense(grid: Grid, columns: CellAverages) -> FloatArray:
    """(ny, nx, n) of them, no sample twice."""
    found = np.zeros((grid.ny * grid.nx, len(columns.count)))
    owner = np.repeat(np.arange(len(columns.count)), columns.count)
    found[columns.sample, owner] = columns.rate
    assert np.count_nonzero(found) == columns.rate.size
    assert (columns.rate > 0).all()
    return found.reshape(*grid.shape, -1)


@given(
    st.integers(0, 2**32 - 1),
    st.sampled_from([1, 2, 7, 32]),
    st.sampled_from([0.05, 0.3, 1.0, 5.0]),
    st.tuples(st.integers(1, 9), st.integers(1, 9)),
)
@settings(max_examples=60, deadline=None)
def test_it_is_each_square_shared_out(seed: int, squares: int, pitch: float, shape: tuple[int, int]) -> None:
    """Squares and cells of any size, patches that are mostly empty, positions on the grid, across its edge and off."""
    rng = np.random.default_rng(seed)
    grid, n = Grid(*shape, pitch), int(rng.integers(1, 5))
    patch = rng.uniform(0, 5, (n, squares, squares)) * (rng.uniform(size=(n, squares, squares)) < 0.4)
    half, count = pitch * rng.uniform(0.1, 4.0, n), rng.integers(1, 6, n)
    position = pitch * rng.uniform(-8, 8, (int(count.sum()), 2))
    want = shared_out(grid, patch, half, count, position)
    got = dense(grid, average_over_cells(grid, integrals(patch), np.column_stack([half, half]), count, position))
    peak = patch.sum(axis=(1, 2)).max() / pitch**2
    np.testing.assert_allclose(got, want, rtol=0, atol=1e-13 * peak)


def test_the_hertz_spot_has_the_same_entries_to_rounding() -> None:
    rng, grid = np.random.default_rng(3), Grid(24, 30, 0.5)
    spot, gamma, azimuth = HertzSpot(ToolProcess(), 64), rng.uniform(0.8, 1.0, 12), rng.uniform(-3, 3, 12)
    patch, half, count = spot.patch(gamma, azimuth), spot.half_width_mm(gamma), np.full(12, 4)
    position = rng.uniform(-9, 9, (48, 2))
    want = shared_out(grid, patch, half, count, position)
    got = dense(grid, average_over_cells(grid, integrals(patch), np.column_stack([half, half]), count, position))
    assert abs(got - want).max() < 1e-13 * want.max()
    np.testing.assert_array_equal(got > 0, want > 1e-12 * want.max())


def test_by_hand() -> None:
    """A patch of 2 by 2 squares of 1 mm, its middle half a millimetre right of and above a corner of cells of 2 mm."""
    grid, patch = Grid(2, 2, 2.0), np.array([[[1.0, 2.0], [3.0, 4.0]]])
    got = dense(
        grid, average_over_cells(grid, integrals(patch), np.ones((1, 2)), np.ones(1, int), np.full((1, 2), 0.5))
    )
    np.testing.assert_allclose(got[:, :, 0] * 4, [[0.5 + 0.75, 0.5 + 2 + 0.75 + 2], [0.75, 0.75 + 2]], rtol=1e-15)


def test_what_is_empty_has_no_entry() -> None:
    """Where a patch has nothing, differences of its integral only leave what they round to."""
    rng, grid = np.random.default_rng(5), Grid(40, 40, 0.25)
    patch = np.zeros((1, 64, 64))
    patch[0, :, 40:] = rng.uniform(1, 2, (64, 24))
    got = dense(
        grid,
        average_over_cells(grid, integrals(patch), np.full((1, 2), 4.0), np.ones(1, int), np.array([[0.03, -0.04]])),
    )
    left = grid.x_mm + 0.125 <= 0.03 + 1.0
    assert not got[:, left].any()
    assert got[5:35, ~left][:, :11].all()


@pytest.mark.parametrize("squares", [32, 64])
def test_blocks_that_lie_in_several_ways_are_as_each_on_its_own(squares: int) -> None:
    rng, grid = np.random.default_rng(2), Grid(30, 31, 0.5)
    n, spot = 60, HertzSpot(ToolProcess(), squares)
    gamma, azimuth, factor = rng.uniform(0.8, 1.0, n), rng.uniform(-3, 3, n), rng.uniform(0, 1, n)
    start = rng.uniform(-6, 6, (n, 2))
    ends = start, start + rng.uniform(-4, 4, (n, 2))
    moved = ends[0] + 0.1, ends[1] + 0.1
    lies = [PointLocation(ends), PointLocation(moved), PointLocation(ends, 1.3)]
    got = effects_columns(grid, spot, lies, azimuth, depth_ratio=gamma, factor=factor)
    for one, at, wider in zip(got, (ends, moved, ends), (1.0, 1.0, 1.3), strict=True):
        own = effect_columns(grid, WiderSpot(spot, wider), at, azimuth, depth_ratio=gamma, factor=factor)
        assert abs(one - own).max() < 1e-13 * own.max()


def test_a_factor_of_nothing_leaves_an_empty_column() -> None:
    at = np.zeros((2, 2)), np.zeros((2, 2))
    one, spot = np.ones(2), HertzSpot(ToolProcess())
    matrix = effect_columns(Grid(9, 9, 1.0), spot, at, one, depth_ratio=one, factor=np.array([1.0, 0.0]))
    np.testing.assert_array_equal(np.unique(matrix.nonzero()[1]), [0])
    assert matrix.nnz == np.count_nonzero(matrix.data)


def test_a_column_is_the_same_whatever_is_laid_with_it() -> None:
    """To the last bit: a difference that is left of large numbers would show how these were added up."""
    rng, grid, n = np.random.default_rng(4), Grid(60, 60, 0.1), 9
    gamma, azimuth, at = rng.uniform(0.8, 1.0, n), rng.uniform(-3, 3, n), rng.uniform(-2, 2, (n, 2))
    spot, one = HertzSpot(ToolProcess()), np.ones(n)
    whole = effect_columns(grid, spot, (at, at), azimuth, depth_ratio=gamma, factor=one).toarray()
    for k in (0, 4, 8):
        own, place = slice(k, k + 1), at[k : k + 1]
        alone = effect_columns(
            grid, spot, (place, place), azimuth[own], depth_ratio=gamma[own], factor=one[own]
        ).toarray()
        np.testing.assert_array_equal(whole[:, k], alone[:, 0])
