"""The proof of a gap: never below the true one, of whatever dwell, and near it with next to no regularisation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import optimize, sparse

from polishd.model.surface import FloatArray, Grid
from polishd.process.dwell.certificate import certify_dwell, largest_gap
from polishd.process.dwell.lower_bound import LowerBound, prove_lower_bound, smallest_gap
from polishd.process.dwell.newton_cg import solve
from polishd.process.dwell.problem import DwellProblem
from polishd.process.dwell.quadratic import quadratic
from polishd.process.removal.effect import SparseEffect
from tests.unit.process.gaussian import dwell_problem


def never() -> bool:
    return False


def always() -> bool:
    return True


def small(rng: np.random.Generator, rho: float, *, upper: bool, price: float, weighted: bool) -> DwellProblem:
    """Some samples and points, at random: of points more or fewer than samples, some that reach nothing."""
    shape, n = (int(rng.integers(1, 4)), int(rng.integers(1, 5))), int(rng.integers(1, 12))
    matrix = rng.random((shape[0] * shape[1], n)) * (rng.random((shape[0] * shape[1], n)) < 0.6)
    matrix[0, 0] = 1.0
    target = rng.normal(2.0, 3.0, shape)
    mask = np.ones(shape, dtype=bool)
    lower = rng.random(n) * rng.integers(0, 2)
    high = lower + 3 * rng.random(n) if upper else np.full(n, np.inf)
    weight = 2 * rng.random(shape) if weighted else None
    regularisation = rho * max(float(np.linalg.norm(matrix, 2)) ** 2, 1e-3) / mask.sum()
    effect = SparseEffect(Grid(*shape, 1.0), sparse.csr_array(matrix))
    return DwellProblem(effect, target, mask, mask, lower, high, regularisation, weight, price)


def least(problem: DwellProblem) -> float:
    """The least objective: scipy's bounded least squares, which shares nothing with the proof; no price."""
    root = np.ones(problem.target_nm.size) if problem.weight is None else np.sqrt(problem.weight.ravel())
    n, m = problem.effect.n, problem.target_nm.size
    assert isinstance(problem.effect, SparseEffect)
    rows = root[:, None] * problem.effect.matrix.toarray() / np.sqrt(m)
    rows = np.vstack([rows, np.sqrt(problem.regularisation) * np.eye(n)])
    aim = np.append(root * problem.target_nm.ravel() / np.sqrt(m), np.zeros(n))
    high = np.where(np.isfinite(problem.upper_s), problem.upper_s, 1e6)
    high = np.maximum(high, problem.lower_s + 1e-12)
    found = optimize.lsq_linear(rows, aim, (problem.lower_s, high), method="bvls", tol=1e-15, max_iter=10_000)
    return 2 * float(found.cost)


@pytest.mark.full
@settings(max_examples=300, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    rho=st.sampled_from([0.0, 1e-10, 1e-8, 1e-6, 1e-3, 0.3]),
    upper=st.booleans(),
    weighted=st.booleans(),
    off=st.sampled_from([0.0, 1e-6, 1e-3, 1.0]),
    ended=st.booleans(),
)
def test_no_dwell_is_better_by_more_than_is_proved(
    seed: int, rho: float, upper: bool, weighted: bool, off: float, ended: bool
) -> None:
    rng = np.random.default_rng(seed)
    problem = small(rng, rho, upper=upper, price=0.0, weighted=weighted)
    near = solve(problem, 0.05, 1e-9).time_s
    time_s = np.clip(near + off * rng.standard_normal(near.size), problem.lower_s, problem.upper_s)
    f = quadratic(problem)
    gap = smallest_gap(problem, f, time_s, 1e-9, always if ended else never)
    value = f.value(time_s)
    assert value - least(problem) <= gap + 1e-10 * max(value, 1e-3)


@pytest.mark.full
@settings(max_examples=200, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), rho=st.sampled_from([1e-8, 1e-6, 0.1]), price=st.sampled_from([0.01, 1.0]))
def test_nor_is_any_dwell_at_random_where_time_has_a_price(seed: int, rho: float, price: float) -> None:
    rng = np.random.default_rng(seed)
    problem = small(rng, rho, upper=False, price=price, weighted=True)
    f = quadratic(problem)
    time_s = solve(problem, 0.05, 1e-6).time_s * 1.1
    proof = f.value(time_s) - smallest_gap(problem, f, time_s, 1e-9, never)
    others = [problem.lower_s + size * rng.random((20, f.n)) for size in (0.01, 0.3, 1.0, 5.0)]
    others.append(np.maximum(time_s + 0.1 * rng.standard_normal((20, f.n)), problem.lower_s))
    assert min(f.value(other) for some in others for other in some) >= proof - 1e-10


@settings(max_examples=100, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), rho=st.sampled_from([0.0, 1e-6, 0.1]))
def test_any_tangent_is_a_bound_even_beyond_the_bounds(seed: int, rho: float) -> None:
    rng = np.random.default_rng(seed)
    problem = small(rng, rho, upper=True, price=0.0, weighted=False)
    f = quadratic(problem)
    reach = LowerBound.of(problem, f, f.value(problem.lower_s))
    at_s = 5 * rng.standard_normal(f.n)
    exact = least(problem)
    assert reach.least(at_s, *f.at(at_s), problem.regularisation) <= exact + 1e-10 * max(exact, 1.0)


@pytest.mark.parametrize("rho", [1e-6, pytest.param(1e-8, marks=pytest.mark.full)])
def test_with_next_to_no_regularisation_it_proves_much_more_than_the_tangent_at_the_dwell(rho: float) -> None:
    problem = dwell_problem(radius_mm=14, rho=rho)
    found = solve(problem, 60.0, 1e-5)
    sharper = prove_lower_bound(problem, found, 1e-5, 60.0)
    before, after = found.certificate, sharper.certificate
    assert before.gap is not None
    assert after.gap is not None
    assert before.gap > 1e-2
    assert after.gap < 0.1 * before.gap
    assert after.gap_nm == pytest.approx(after.gap * before.objective**0.5 / 2, rel=0.02)
    np.testing.assert_array_equal(sharper.time_s, found.time_s)


def test_without_any_bound_or_regularisation_something_is_proved() -> None:
    """The tangent alone proves nothing there: what is removed in all holds the dwell."""
    problem = dwell_problem(radius_mm=8, rho=0.0)
    problem = replace(problem, upper_s=np.full(problem.effect.n, np.inf))
    found = solve(problem, 60.0, 1e-6)
    assert largest_gap(problem, found.time_s) == np.inf
    assert found.certificate.gap is None
    gap = prove_lower_bound(problem, found, 1e-3, 60.0).certificate.gap
    assert gap is not None
    assert gap < 0.05


@pytest.mark.full
def test_a_dwell_that_is_far_off_is_said_to_be() -> None:
    """By no more than what it has: no objective is below 0, which the tangent at the dwell does not know."""
    problem = dwell_problem(radius_mm=10, rho=1e-6)
    f, best = quadratic(problem), solve(problem, 60.0, 1e-9)
    far: FloatArray = np.clip(1.05 * best.time_s, problem.lower_s, problem.upper_s)
    true = f.value(far) - f.value(best.time_s)
    found = certify_dwell(problem, far, solver="hand", iterations=0, seconds=0.0, stopped="")
    gap = prove_lower_bound(problem, found, 1e-5, 60.0).certificate.gap
    assert gap is not None
    assert true <= gap * found.certificate.objective <= found.certificate.objective


def test_what_is_proved_already_is_given_back() -> None:
    problem = dwell_problem(radius_mm=8, rho=1e-2)
    found = solve(problem, 60.0, 1e-8)
    assert prove_lower_bound(problem, found, 1e-4, 60.0) is found
