"""The sum of convolutions against the effect matrix, and against itself transposed."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

from polishd.model.errors import ComputeError
from polishd.model.process import ToolProcess
from polishd.model.program import Program
from polishd.model.surface import Grid
from polishd.process.removal.convolution import ConvolutionEffect, convolution_effect
from polishd.process.removal.dynamic_tif import effect_matrix
from polishd.process.removal.effect import Effect, SparseEffect
from polishd.process.removal.tif import HertzSpot
from tests.unit.process.moves import inward_program, program

SPOT = HertzSpot(ToolProcess())
GRID = Grid(33, 40, 1.0)


def dwells(grid: Grid, margin: int = 0, share: float = 1.0, seed: int = 0) -> Program:
    """Dwells on a share of the grid's nodes, and on its lattice up to a margin beyond, in any order."""
    rng = np.random.default_rng(seed)
    row, column = (np.arange(-margin, n + margin) for n in grid.shape)
    x = grid.x_mm[0] + grid.pitch_mm * column
    y = grid.y_mm[0] - grid.pitch_mm * row
    nodes = np.stack([a.ravel() for a in np.meshgrid(x, y)], axis=1)
    chosen = nodes[rng.permutation(len(nodes))[: int(share * len(nodes))]]
    return inward_program(chosen, chosen)


def both(
    grid: Grid, moves: Program, tolerance: float = 1e-4, ratios: tuple[float, float] = (0.835, 0.913)
) -> tuple[ConvolutionEffect, SparseEffect]:
    """Return the effect by convolutions and as a matrix."""
    rng = np.random.default_rng(3)
    gamma, factor = rng.uniform(*ratios, moves.n), rng.uniform(0.8, 1.2, moves.n)
    quick = convolution_effect(grid, SPOT, moves, gamma, factor, tolerance=tolerance)
    return quick, SparseEffect(grid, effect_matrix(grid, SPOT, moves, gamma, factor))


@pytest.mark.parametrize("tolerance", [1e-2, 1e-4, 1e-6])
@pytest.mark.parametrize("margin", [0, 3])
def test_every_column_is_right_within_the_stated_truncation(tolerance: float, margin: int) -> None:
    grid = Grid(9, 12, 1.0)
    quick, exact = both(grid, dwells(grid, margin), tolerance)
    assert quick.truncation <= tolerance * (1 + 1e-9)
    assert quick.n == exact.n
    whole = np.linalg.norm(quick.coefficients, axis=1)  # of the column, also of what is cut away at the edge
    for k in range(0, quick.n, 5):
        one = np.eye(1, quick.n, k)[0]
        error = np.linalg.norm(quick.removal_nm(one) - exact.removal_nm(one))
        assert error < 1.01 * quick.truncation * whole[k] + 1e-9


def test_columns_in_the_middle_of_the_grid_are_relatively_right() -> None:
    grid = Grid(9, 9, 1.0)
    moves = program([[0.0, 0.0]] * 50, [[0.0, 0.0]] * 50, np.linspace(2.0, 2.4, 50))
    quick, exact = both(grid, moves, 1e-3)
    error = [
        np.linalg.norm(quick.removal_nm(one) - exact.removal_nm(one)) / np.linalg.norm(exact.removal_nm(one))
        for one in np.eye(50)
    ]
    assert max(error) == pytest.approx(quick.truncation, rel=1e-6)
    assert 1e-5 < max(error) <= 1e-3


@pytest.mark.parametrize("margin", [0, 2, 9])
@pytest.mark.parametrize("pitch", [0.5, 1.0])
def test_a_whole_dwell_map_removes_what_the_matrix_says(margin: int, pitch: float) -> None:
    grid = Grid(33, 40, pitch)
    quick, exact = both(grid, dwells(grid, margin))
    time = np.random.default_rng(1).uniform(0, 10, quick.n)
    want = exact.removal_nm(time)
    assert np.abs(quick.removal_nm(time) - want).max() < 1e-4 * want.max()


@pytest.mark.parametrize(("margin", "share"), [(0, 1.0), (4, 1.0), (2, 0.1)])
def test_the_adjoint_is_the_transpose(margin: int, share: float) -> None:
    quick, exact = both(GRID, dwells(GRID, margin, share))
    rng = np.random.default_rng(2)
    for _ in range(5):
        time, weight = rng.standard_normal(quick.n), rng.standard_normal(GRID.shape)
        forward, backward = np.vdot(quick.removal_nm(time), weight), time @ quick.adjoint(weight)
        assert forward == pytest.approx(backward, rel=1e-10, abs=1e-6)
    want = exact.adjoint(weight)
    assert np.abs(quick.adjoint(weight) - want).max() < 1e-3 * np.abs(want).max()


def test_nothing_wraps_round_the_edges() -> None:
    """A dwell in one corner leaves the opposite ones as they are."""
    corner = [[GRID.x_mm[-1], GRID.y_mm[-1]]]
    quick, _ = both(GRID, program(corner, corner))
    removal = quick.removal_nm(np.ones(1))
    assert removal[-1, -1] > 50
    assert np.abs(removal[:-6]).max() < 1e-9
    assert np.abs(removal[:, :-6]).max() < 1e-9


def test_a_node_may_be_visited_twice() -> None:
    twice = program([[0.5, 0.0], [0.5, 0.0]], [[0.5, 0.0], [0.5, 0.0]], [0.0, 1.0])
    quick, exact = both(GRID, twice)
    np.testing.assert_allclose(
        quick.removal_nm(np.array([1.0, 2.0])), exact.removal_nm(np.array([1.0, 2.0])), atol=0.05
    )


def test_no_points_remove_nothing() -> None:
    quick, _ = both(GRID, program(np.empty((0, 2)), np.empty((0, 2))))
    assert quick.n == 0
    assert (quick.removal_nm(np.empty(0)) == 0).all()
    assert quick.adjoint(np.ones(GRID.shape)).shape == (0,)


def test_it_is_an_effect_and_can_go_to_the_worker() -> None:
    quick, _ = both(GRID, dwells(GRID, 0, 0.05))
    effect: Effect = pickle.loads(pickle.dumps(quick))
    time = np.arange(quick.n, dtype=np.float64)
    np.testing.assert_array_equal(effect.removal_nm(time), quick.removal_nm(time))
    assert effect.grid == GRID


def test_few_convolutions_are_enough() -> None:
    """One way of leaning and the paper's range: rank 4 at 1e-4."""
    moves = dwells(GRID)
    fixed = program(moves.start_mm[:, :2], moves.end_mm[:, :2])
    quick, _ = both(GRID, fixed, 1e-4)
    assert quick.rank == 4


@pytest.mark.parametrize("off", [(0.3, 0.0), (0.0, -0.01), (np.nan, 0.0)])
def test_points_off_the_nodes_are_refused(off: tuple[float, float]) -> None:
    point = np.array([[GRID.x_mm[3], GRID.y_mm[5]], [GRID.x_mm[7] + off[0], GRID.y_mm[2] + off[1]]])
    with pytest.raises(ComputeError, match="point 1: the distance to the grid's nearest node is"):
        both(GRID, program(point, point))


def test_blocks_that_move_are_refused() -> None:
    start = np.array([[GRID.x_mm[3], GRID.y_mm[5]]])
    with pytest.raises(ComputeError, match="point 0: the block's length is 1 mm, a convolution needs dwells at rest"):
        both(GRID, program(start, start + np.array([1.0, 0.0])))


@pytest.mark.parametrize("factor", [-1.0, np.nan])
def test_an_impossible_factor_is_refused(factor: float) -> None:
    here = [[0.5, 0.0]]
    with pytest.raises(ComputeError, match="point 0: the factor on the removal"):
        convolution_effect(GRID, SPOT, program(here, here), np.ones(1), np.array([factor]))
