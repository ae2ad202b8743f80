"""The splitting solver against solvers that share no code with it, and what must hold whenever it is stopped."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from polishd.model.dwell import DwellSolution
from polishd.model.errors import ComputeError
from polishd.process.dwell import douglas_rachford, newton_cg
from polishd.process.dwell.douglas_rachford import solve, start_splitting
from polishd.process.dwell.problem import DwellProblem
from polishd.process.dwell.quadratic import quadratic
from polishd.process.removal.convolution import ConvolutionEffect
from tests.unit.process.gaussian import dwell_problem
from tests.unit.process.lattices import as_matrix, lattice_problem, plant


@pytest.fixture(scope="module")
def problem() -> DwellProblem:
    return lattice_problem()


@pytest.fixture(scope="module")
def best(problem: DwellProblem) -> DwellSolution:
    """Return the solution by projected Newton steps on the written-out matrix."""
    return newton_cg.solve(as_matrix(problem), 60.0, 1e-10)


def test_the_problem_is_a_dynamic_one_with_bounds_that_hold(problem: DwellProblem, best: DwellSolution) -> None:
    assert isinstance(problem.effect, ConvolutionEffect)
    assert problem.effect.rank >= 3
    assert best.certificate.at_lower > 20
    assert best.certificate.kkt_residual < 1e-9


def test_it_comes_to_the_same_minimum(problem: DwellProblem, best: DwellSolution) -> None:
    found = solve(problem, 60.0, 1e-7)
    c = found.certificate
    assert (c.solver, c.stopped) == ("douglas_rachford", "converged")
    assert c.kkt_residual <= 1e-7
    assert c.bound_violation_s == 0.0
    assert c.objective == pytest.approx(best.certificate.objective, rel=1e-8)
    np.testing.assert_allclose(found.time_s, best.time_s, atol=1e-3 * best.time_s.max())
    assert c.predicted_rms_nm == pytest.approx(best.certificate.predicted_rms_nm, rel=1e-4)


@pytest.mark.full
def test_float64_takes_over_where_float32_has_no_digits(problem: DwellProblem, best: DwellSolution) -> None:
    found = solve(problem, 60.0, 1e-11)
    assert found.certificate.kkt_residual <= 1e-11
    assert found.state["w"].dtype == np.float64
    assert found.certificate.objective == pytest.approx(best.certificate.objective, rel=1e-10)


@pytest.mark.one_of_each
@pytest.mark.parametrize(
    "changes",
    [
        {"lower_s": 0.02, "upper_s": 0.35},
        {"price_nm2_per_s": 2.0},
        {"weight": "ramp"},
        {"regularisation": 0.0},
        {"weight": "ramp", "price_nm2_per_s": 0.5, "lower_s": 0.01},
    ],
    ids=["bounds", "price", "weights", "no P", "all"],
)
def test_bounds_price_and_weights_are_those_of_the_problem(problem: DwellProblem, changes: dict[str, object]) -> None:
    values = dict(changes)
    n, shape = problem.effect.n, problem.effect.grid.shape
    for name in ("lower_s", "upper_s"):
        if name in values:
            values[name] = np.full(n, values[name])
    if "weight" in values:
        values["weight"] = np.broadcast_to(np.linspace(0.1, 3.0, shape[1]), shape)
    changed = replace(problem, **values)  # type: ignore[arg-type]
    tolerance = 1e-7 if changed.regularisation else 1e-5
    found, best = solve(changed, 60.0, tolerance), newton_cg.solve(as_matrix(changed), 4.0, 1e-9)
    assert found.certificate.kkt_residual <= tolerance
    assert found.certificate.bound_violation_s == 0.0
    # without P the objective is flat: how far the other solver comes in its four seconds goes with the processor
    close = 1e-7 if changed.regularisation else 5e-4
    assert found.certificate.objective == pytest.approx(best.certificate.objective, rel=close)


def test_a_dwell_bound_to_points_stays_where_it_was_put(problem: DwellProblem) -> None:
    lower = np.linspace(0.0, 0.2, problem.effect.n)
    pinned = replace(problem, lower_s=lower, upper_s=lower + 1e-3)
    found = solve(pinned, 60.0, 1e-6).time_s
    assert (found >= lower).all()
    assert (found <= lower + 1e-3).all()


def test_the_plant_is_met_as_well_as_the_truncation_allows(problem: DwellProblem) -> None:
    """The exact dynamic TIF, not a static one: what really acts leaves what the certificate predicts."""
    fine = lattice_problem(tolerance=1e-4)
    found = solve(fine, 60.0)
    residual = (fine.target_nm - plant(fine).removal_nm(found.time_s))[fine.metric_mask]
    assert residual.std() == pytest.approx(found.certificate.predicted_rms_nm, rel=0.02)


@pytest.mark.full
def test_a_warm_start_takes_a_fifth_of_the_iterations(problem: DwellProblem) -> None:
    """From the splitting's state, after gamma moved by 1 %."""
    assert isinstance(problem.effect, ConvolutionEffect)
    last = solve(problem, 60.0, 1e-6)
    drift = 1 + 0.01 * np.sin(np.arange(problem.effect.n) / 40)[:, None]
    moved = replace(problem, effect=replace(problem.effect, coefficients=problem.effect.coefficients * drift))
    goal = newton_cg.solve(as_matrix(moved), 60.0, 1e-10).certificate.objective * (1 + 1e-6)
    cold, warm, dwell_only = (
        iterations_to(goal, replace(moved, warm=start)) for start in (None, last, replace(last, state={}))
    )
    assert warm <= cold / 5
    assert warm < dwell_only <= cold


def iterations_to(goal: float, problem: DwellProblem) -> int:
    work, f = start_splitting(problem, problem.effect), quadratic(problem)  # type: ignore[arg-type]
    for count in range(1, 2000):
        work.iterate()
        if f.value(np.clip(work.time_s, problem.lower_s, problem.upper_s)) <= goal:
            return count
    raise AssertionError("never came there")


def test_a_state_of_another_problem_is_not_taken(problem: DwellProblem) -> None:
    other = solve(lattice_problem(radius_mm=9.0), 60.0, 1e-4)
    found = solve(replace(problem, warm=other), 60.0, 1e-6)
    assert found.certificate.stopped == "converged"


def test_when_time_is_up_the_dwell_is_feasible_and_says_how_good_it_is(problem: DwellProblem) -> None:
    found = solve(problem, 0.0, 1e-9)
    assert found.certificate.stopped == "deadline"
    assert found.certificate.bound_violation_s == 0.0
    assert 1e-9 < found.certificate.kkt_residual < 1.5
    np.testing.assert_allclose(found.removal_nm, problem.effect.removal_nm(found.time_s))


def test_an_iteration_cap_is_an_honest_end(problem: DwellProblem, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(douglas_rachford, "MAX_ITERATIONS", 7)
    found = solve(problem, 60.0, 1e-12)
    assert (found.certificate.stopped, found.certificate.iterations) == ("iterations", 7)


def test_it_needs_convolutions() -> None:
    with pytest.raises(ComputeError, match="use newton_cg"):
        solve(dwell_problem(radius_mm=8), 1.0)


def test_a_malformed_problem_is_refused(problem: DwellProblem) -> None:
    with pytest.raises(ComputeError, match="lower_s is above upper_s"):
        solve(replace(problem, upper_s=problem.lower_s - 1), 1.0)
    nan = np.where(problem.solve_mask, np.nan, 0.0)
    with pytest.raises(ComputeError, match="target_nm is not finite"):
        solve(replace(problem, target_nm=nan), 1.0)
