"""Time budgets, targets, and the cost of the dwell floor."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from polishd.model.dwell import DwellSolution
from polishd.model.errors import ComputeError
from polishd.process.dwell import interior_point, newton_cg
from polishd.process.dwell.problem import DwellProblem
from polishd.process.dwell.quadratic import quadratic
from polishd.process.dwell.residual_curve import floor_cost, possible_gain_nm, solve_to_target, solve_within_budget
from tests.unit.process.gaussian import dwell_problem

PROBLEM = dwell_problem(radius_mm=8, rho=1e-6, feed_mm_s=500)
solve = partial(interior_point.solve, within_s=30.0)
FREE = solve(PROBLEM).certificate
FLOOR_S = float(PROBLEM.lower_s.sum())


@pytest.mark.one_of_each
@pytest.mark.parametrize("share", [0.3, 0.6, 0.9, 0.99])
def test_the_budget_is_used_and_kept(share: float) -> None:
    budget = FLOOR_S + share * (FREE.dwell_total_s - FLOOR_S)
    found = solve_within_budget(PROBLEM, budget, solve)
    assert 0.999 * budget <= found.total_s <= budget
    c = found.solution.certificate
    assert c.kkt_residual <= 1e-8
    assert any("binds at" in note for note in c.notes)
    assert quadratic(PROBLEM).value(found.solution.time_s) > FREE.objective


def test_no_dwell_within_the_budget_is_better() -> None:
    budget = 0.8 * FREE.dwell_total_s
    found = solve_within_budget(PROBLEM, budget, solve)
    best = quadratic(PROBLEM).value(found.solution.time_s)
    rng = np.random.default_rng(1)
    for size in (1e-3, 1e-2, 0.1):
        other = np.clip(
            found.solution.time_s * (1 + size * rng.standard_normal(PROBLEM.effect.n)), PROBLEM.lower_s, None
        )
        extra = PROBLEM.lower_s + (other - PROBLEM.lower_s) * min(
            1.0, (found.total_s - FLOOR_S) / float((other - PROBLEM.lower_s).sum())
        )
        assert extra.sum() <= found.total_s * (1 + 1e-12)
        assert quadratic(PROBLEM).value(extra) > best
    scaled = solve(PROBLEM).time_s * budget / FREE.dwell_total_s  # the naive way: everything a little shorter
    assert quadratic(PROBLEM).value(np.maximum(scaled, PROBLEM.lower_s)) > 1.5 * best


@pytest.mark.full
@pytest.mark.parametrize("more", [1.0, 1.02, 1.3])
def test_what_any_dwell_within_a_budget_can_be_better_by_is_proved(more: float) -> None:
    """Of a dwell that leaves some of it unused, too: beside the least within all of it."""
    found = solve_within_budget(PROBLEM, 0.6 * FREE.dwell_total_s, solve)
    budget = more * found.total_s
    proof = possible_gain_nm(found, budget)
    assert proof is not None
    value = quadratic(PROBLEM).value
    least = solve_within_budget(PROBLEM, budget, solve, tolerance=1e-5).solution.time_s
    true = value(found.solution.time_s) ** 0.5 - value(least) ** 0.5
    assert true <= proof + 1e-9
    assert proof < (1e-4 if more == 1 else 3 * true)
    assert any("no dwell within it leaves" in note for note in found.solution.certificate.notes)


@pytest.mark.full
def test_more_budget_never_hurts() -> None:
    found = [solve_within_budget(PROBLEM, share * FREE.dwell_total_s, solve) for share in (0.5, 0.7, 0.9, 1.0, 1.5)]
    misses = [quadratic(PROBLEM).value(point.solution.time_s) for point in found]
    assert misses == sorted(misses, reverse=True)


def test_a_budget_that_does_not_bind_costs_one_solve() -> None:
    calls = 0

    def counted(problem: DwellProblem) -> DwellSolution:
        nonlocal calls
        calls += 1
        return solve(problem)

    found = solve_within_budget(PROBLEM, 1.1 * FREE.dwell_total_s, counted)
    assert calls == 1
    assert found.rms_nm == FREE.predicted_rms_nm
    assert any("does not bind" in note for note in found.solution.certificate.notes)
    solve_within_budget(PROBLEM, 0.8 * FREE.dwell_total_s, counted)
    assert calls < 20


def test_budgets_below_the_floor_are_refused_with_both_numbers() -> None:
    problem = replace(PROBLEM, lower_s=np.full(PROBLEM.effect.n, 0.5))
    floor = 0.5 * PROBLEM.effect.n
    with pytest.raises(ComputeError, match=rf"the budget is 7 s, but the dwell floor alone takes {floor:g} s"):
        solve_within_budget(problem, 7.0, solve)
    with pytest.raises(ComputeError, match="budget is nan s"):
        solve_within_budget(problem, float("nan"), solve)
    found = solve_within_budget(problem, floor * 1.0001, solve)  # and just above it is met
    assert floor <= found.total_s <= floor * 1.0001


def test_a_general_solver_keeps_a_budget_too() -> None:
    def general(problem: DwellProblem) -> DwellSolution:
        return newton_cg.solve(problem, 30.0, 1e-7, None if problem.warm is None else problem.warm.time_s)

    problem = dwell_problem(radius_mm=8)
    budget = 0.8 * general(problem).certificate.dwell_total_s
    found = solve_within_budget(problem, budget, general)
    assert 0.999 * budget <= found.total_s <= budget
    exact = solve_within_budget(problem, budget, solve)
    assert found.rms_nm == pytest.approx(exact.rms_nm, rel=2e-2)


@pytest.mark.full
@pytest.mark.parametrize("factor", [1.2, 3.0])
def test_a_target_is_met_and_not_overdone(factor: float) -> None:
    target = factor * FREE.predicted_rms_nm
    found = solve_to_target(PROBLEM, target, solve)
    assert 0.99 * target <= found.rms_nm <= target
    assert found.total_s <= FREE.dwell_total_s
    again = solve_within_budget(PROBLEM, 0.99 * found.total_s, solve)
    assert again.rms_nm > found.rms_nm


def test_a_target_out_of_reach_is_refused() -> None:
    with pytest.raises(ComputeError, match=r"is out of reach: the least is"):
        solve_to_target(PROBLEM, 0.9 * FREE.predicted_rms_nm, solve)


def test_what_the_floor_costs() -> None:
    problem = replace(PROBLEM, lower_s=np.full(PROBLEM.effect.n, 0.05))
    cost = floor_cost(problem, solve)
    row = json.loads(json.dumps(cost.row()))
    assert row["floor_s"] == pytest.approx(0.05 * problem.effect.n)
    assert row["at_floor"] > 0
    assert row["rms_cost"] == pytest.approx(row["rms_nm"] / row["free_rms_nm"] - 1)
    assert row["time_cost_s"] == pytest.approx(row["total_s"] - row["free_total_s"])
    assert (cost.free.solution.time_s >= 0).all()
    assert (cost.free.solution.time_s < 0.05).any()
    for point in (cost.bounded, cost.raised):
        assert (point.solution.time_s >= 0.05).all()
    free = quadratic(cost.free.problem)
    assert free.value(cost.bounded.solution.time_s) > free.value(cost.free.solution.time_s)
    dug = problem.effect.removal_nm(problem.lower_s)[problem.solve_mask].max()
    assert row["raised_by_nm"] == pytest.approx(dug)
    assert row["raised_total_s"] > row["total_s"]
    assert row["raised_rms_cost"] < row["rms_cost"]


def test_a_floor_of_zero_costs_nothing() -> None:
    row = floor_cost(replace(PROBLEM, lower_s=0 * PROBLEM.lower_s), solve).row()
    for key in ("rms_cost", "time_cost_s", "raised_by_nm", "raised_rms_cost"):
        assert row[key] == pytest.approx(0, abs=1e-9)
