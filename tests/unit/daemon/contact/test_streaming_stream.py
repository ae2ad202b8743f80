"""Streaming: where the robot stops, how far ahead it is fed, and what ends a pass that cannot go on."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from polishd.daemon.contact.streaming import CHUNK, STANDS, WATCH_S, streaming
from polishd.model.errors import DeviceFault, DeviceRefused, LinkError, SafetyStop
from polishd.model.program import Plan, Segment
from tests.fakes.devices import FakeCell
from tests.unit.process.gaussian import program


def small_plan(blocks: int = 20, approach: int = 3, retreat: int = 2) -> Plan:
    timed = blocks - approach - retreat
    points = np.column_stack([np.arange(timed + 1.0), np.zeros((timed + 1, 2))])
    segments = tuple(Segment(seq, b"G1 X%d" % seq) for seq in range(blocks))
    return Plan(program(points), approach, blocks - retreat, np.full(timed, 0.1), np.zeros((1, 1)), segments)


@pytest.fixture
def fake() -> FakeCell:
    return FakeCell()


async def whole_pass(
    fake: FakeCell, plan: Plan, stream_ahead_s: float = 1.0, each: Callable[[int], object] = int
) -> list[int]:
    """Run a whole pass; ``each`` gets every block in contact."""
    seqs = []
    async with streaming(plan, fake.robot, fake.clock, stream_ahead_s, least_s=stream_ahead_s / 4) as stream:
        await stream.approach()
        async for block in stream.polish():
            each(block.seq)
            seqs.append(block.seq)
        await stream.retreat()
    return seqs


async def time_passes(fake: FakeCell, seconds: float, until: asyncio.Future[Any]) -> None:
    """Advance the fake clock in small steps, in which all tasks run, until that is done or the time is over."""
    end_s = fake.clock.at_s + seconds
    while fake.clock.at_s < end_s and not until.done():
        fake.clock.advance(WATCH_S / 2)
        for _ in range(4):
            await asyncio.sleep(0)


async def test_contact_is_what_lies_between_the_landing_points(fake: FakeCell) -> None:
    assert await whole_pass(fake, small_plan()) == list(range(3, 18))
    assert fake.of("robot.prepare", "robot.resume") == [
        "robot.prepare",
        "robot.resume 3",
        "robot.resume 18",
        "robot.resume None",
    ]
    assert fake.robot.done == 20


async def test_the_robot_stands_at_each_landing_point_until_it_is_resumed(fake: FakeCell) -> None:
    async with streaming(small_plan(), fake.robot, fake.clock, 1.0, least_s=0.25) as stream:
        await stream.approach()
        assert (fake.robot.done, (await fake.robot.progress()).state) == (3, "held")
        async for _ in stream.polish():
            pass
        assert (fake.robot.done, (await fake.robot.progress()).state) == (18, "held")
        await stream.retreat()


@pytest.mark.parametrize(("approach", "retreat"), [(0, 0), (0, 2), (3, 0)])
async def test_a_program_without_a_way_in_or_out(fake: FakeCell, approach: int, retreat: int) -> None:
    seqs = await whole_pass(fake, small_plan(12, approach, retreat))
    assert seqs == list(range(approach, 12 - retreat))
    assert len(fake.of("robot.resume")) == 1 + bool(approach) + bool(retreat)
    assert fake.robot.done == 12


async def test_nothing_runs_before_the_look_ahead_is_filled(fake: FakeCell) -> None:
    fake.robot.block_s = 0.004  # 128 blocks are half a second
    filled: list[float] = []
    fake.robot.acts.before["resume"] = lambda: filled.append(fake.robot.buffer_s)
    await whole_pass(fake, small_plan(1000))
    assert filled[0] >= 1.0


async def test_the_look_ahead_is_bounded_and_replenished(fake: FakeCell) -> None:
    plan = small_plan(1000)
    fake.robot.block_s = 0.01
    least: list[float] = []
    await whole_pass(fake, plan, 2.0, lambda seq: least.append(fake.robot.buffer_s) if seq < 800 else None)
    assert fake.robot.most_buffered_s <= 2 * 2.0 + CHUNK * 0.01
    assert min(least) > 2.0, "fed again before a look-ahead is used up"
    sent = [event.split()[1] for event in fake.of("robot.send")]
    assert sent == [f"{k}-{min(k + CHUNK, 1000) - 1}" for k in range(0, 1000, CHUNK)], "each once, in order"


async def test_a_program_shorter_than_the_look_ahead_is_no_starvation(fake: FakeCell) -> None:
    assert await whole_pass(fake, small_plan(6, 1, 1), 60.0) == [1, 2, 3, 4]


async def test_a_robot_that_holds_less_than_the_look_ahead_starts_when_it_is_full(fake: FakeCell) -> None:
    fake.robot.block_s = 0.0002  # a chunk is 26 ms, the look-ahead 40 ms, and 10 ms must be left in contact
    fake.robot.takes = CHUNK
    with pytest.raises(SafetyStop, match="cannot keep up"):
        await whole_pass(fake, small_plan(1000), 0.04)
    assert fake.robot.done > 3, "the approach was run; then it starves, since the rest is never taken"


async def test_a_robot_that_holds_too_little_to_lift_in_is_refused_before_it_moves(fake: FakeCell) -> None:
    fake.robot.block_s = 0.00005
    fake.robot.takes = CHUNK
    with pytest.raises(DeviceRefused, match=r"buffers 0\.01 s of motion; .* nothing was moved"):
        await whole_pass(fake, small_plan(1000), 0.04)
    assert fake.robot.done == 0


async def test_starvation_ends_the_pass_while_there_still_is_motion(fake: FakeCell) -> None:
    fake.robot.takes = 2 * CHUNK
    fake.robot.block_s = 0.01
    seqs: list[int] = []
    with pytest.raises(SafetyStop, match=r"only 0\.\d+ s of motion are left in the robot at block 256"):
        await whole_pass(fake, small_plan(1000), 1.0, seqs.append)
    assert seqs == list(range(3, len(seqs) + 3))
    assert 0.2 < fake.robot.buffer_s < 0.25


@pytest.mark.parametrize("error", [LinkError("the wire is cut"), DeviceRefused("block 128 is out of order")])
async def test_an_error_of_the_feeder_comes_out_as_itself(fake: FakeCell, error: Exception) -> None:
    fake.robot.block_s = 0.01

    def cut() -> None:
        if len(fake.robot.loaded) >= 4 * CHUNK:
            fake.robot.acts.fails["send"] = error

    fake.robot.acts.before["send"] = cut
    with pytest.raises(type(error), match=str(error)):
        await whole_pass(fake, small_plan(1000))
    assert 3 < fake.robot.done < 4 * CHUNK


async def test_a_program_that_the_robot_refuses(fake: FakeCell) -> None:
    fake.robot.acts.fails["prepare"] = DeviceRefused("too long")
    with pytest.raises(DeviceRefused, match="too long"):
        await whole_pass(fake, small_plan())
    assert fake.events == ["robot.prepare"]


@pytest.mark.parametrize("at", [1, 9, 19])
async def test_a_program_that_ends_early(fake: FakeCell, at: int) -> None:
    fake.robot.ends_at = at
    with pytest.raises(DeviceFault, match=rf"ended the program at block {at} of \d+ \(done: fake\)"):
        await whole_pass(fake, small_plan())


async def test_an_error_in_the_block_comes_out_as_itself(fake: FakeCell) -> None:
    with pytest.raises(KeyError, match="mine"):
        async with streaming(small_plan(), fake.robot, fake.clock, 1.0, least_s=0.25):
            raise KeyError("mine")


async def test_a_robot_that_stands_in_contact(fake: FakeCell) -> None:
    task = asyncio.ensure_future(whole_pass(fake, small_plan()))
    fake.robot.acts.before["resume"] = lambda: setattr(fake.robot, "stands", fake.robot.done >= 3)
    await time_passes(fake, 5.0, task)
    with pytest.raises(SafetyStop, match=r"stands at block 3 of 18 \(held: fake\)"):
        await task
    assert fake.clock.at_s < 0.3 + (STANDS + 3) * WATCH_S, "found soon"


async def test_a_robot_that_waits_at_a_landing_point_does_not_stand(fake: FakeCell) -> None:
    async with streaming(small_plan(), fake.robot, fake.clock, 1.0, least_s=0.25) as stream:
        await stream.approach()
        landing = asyncio.get_running_loop().create_future()
        await time_passes(fake, 10.0, landing)
        assert [block.seq async for block in stream.polish()] == list(range(3, 18))
        await time_passes(fake, 10.0, landing)
        await stream.retreat()


async def test_a_robot_that_falls_silent_while_it_is_watched(fake: FakeCell) -> None:
    task = asyncio.ensure_future(whole_pass(fake, small_plan()))
    fake.robot.acts.before["resume"] = lambda: setattr(fake.robot, "stands", True)
    fake.robot.acts.fails["progress"] = LinkError("robot: silent")
    await time_passes(fake, 5.0, task)
    with pytest.raises(LinkError, match="silent"):
        await task


async def test_cancelled_amid_a_pass_nothing_more_is_sent(fake: FakeCell) -> None:
    fake.robot.block_s = 0.01
    task = asyncio.ensure_future(whole_pass(fake, small_plan(1000)))

    def cancel() -> None:
        if len(fake.robot.loaded) >= 3 * CHUNK:
            task.cancel()

    fake.robot.acts.before["send"] = cancel
    with pytest.raises(asyncio.CancelledError):
        await task
    count = len(fake.events)
    fake.clock.advance(100.0)
    await asyncio.sleep(0)
    assert len(fake.events) == count


async def test_why_it_ends_is_reported_before_the_block_has_ended(fake: FakeCell) -> None:
    """Contact is left inside the block, and takes its time."""
    order: list[str] = []

    def ended(task: asyncio.Task[None]) -> None:
        if not task.cancelled():
            order.append(str(task.exception()))

    async def lifting() -> None:
        async with streaming(small_plan(), fake.robot, fake.clock, 1.0, least_s=0.25, ended=ended):
            try:
                fake.robot.acts.fails["progress"] = LinkError("unplugged")
                await asyncio.Event().wait()
            finally:
                order.append("lifted")

    task = asyncio.ensure_future(lifting())
    await time_passes(fake, 5.0, task)
    with pytest.raises(LinkError, match="unplugged"):
        await task
    assert order == ["unplugged", "lifted"]
