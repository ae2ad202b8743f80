"""The certificate is computed from the solution: it separates a wrong dwell from a right one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import sparse

from polishd.model.dwell import DwellSolution
from polishd.model.errors import ComputeError
from polishd.model.surface import FloatArray, Grid
from polishd.process.dwell.certificate import certify_dwell, kkt_residual, largest_gap
from polishd.process.dwell.newton_cg import solve
from polishd.process.dwell.problem import DwellProblem
from polishd.process.dwell.quadratic import projected_gradient, quadratic
from polishd.process.removal.effect import SparseEffect
from tests.unit.process.gaussian import dwell_problem


def two_samples(target: tuple[float, float], lower: float = 0.0) -> DwellProblem:
    """Two points, two samples, each point removes 2 nm/s from its own."""
    effect = SparseEffect(Grid(1, 2, 1.0), sparse.csr_array(np.diag([2.0, 2.0])))
    mask = np.ones((1, 2), dtype=bool)
    bounds = np.full(2, lower), np.full(2, 10.0)
    return DwellProblem(effect, np.array([target]), mask, mask, *bounds, regularisation=0.5)


def certify(problem: DwellProblem, time_s: FloatArray) -> DwellSolution:
    return certify_dwell(problem, time_s, solver="hand", iterations=3, seconds=0.5, stopped="converged")


def test_every_figure_by_hand() -> None:
    problem = two_samples((4.0, 8.0), lower=1.0)
    solution = certify(problem, np.array([1.0, 3.0]))
    c = solution.certificate
    # misses 2 and 2: (4 + 4) / 2 + 0.5 (1 + 9)
    assert c.objective == pytest.approx(9.0)
    # gradient 2/2 * 2 * (-2) + t = (-3, -1); at the lower bound (1, 1) it is (2/2 * 2 * (-2, -6) + 1) = (-3, -11)
    assert c.kkt_residual == pytest.approx(3 / 11)
    assert (c.predicted_rms_nm, c.predicted_pv_nm) == (0.0, 0.0)
    assert c.dwell_total_s == 4.0
    assert c.piston_nm == 6.0
    assert (c.at_lower, c.at_upper) == (1, 0)
    assert (c.solver, c.iterations, c.seconds, c.stopped) == ("hand", 3, 0.5, "converged")
    np.testing.assert_allclose(solution.removal_nm, [[2.0, 6.0]])
    np.testing.assert_allclose(solution.residual_nm, [[0.0, 0.0]])


def test_bound_violations_are_reported() -> None:
    problem = two_samples((4.0, 8.0), lower=1.0)
    assert certify(problem, np.array([0.75, 3.0])).certificate.bound_violation_s == pytest.approx(0.25)
    assert certify(problem, np.array([1.0, 10.5])).certificate.bound_violation_s == pytest.approx(0.5)
    assert certify(problem, np.array([1.0, 10.0])).certificate.bound_violation_s == 0


def test_the_residual_is_nan_outside_and_without_mean_inside() -> None:
    problem = dwell_problem(radius_mm=8)
    solution = solve(problem, 10)
    assert np.isnan(solution.residual_nm[~problem.solve_mask]).all()
    inside = solution.residual_nm[problem.metric_mask]
    assert inside.mean() == pytest.approx(0, abs=1e-12)
    assert inside.std() == pytest.approx(solution.certificate.predicted_rms_nm)
    by_hand = (problem.target_nm - problem.effect.removal_nm(solution.time_s))[problem.metric_mask]
    assert by_hand.std() == pytest.approx(solution.certificate.predicted_rms_nm)


def test_a_wrong_dwell_has_a_large_kkt_residual() -> None:
    problem = dwell_problem(radius_mm=10)
    good = solve(problem, 10, 1e-9).time_s
    assert kkt_residual(problem, good) <= 1e-9
    worse = np.clip(good * 1.1, problem.lower_s, problem.upper_s)
    assert kkt_residual(problem, worse) > 1e-3
    assert kkt_residual(problem, problem.lower_s) == pytest.approx(1, abs=0.2)


def test_a_dwell_a_hair_off_its_bound_is_nearly_as_good() -> None:
    problem = dwell_problem(radius_mm=10)
    good = solve(problem, 10, 1e-9).time_s
    assert kkt_residual(problem, np.minimum(good + 1e-9, problem.upper_s)) < 1e-6


@pytest.mark.parametrize(("height", "expected"), [(0.0, 0.0), (-3.0, 0.0)])
def test_nothing_to_remove_is_solved_by_the_lower_bound(height: float, expected: float) -> None:
    problem = two_samples((height, height))
    solution = solve(problem, 1)
    np.testing.assert_array_equal(solution.time_s, [expected, expected])
    assert solution.certificate.kkt_residual == 0


def test_without_a_gradient_at_the_lower_bound_only_a_minimum_passes() -> None:
    problem = two_samples((0.0, 0.0))
    assert kkt_residual(problem, np.zeros(2)) == 0
    assert kkt_residual(problem, np.ones(2)) == float("inf")


@pytest.mark.parametrize("time_s", [np.zeros(3), np.array([0.0, np.nan])])
def test_no_certificate_for_a_dwell_that_is_none(time_s: FloatArray) -> None:
    with pytest.raises(ComputeError, match="hand gave no finite dwell for each of the 2 points"):
        certify(two_samples((1.0, 1.0)), time_s)


def test_gradient_and_curvature_are_those_of_the_value() -> None:
    f = quadratic(dwell_problem(radius_mm=6))
    rng = np.random.default_rng(0)
    n = len(f.backward(f.target))
    t, d = rng.random(n), rng.standard_normal(n)
    slope = (f.value(t + 1e-4 * d) - f.value(t - 1e-4 * d)) / 2e-4
    assert f.gradient(t) @ d == pytest.approx(slope, rel=1e-7)
    bend = f.value(t + d) - 2 * f.value(t) + f.value(t - d)
    assert f.curvature(d) @ d == pytest.approx(bend, rel=1e-9)


@pytest.mark.parametrize(("points", "made"), [(30, True), (400, False)])
def test_the_product_of_both_matrices_is_taken_where_points_are_few_and_bends_the_same(points: int, made: bool) -> None:
    """400 samples of which each point reaches about 40; of 400 points as many meet in a sample, and R'R is full."""
    rng, grid = np.random.default_rng(1), Grid(20, 20, 0.5)
    matrix = sparse.csr_array(rng.random((400, points)) * (rng.random((400, points)) < 0.1))
    mask, lower = rng.random(grid.shape) < 0.8, np.zeros(points)
    weight, target = rng.random(grid.shape), np.where(mask, 5.0, 0.0)
    problem = DwellProblem(SparseEffect(grid, matrix), target, mask, mask, lower, lower + 9, 0.1, weight)
    f = quadratic(problem)
    assert (f.gram is not None) == made
    rough = replace(f, gram=None)
    d = rng.standard_normal(points)
    np.testing.assert_allclose(f.curvature(d), rough.curvature(d), rtol=1e-12, atol=1e-13)
    np.testing.assert_array_equal(f.rough_curvature(d), f.curvature(d))


def test_the_safe_step_is_below_one_over_the_largest_eigenvalue_and_not_far() -> None:
    problem = dwell_problem(radius_mm=6)
    f = quadratic(problem)
    n = problem.effect.n
    hessian = np.stack([f.curvature(row) for row in np.eye(n)])
    largest = np.linalg.eigvalsh(hessian)[-1]
    assert 1 / largest / 3 < f.safe_step <= 1 / largest


def test_the_projected_gradient_is_what_the_bounds_leave() -> None:
    gradient = np.array([1.0, -1.0, 1.0, -1.0, 0.5])
    t, lower, upper = np.array([0.0, 0.0, 2.0, 2.0, 1.0]), np.zeros(5), np.full(5, 2.0)
    np.testing.assert_allclose(projected_gradient(gradient, t, lower, upper, 0.1), [0, -1, 1, 0, 0.5])


def test_samples_outside_the_mask_do_not_count() -> None:
    problem = dwell_problem(radius_mm=8)
    target = np.where(problem.solve_mask, problem.target_nm, 1e9)
    once, other = solve(problem, 10), solve(replace(problem, target_nm=target), 10)
    np.testing.assert_array_equal(once.time_s, other.time_s)
    assert once.certificate.objective == other.certificate.objective


def test_the_gap_by_hand() -> None:
    """Point by point: f = (2 t - h)^2 / 2 + t^2 / 2 has its least at t = 2 h / 5; P is 1/2, its curvature 5."""
    problem = two_samples((5.0, 10.0), lower=0.0)
    best = np.array([2.0, 4.0])
    assert largest_gap(problem, best) == pytest.approx(0.0, abs=1e-12)
    step = -3.0  # of the first point, whose gradient is 5: P alone would have its least 5 away, the bound is nearer
    assert largest_gap(problem, best + np.array([1.0, 0.0])) == pytest.approx(-5.0 * step - 0.5 * step**2)


@pytest.mark.one_of_each
@pytest.mark.parametrize("regularisation", [0.0, 1e-6, 1e-3, 1.0])
def test_no_dwell_is_better_by_more_than_the_gap(regularisation: float) -> None:
    problem = replace(dwell_problem(radius_mm=8), regularisation=regularisation)
    f = quadratic(problem)
    solution = solve(problem, 20, kkt_tolerance=1e-9)
    best = f.value(solution.time_s)
    rng = np.random.default_rng(3)
    for size in (0.0, 1e-4, 1e-2, 1.0):
        moved = solution.time_s + size * rng.standard_normal(solution.time_s.size)
        t = np.clip(moved, problem.lower_s, problem.upper_s)
        assert f.value(t) - best <= largest_gap(problem, t, f) + 1e-9 * best, size


def test_the_gap_of_an_optimum_is_next_to_nothing_and_that_of_a_guess_is_not() -> None:
    problem = dwell_problem(radius_mm=8)
    found = solve(problem, 20, kkt_tolerance=1e-8).certificate
    assert found.gap is not None
    assert found.gap_nm is not None
    assert 0.0 <= found.gap < 1e-4
    assert found.gap_nm < 1e-3
    guess = certify(problem, np.maximum(problem.lower_s, 0.1)).certificate
    assert guess.gap is not None
    assert guess.gap > 0.1


def test_without_bounds_and_p_nothing_is_proved() -> None:
    problem = replace(two_samples((5.0, 10.0)), regularisation=0.0, upper_s=np.full(2, np.inf))
    guess = certify(problem, np.array([1.0, 1.0])).certificate
    assert guess.gap is guess.gap_nm is None
    best = certify(problem, np.array([2.5, 5.0])).certificate
    assert best.gap == best.gap_nm == 0.0
