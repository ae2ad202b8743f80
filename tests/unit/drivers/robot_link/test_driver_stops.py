"""Who may write to the robot, and stopping: it needs no credit, no lease, and is not undone by what was under way."""

from __future__ import annotations

import asyncio
from dataclasses import replace

import pytest

from polishd.api import DeviceBusy, DeviceFault, DeviceRefused, LinkError
from polishd.drivers.robot_link import driver
from polishd.drivers.robot_link.driver import RobotLink
from polishd.drivers.transport.address import Tcp
from tests.fakes import robot as wire
from tests.time_limits import SOON_S
from tests.unit.drivers.conftest import PLAN, Pair


async def follow(robot: RobotLink) -> int:
    """Blocks executed until that ends."""
    return len([one async for one in robot.executed()])


async def test_one_writer_only(pair: Pair) -> None:
    _, fake = pair
    second = RobotLink(Tcp("127.0.0.1", fake.port))
    with pytest.raises(DeviceBusy, match="busy"):
        await second.open()
    reader = RobotLink(Tcp("127.0.0.1", fake.port), role="reader")
    await reader.open()
    assert (await reader.progress()).state == "idle"
    with pytest.raises(DeviceRefused, match="reader"):
        await reader.prepare(PLAN)
    await reader.hold()
    await reader.close()


async def test_hold_is_known_from_status_where_its_answer_is_lost(pair: Pair, monkeypatch: pytest.MonkeyPatch) -> None:
    robot, fake = pair
    monkeypatch.setattr(driver, "HOLD_ANSWER_S", 0.1)
    fake.outgoing = lambda kind, frame: [] if kind == wire.ACK and fake.received[-1] == wire.HOLD else [frame]
    fake.block_s = 0.1
    await robot.prepare(PLAN)
    await robot.send(PLAN.segments[:30])
    await robot.resume()
    await robot.hold()
    assert fake.state == "held"


async def test_a_robot_that_does_not_stop_is_a_fault(pair: Pair, monkeypatch: pytest.MonkeyPatch) -> None:
    robot, fake = pair
    monkeypatch.setattr(driver, "HOLD_ANSWER_S", 0.1)
    robot._times = replace(robot.times, stop_s=0.2)
    fake.brake_s, fake.block_s = 60.0, 0.1
    await robot.prepare(PLAN)
    await robot.send(PLAN.segments[:30])
    await robot.resume()
    with pytest.raises(DeviceFault, match="still runs"):
        await robot.hold()


async def test_make_safe_reaches_a_robot_whose_link_was_cut(pair: Pair) -> None:
    robot, fake = pair
    fake.block_s, fake.watchdog_s = 0.1, 60.0
    await robot.prepare(PLAN)
    await robot.send(PLAN.segments[:30])
    await robot.resume()
    fake.drop()
    with pytest.raises(LinkError):
        await robot.hold()
    await robot.make_safe()
    assert fake.state == "held"
    with pytest.raises(LinkError):
        await robot.progress()


async def test_a_hold_on_its_way_is_not_undone_by_a_resume_beside_it(pair: Pair) -> None:
    robot, fake = pair
    await robot.prepare(PLAN)
    await robot.send(PLAN.segments[:40])
    held, resumed = await asyncio.gather(robot.hold(), robot.resume(), return_exceptions=True)
    assert held is None
    assert isinstance(resumed, DeviceRefused)
    assert "stale" in str(resumed)
    assert fake.state == "held"
    await robot.resume(until=40)


async def test_a_hold_from_elsewhere_makes_a_resume_stale(pair: Pair) -> None:
    robot, fake = pair
    await robot.prepare(PLAN)
    await robot.send(PLAN.segments[:40])
    fake.say_all = lambda kind, payload: None  # type: ignore[method-assign]  # so that the writer does not learn of it
    reader = RobotLink(Tcp("127.0.0.1", fake.port), role="reader")
    await reader.make_safe()
    with pytest.raises(DeviceRefused, match="stale"):
        await robot.resume()
    assert fake.state == "held"


async def test_the_lease_is_shown_on_the_next_connection(pair: Pair) -> None:
    robot, fake = pair
    await robot.close()
    await robot.open()
    reader = RobotLink(Tcp("127.0.0.1", fake.port), role="reader")
    await reader.open()
    await reader.close()
    await reader.open()
    assert [hello["lease"] for hello in fake.hellos] == ["", "lease of test", "", ""]
    await reader.close()


async def test_who_sends_hears_that_the_program_was_dropped(pair: Pair) -> None:
    robot, fake = pair
    await robot.prepare(PLAN)
    sending = asyncio.create_task(robot.send(PLAN.segments))
    while len(fake.lines) < fake.window:  # noqa: ASYNC110
        await asyncio.sleep(0)
    assert not sending.done(), "it waits for credit"
    await robot.abort()
    with pytest.raises(DeviceRefused, match="dropped"):
        async with asyncio.timeout(SOON_S):
            await sending
    assert (await robot.progress()).state == "idle"


async def test_hold_and_abort_pass_a_send_that_waits_for_credit(pair: Pair) -> None:
    robot, fake = pair
    await robot.prepare(PLAN)
    await robot.send(PLAN.segments[:40])
    await robot.resume(until=200)
    fake.block_s = 5.0
    sending = asyncio.create_task(robot.send(PLAN.segments))
    while len(fake.lines) < fake.window:  # noqa: ASYNC110
        await asyncio.sleep(0.001)
    async with asyncio.timeout(SOON_S):
        await robot.hold()
    assert fake.state == "held"
    assert not sending.done()
    sending.cancel()
    with pytest.raises(asyncio.CancelledError):
        await sending


async def test_abort_ends_what_is_followed(pair: Pair) -> None:
    robot, fake = pair
    fake.block_s = 0.05
    await robot.prepare(PLAN)
    await robot.send(PLAN.segments[:40])
    await robot.resume()
    following = asyncio.create_task(follow(robot))
    await asyncio.sleep(0)
    await robot.abort()
    await following
    assert (await robot.progress()).state == "idle"
