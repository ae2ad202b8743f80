"""The bound that ``polishd check`` gives for a robot that stands in contact holds for what the daemon does."""

from __future__ import annotations

from dataclasses import replace

import pytest

from polishd.daemon.cell.time_limits import LOOK_S, TimeLimits
from polishd.daemon.contact.progress import FIRST_POINTS, MOST_OVERHEAD_S, STEP_S, ProgressLimits
from polishd.daemon.contact.stall_removal import stall_removal
from polishd.model.devices import ActuatorTimes, RobotTimes, SpindleTimes
from polishd.pipeline.steps import envelope_of
from polishd.process.robot.motion import delivered_time_s
from tests.unit.daemon.contact.test_progress import Run, excess_of, plan_of
from tests.unit.daemon.small_job import small_recipe

TIMES = TimeLimits(ActuatorTimes(), RobotTimes(report_s=0.1), SpindleTimes())
NO_LIMIT_NM = 1e6
"""Removal limit without effect, so that only the time of a standstill counts."""


@pytest.mark.parametrize("points", [1, FIRST_POINTS - 1, FIRST_POINTS + 5])
@pytest.mark.parametrize("knows_overhead", [False, True])
def test_no_standstill_is_noticed_later_than_the_bound(points: int, knows_overhead: bool) -> None:
    recipe, plan = small_recipe(), plan_of()
    expected_s = delivered_time_s(plan.program, plan.program.time_s, envelope_of(recipe, plan.program))
    plan = replace(plan, expected_time_s=expected_s)
    bound = stall_removal(TIMES, recipe, plan.program)
    limits = ProgressLimits.of(TIMES, 0.95, None, knows_overhead=knows_overhead)
    run = Run(plan, excess_of(plan, floor_nm=NO_LIMIT_NM), limits)
    for point in range(points):
        run.block(expected_s[point], took_s=expected_s[point])
    stood_s, _ = run.until_stopped(5.0)
    assert stood_s <= bound.notice_s + STEP_S + LOOK_S
    if not knows_overhead and points < FIRST_POINTS:
        assert stood_s > bound.notice_s - MOST_OVERHEAD_S / 2, "the bound is what the first points of a pass need"
    else:
        assert stood_s <= bound.notice_s - bound.first_s + STEP_S + LOOK_S
