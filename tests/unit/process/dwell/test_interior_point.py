"""The interior point solver: against bvls and nnls, with every kind of bound, at its deadline, and where it refuses."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import optimize, sparse

from polishd.model.errors import ComputeError
from polishd.model.surface import FloatArray, Grid
from polishd.process.dwell import interior_point, newton_cg
from polishd.process.dwell.problem import DwellProblem
from polishd.process.dwell.quadratic import quadratic
from polishd.process.removal.effect import SparseEffect
from tests.unit.process.dwell.exact_dwell import by_nnls, normal_equations
from tests.unit.process.gaussian import dwell_problem


def small(seed: int, p: float) -> DwellProblem:
    """A random effect on a 6 x 5 grid; bounds of all kinds, some of them without any room."""
    rng = np.random.default_rng(seed)
    grid = Grid(6, 5, 1.0)
    matrix = sparse.csr_array(rng.random((30, 12)) * (rng.random((30, 12)) < 0.6))
    mask = rng.random(grid.shape) < 0.9
    lower = rng.random(12) * 0.3
    upper = lower + rng.choice([0.0, 1e-6, 0.2, 2.0, np.inf], 12)
    return DwellProblem(
        SparseEffect(grid, matrix), 5 * rng.random(grid.shape), mask, mask, lower, upper, p,
        weight=rng.random(grid.shape) + 0.1, price_nm2_per_s=float(rng.choice([0.0, 0.3])),
    )  # fmt: skip


def by_bvls(problem: DwellProblem) -> float:
    """The least objective by scipy's bounded least squares on the Cholesky factor of the normal equations."""
    hessian, c = normal_equations(problem)
    free = problem.lower_s < problem.upper_s
    at = np.where(free, 0.0, problem.lower_s)
    lower = np.linalg.cholesky(hessian.toarray()[np.ix_(free, free)])
    aim = -np.linalg.solve(lower, (c + hessian @ at)[free])
    found = optimize.lsq_linear(
        lower.T, aim, (problem.lower_s[free], problem.upper_s[free]), tol=1e-14, method="bvls", max_iter=500
    )
    at[free] = found.x
    return quadratic(problem).value(at)


@pytest.mark.full
@settings(max_examples=60)
@given(st.integers(0, 10**6), st.sampled_from([1e-7, 1e-4, 0.1]))
def test_agrees_with_bvls_on_any_small_problem(seed: int, p: float) -> None:
    problem = small(seed, p)
    solution = interior_point.solve(problem, 10)
    c = solution.certificate
    assert (c.stopped, c.bound_violation_s) == ("converged", 0)
    assert c.objective == pytest.approx(by_bvls(problem), rel=1e-7, abs=1e-12)
    assert (solution.time_s >= problem.lower_s).all()
    assert (solution.time_s <= problem.upper_s).all()


@pytest.mark.parametrize("rho", [1e-2, 1e-6, 1e-12])
def test_agrees_with_nnls_in_about_as_many_rounds_whatever_p(rho: float) -> None:
    problem = dwell_problem(radius_mm=8, rho=rho)
    problem = replace(problem, lower_s=0 * problem.lower_s, upper_s=np.full(problem.effect.n, np.inf))
    solution = interior_point.solve(problem, 30)
    exact = by_nnls(problem)
    assert solution.certificate.objective == pytest.approx(quadratic(problem).value(exact), rel=1e-8)
    mask = problem.solve_mask
    assert solution.removal_nm[mask] == pytest.approx(problem.effect.removal_nm(exact)[mask], abs=0.02)
    assert solution.certificate.iterations < 40
    assert solution.certificate.kkt_residual <= 1e-8


def test_agrees_with_newton_cg_between_bounds_that_bind_on_both_sides() -> None:
    problem = dwell_problem(radius_mm=12, feed_mm_s=15)
    problem = replace(problem, upper_s=np.maximum(problem.lower_s, 0.15))
    ours, theirs = interior_point.solve(problem, 30, 1e-10), newton_cg.solve(problem, 30, 1e-10)
    assert ours.certificate.objective == pytest.approx(theirs.certificate.objective, rel=1e-8)
    assert ours.time_s == pytest.approx(theirs.time_s, abs=1e-5)
    assert min(ours.certificate.at_lower, ours.certificate.at_upper) > 10


def test_the_gap_bounds_the_error() -> None:
    problem = dwell_problem(radius_mm=10, rho=1e-6)
    exact = interior_point.solve(problem, 30, 1e-12).certificate.objective
    for tolerance in (1e-2, 1e-4):
        found = interior_point.solve(problem, 30, tolerance).certificate
        (note,) = found.notes
        gap = float(note.split()[2])
        assert -1e-12 <= found.objective - exact <= 1.1 * gap + 1e-9
        assert gap <= tolerance * found.objective


def test_the_order_of_the_points_does_not_matter() -> None:
    problem = dwell_problem(radius_mm=10)
    order = np.random.default_rng(5).permutation(problem.effect.n)
    other = replace(
        problem,
        effect=SparseEffect(problem.effect.grid, sparse.csr_array(problem.effect.matrix[:, order])),
        lower_s=problem.lower_s[order],
        upper_s=problem.upper_s[order],
    )
    as_given = interior_point.solve(problem, 30).time_s
    assert interior_point.solve(other, 30).time_s == pytest.approx(as_given[order], abs=1e-6)
    free = np.ones(problem.effect.n, dtype=bool)
    given, found = (interior_point.BandedHessian.of(p, free).band.shape[0] for p in (problem, other))
    assert found < 3 * given  # the band is found again


def test_out_of_time_it_gives_a_feasible_dwell_and_says_so() -> None:
    problem = dwell_problem(radius_mm=10)
    solution = interior_point.solve(problem, 0.0)
    c = solution.certificate
    assert (c.stopped, c.iterations, c.bound_violation_s) == ("deadline", 0, 0)
    assert c.kkt_residual > 1e-3
    assert c.objective <= quadratic(problem).value(problem.lower_s)


def test_a_deadline_on_the_way_keeps_the_best(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = dwell_problem(radius_mm=10)
    now = iter(np.arange(1000.0))
    monkeypatch.setattr(time, "thread_time", lambda: next(now))
    objectives = []
    for seconds in (1.0, 4.0, 7.0, 10.0, 100.0):
        solution = interior_point.solve(problem, seconds)
        objectives.append(solution.certificate.objective)
        assert solution.certificate.bound_violation_s == 0
    assert objectives == sorted(objectives, reverse=True)
    assert solution.certificate.stopped == "converged"


def test_points_without_room() -> None:
    problem = dwell_problem(radius_mm=6)
    fixed = replace(problem, lower_s=np.full(problem.effect.n, 0.1), upper_s=np.full(problem.effect.n, 0.1))
    solution = interior_point.solve(fixed, 10)
    np.testing.assert_array_equal(solution.time_s, 0.1)
    assert (solution.certificate.stopped, solution.certificate.kkt_residual) == ("converged", 0)


def test_points_without_effect_stay_at_their_lower_bound() -> None:
    problem = dwell_problem(radius_mm=6)
    matrix = problem.effect.matrix.copy()
    idle = np.arange(problem.effect.n) % 7 == 0
    matrix = sparse.csr_array(matrix @ sparse.diags_array(np.where(idle, 0.0, 1.0)))
    solution = interior_point.solve(replace(problem, effect=SparseEffect(problem.effect.grid, matrix)), 10, 1e-2)
    np.testing.assert_array_equal(solution.time_s[idle], problem.lower_s[idle])
    assert (solution.time_s[~idle] > problem.lower_s[~idle]).any()


def test_a_singular_hessian_is_survived() -> None:
    problem = dwell_problem(radius_mm=6)
    twice = sparse.csr_array(sparse.hstack([problem.effect.matrix, problem.effect.matrix]))
    n = twice.shape[1]
    double = replace(
        problem,
        effect=SparseEffect(problem.effect.grid, twice),
        lower_s=np.zeros(n),
        upper_s=np.full(n, 10.0),
        regularisation=0.0,
    )
    c = interior_point.solve(double, 10).certificate
    single = replace(problem, lower_s=np.zeros(n // 2), upper_s=np.full(n // 2, 20.0), regularisation=0.0)
    assert c.stopped == "converged"
    assert c.objective == pytest.approx(interior_point.solve(single, 10).certificate.objective, rel=1e-6)


class Opaque:
    """An effect that is no matrix."""

    def __init__(self, inner: SparseEffect) -> None:
        self.grid, self.n, self.removal_nm, self.adjoint = inner.grid, inner.n, inner.removal_nm, inner.adjoint


def test_what_it_cannot_factorise_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = dwell_problem(radius_mm=6)
    with pytest.raises(ComputeError, match="needs an effect matrix, not a Opaque"):
        interior_point.solve(replace(problem, effect=Opaque(problem.effect)), 10)
    with pytest.raises(ComputeError, match="regularisation must be finite"):
        interior_point.solve(replace(problem, regularisation=-1.0), 10)
    for limit in ("MAX_ENTRIES", "MAX_PRODUCTS"):
        with monkeypatch.context() as patch:
            patch.setattr(interior_point, limit, 100)
            with pytest.raises(ComputeError, match="100 at most: use another solver"):
                interior_point.solve(problem, 10)


def test_the_band_holds_the_hessian() -> None:
    problem = dwell_problem(radius_mm=6)
    some = np.arange(problem.effect.n) % 3 > 0
    hessian = interior_point.BandedHessian.of(problem, some)
    whole, _ = normal_equations(problem)
    dense = whole.toarray()[np.ix_(hessian.order, hessian.order)]
    assert sorted(hessian.order) == list(np.flatnonzero(some))
    for k, line in enumerate(hessian.band):
        assert line[: line.size - k] == pytest.approx(np.diagonal(dense, -k), abs=1e-12 * dense.max())
    y: FloatArray = np.random.default_rng(0).random(len(dense))
    added = np.linspace(1, 2, len(dense))
    assert hessian.factor(added)(y) == pytest.approx(np.linalg.solve(dense + np.diag(added), y), rel=1e-6)
