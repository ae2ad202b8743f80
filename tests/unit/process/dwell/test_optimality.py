"""The dwell solvers against scipy's nnls and clarabel, and how a minimum must answer to a change of its problem."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from types import ModuleType

import clarabel
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import optimize, sparse

from polishd.model.dwell import DwellSolution
from polishd.model.surface import FloatArray, Grid
from polishd.process.dwell import douglas_rachford, interior_point, lucy_richardson, newton_cg
from polishd.process.dwell.problem import DwellProblem
from polishd.process.dwell.quadratic import quadratic
from polishd.process.removal.convolution import convolution_effect
from polishd.process.removal.effect import SparseEffect
from polishd.process.removal.tif import HertzSpot
from tests.unit.process.lattices import PAPER, as_matrix, lattice_problem, resting

Solve = Callable[[DwellProblem, float], DwellSolution]


def by_newton(problem: DwellProblem, kkt_tolerance: float) -> DwellSolution:
    return newton_cg.solve(problem, 30, kkt_tolerance)


def by_transforms(problem: DwellProblem, kkt_tolerance: float) -> DwellSolution:
    return douglas_rachford.solve(problem, 30, kkt_tolerance)


def by_interior_point(problem: DwellProblem, kkt_tolerance: float) -> DwellSolution:
    return interior_point.solve(as_matrix(problem), 30, kkt_tolerance)


SOLVERS = [by_newton, by_transforms, by_interior_point]
each = pytest.mark.parametrize("solve", SOLVERS, ids=lambda solve: solve.__name__)


def dense(problem: DwellProblem) -> tuple[FloatArray, FloatArray]:
    """``A, b`` with the objective, less the price, as ``|A t - b|^2``."""
    effect = as_matrix(problem).effect
    assert isinstance(effect, SparseEffect)
    mask, n = problem.solve_mask, effect.n
    weight = np.ones(mask.shape) if problem.weight is None else problem.weight
    root = np.sqrt(weight[mask] / mask.sum())
    rows = root[:, None] * effect.matrix.toarray()[mask.ravel()]
    a = np.vstack([rows, np.sqrt(problem.regularisation) * np.eye(n)])
    return a, np.concatenate([root * problem.target_nm[mask], np.zeros(n)])


def least_by_clarabel(problem: DwellProblem) -> float:
    """The minimum, asked of clarabel itself: in (t, y) with y the misfit, so that no digit cancels."""
    a, b = dense(problem)
    (m, n), upper = a.shape, np.isfinite(problem.upper_s)
    p = sparse.csc_matrix(sparse.block_diag([sparse.csc_matrix((n, n)), 2 * sparse.eye(m)]))
    t = sparse.eye(n, format="csr")
    rows = sparse.bmat([[sparse.csr_matrix(a), -sparse.eye(m)], [-t, None], [t[upper], None]])
    limits = np.concatenate([b, -problem.lower_s, problem.upper_s[upper]])
    cones = [clarabel.ZeroConeT(m), clarabel.NonnegativeConeT(n + int(upper.sum()))]
    options = clarabel.DefaultSettings()
    options.verbose = False
    options.tol_gap_abs = options.tol_gap_rel = 1e-13
    options.tol_feas = 1e-11
    linear = np.concatenate([np.full(n, problem.price_nm2_per_s), np.zeros(m)])
    found = clarabel.DefaultSolver(p, linear, sparse.csc_matrix(rows), limits, cones, options).solve()
    assert found.status == clarabel.SolverStatus.Solved
    return quadratic(problem).value(np.clip(np.array(found.x[:n]), problem.lower_s, problem.upper_s))


def constrained(seed: int = 0) -> DwellProblem:
    """All that a problem can have: floors, ceilings, weights and a price."""
    problem = lattice_problem(radius_mm=8, seed=seed)
    rng = np.random.default_rng(seed)
    lower = np.where(rng.random(problem.effect.n) < 0.5, 0.0, 0.02)
    return replace(
        problem,
        lower_s=lower,
        upper_s=lower + rng.choice([0.03, 0.1, np.inf], problem.effect.n),
        weight=rng.uniform(0.2, 3.0, problem.solve_mask.shape),
        price_nm2_per_s=0.3,
    )


# against others


@pytest.mark.full
@each
def test_nnls_finds_the_same_objective(solve: Solve) -> None:
    problem = lattice_problem(radius_mm=8)
    _, norm = optimize.nnls(*dense(problem))
    certificate = solve(problem, 1e-8).certificate
    assert certificate.objective == pytest.approx(norm**2, rel=1e-8)
    assert certificate.kkt_residual <= 1e-6
    assert 0 < certificate.at_lower < problem.effect.n  # else the bound was not tried


@pytest.mark.one_of_each
@each
@pytest.mark.parametrize("seed", [0, 1])
def test_clarabel_finds_the_same_objective(solve: Solve, seed: int) -> None:
    problem = constrained(seed)
    certificate = solve(problem, 1e-8).certificate
    assert certificate.objective == pytest.approx(least_by_clarabel(problem), rel=1e-8)
    assert certificate.kkt_residual <= 1e-6
    assert min(certificate.at_lower, certificate.at_upper) > 10
    assert certificate.bound_violation_s == 0


@pytest.mark.one_of_each
@pytest.mark.parametrize(
    ("solve", "rho"),
    [(solve, rho) for solve in SOLVERS for rho in (1e-2, 1e-5)] + [(by_newton, 1e-6), (by_interior_point, 1e-8)],
)
def test_whatever_the_regularisation(solve: Solve, rho: float) -> None:
    problem = lattice_problem(radius_mm=7, rho=rho)
    certificate = solve(problem, 1e-9).certificate
    assert certificate.objective == pytest.approx(least_by_clarabel(problem), rel=1e-8)
    assert certificate.kkt_residual <= 1e-6


@pytest.mark.full
def test_transforms_that_give_up_on_an_ill_conditioned_problem_say_so() -> None:
    found = by_transforms(lattice_problem(radius_mm=5, rho=1e-8), 1e-9).certificate
    assert found.stopped == "iterations"
    assert 1e-9 < found.kkt_residual <= 1e-6


# how a minimum answers

SEED = st.integers(0, 2**16)
few = settings(max_examples=4, deadline=None, database=None)


def small(seed: int) -> DwellProblem:
    """A part of 81 points, another for each seed."""
    return lattice_problem(radius_mm=4.0, seed=seed)


@pytest.mark.parametrize("solver", [newton_cg, douglas_rachford, lucy_richardson], ids=lambda solver: solver.NAME)
@few
@given(seed=SEED, within_s=st.sampled_from([0.0, 1e-3, 30.0]), tightest=st.floats(0.0, 0.2))
def test_bounds_are_never_violated(solver: ModuleType, seed: int, within_s: float, tightest: float) -> None:
    rng = np.random.default_rng(seed)
    problem = small(seed)
    lower = rng.choice([0.0, 0.01, 0.1], problem.effect.n)
    problem = replace(problem, lower_s=lower, upper_s=lower + rng.choice([0.0, tightest, np.inf], problem.effect.n))
    found = solver.solve(problem, within_s)
    assert (found.time_s >= problem.lower_s).all()
    assert (found.time_s <= problem.upper_s).all()
    assert found.certificate.bound_violation_s == 0


@pytest.mark.full
@pytest.mark.one_of_each
@each
@few
@given(seed=SEED, prices=st.lists(st.floats(0, 30), min_size=2, max_size=2, unique=True))
def test_more_time_never_hurts(solve: Solve, seed: int, prices: list[float]) -> None:
    """A lower price of time is a larger budget: more of it is used, and the misfit is no larger."""
    problem = small(seed)
    free = quadratic(problem)
    dear, cheap = (
        solve(replace(problem, price_nm2_per_s=price), 1e-8).time_s for price in sorted(prices, reverse=True)
    )
    scale = free.value(problem.lower_s)
    assert cheap.sum() >= dear.sum() * (1 - 1e-6)
    assert free.value(cheap) <= free.value(dear) + 1e-8 * scale


@pytest.mark.full
@pytest.mark.one_of_each
@each
@few
@given(seed=SEED, raised=st.floats(1.01, 3.0))
def test_wider_bounds_never_hurt(solve: Solve, seed: int, raised: float) -> None:
    problem = small(seed)
    narrow = replace(problem, upper_s=np.full(problem.effect.n, 0.05))
    wide = replace(narrow, upper_s=raised * narrow.upper_s)
    less, more = solve(narrow, 1e-8).certificate.objective, solve(wide, 1e-8).certificate.objective
    assert more <= less * (1 + 1e-8)


@pytest.mark.full
@pytest.mark.one_of_each
@each
@few
@given(seed=SEED, factor=st.floats(0.1, 50.0))
def test_scaling_the_map_scales_the_dwell(solve: Solve, seed: int, factor: float) -> None:
    problem = small(seed)
    once, scaled = solve(problem, 1e-9), solve(replace(problem, target_nm=factor * problem.target_nm), 1e-9)
    np.testing.assert_allclose(scaled.time_s, factor * once.time_s, atol=1e-4 * factor * once.time_s.max())
    assert scaled.certificate.objective == pytest.approx(factor**2 * once.certificate.objective, rel=1e-8)


@pytest.mark.full
@pytest.mark.one_of_each
@each
@few
@given(seed=SEED, factor=st.floats(0.01, 100.0))
def test_a_constant_weight_is_another_regularisation(solve: Solve, seed: int, factor: float) -> None:
    problem = small(seed)
    weighted = replace(
        problem,
        weight=np.full(problem.solve_mask.shape, factor),
        regularisation=factor * problem.regularisation,
    )
    once, again = solve(problem, 1e-9), solve(weighted, 1e-9)
    np.testing.assert_allclose(again.time_s, once.time_s, atol=1e-4 * once.time_s.max())
    assert again.certificate.objective == pytest.approx(factor * once.certificate.objective, rel=1e-8)


def laid(row: int, column: int, seed: int) -> DwellProblem:
    """A part of 8 mm with its dwell points, its map and its mask laid elsewhere on a grid of 40 mm."""
    part = small(seed)
    grid, points = Grid(40, 40, 1.0), resting(4.0)
    # the part's grid has a sample in its middle, this one has not
    shift = np.array([column - 0.5, 0.5 - row, 0.0])
    points = replace(points, start_mm=points.start_mm + shift, end_mm=points.end_mm + shift)
    effect = convolution_effect(grid, HertzSpot(PAPER), points, np.full(points.n, 0.87), np.ones(points.n))
    n = part.effect.grid.ny
    top, left = 20 - (n + 1) // 2 + row, 20 - (n + 1) // 2 + column
    here = (slice(top, top + n), slice(left, left + n))
    target, mask, clear = np.zeros(grid.shape), np.zeros(grid.shape, bool), np.zeros(grid.shape, bool)
    target[here], mask[here], clear[here] = part.target_nm, part.solve_mask, part.metric_mask
    return replace(part, effect=effect, target_nm=target, solve_mask=mask, metric_mask=clear)


@pytest.mark.full
@pytest.mark.one_of_each
@each
@few
@given(seed=SEED, row=st.integers(-7, 7), column=st.integers(-7, 7))
def test_a_map_shifted_with_its_mask_and_points_has_the_same_dwell(
    solve: Solve, seed: int, row: int, column: int
) -> None:
    here, there = solve(laid(0, 0, seed), 1e-9), solve(laid(row, column, seed), 1e-9)
    np.testing.assert_allclose(there.time_s, here.time_s, atol=1e-4 * here.time_s.max())
    assert there.certificate.objective == pytest.approx(here.certificate.objective, rel=1e-8)
    residual = np.roll(there.residual_nm, (-row, -column), axis=(0, 1))
    np.testing.assert_allclose(residual, here.residual_nm, atol=1e-3, equal_nan=True)
