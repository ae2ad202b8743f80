"""The literature's baseline: what it honours, what it does not, and that it says so."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import sparse

from polishd.model.errors import ComputeError
from polishd.model.surface import Grid
from polishd.process.dwell import lucy_richardson, newton_cg
from polishd.process.dwell.problem import DwellProblem
from polishd.process.dwell.quadratic import quadratic
from polishd.process.removal.effect import SparseEffect
from tests.unit.process.gaussian import dwell_problem
from tests.unit.process.lattices import lattice_problem


def free() -> DwellProblem:
    problem = dwell_problem(radius_mm=12)
    return replace(problem, lower_s=0 * problem.lower_s, upper_s=np.full(problem.effect.n, np.inf))


def test_one_step_is_the_published_formula() -> None:
    rng = np.random.default_rng(4)
    grid = Grid(5, 4, 1.0)
    rate, mask = rng.random((20, 7)), rng.random(grid.shape) < 0.8
    target, weight = 100 * rng.random(grid.shape) + 50, rng.uniform(0.5, 2, grid.shape)
    problem = DwellProblem(
        SparseEffect(grid, sparse.csr_array(rate)), target, mask, mask, np.zeros(7), np.full(7, np.inf), 0.0, weight
    )
    r, h, w = rate[mask.ravel()], target[mask], weight[mask]
    start = np.full(7, (w @ h) / (w @ r.sum(axis=1)))
    by_hand = start * (r.T @ (w * h / (r @ start))) / (r.T @ w)
    found = lucy_richardson.solve(problem, 10, iterations=1)
    np.testing.assert_allclose(found.time_s, by_hand, rtol=1e-12)
    assert found.certificate.iterations == 1


def test_it_comes_near_the_minimum_and_not_below() -> None:
    problem = free()
    best = newton_cg.solve(problem, 10, 1e-9).certificate
    found = lucy_richardson.solve(problem, 10).certificate
    start = lucy_richardson.solve(problem, 10, iterations=0).certificate
    assert found.iterations == lucy_richardson.ITERATIONS
    assert found.stopped == "iterations"
    assert best.objective < found.objective < 0.05 * start.objective
    assert best.predicted_rms_nm < found.predicted_rms_nm < 3 * best.predicted_rms_nm
    assert found.kkt_residual > best.kkt_residual
    assert "does not minimise the objective" in found.notes[0]


def test_more_iterations_are_never_worse() -> None:
    problem = dwell_problem(radius_mm=10)
    found = [lucy_richardson.solve(problem, 10, iterations=n).certificate.objective for n in (0, 3, 10, 40, 160)]
    assert found == sorted(found, reverse=True)
    assert found[-1] < 0.1 * found[0]


def test_what_noise_would_make_of_too_many_iterations_is_not_returned() -> None:
    problem = replace(free(), regularisation=30 * free().regularisation)  # which the iteration does not know
    far, near = (lucy_richardson.solve(problem, 30, iterations=n) for n in (600, 300))
    assert far.certificate.objective <= near.certificate.objective
    assert far.certificate.objective == pytest.approx(quadratic(problem).value(far.time_s), rel=1e-12)


def test_a_plant_without_noise_is_recovered() -> None:
    problem = replace(free(), regularisation=0.0)
    true_s = 0.2 + 0.1 * np.sin(np.arange(problem.effect.n) / 40)
    problem = replace(problem, target_nm=problem.effect.removal_nm(true_s))
    found = lucy_richardson.solve(problem, 30, iterations=300)
    assert found.certificate.predicted_rms_nm < 0.02 * problem.target_nm[problem.metric_mask].std()


def test_bounds_hold_on_both_sides() -> None:
    problem = dwell_problem(radius_mm=12, unreachable=0.05)
    problem = replace(problem, upper_s=np.maximum(problem.lower_s, 0.12))
    certificate = lucy_richardson.solve(problem, 10).certificate
    assert certificate.bound_violation_s == 0
    assert min(certificate.at_lower, certificate.at_upper) > 10


def test_weight_moves_the_misfit_to_where_it_counts_less() -> None:
    problem = dwell_problem(radius_mm=12)
    x_mm = np.broadcast_to(problem.effect.grid.x_mm, problem.solve_mask.shape)
    left, seam = x_mm < 0, problem.solve_mask & (x_mm < 0) & (x_mm > -2)

    def miss(weight: float) -> float:
        found = lucy_richardson.solve(replace(problem, weight=np.where(left, weight, 1.0)), 10)
        return float(np.sqrt(np.mean((problem.target_nm - found.removal_nm)[seam] ** 2)))

    assert miss(100.0) < 0.98 * miss(1.0) < 0.6 * miss(0.01)


def test_sums_of_convolutions_and_pits() -> None:
    problem = lattice_problem(radius_mm=9)
    assert (problem.target_nm[problem.solve_mask] < 0).any()
    certificate = lucy_richardson.solve(problem, 10).certificate
    best = newton_cg.solve(problem, 10, 1e-9).certificate
    assert best.predicted_rms_nm < certificate.predicted_rms_nm < 2 * best.predicted_rms_nm


def test_a_warm_start_goes_on_where_the_last_ended() -> None:
    problem = dwell_problem(radius_mm=10)
    first = lucy_richardson.solve(problem, 10, iterations=30)
    again = lucy_richardson.solve(replace(problem, warm=first), 10, iterations=30).certificate.objective
    assert again == pytest.approx(lucy_richardson.solve(problem, 10, iterations=60).certificate.objective, rel=1e-3)


def test_out_of_time_it_gives_a_feasible_dwell_and_says_so() -> None:
    problem = dwell_problem(radius_mm=20)
    certificate = lucy_richardson.solve(problem, 0.0).certificate
    assert (certificate.stopped, certificate.iterations, certificate.bound_violation_s) == ("deadline", 0, 0)


def test_nothing_to_remove_is_refused() -> None:
    problem = dwell_problem(radius_mm=6)
    with pytest.raises(ComputeError, match="nowhere above 0"):
        lucy_richardson.solve(replace(problem, target_nm=-np.abs(problem.target_nm)), 5)


def test_the_problem_is_checked_first() -> None:
    problem = dwell_problem(radius_mm=6)
    with pytest.raises(ComputeError, match="solve_mask is empty"):
        lucy_richardson.solve(replace(problem, solve_mask=np.zeros_like(problem.solve_mask)), 5)
