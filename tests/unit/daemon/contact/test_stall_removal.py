"""The bound that ``polishd check`` gives for a robot that stands in contact holds for what the daemon does."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from polishd.config.cell import CellConfig, load_config
from polishd.daemon.cell.cell import Cell
from polishd.daemon.cell.time_limits import LOOK_S, TimeLimits
from polishd.daemon.contact.progress import FIRST_POINTS, MOST_OVERHEAD_S, STEP_S, ProgressLimits
from polishd.daemon.contact.stall_removal import (
    StallRemoval,
    peak_nm_s,
    require_held_motion,
    require_stall_depth,
    round_up,
    stall_removal,
)
from polishd.model.devices import ActuatorTimes, RobotTimes, SpindleTimes
from polishd.model.dwell import AS_PROGRAMMED
from polishd.model.errors import ConfigError
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


def test_facts_row_and_warning_state_the_same_pit() -> None:
    bound = StallRemoval(notice_s=0.5, first_s=0.25, release_s=0.1, rate_nm_s=20.0)
    assert bound.facts() == {"notice_s": 0.5, "first_s": 0.25, "release_s": 0.1, "rate_nm_s": 20.0, "removal_nm": 12.0}
    row = bound.row()
    assert row["seconds"] == 0.5
    assert "(0.25 s of it only in a first pass" in row["what"]
    assert "force off after 0.60 s, removal 12 nm at most" in row["what"]
    assert bound.warning(None) == ""
    assert bound.warning(24.0) == ""
    assert "up to 12 nm before the force is off, more than half of the tolerance of 23.9 nm" in bound.warning(23.9)


# a robot that stands before it reports it


def cell_with(**times: Any) -> Cell:
    """Cell of which only the times count."""
    limits = TimeLimits(ActuatorTimes(release_s=0.1, retract_s=0.5), RobotTimes(**times), SpindleTimes())
    return cast(Cell, SimpleNamespace(limits=limits))


@pytest.fixture
def config(tmp_path: Path, example: str) -> CellConfig:
    path = tmp_path / "cell.toml"
    path.write_text(example)
    (tmp_path / "program.rnc").write_text("M30\n")
    return load_config(path)


def test_a_hold_that_is_reported_late_digs_no_deeper_than_its_limit(config: CellConfig) -> None:
    recipe = small_recipe()
    assert require_stall_depth(config, cell_with(), recipe) == "", "a robot that reports it at once"
    late = cell_with(unseen_stop_s=0.3)
    depth_nm = peak_nm_s(recipe) * (0.3 + 0.1)
    at_limit = config.model_copy(update={"limits": config.limits.model_copy(update={"max_stall_removal_nm": depth_nm})})
    assert require_stall_depth(at_limit, late, recipe) == (
        f"{depth_nm:.1f} nm at most: 300 ms until the robot reports it, 100 ms until the force is off, "
        f"at {peak_nm_s(recipe):.0f} nm/s"
    )
    beyond = config.model_copy(
        update={"limits": config.limits.model_copy(update={"max_stall_removal_nm": 0.999 * depth_nm})}
    )
    with pytest.raises(ConfigError, match=rf"limits\.max_stall_removal_nm: a feed hold .* would dig {depth_nm:.1f} nm"):
        require_stall_depth(beyond, late, recipe)


@pytest.mark.parametrize("objective", ["removal", AS_PROGRAMMED])
def test_a_robot_with_few_instructions_must_hold_motion_for_the_lift(config: CellConfig, objective: str) -> None:
    recipe = small_recipe(objective=objective) if objective == AS_PROGRAMMED else small_recipe()
    program = plan_of().program
    assert require_held_motion(config, cell_with(), recipe, program) == "", "a robot that holds a whole program"
    said = require_held_motion(config, cell_with(held_instructions=2000), recipe, program)
    assert said.startswith("at least ")
    assert "in 2000 instructions; to lift the tool if the actuator stops answering" in said
    few = cell_with(held_instructions=3)
    needed_s = round_up(few.limits.held_motion_s / few.limits.held_points(program.encoding))
    expected = (
        rf"machine\.least_point_s: .* Have it posted with points of {needed_s:g} s or more \(a first touch"
        if objective == AS_PROGRAMMED
        else rf"machine\.least_point_s: .* Set machine\.least_point_s to {needed_s:g} or more"
    )
    with pytest.raises(ConfigError, match=rf"(?s){expected}"):
        require_held_motion(config, few, recipe, program)


@pytest.mark.parametrize(("seconds", "expected"), [(0.1, 0.1), (0.1001, 0.101), (0.1 + 1e-10, 0.1), (0.0, 0.0)])
def test_a_time_is_rounded_to_the_next_millisecond(seconds: float, expected: float) -> None:
    assert round_up(seconds) == expected
