"""Streaming, look by look: when a robot stands, when it starves, and how far ahead it is fed."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Sequence
from typing import Any

import pytest

from polishd.daemon.contact.streaming import CHUNK, STANDS, WATCH_S, Stream, streaming
from polishd.model.devices import ExecutedBlock, RobotProgress, RobotState
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
        self.gains_s = 0.01
        """Motion time that each sent block adds; a sleep uses its duration of it."""

    async def progress(self) -> RobotProgress:
        if not self.looks:
            raise Over
        state, executed = self.looks.pop(0)
        return RobotProgress(state, "sha", 0, executed, self.buffer_s, "boot", "why")

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

    def stream(self, blocks: int = 20) -> Stream:
        robot: Any = self
        return Stream(small_plan(blocks), robot, robot, LOOKAHEAD_S, LEAST_S)


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
