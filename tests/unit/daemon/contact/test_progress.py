"""Progress in contact: standing, slow motion and speed override, whatever the robot's state says."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from polishd.daemon.cell.time_limits import late_s
from polishd.daemon.contact.progress import (
    AWAY_S,
    MOST_STEP_S,
    STEP_S,
    Progress,
    ProgressLimits,
    expected_block_s,
    low_override,
)
from polishd.daemon.contact.streaming import SLOW_LOOKS, WATCH_S, streaming
from polishd.model.devices import ExecutedBlock, RobotProgress
from polishd.model.errors import DeviceRefused, SafetyStop
from polishd.model.process import ToolProcess
from polishd.model.program import Plan, Segment
from polishd.process.removal.excess import ExcessMap
from polishd.process.removal.measured_tif import spot_figures
from tests.fakes.devices import FakeCell
from tests.unit.daemon.contact.test_streaming_stream import time_passes
from tests.unit.process.gaussian import program

BLOCK_S = 0.08
SPOT = spot_figures(ToolProcess(force_n=12.0))
LIMITS = ProgressLimits(late_s=0.3, start_s=5.0, release_s=0.2, least_override=0.95)
LATEST_S = BLOCK_S + late_s(BLOCK_S) + LIMITS.late_s


def plan_of(blocks: int = 200, block_s: float = BLOCK_S, approach: int = 3) -> Plan:
    """A straight path of points 0.5 mm apart, and three blocks before it."""
    points = np.column_stack([0.5 * np.arange(blocks + 1.0), np.zeros((blocks + 1, 2))])
    path = program(points, block_s)
    path = replace(path, block=path.block + approach)
    segments = tuple(Segment(seq, b"G1 X%d" % seq) for seq in range(blocks + approach))
    return Plan(path, approach, blocks + approach, np.full(blocks, block_s), np.zeros((1, 1)), segments)


def excess_of(plan: Plan, floor_nm: float = 5.0) -> ExcessMap:
    return ExcessMap(plan.program, plan.expected_time_s, SPOT, floor_nm=floor_nm, share=0.1)


class Run:
    """A robot and the daemon's clock, block by block, in contact."""

    def __init__(
        self, plan: Plan | None = None, excess: ExcessMap | None = None, limits: ProgressLimits = LIMITS
    ) -> None:
        self.plan = plan or plan_of()
        self.progress = Progress(self.plan, limits, excess)
        self.now_s, self.clock_s, self.seq = 100.0, 0.0, self.plan.approach_blocks
        self.progress.start(self.now_s)

    def passes(self, seconds: float) -> None:
        """Nothing is reported meanwhile."""
        for _ in range(round(seconds / STEP_S)):
            self.now_s += STEP_S
            self.progress.look(self.now_s, in_contact=True)

    def block(self, reported_s: float = BLOCK_S, took_s: float = BLOCK_S) -> None:
        """A block that took so long, and by the controller's clock so long."""
        self.passes(took_s)
        self.progress.record(
            ExecutedBlock(self.seq, self.clock_s, self.clock_s + reported_s), self.now_s, in_contact=True
        )
        self.clock_s, self.seq = self.clock_s + reported_s, self.seq + 1
        self.progress.look(self.now_s, in_contact=True)

    def until_stopped(self, most_s: float, **took: float) -> tuple[float, str]:
        """Seconds until contact is left, and why."""
        begun_s = self.now_s
        try:
            while self.now_s < begun_s + most_s:
                self.block(**took) if took else self.passes(STEP_S)
        except SafetyStop as stopped:
            return self.now_s - begun_s, str(stopped)
        raise AssertionError(f"not noticed within {most_s} s")


def test_a_robot_that_stands_is_noticed_within_its_block_its_report_and_two_looks() -> None:
    run = Run()
    for _ in range(30):
        run.block()
    stood_s, why = run.until_stopped(5.0)
    assert stood_s == pytest.approx(LATEST_S, abs=2 * STEP_S)
    assert why.startswith("robot does not advance: block 33 expected 0.08 s, no progress for 0.4 s. ")


def test_the_block_under_way_counts_with_what_was_slow_before() -> None:
    """Standing alone is noticed 0.1 s later: here the place is at its limit already."""
    plan = plan_of()
    run = Run(plan, excess_of(plan))
    for _ in range(30):
        run.block()
    for _ in range(2):
        run.progress._reported.add(run.seq - 3, 2.4 / SPOT.peak_nm_s)  # type: ignore[union-attr]
    stood_s, why = run.until_stopped(5.0)
    assert stood_s < LATEST_S - 2 * STEP_S
    assert "robot does not advance: block 33 expected 0.08 s" in why
    assert "nm beyond the plan, at most 5.0 nm (limits.excess_nm)" in why


def test_a_long_block_is_not_taken_for_a_standstill() -> None:
    run = Run(plan_of(block_s=6.0))
    for _ in range(5):
        run.block(6.0, took_s=6.08)
    stood_s, why = run.until_stopped(10.0)
    assert 6.3 < stood_s < 6.5
    assert "expected 6.00 s" in why


def test_blocks_of_unequal_length_each_have_their_own_time() -> None:
    plan = plan_of()
    times = np.where(np.arange(200) % 5 == 0, 2.0, 0.02)
    run = Run(replace(plan, expected_time_s=times))
    for seconds in times[:50]:
        run.block(seconds, took_s=seconds)
    stood_s, _ = run.until_stopped(10.0)
    assert stood_s == pytest.approx(2.0 + 0.1 + LIMITS.late_s, abs=2 * STEP_S)


@pytest.mark.parametrize("stall_s", [0.5, 3.0, 60.0])
def test_time_in_which_this_process_did_not_run_is_no_standstill(stall_s: float) -> None:
    run = Run(excess=excess_of(plan_of()))
    for _ in range(30):
        run.block()
    run.now_s += stall_s
    run.progress.look(run.now_s, in_contact=True)  # before it has read what came meanwhile
    assert LIMITS.late_s / 2 > MOST_STEP_S
    for _ in range(20):  # then all at once
        run.block(took_s=0.0)
    for _ in range(20):
        run.block()


def test_a_robot_may_take_its_time_to_start_but_not_for_ever() -> None:
    run = Run()
    run.passes(4.9)
    for _ in range(10):
        run.block()
    run.progress.start(run.now_s)
    waited_s, why = run.until_stopped(20.0)
    assert waited_s == pytest.approx(LATEST_S + LIMITS.start_s, abs=2 * STEP_S)
    assert "does not advance" in why


def test_with_the_tool_up_it_is_waited_for_long_and_then_reported() -> None:
    run = Run()

    def wait(seconds: float) -> None:
        for _ in range(round(seconds / MOST_STEP_S)):
            run.now_s += MOST_STEP_S
            run.progress.look(run.now_s, in_contact=False)

    wait(AWAY_S - 1.0)
    with pytest.raises(SafetyStop, match=r"does not advance: block 0 no expected time, no progress for 300\.\d s"):
        wait(2.0)


@pytest.mark.parametrize("percent", [50, 80])
def test_slow_motion_is_noticed_before_the_excess_is_beyond_its_limit(percent: int) -> None:
    plan = plan_of()
    excess = excess_of(plan)
    run = Run(plan, excess)
    for _ in range(30):
        run.block()
    slow_s = BLOCK_S * 100 / percent
    took_s, why = run.until_stopped(5.0, reported_s=slow_s, took_s=slow_s)
    assert "robot is slower than planned" in why
    assert "limits.excess_nm" in why
    assert run.progress.worst < 1.0 + 1.1 * SPOT.peak_nm_s * (slow_s - BLOCK_S) / 5.0, "one block at most"
    assert took_s < 1.0


def test_slow_motion_is_noticed_by_when_reports_come_if_the_controllers_clock_hides_it() -> None:
    """It says of each block that it took what was planned."""
    plan = plan_of()
    run = Run(plan, excess_of(plan))
    for _ in range(30):
        run.block()
    took_s, why = run.until_stopped(10.0, reported_s=BLOCK_S, took_s=2 * BLOCK_S)
    assert "robot is slower than planned" in why
    assert took_s < 3.0


@pytest.mark.parametrize("reported_s", [0.98 * BLOCK_S, BLOCK_S, 1.05 * BLOCK_S])
def test_ordinary_motion_is_none(reported_s: float) -> None:
    """Also reported in lumps of ten blocks, and sixty times as fast as real time."""
    for lump, pace in ((1, 1.0), (3, 1.0), (10, 60.0)):
        plan = plan_of()
        run = Run(plan, excess_of(plan))
        for k in range(200):
            last = k % lump == lump - 1
            run.block(reported_s, took_s=lump * reported_s / pace if last else 0.0)
        assert run.progress.worst < 1.0


@pytest.mark.parametrize("overhead_s", [0.005, 0.03, 0.29])
def test_the_first_pass_may_show_what_a_point_costs_and_is_still_watched(overhead_s: float) -> None:
    """Each point alike takes so much beyond its plan; then the robot stands, or slows down to a half."""
    first = replace(LIMITS, knows_overhead=False)
    jitter_s = np.random.default_rng(3).normal(0.0, 0.003, 101)
    for slow in (False, True):
        plan = plan_of()
        run = Run(plan, excess_of(plan), first)
        for late_s_, next_s in pairwise(jitter_s):
            took_s = BLOCK_S + overhead_s + next_s - late_s_
            run.block(took_s, took_s=took_s)
        took = 2 * BLOCK_S + overhead_s
        stood_s, why = run.until_stopped(5.0, **({"reported_s": took, "took_s": took} if slow else {}))
        assert ("slower than planned" if slow else "does not advance") in why
        assert stood_s < overhead_s + LATEST_S + 3 * STEP_S if not slow else stood_s < 4 * took


@pytest.mark.parametrize("speed", [1.0, 30.0])
def test_how_well_an_end_is_known_is_no_slow_motion_at_any_speed_of_the_clock(speed: float) -> None:
    """Reports 0.1 s apart have ends 29 ms off; a controller that is simulated faster is off by as much more."""
    plan, late = plan_of(), np.random.default_rng(5).normal(0.0, 0.029, 201)
    run = Run(plan, excess_of(plan), replace(LIMITS, blur_s=0.087))
    for before_s, after_s in pairwise(late * speed):
        run.block(BLOCK_S + after_s - before_s, took_s=BLOCK_S / speed)
    assert run.progress.worst > 1.0
    if speed == 1.0:
        slow = Run(plan_of(), excess_of(plan), replace(LIMITS, blur_s=0.087))
        _, why = slow.until_stopped(10.0, reported_s=2 * BLOCK_S, took_s=2 * BLOCK_S)
        assert "slower than planned" in why


def test_with_a_known_overhead_the_same_is_slow_motion() -> None:
    plan = plan_of()
    run = Run(plan, excess_of(plan))
    took_s, why = run.until_stopped(20.0, reported_s=1.3 * BLOCK_S, took_s=1.3 * BLOCK_S)
    assert "robot is slower than planned" in why
    assert took_s < 2.0


def test_without_limits_of_its_excess_a_robot_may_be_slow() -> None:
    run = Run()
    for _ in range(100):
        run.block(2 * BLOCK_S, took_s=2 * BLOCK_S)


def test_a_block_without_a_time_leads_to_the_point_after_it() -> None:
    dwell = program(np.column_stack([np.arange(4.0), np.zeros((4, 2))]), [1.0, 2.0, 0.5, 1.0], "dwell")  # type: ignore[arg-type]
    dwell = replace(dwell, block=np.array([3, 5, 7, 9]))
    plan = Plan(dwell, 3, 10, dwell.time_s + 0.25, np.zeros((1, 1)))
    assert expected_block_s(plan)[3:].tolist() == pytest.approx([1.25, 0.25, 2.25, 0.25, 0.75, 0.25, 1.25])
    joined = expected_block_s(plan, reports_dwells=False)
    assert joined[3:].tolist() == pytest.approx([1.25, 2.25, 2.25, 0.75, 0.75, 1.25, 1.25]), "a move, then its dwell"
    far = program(np.array([[0, 0, 0], [1, 0, 0]]), 0.5)
    start, end = np.array([[0.0, 0, 0], [3.0, 0, 0]]), np.array([[1.0, 0, 0], [4.0, 0, 0]])
    gap = replace(far, start_mm=start, end_mm=end, block=np.array([0, 2]), time_s=np.full(2, 0.5))
    assert expected_block_s(Plan(gap, 0, 3, gap.time_s, np.zeros((1, 1)))).tolist() == pytest.approx([0.5, 1.5, 0.5])


def test_an_override_that_cannot_be_read_is_not_judged() -> None:
    robot = RobotProgress("running", "", 0, 0, 0.0)
    assert low_override(robot, 0.95) == ""
    assert low_override(replace(robot, override=0.95), 0.95) == ""
    assert low_override(replace(robot, override=1.1), 0.95) == ""
    said = low_override(replace(robot, override=0.5), 0.95)
    assert said.startswith("the robot's speed override is 50%, at least 95% is needed (robot.least_override)")


@pytest.mark.parametrize(("override", "reports"), [(1.0, "an override of 100%"), (None, "no override")])
def test_a_speed_that_the_driver_measures_counts_whatever_override_is_reported(
    override: float | None, reports: str
) -> None:
    robot = RobotProgress("running", "", 0, 0, 0.0, override=override, measured_speed=0.55)
    said = low_override(robot, 0.95)
    assert said.startswith(
        f"the robot moves at 55% of the programmed speed at most and reports {reports}; at least 95%"
    )
    assert low_override(robot, 0.5) == ""
    assert "override is 0%" in low_override(replace(robot, override=0.0), 0.95)


# the whole stream


async def pass_of(fake: FakeCell, each: Callable[[int], object] = int) -> None:
    plan = plan_of(60)
    async with streaming(plan, fake.robot, fake.clock, 1.0, least_s=0.25, limits=LIMITS) as stream:
        await stream.approach()
        async for block in stream.polish():
            each(block.seq)
        await stream.retreat()


@pytest.fixture
def fake() -> FakeCell:
    found = FakeCell()
    found.robot.block_s, found.robot.lies = BLOCK_S, True
    return found


async def test_a_robot_that_says_it_runs_and_stands_ends_contact(fake: FakeCell) -> None:
    at: list[float] = []

    def stand(seq: int) -> None:
        if seq == 20:
            fake.robot.stands = True
            at.append(fake.clock.at_s)

    task = asyncio.ensure_future(pass_of(fake, stand))
    await time_passes(fake, 60.0, task)
    with pytest.raises(SafetyStop, match=r"robot does not advance: block 21 expected 0\.08 s, no progress for 0\.\d s"):
        await task
    assert (await fake.robot.progress()).state == "running"
    assert fake.clock.at_s - at[0] <= LATEST_S + 2 * WATCH_S


async def test_a_robot_that_stands_on_its_way_is_reported_after_minutes(fake: FakeCell) -> None:
    fake.robot.stands = True
    task = asyncio.ensure_future(pass_of(fake))
    await time_passes(fake, 10.0, task)
    assert not task.done(), "nothing is pressed there"
    await time_passes(fake, AWAY_S, task)
    with pytest.raises(SafetyStop, match="robot does not advance: block 0 no expected time"):
        await task


async def test_before_contact_a_low_override_is_refused_with_the_tool_up(fake: FakeCell) -> None:
    fake.robot.override = 0.5
    with pytest.raises(DeviceRefused, match=r"speed override is 50%, at least 95% .* the tool did not land"):
        await pass_of(fake)
    assert fake.robot.done == 3


async def test_in_contact_two_looks_at_a_low_override_end_it_and_one_does_not(fake: FakeCell) -> None:
    plan = plan_of(60)
    async with streaming(plan, fake.robot, fake.clock, 1.0, least_s=0.25, limits=LIMITS) as stream:
        fake.robot.override = 0.2
        await stream_looks(fake, 1)  # on its way the tool is up
        fake.robot.override = 1.0
        await stream.approach()
        fake.robot.override = 0.94
        await stream_looks(fake, SLOW_LOOKS - 1)
        fake.robot.override = None
        await stream_looks(fake, 1)

    async def slow() -> None:
        async with streaming(plan, fake.robot, fake.clock, 1.0, least_s=0.25, limits=LIMITS) as stream:
            await stream.approach()
            fake.robot.override = 0.94
            await asyncio.Event().wait()

    task = asyncio.ensure_future(slow())
    await time_passes(fake, 5.0, task)
    with pytest.raises(SafetyStop, match="speed override is 94%"):
        await task


async def stream_looks(fake: FakeCell, looks: int) -> None:
    """Let the stream's monitor check this number of times."""
    for _ in range(looks):
        fake.clock.advance(WATCH_S)
        for _ in range(4):
            await asyncio.sleep(0)
