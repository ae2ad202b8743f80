"""Streaming, look by look: when a robot stands, when it starves, and how far ahead it is fed."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Sequence
from typing import Any

import pytest

from polishd.daemon.contact.progress import STEP_S, Progress, ProgressLimits
from polishd.daemon.contact.streaming import CHUNK, STANDS, WATCH_S, Stream, streaming
from polishd.model.devices import ExecutedBlock, RobotProgress, RobotState, RobotTimes
from polishd.model.errors import DeviceRefused, SafetyStop
from polishd.model.program import Segment
from tests.fakes.devices import FakeCell
from tests.unit.daemon.contact.test_streaming_stream import small_plan, whole_pass

LOOKAHEAD_S, LEAST_S = 1.0, 0.25


class Over(Exception):
    """The script is."""


class Scripted:
    """A robot, and a clock, of which each look finds what the test wrote."""

    def __init__(self, *looks: tuple[RobotState, int]) -> None:
        self.looks = list(looks)
        self.buffer_s = 9.0
        self.sent: list[Segment] = []
        self.slept_s: list[float] = []
        self.override: float | None = None
        self.gains_s = 0.01
        """Motion time that each sent block adds; a sleep uses its duration of it."""

    async def progress(self) -> RobotProgress:
        if not self.looks:
            raise Over
        state, executed = self.looks.pop(0)
        return RobotProgress(state, "sha", 0, executed, self.buffer_s, "boot", "why", self.override)

    async def executed(self, from_seq: int = 0) -> AsyncIterator[ExecutedBlock]:
        assert from_seq == 0
        for seq in range(100):
            yield ExecutedBlock(seq, float(seq), seq + 1.0)

    async def resume(self, until: int | None = None) -> None: ...

    async def send(self, segments: Sequence[Segment]) -> None:
        self.sent += segments
        self.buffer_s += self.gains_s * len(segments)

    def now_s(self) -> float:
        return sum(self.slept_s)

    async def sleep(self, seconds: float) -> None:
        self.slept_s.append(seconds)
        self.buffer_s -= seconds
        await asyncio.sleep(0)

    def stream(self, blocks: int = 20, **options: Any) -> Stream:
        robot: Any = self
        return Stream(small_plan(blocks), robot, robot, LOOKAHEAD_S, LEAST_S, **options)


async def looked(robot: Scripted, target: int | None = 10) -> int:
    """At how many looks it was found to stand; 0: at none."""
    stream, looks = robot.stream(), len(robot.looks)
    stream._target = target
    with pytest.raises((SafetyStop, Over)) as found:
        await stream.watch()
    assert set(robot.slept_s) == {WATCH_S}
    if isinstance(found.value, Over):
        return 0
    assert f"stands at block 5 of {target} (held: why)" in str(found.value)
    return looks - len(robot.looks)


@pytest.mark.parametrize(
    ("looks", "target", "at"),
    [
        ([("held", 5)] * 9, 10, STANDS),
        ([("held", 5)] * 2 + [("running", 5)] + [("held", 5)] * 2, 10, 0),
        ([("running", 5), ("held", 5), ("running", 6)] * 5, 10, 0),
        ([("running", 5)] * 2 + [("held", 5)] * 9, 10, 2 + STANDS),
        ([("held", 10)] * 9, 10, 0),  # where it has to stand
        ([("running", 5)] * 9, 10, 0),
        ([("held", 5)] * 9, None, 0),  # it does not have to run
    ],
)
async def test_a_robot_stands_that_does_so_three_looks_in_a_row(
    looks: list[tuple[RobotState, int]], target: int | None, at: int
) -> None:
    assert (STANDS, WATCH_S) == (3, 0.1), "a tool that stands digs 160 nm a second"
    assert await looked(Scripted(*looks), target) == at


async def test_too_little_motion_is_seen_by_who_looks_and_by_who_follows() -> None:
    robot = Scripted(("running", 5), ("running", 5))
    stream = robot.stream()
    robot.buffer_s = LEAST_S
    blocks = stream.polish()
    await anext(blocks)
    supplied = asyncio.ensure_future(stream.supplied())
    await asyncio.sleep(0)
    assert not supplied.done(), "just enough is enough"
    robot.buffer_s = LEAST_S - 0.01
    await anext(blocks)
    await anext(blocks)  # published once, and the recording goes on
    with pytest.raises(SafetyStop, match=r"only 0\.24 s of motion are left in the robot at block 0, and a lift may"):
        await supplied
    with pytest.raises(Over):
        await stream.watch()


async def test_who_looks_alone_sees_it_too() -> None:
    robot = Scripted(("running", 5))
    stream = robot.stream()
    await anext(stream.polish())
    robot.buffer_s = 0.0
    with pytest.raises(Over):
        await stream.watch()
    with pytest.raises(SafetyStop, match="only"):
        await stream.supplied()


@pytest.mark.parametrize("how", ["before", "left", "all sent", "ended"])
async def test_out_of_contact_or_with_all_sent_it_may_run_dry(how: str) -> None:
    robot = Scripted(("held", 5))
    stream = robot.stream()
    if how == "ended":
        assert [block.seq async for block in stream.polish()] == list(range(18))
    elif how != "before":
        await anext(stream.polish())
    if how == "left":
        stream.leave()
    if how == "all sent":
        await stream.feed()
    robot.buffer_s = 0.0
    with pytest.raises(Over):
        await stream.watch()
    assert not stream._short.done()


async def test_when_contact_is_left_it_may_stand_wherever_it_is() -> None:
    robot = Scripted(*[("held", 5)] * 9)
    stream = robot.stream()
    await anext(stream.polish())
    stream.leave()
    with pytest.raises(Over):
        await stream.watch()


async def test_it_is_fed_while_less_than_two_look_aheads_are_held_and_not_more() -> None:
    robot = Scripted()
    robot.buffer_s = 0.0
    robot.gains_s = 0.5 / CHUNK
    stream = robot.stream(9 * CHUNK + 1)
    held_s: list[float] = []
    plain = robot.send

    async def send(segments: Sequence[Segment]) -> None:
        held_s.append(round(robot.buffer_s, 9))
        assert len(segments) in {CHUNK, 1}
        await plain(segments)

    robot.send = send  # type: ignore[method-assign]
    await stream.feed()
    assert [segment.seq for segment in robot.sent] == list(range(9 * CHUNK + 1))
    assert held_s[:5] == [0.0, 0.5, 1.0, 1.5, 1.9], "a tenth of a look-ahead after two of them were full"
    assert max(held_s) <= 2 * LOOKAHEAD_S
    assert set(robot.slept_s) == {LOOKAHEAD_S / 10}


@pytest.mark.parametrize(("held_s", "full"), [(0.99, False), (1.0, True)])
async def test_the_way_in_begins_once_a_look_ahead_is_held(held_s: float, full: bool) -> None:
    robot = Scripted()
    robot.buffer_s, robot.gains_s = held_s, 0.0
    stream, gate = robot.stream(3 * CHUNK), asyncio.Event()
    plain = robot.send

    async def send(segments: Sequence[Segment]) -> None:
        if robot.sent:
            await gate.wait()
        await plain(segments)

    robot.send = send  # type: ignore[method-assign]
    feeding = asyncio.ensure_future(stream.feed())
    for _ in range(4):
        await asyncio.sleep(0)
    assert stream._filled.is_set() is full
    gate.set()
    await feeding
    assert stream._filled.is_set(), "all is sent"


async def test_a_robot_with_just_enough_motion_to_lift_in_may_go() -> None:
    fake = FakeCell()
    fake.robot.takes, fake.robot.block_s = CHUNK, 0.01 / CHUNK
    async with streaming(small_plan(1000), fake.robot, fake.clock, 0.02, least_s=fake.robot.block_s * CHUNK) as stream:
        await stream.approach()
    assert fake.robot.done == 3
    fake = FakeCell()
    fake.robot.takes, fake.robot.block_s = CHUNK, 0.01 / CHUNK
    with pytest.raises(DeviceRefused, match=r"buffers 0\.01 s of motion"):
        await refused(fake)
    assert fake.robot.done == 0


async def refused(fake: FakeCell) -> None:
    async with streaming(small_plan(1000), fake.robot, fake.clock, 0.02, least_s=0.0101) as stream:
        await stream.approach()


async def test_the_robot_is_asked_to_run_no_farther_than_each_landing_point() -> None:
    fake = FakeCell()
    await whole_pass(fake, small_plan(12, 0, 0))
    assert fake.of("robot.resume") == ["robot.resume 12"]
    fake = FakeCell()
    await whole_pass(fake, small_plan(12, 2, 1))
    assert fake.of("robot.resume") == ["robot.resume 2", "robot.resume 11", "robot.resume None"]


async def test_a_robot_whose_held_instructions_were_checked_may_hold_less_than_a_lift_takes() -> None:
    fake = FakeCell()
    fake.robot.block_s, fake.robot.takes = 0.00005, CHUNK
    fake.robot.times = RobotTimes(held_instructions=8)
    with pytest.raises(SafetyStop, match="cannot keep up"):
        await whole_pass(fake, small_plan(1000), 0.04)
    assert fake.robot.done >= 3, "the way to the part was run"


@pytest.mark.parametrize(("lands", "looks"), [(True, 2), (False, 0)])
async def test_two_looks_at_a_low_override_count_where_the_tool_lands_or_presses(lands: bool, looks: int) -> None:
    robot = Scripted(*[("running", 5)] * 4)
    robot.override = 0.5
    stream = robot.stream(limits=ProgressLimits(least_override=0.95))
    if lands:
        stream._lands = True
    with pytest.raises(SafetyStop if looks else Over):
        await stream.watch()
    assert 4 - len(robot.looks) == (looks or 4)
    stream.leave()
    robot.looks = [("running", 5)] * 4
    with pytest.raises(Over):
        await stream.watch()


class Calls:
    """Stands in for the progress of a pass, and records its calls."""

    def __init__(self, executed: int = 0, worst: float = 0.0) -> None:
        self.executed, self.worst = executed, worst
        self.all: list[tuple[Any, ...]] = []

    def start(self, now_s: float) -> None:
        self.all.append(("start", now_s))

    def reported(self, executed: int, now_s: float) -> None:
        self.all.append(("reported", executed, now_s))

    def record(self, block: ExecutedBlock, now_s: float, *, in_contact: bool) -> None:
        self.all.append(("record", block.seq, now_s, in_contact))

    def look(self, now_s: float, *, in_contact: bool) -> None:
        self.all.append(("look", now_s, in_contact))


async def test_each_report_of_the_robot_is_handed_on_and_counts_for_its_progress() -> None:
    robot, reports = Scripted(("running", 5), ("running", 6)), list[RobotProgress]()
    stream = robot.stream(on_progress=reports.append)
    calls: Any = Calls()
    stream._progress = calls
    with pytest.raises(Over):
        await stream.watch()
    assert [report.executed for report in reports] == [5, 6]
    assert calls.all == [("reported", 5, WATCH_S), ("reported", 6, 2 * WATCH_S)]


async def test_each_executed_block_counts_for_the_progress_of_its_part() -> None:
    robot = Scripted()
    stream, calls = robot.stream(), Calls()
    spy: Any = calls
    stream._progress = spy
    blocks = stream.polish()
    await anext(blocks)
    assert calls.all == [("start", 0.0), ("record", 0, 0.0, True)]


@pytest.mark.parametrize(("target", "looks"), [(6, 3), (5, 0), (None, 0)])
async def test_its_progress_is_looked_at_while_it_has_blocks_to_run(target: int | None, looks: int) -> None:
    robot = Scripted()
    stream, calls = robot.stream(), Calls(executed=5)
    spy: Any = calls
    stream._progress, stream._target = spy, target
    plain = robot.sleep

    async def sleep(seconds: float) -> None:
        if len(robot.slept_s) == 3:
            raise Over
        await plain(seconds)

    robot.sleep = sleep  # type: ignore[method-assign]
    with pytest.raises(Over):
        await stream.advance()
    assert calls.all == [("look", pytest.approx((k + 1) * STEP_S), False) for k in range(looks)]


@pytest.mark.parametrize(("worst", "said"), [(0.0, []), (0.5, ["excess removal, at most 50% of its limit"])])
async def test_what_a_pass_removed_beyond_its_plan_is_logged(
    caplog: pytest.LogCaptureFixture, worst: float, said: list[str]
) -> None:
    caplog.set_level("INFO", "polishd.daemon.contact.streaming")
    stream = Scripted().stream()
    calls: Any = Calls(worst=worst)
    stream._progress = calls
    async for _ in stream.polish():
        pass
    assert caplog.messages == said


async def test_a_stream_judges_its_excess_and_hands_reports_on(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    fake, reports, given = FakeCell(), list[RobotProgress](), list[object]()
    excess: Any = object()

    def progress(plan: Any, limits: Any, excess: Any) -> Progress:
        given.append(excess)
        return Progress(plan, limits)

    monkeypatch.setattr("polishd.daemon.contact.streaming.Progress", progress)
    async with streaming(
        small_plan(), fake.robot, fake.clock, 1.0, least_s=0.25, on_progress=reports.append, excess=excess
    ) as stream:
        await stream.approach()
        fake.clock.advance(WATCH_S)
        for _ in range(20):
            await asyncio.sleep(0)
    assert given == [excess]
    assert reports[0].accepted == 20
