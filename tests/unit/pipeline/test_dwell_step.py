"""The dwell step's rim, extension and reach: what the solver is given where the map ends before the part."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from polishd.hookspecs import DwellSolver, RemovalAnswer, RemovalModel, RemovalRequest
from polishd.model.dwell import DwellSolution
from polishd.model.errors import ComputeError, PlanRefused
from polishd.model.tolerance import ToleranceLine
from polishd.pipeline import dwell_step, precheck, steps
from polishd.pipeline.dwell_step import EXTENDED_WEIGHT
from polishd.pipeline.recipe import Recipe
from polishd.pipeline.records import MeasureResult
from polishd.process.dwell import newton_cg
from polishd.process.dwell.problem import DwellProblem
from polishd.process.removal.transfer_function import SpotTransferFunction
from tests.unit.daemon.small_job import (
    APERTURE_MM,
    gaussian_effect,
    pointwise_effect,
    small_map,
    small_program,
    small_recipe,
)


def short_sighted(recipe: Recipe, lost_mm: float) -> MeasureResult:
    """A measurement whose map ends so far before the part's rim."""
    surface = small_map()
    seen = surface.grid.radius_mm() <= APERTURE_MM / 2 - lost_mm
    return steps.condition(recipe, surface.with_height(np.where(seen, surface.height_nm, np.nan)))


def asked(recipe: Recipe, measured: MeasureResult) -> DwellProblem:
    """The problem that the recipe's solver is given first."""
    given: list[DwellProblem] = []

    def solve(problem: DwellProblem, within_s: float) -> DwellSolution:
        given.append(problem)
        return newton_cg.solve(problem, within_s)

    dwell_step.solve(replace(recipe, solver=DwellSolver("seen", solve)), small_program(), measured)
    return given[0]


@pytest.mark.one_of_each
@pytest.mark.parametrize("method", ["nearest", "c1", "gerchberg_papoulis"])
def test_a_rim_without_data_is_extended_at_a_small_weight(method: str) -> None:
    recipe = small_recipe(extension=method)
    measured = short_sighted(recipe, 1.0)
    problem = asked(recipe, measured)
    part = measured.grid.radius_mm() <= APERTURE_MM / 2
    assert not measured.solve_mask[part].all()
    assert problem.solve_mask[part].all()
    assert not problem.solve_mask[~part & ~measured.solve_mask].any(), "beyond the part nothing is asked for"
    assert problem.weight is not None
    np.testing.assert_array_equal(problem.weight[measured.solve_mask], 1.0)
    np.testing.assert_array_equal(problem.weight[problem.solve_mask & ~measured.solve_mask], EXTENDED_WEIGHT)
    kept = problem.target_nm - measured.height_nm
    np.testing.assert_allclose(kept[measured.solve_mask], kept[measured.solve_mask][0])
    assert (problem.metric_mask == measured.metric_mask).all(), "figures are of data only"


def test_the_extended_rim_is_nearer_to_the_truth() -> None:
    truth = steps.condition(small_recipe(), small_map())
    left = {}
    for method in ("none", "c1"):
        recipe = small_recipe(extension=method)
        measured = short_sighted(recipe, 1.0)
        found = dwell_step.solve(recipe, small_program(), measured)
        rim = truth.solve_mask & ~measured.solve_mask
        after = truth.height_nm - found.answer.removal_nm(found.dwell.time_s)
        left[method] = float((after[rim] - after[measured.metric_mask].mean()).std())
    assert left["c1"] < left["none"]


@pytest.mark.parametrize(("method", "lost_mm"), [("none", 1.0), ("c1", 0.0)])
def test_nothing_is_extended_unasked_or_where_the_data_reach_the_rim(method: str, lost_mm: float) -> None:
    recipe = small_recipe(extension=method)
    measured = short_sighted(recipe, lost_mm)
    problem = asked(recipe, measured)
    assert problem.weight is None
    assert (problem.solve_mask == measured.solve_mask).all()


def test_a_free_rim_reaches_the_removal_model() -> None:
    seen: list[RemovalRequest] = []

    def ask(request: RemovalRequest) -> RemovalAnswer:
        seen.append(request)
        return gaussian_effect(request)

    for free in (False, True):
        recipe = small_recipe(model=RemovalModel("asked", ask), free_edge=free)
        steps.effect_of(recipe, small_program(), steps.process_grid(recipe))
    ring, rim = (request.rim for request in seen)
    assert ring is None
    assert rim is not None
    np.testing.assert_allclose(rim.inside_mm(np.array([0.0, APERTURE_MM / 2 + 1]), np.zeros(2)), [12.0, -1.0])


def test_the_certificate_states_what_the_shortest_times_remove() -> None:
    recipe = small_recipe()
    measured = steps.condition(recipe, small_map())
    found = dwell_step.solve(recipe, small_program(), measured)
    removal = found.answer.removal_nm(found.dwell.lower_s)
    assert found.dwell.certificate.floor_nm == pytest.approx(removal[measured.metric_mask].mean())
    slow = replace(recipe, envelope=replace(recipe.envelope, least_point_s=float(found.dwell.time_s.max())))
    floored = dwell_step.solve(slow, small_program(), measured).dwell.certificate
    assert floored.floor_nm is not None
    assert any(f"the shortest times of the machine remove {floored.floor_nm:.3g} nm" in note for note in floored.notes)


def test_the_certificate_names_the_feed_that_limits_the_longest_times() -> None:
    recipe = small_recipe()
    measured = steps.condition(recipe, small_map())
    free = dwell_step.solve(recipe, small_program(), measured).dwell
    assert not any("longest time" in note for note in free.certificate.notes)
    moves = small_program()
    feed_mm_s = float(np.median(moves.length_mm / free.time_s))
    fast = replace(recipe, envelope=replace(recipe.envelope, min_feed_mm_s=feed_mm_s))
    notes = dwell_step.solve(fast, moves, measured).dwell.certificate.notes
    (note,) = (note for note in notes if "longest time" in note)
    assert f"by the smallest feed, {feed_mm_s:g} mm/s (machine.min_feed_mm_s): the result is limited by it" in note
    assert note.startswith(tuple(f"{share}% of the points of {moves.name} " for share in range(11, 101)))


def test_the_certificate_says_what_is_out_of_reach() -> None:
    def short(request: RemovalRequest) -> RemovalAnswer:
        return replace(
            gaussian_effect(request), transfer=SpotTransferFunction(np.zeros(1), np.ones(1), 0.05, 5.0, None)
        )

    lines = (
        ToleranceLine("rms", 0.5),
        ToleranceLine("rms", 500.0),
        ToleranceLine("pv", 1.0),
        ToleranceLine("rms", 0.5, above_mm=8.0),
    )
    recipe = small_recipe(model=RemovalModel("short", short), tolerance_nm=None, tolerance=lines)
    measured = steps.condition(recipe, small_map())
    note, *unreachable = dwell_step.solve(recipe, small_program(), measured).dwell.certificate.notes
    assert "nm RMS of the surface has periods below 5.00 mm" in note
    assert [re.split(r" [\d.]+ nm of ", line)[0] for line in unreachable] == ["that alone has RMS", "that alone has PV"]
    assert "nm allowed: this spot cannot bring the part into tolerance" in unreachable[0]
    plain = dwell_step.solve(small_recipe(), small_program(), measured)
    assert plain.dwell.certificate.notes == ()


@pytest.mark.full
def test_a_time_budget_is_kept_and_costs_residual() -> None:
    measured = steps.condition(small_recipe(), small_map())
    free = dwell_step.solve(small_recipe(), small_program(), measured).dwell.certificate
    budget = 0.8 * free.dwell_total_s
    kept = dwell_step.solve(small_recipe(objective="budget", budget_s=budget), small_program(), measured)
    c = kept.dwell.certificate
    assert 0.95 * budget < c.dwell_total_s <= budget * 1.0001
    assert c.predicted_rms_nm > free.predicted_rms_nm
    assert c.kkt_residual <= 1e-4
    limits = f"the dwell takes all of dwell.budget_s = {budget:g} s: the result is limited by it"
    assert (limits in c.notes, limits in free.notes) == (True, False)


def test_a_budget_below_what_motion_takes_is_refused_with_both_numbers() -> None:
    measured = steps.condition(small_recipe(), small_map())
    with pytest.raises(ComputeError, match=r"0\.5 s"):
        dwell_step.solve(small_recipe(objective="budget", budget_s=0.5), small_program(), measured)


@pytest.mark.full
def test_a_curve_comes_with_the_plan_if_asked_for() -> None:
    measured = steps.condition(small_recipe(), small_map())
    solved = dwell_step.solve(small_recipe(curve=True), small_program(), measured)
    totals, left = ([row[key] for row in solved.curve] for key in ("total_s", "rms_nm"))
    assert totals == sorted(totals)
    assert left[-1] < 0.5 * left[0]
    assert left[-1] == pytest.approx(solved.dwell.certificate.predicted_rms_nm, rel=0.05)
    assert dwell_step.solve(small_recipe(), small_program(), measured).curve == ()


@pytest.mark.full
def test_a_target_is_met_in_the_least_time() -> None:
    measured = steps.condition(small_recipe(), small_map())
    free = dwell_step.solve(small_recipe(), small_program(), measured).dwell.certificate
    aim = 1.5 * free.predicted_rms_nm
    c = dwell_step.solve(small_recipe(objective="target", target_nm=aim), small_program(), measured).dwell.certificate
    assert 0.95 * aim < c.predicted_rms_nm <= aim * 1.001
    assert c.dwell_total_s < free.dwell_total_s


@pytest.mark.full
def test_the_knee_is_a_point_of_the_curve() -> None:
    measured = steps.condition(small_recipe(), small_map())
    found = dwell_step.solve(small_recipe(objective="knee", curve=True), small_program(), measured)
    product = found.dwell.certificate.dwell_total_s * found.dwell.certificate.predicted_rms_nm
    longest = max(found.curve, key=lambda row: row["total_s"])
    assert product <= longest["total_s"] * longest["rms_nm"] * 1.01


# what takes longer than a pass may


def never(problem: DwellProblem, within_s: float) -> DwellSolution:
    raise AssertionError("solved")


def limited(max_pass_s: float, **changes: Any) -> Recipe:
    recipe = small_recipe(solver=DwellSolver("never", never), **changes)
    return replace(recipe, envelope=replace(recipe.envelope, max_pass_s=max_pass_s))


@pytest.mark.parametrize("model", [gaussian_effect, pointwise_effect])
def test_a_removal_that_takes_too_long_is_refused_before_it_is_solved(
    model: Callable[[RemovalRequest], RemovalAnswer],
) -> None:
    kind = RemovalModel("m", model)
    program, measured = small_program(), steps.condition(small_recipe(), small_map(rms_nm=200.0))
    solved = dwell_step.solve(small_recipe(model=kind), program, measured)
    takes = float(solved.expected_s.sum())
    with pytest.raises(
        PlanRefused, match=r"at least \d+ s, more than limits\.max_pass_s = .* set it to \d+ or more"
    ) as said:
        dwell_step.solve(limited(0.5 * takes, model=kind), program, measured)
    least = float(re.findall(r"at least (\d+) s", str(said.value))[0])
    assert 0.5 * takes < least < takes, "a lower bound, and not a poor one"
    with pytest.raises(AssertionError, match="solved"):
        dwell_step.solve(limited(takes, model=kind), program, measured)


def test_a_budget_may_take_less_than_all_of_the_removal() -> None:
    measured = steps.condition(small_recipe(), small_map(rms_nm=200.0))
    answer = steps.effect_of(small_recipe(), small_program(), measured.grid)
    least = precheck.removal_time_s(measured, answer, np.zeros(small_program().n))
    with pytest.raises(AssertionError, match="solved"):
        dwell_step.solve(limited(0.5 * least, objective="knee"), small_program(), measured)


def test_a_path_that_takes_too_long_is_refused_before_anything_is_computed() -> None:
    measured = steps.condition(small_recipe(), small_map())
    with pytest.raises(
        PlanRefused, match=r"small.rnc at the largest feed takes \d+ s, more than limits.max_pass_s = 3 s"
    ):
        dwell_step.solve(limited(3.0, model=RemovalModel("never", never)), small_program(), measured)


def test_the_change_of_feed_counts_as_much_as_the_acceleration_loses() -> None:
    """On a slow machine the feeds change less, and the delivered dwell is nearer to the planned one."""
    slow = replace(small_recipe().envelope, accel_mm_s2=20.0)
    found = {}
    for weight in (0.0, 1.0, 10.0):
        recipe = small_recipe(feed_change=weight, envelope=slow)
        measured = steps.condition(recipe, small_map())
        program = small_program()
        solved = dwell_step.solve(recipe, program, measured)
        slowness = solved.dwell.time_s / program.length_mm
        late = solved.answer.removal_nm(solved.expected_s - solved.dwell.time_s)[measured.metric_mask]
        found[weight] = float(np.abs(np.diff(slowness)).mean()), float(np.sqrt(np.mean(late**2)))
        noted = any("the change of feed between blocks counts" in note for note in solved.dwell.certificate.notes)
        assert noted == (weight > 0)
    assert found[10.0][0] < found[1.0][0] < found[0.0][0]
    assert found[10.0][1] < found[0.0][1]
