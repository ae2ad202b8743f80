"""The default solver against solvers that share no code with it, and what must hold for any problem."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import optimize, sparse

from polishd.model.errors import ComputeError
from polishd.model.surface import FloatArray, Grid
from polishd.process.dwell import newton_cg
from polishd.process.dwell.certificate import certify_dwell
from polishd.process.dwell.problem import DwellProblem
from polishd.process.dwell.quadratic import projected_gradient, quadratic
from polishd.process.removal.effect import SparseEffect
from tests.unit.process.gaussian import dwell_problem


def least_squares(problem: DwellProblem) -> tuple[FloatArray, FloatArray]:
    """The problem as ``|A t - b|^2``: regularization as further rows."""
    m = np.count_nonzero(problem.solve_mask)
    rows = problem.effect.matrix.toarray()[problem.solve_mask.ravel()] / np.sqrt(m)
    n = rows.shape[1]
    a = np.vstack([rows, np.sqrt(problem.regularisation) * np.eye(n)])
    return a, np.concatenate([problem.target_nm[problem.solve_mask] / np.sqrt(m), np.zeros(n)])


def small_problem(seed: int, n: int = 12, p: float = 0.01) -> DwellProblem:
    """Random non-negative effect on a 6 x 5 grid, a tenth of it masked; bounds of all kinds."""
    rng = np.random.default_rng(seed)
    grid = Grid(6, 5, 1.0)
    matrix = sparse.csr_array(rng.random((30, n)) * (rng.random((30, n)) < 0.6))
    mask = rng.random(grid.shape) < 0.9
    lower = rng.random(n) * 0.3
    upper = lower + rng.choice([0.0, 0.2, 2.0, np.inf], n)
    return DwellProblem(SparseEffect(grid, matrix), 5 * rng.random(grid.shape), mask, mask, lower, upper, p)


def test_agrees_with_nnls() -> None:
    problem = dwell_problem(radius_mm=6)
    problem = replace(problem, lower_s=0 * problem.lower_s, upper_s=np.full(problem.effect.n, np.inf))
    a, b = least_squares(problem)
    _, norm = optimize.nnls(a, b)
    ours = newton_cg.solve(problem, 10, 1e-10).certificate
    assert ours.stopped == "converged"
    assert ours.objective == pytest.approx(norm**2, rel=1e-8)
    assert 0 < ours.at_lower < problem.effect.n  # else the bound was not tried


def test_agrees_with_lsq_linear_between_bounds() -> None:
    problem = dwell_problem(radius_mm=6)
    problem = replace(problem, upper_s=np.maximum(problem.lower_s, 0.15))
    a, b = least_squares(problem)
    apart = problem.upper_s - problem.lower_s
    theirs = optimize.lsq_linear(a, b, (problem.lower_s, problem.upper_s + 1e-15), tol=1e-14, method="bvls")
    ours = newton_cg.solve(problem, 10, 1e-10).certificate
    assert ours.objective == pytest.approx(2 * theirs.cost, rel=1e-8)
    assert min(ours.at_lower, ours.at_upper) > np.count_nonzero(apart == 0)


@settings(max_examples=60)
@given(st.integers(0, 10**6), st.sampled_from([0.0, 1e-4, 0.1]))
def test_agrees_with_lsq_linear_on_any_small_problem(seed: int, p: float) -> None:
    problem = small_problem(seed, p=p)
    a, b = least_squares(problem)
    fixed = problem.lower_s == problem.upper_s
    theirs = optimize.lsq_linear(
        a[:, ~fixed], b - a[:, fixed] @ problem.lower_s[fixed], (problem.lower_s[~fixed], problem.upper_s[~fixed]),
        tol=1e-13, method="bvls",
    )  # fmt: skip
    solution = newton_cg.solve(problem, 10, 1e-11)
    assert solution.certificate.objective <= 2 * theirs.cost * (1 + 1e-8) + 1e-14
    assert (solution.time_s >= problem.lower_s).all()
    assert (solution.time_s <= problem.upper_s).all()
    assert solution.certificate.bound_violation_s == 0


@settings(max_examples=25)
@given(st.integers(0, 10**6), st.floats(1e-3, 1e3))
def test_scaling_map_and_bounds_scales_the_dwell(seed: int, factor: float) -> None:
    problem = small_problem(seed)
    scaled = replace(
        problem,
        target_nm=factor * problem.target_nm,
        lower_s=factor * problem.lower_s,
        upper_s=factor * problem.upper_s,
    )
    once, more = newton_cg.solve(problem, 10, 1e-12).time_s, newton_cg.solve(scaled, 10, 1e-12).time_s
    assert more == pytest.approx(factor * once, rel=1e-6, abs=1e-7 * factor)


@settings(max_examples=25)
@given(st.integers(0, 10**6), st.integers(0, 10**6))
def test_the_order_of_the_points_does_not_matter(seed: int, shuffle: int) -> None:
    problem = small_problem(seed)
    order = np.random.default_rng(shuffle).permutation(problem.effect.n)
    other = replace(
        problem,
        effect=SparseEffect(problem.effect.grid, sparse.csr_array(problem.effect.matrix[:, order])),
        lower_s=problem.lower_s[order],
        upper_s=problem.upper_s[order],
    )
    once = newton_cg.solve(problem, 10, 1e-12).time_s
    assert newton_cg.solve(other, 10, 1e-12).time_s == pytest.approx(once[order], rel=1e-6, abs=1e-7)


@pytest.mark.full
def test_a_problem_of_the_demo_size_is_solved_with_bounds_that_bind() -> None:
    problem = dwell_problem(radius_mm=50)
    assert problem.effect.n > 7900
    solution = newton_cg.solve(problem, 30)
    certificate = solution.certificate
    assert certificate.stopped == "converged"
    assert certificate.kkt_residual <= 1e-5
    assert certificate.at_lower > 50
    assert certificate.predicted_rms_nm < 2
    assert certificate.seconds < 10  # of CPU time; 0.1 and more


def test_no_other_feasible_dwell_is_better() -> None:
    problem = dwell_problem(radius_mm=10)
    solution = newton_cg.solve(problem, 10, 1e-9)
    f = quadratic(problem)
    rng = np.random.default_rng(3)
    for size in (1e-4, 1e-2, 1.0):
        other = np.clip(
            solution.time_s * (1 + size * rng.standard_normal(problem.effect.n)), problem.lower_s, problem.upper_s
        )
        assert f.value(other) >= solution.certificate.objective


def test_solving_with_the_bound_beats_clipping_to_it() -> None:
    problem = dwell_problem(radius_mm=12, feed_mm_s=15)
    free = replace(problem, lower_s=0 * problem.lower_s)
    clipped = np.clip(newton_cg.solve(free, 10).time_s, problem.lower_s, problem.upper_s)
    assert newton_cg.solve(problem, 10).certificate.objective < 0.9 * quadratic(problem).value(clipped)


def test_out_of_time_it_gives_a_feasible_dwell_and_says_so() -> None:
    problem = dwell_problem(radius_mm=30)
    solution = newton_cg.solve(problem, 0.0)
    certificate = solution.certificate
    assert (certificate.stopped, certificate.iterations) == ("deadline", 0)
    assert certificate.kkt_residual > 1e-3
    np.testing.assert_array_equal(solution.time_s, problem.lower_s)


def test_a_deadline_in_the_middle_of_a_round_ends_it_at_once() -> None:
    problem = dwell_problem(radius_mm=30)
    f = quadratic(problem)
    asked = 0

    def expired() -> bool:
        nonlocal asked
        asked += 1
        return asked >= 3

    def stop(t: FloatArray, gradient: FloatArray) -> str | None:
        return "deadline" if asked >= 3 else None

    bounds = (problem.lower_s, problem.upper_s)
    t, _, stopped = newton_cg.minimise(f, bounds, problem.lower_s, stop, expired)
    assert (stopped, asked) == ("deadline", 3)
    assert f.value(t) < 0.5 * f.value(problem.lower_s)


def test_the_objective_never_rises() -> None:
    problem = dwell_problem(radius_mm=20)
    f = quadratic(problem)
    seen: list[float] = []

    def stop(t: FloatArray, gradient: FloatArray) -> str | None:
        seen.append(f.value(t))
        np.testing.assert_allclose(gradient, f.gradient(t), rtol=1e-6, atol=1e-9 * np.abs(gradient).max() + 1e-9)
        return "enough" if len(seen) == 12 else None

    newton_cg.minimise(f, (problem.lower_s, problem.upper_s), problem.upper_s, stop)
    assert (np.diff(seen) <= 1e-12 * seen[0]).all()
    assert seen[-1] < 1e-2 * seen[0]


@pytest.mark.parametrize(("share", "price", "most"), [(0.01, 0.0, 4500), (1.0, 0.5, 1100)])
def test_points_that_meet_their_bounds_cost_few_products(share: float, price: float, most: int) -> None:
    problem = dwell_problem(radius_mm=20)
    problem = replace(problem, regularisation=share * problem.regularisation, price_nm2_per_s=price)
    f, bounds = quadratic(problem), (problem.lower_s, problem.upper_s)
    enough = 1e-5 * np.abs(f.gradient(problem.lower_s)).max()
    products = 0

    def forward(time_s: FloatArray) -> FloatArray:
        nonlocal products
        products += 1
        return f.forward(time_s)

    def stop(t: FloatArray, gradient: FloatArray) -> str | None:
        left = projected_gradient(gradient, t, *bounds, f.safe_step)
        return "converged" if np.abs(left).max() <= enough else None

    counted = replace(f, forward=forward, gram=None)
    t, _, stopped = newton_cg.minimise(counted, bounds, problem.lower_s, stop)
    assert stopped == "converged"
    assert np.count_nonzero(t == problem.lower_s) > 10
    assert products < most  # with each round's conjugate gradients taken to their tolerance 19,270 and 1,571


def test_a_warm_start_needs_fewer_rounds() -> None:
    problem = dwell_problem(radius_mm=20)
    cold = newton_cg.solve(problem, 10)
    later = replace(problem, target_nm=problem.target_nm * 1.001)
    warm = newton_cg.solve(later, 10, start_s=cold.time_s)
    assert warm.certificate.iterations < newton_cg.solve(later, 10).certificate.iterations
    assert warm.certificate.kkt_residual <= 1e-5


@pytest.mark.parametrize("start", [np.zeros(3), np.full(500, np.nan)])
def test_a_start_that_does_not_fit_is_refused(start: FloatArray) -> None:
    with pytest.raises(ComputeError, match="start_s must be"):
        newton_cg.solve(dwell_problem(radius_mm=6), 1, start_s=start)


@dataclass(frozen=True)
class Opaque:
    """An effect that is no matrix."""

    inner: SparseEffect

    @property
    def grid(self) -> Grid:
        return self.inner.grid

    @property
    def n(self) -> int:
        return self.inner.n

    def removal_nm(self, time_s: FloatArray) -> FloatArray:
        return self.inner.removal_nm(time_s)

    def adjoint(self, weight: FloatArray) -> FloatArray:
        return self.inner.adjoint(weight)


def test_an_effect_that_is_no_matrix_gives_the_same_dwell() -> None:
    problem = dwell_problem(radius_mm=10)
    opaque = newton_cg.solve(replace(problem, effect=Opaque(problem.effect)), 10, 1e-9)
    assert opaque.time_s == pytest.approx(newton_cg.solve(problem, 10, 1e-9).time_s, abs=1e-6)
    assert opaque.certificate.kkt_residual <= 1e-9


def test_weights_and_price_enter_as_written() -> None:
    problem = dwell_problem(radius_mm=8)
    rng = np.random.default_rng(3)
    weight = rng.uniform(0.2, 3.0, problem.solve_mask.shape)
    priced = replace(problem, weight=weight, price_nm2_per_s=0.3, band_period_mm=8.0)
    solution = newton_cg.solve(priced, 30.0, 1e-9)
    t, mask = solution.time_s, problem.solve_mask
    miss = (problem.effect.removal_nm(t) - problem.target_nm)[mask]
    written = float(weight[mask] @ miss**2) / mask.sum() + problem.regularisation * float(t @ t) + 0.3 * float(t.sum())
    assert solution.certificate.objective == pytest.approx(written, rel=1e-12)
    for _ in range(20):  # no feasible dwell nearby is better
        near = np.clip(t + 1e-3 * rng.standard_normal(t.size), problem.lower_s, problem.upper_s)
        assert (
            certify_dwell(priced, near, solver="x", iterations=0, seconds=0, stopped="x").certificate.objective
            > written
        )
    assert solution.certificate.predicted_band_rms_nm is not None
    assert 0 < solution.certificate.predicted_band_rms_nm < solution.certificate.predicted_rms_nm


def test_a_higher_price_buys_less_time_and_leaves_more() -> None:
    problem = dwell_problem(radius_mm=8)
    found = [
        newton_cg.solve(replace(problem, price_nm2_per_s=price), 30.0, 1e-8).certificate
        for price in (0.0, 0.1, 1.0, 10.0)
    ]
    totals, misses = [c.dwell_total_s for c in found], [c.objective for c in found]
    assert totals == sorted(totals, reverse=True)
    assert totals[0] > 1.05 * totals[-1]
    assert misses == sorted(misses)


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"price_nm2_per_s": -1.0}, "price of time"),
        ({"price_nm2_per_s": np.nan}, "price of time"),
        ({"weight": np.ones((2, 2))}, "weight is"),
        ({"weight": np.zeros((26, 26))}, "above 0 somewhere"),
        ({"weight": np.full((26, 26), -1.0)}, "not negative"),
        ({"weight": np.full((26, 26), np.inf)}, "finite"),
    ],
)
def test_impossible_weights_and_prices_are_refused(changes: dict[str, object], says: str) -> None:
    with pytest.raises(ComputeError, match=says):
        newton_cg.solve(replace(dwell_problem(radius_mm=8), **changes), 1.0)
