"""The bound that ``polishd check`` gives for a robot that stands in contact holds for what the daemon does."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from polishd.config.cell import CellConfig, load_config
from polishd.daemon.cell.cell import Cell
from polishd.daemon.cell.time_limits import LOOK_S, TimeLimits, late_s
from polishd.daemon.contact.progress import FIRST_POINTS, MOST_OVERHEAD_S, STEP_S, ProgressLimits
from polishd.daemon.contact.stall_removal import (
    NO_TOLERANCE_NM,
    StallRemoval,
    excess_map,
    peak_nm_s,
    require_held_motion,
    require_stall_depth,
    round_up,
    stall_removal,
    timing_uncertainty_s,
    tolerance_nm,
)
from polishd.model.devices import ActuatorTimes, RobotTimes, SpindleTimes
from polishd.model.dwell import AS_PROGRAMMED
from polishd.model.errors import ConfigError
from polishd.pipeline.recipe import Recipe
from polishd.pipeline.steps import envelope_of, in_part_frame
from polishd.process.removal.excess import ExcessMap
from polishd.process.removal.measured_tif import spot_figures
from polishd.process.robot.motion import delivered_time_s, least_time_s
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


@pytest.mark.parametrize("encoding", ["feed", "dwell"])
def test_a_standstill_is_noticed_after_the_longest_motion_what_a_point_costs_and_the_lateness(encoding: str) -> None:
    recipe, program = small_recipe(), replace(plan_of().program, encoding=encoding)
    moving_s = delivered_time_s(program, program.time_s, envelope_of(recipe, program))
    if encoding == "dwell":  # the tool has to stand there meanwhile
        moving_s = moving_s - program.time_s
    longest_s = float(moving_s.max()) + MOST_OVERHEAD_S
    bound = stall_removal(TIMES, recipe, program)
    assert bound.notice_s == pytest.approx(longest_s + late_s(longest_s) + TIMES.no_progress_s)
    assert stall_removal(TIMES, recipe, program, 7.0).notice_s == pytest.approx(longest_s + late_s(longest_s) + 7.0)
    assert (bound.first_s, bound.release_s) == (MOST_OVERHEAD_S, TIMES.actuator.release_s)
    assert bound.rate_nm_s == peak_nm_s(recipe)


def lines(*limits: tuple[float, str]) -> Recipe:
    """A recipe of which only the lines of the tolerance count."""
    return cast(Recipe, SimpleNamespace(lines=[SimpleNamespace(limit=limit, unit=unit) for limit, unit in limits]))


def test_the_tightest_limit_in_nm_is_the_tolerance() -> None:
    assert tolerance_nm(lines((5.0, "nm"), (3.0, "nm"), (1.0, "urad"))) == 3.0
    assert tolerance_nm(lines((1.0, "urad"))) is None


def test_the_end_of_a_block_is_as_uncertain_as_the_robot_reports_it() -> None:
    recipe = small_recipe()
    assert timing_uncertainty_s(cell_with(), recipe) == ""
    assert timing_uncertainty_s(cell_with(block_end_s=0.004), recipe) == (
        f"4 ms rms, {0.004 * peak_nm_s(recipe):.1f} nm; it does not add up"
    )


def limits_of(most_nm: float | None, tolerance: float | None = 0.5) -> np.ndarray:
    """The limits of excess removal along the path, where it is on the part."""
    recipe = small_recipe(tolerance_nm=tolerance) if tolerance else small_recipe()
    if tolerance is None:
        recipe = cast(Recipe, Untolerated(recipe))
    limit_nm = excess_map(recipe, plan_of(), most_nm)._limit_nm
    assert np.isinf(limit_nm).any(), "beside the part nothing is judged"
    return limit_nm[np.isfinite(limit_nm)]


class Untolerated:
    """A recipe whose tolerance has no line in nm."""

    lines: tuple[Any, ...] = ()

    def __init__(self, recipe: Recipe) -> None:
        self._recipe = recipe

    def __getattr__(self, name: str) -> Any:
        return getattr(self._recipe, name)


def test_the_excess_may_be_half_of_the_tolerance_or_a_tenth_of_the_plan() -> None:
    assert limits_of(None, 4000.0).min() == 2000.0
    assert limits_of(None).max() > limits_of(None).min() >= 0.25, "a tenth of the removal that is planned there"
    assert limits_of(None, None).min() == NO_TOLERANCE_NM / 2
    np.testing.assert_array_equal(limits_of(7.0), 7.0)
    recipe, plan = small_recipe(tolerance_nm=0.5), plan_of()
    whole = excess_map(recipe, plan, None)._limit_nm
    path, spot = in_part_frame(recipe, plan.program), spot_figures(recipe.process)
    tenth = ExcessMap(path, plan.expected_time_s, spot, floor_nm=0.25, share=0.1, on_part=recipe.outline.contains)
    np.testing.assert_array_equal(whole, tenth._limit_nm)


def test_facts_row_and_warning_state_the_same_pit() -> None:
    bound = StallRemoval(notice_s=0.5, first_s=0.25, release_s=0.1, rate_nm_s=20.0)
    assert replace(bound, notice_s=0.12345).row()["seconds"] == 0.123
    assert bound.row()["key"] == "", "no key of the config is this time"
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
    envelope = envelope_of(recipe, program)
    as_programmed_s = delivered_time_s(program, program.time_s, envelope)
    least_s = np.maximum(least_time_s(program, envelope), recipe.envelope.least_point_s)
    sum_s = (as_programmed_s if objective == AS_PROGRAMMED else least_s).sum()
    assert said.startswith(f"at least {sum_s:.2f} s in 2000 instructions; ")
    assert f"{as_programmed_s.sum():.2f}" != f"{least_s.sum():.2f}"
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
