"""Figures of a plan as an operator approves them: of the arrays of the plan, with each limit of the config."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from polishd.pipeline import dwell_step, steps
from polishd.pipeline.plan_figures import PlanFigures, plan_figures
from polishd.pipeline.records import MeasureResult, PlanResult, SolveResult
from polishd.plugins.plan_checks import DIGITS
from polishd.process.identification.findings import Forecast
from polishd.process.removal.ripple import Ripple, RippleLine
from tests.unit.daemon.small_job import at_rate, small_map, small_program, small_recipe

FORECAST = Forecast(0.5, 0.8, 1.4, 0.9, 0.99)
RIPPLE = Ripple((RippleLine("across", 1.2, 0.6, 0.4, 0.9, 0.0),))


@pytest.fixture(scope="module")
def measured() -> MeasureResult:
    return steps.condition(small_recipe(), small_map())


@pytest.fixture(scope="module")
def solved(measured: MeasureResult) -> SolveResult:
    return dwell_step.solve(small_recipe(), small_program(), measured, at_rate(0.9))


def figures_of(measured: MeasureResult, solved: SolveResult, forecast: Forecast | None) -> PlanFigures:
    plan = steps.rewrite(small_recipe(), small_program(), solved, "small.rnc")
    part = steps.in_part_frame(small_recipe(), plan.program)
    planned = replace(PlanResult.of(plan, solved, part, forecast or FORECAST), forecast=forecast)
    return plan_figures(small_recipe(), measured, solved, plan, planned)


def test_figures_are_of_the_plans_arrays(measured: MeasureResult, solved: SolveResult) -> None:
    found = figures_of(measured, solved, Forecast(0.5, 0.8, 1.4, 0.9, 0.99, RIPPLE))
    removal, inside = solved.dwell.removal_nm, measured.metric_mask
    assert found.removal_mean_nm == pytest.approx(removal[inside].mean(), rel=1e-2)
    volume_mm3 = 1e-6 * removal[inside].sum() * measured.grid.pitch_mm**2
    assert found.removal_mm3 == pytest.approx(volume_mm3, rel=1e-2)
    assert found.before_rms_nm == measured.stats.rms_nm
    assert found.predicted_rms_nm == pytest.approx(np.hypot(solved.dwell.certificate.predicted_rms_nm, 0.4))
    assert (found.ripple_rms_nm, found.ripple_rms_high_nm) == (pytest.approx(0.4), pytest.approx(0.9))
    assert found.expected_nm == (0.5, 1.4)
    assert any("ripple of 0.40 nm RMS" in note for note in found.notes)


def test_each_limit_is_one_of_the_config_and_is_kept(measured: MeasureResult, solved: SolveResult) -> None:
    found = figures_of(measured, solved, None)
    limits = {(one.key, one.least): one for one in found.limits}
    assert {"limits.max_removal_nm", "limits.max_pass_s", "machine.max_feed_mm_s"} <= {key for key, _ in limits}
    assert limits["machine.x_mm", True].limit == small_recipe().envelope.x_mm[0]
    assert limits["limits.max_pass_s", False].value == found.dwell_s
    for one in found.limits:
        room = DIGITS * abs(one.limit)  # of the digits in which a program is written
        assert one.value >= one.limit - room if one.least else one.value <= one.limit + room, one


def test_without_forecast_nothing_is_claimed(measured: MeasureResult, solved: SolveResult) -> None:
    found = figures_of(measured, solved, None)
    assert (found.ripple_rms_nm, found.ripple_rms_high_nm, found.ripple) == (None, None, "")
    assert (found.expected_nm, found.better) == (None, None)


def test_the_journal_keeps_them_with_the_pass(measured: MeasureResult, solved: SolveResult) -> None:
    plan = steps.rewrite(small_recipe(), small_program(), solved, "small.rnc")
    forecast = Forecast(0.5, 0.8, 1.4, 0.9, 0.99)
    planned = PlanResult.of(plan, solved, steps.in_part_frame(small_recipe(), plan.program), forecast)
    planned = replace(planned, figures=plan_figures(small_recipe(), measured, solved, plan, planned).facts())
    facts = json.loads(json.dumps(planned.facts()))
    assert facts["plan_figures"]["dwell_s"] == plan.total_s
    assert facts["plan_figures"]["limits"][0]["key"] == "limits.max_removal_nm"
