"""The Robot port."""

from __future__ import annotations

import asyncio
from itertools import pairwise

import pytest
import pytest_asyncio

from polishd.api import DeviceRefused, ExecutedBlock, LinkError, Plan, Robot, Segment
from polishd.testing.device_rig import Rig, cuts, fresh, moves, rig_fixture
from polishd.testing.helpers import failure_of, is_lost, plan_of, seen, within

RobotRig = Rig[Robot]

robot = rig_fixture("robot")


@pytest_asyncio.fixture
async def opened(robot: RobotRig) -> Robot:
    """An open robot."""
    await robot.device.open()
    return robot.device


def planned(rig: RobotRig, blocks: int) -> Plan:
    """A program of so many blocks. The robot may have to stop at 50: the plan says so, or LinuxCNC could not."""
    block = rig.scope.block or pytest.skip("nothing says where the robot may move")
    return plan_of([block(at) for at in range(blocks)], approach_blocks=min(50, blocks))


async def loaded(rig: RobotRig, blocks: int) -> Plan:
    """Give the robot a program, or the first 60 blocks."""
    plan = planned(rig, blocks)
    await rig.device.prepare(plan)
    await rig.device.send(plan.segments[:60])
    return plan


async def collected(robot: Robot, from_seq: int = 0) -> list[ExecutedBlock]:
    """All that is executed, to the end."""
    return [one async for one in robot.executed(from_seq)]


async def first_blocks(rig: RobotRig, count: int) -> list[ExecutedBlock]:
    """So many, as soon as they are executed."""
    found = []
    async with asyncio.timeout(rig.soon_s):
        async for one in rig.device.executed():
            found.append(one)
            if len(found) == count:
                break
    return found


async def collected_so_far(robot: Robot) -> list[ExecutedBlock]:
    """What is executed within a moment."""
    found = []
    try:
        async with asyncio.timeout(0.15):
            async for one in robot.executed():
                found.append(one)  # noqa: PERF401
    except TimeoutError:
        return found
    return found


async def test_it_is_a_robot(robot: RobotRig) -> None:
    """It has every member of Robot, ``times`` among them, which is known before ``open``."""
    assert isinstance(robot.device, Robot)


async def test_it_says_how_long_it_takes(robot: RobotRig) -> None:
    """``times`` is known before ``open``; the robot's own watchdog is longer than the silence, or 0: it has none."""
    times = robot.device.times
    assert 0.0 < times.silence_s < times.watchdog_s or times.watchdog_s == 0.0
    assert times.stop_s > 0.0


@moves
async def test_a_prepared_robot_stands_and_knows_its_program(robot: RobotRig, opened: Robot) -> None:
    """``prepare`` announces the program and moves nothing: state held, its SHA-256, nothing accepted yet."""
    plan = planned(robot, 2)
    await opened.prepare(plan)
    progress = await opened.progress()
    assert progress.state == "held"
    assert progress.program_sha256 == plan.program.sha256
    assert (progress.accepted, progress.executed) == (0, 0)


@moves
async def test_accepted_is_not_executed(robot: RobotRig, opened: Robot) -> None:
    """``send`` returns when blocks are accepted; they are counted so, none is executed, and the robot stands."""
    await loaded(robot, 40)
    progress = await opened.progress()
    assert (progress.accepted, progress.executed, progress.state) == (40, 0, "held")
    assert await collected_so_far(opened) == []


@moves
async def test_all_is_executed_in_order_and_once(robot: RobotRig, opened: Robot) -> None:
    """``executed`` tells each block once, in order, as it is executed, with times that do not overlap; then done."""
    plan = await loaded(robot, 150)
    await opened.resume()

    async def stream() -> None:
        for at in range(40, 150, 20):  # the first of them again: that is no error
            await opened.send(plan.segments[at : at + 20])

    async with asyncio.TaskGroup() as group:
        group.create_task(stream())
        executed = await collected(opened)
    assert [one.seq for one in executed] == list(range(150))
    assert all(one.end_s >= one.start_s for one in executed)
    assert executed[-1].end_s > executed[0].start_s
    assert all(a.end_s <= b.start_s + 1e-9 for a, b in pairwise(executed))
    assert (await opened.progress()).state == "done"


@moves
async def test_executed_can_be_followed_by_many_from_anywhere(robot: RobotRig, opened: Robot) -> None:
    """``executed(from_seq)`` may be iterated by several, also after the fact, and gives each the same records."""
    await loaded(robot, 40)
    await opened.resume()
    whole, rest = await asyncio.gather(collected(opened), collected(opened, 25))
    assert len(whole) == 40
    assert rest == whole[25:] == await collected(opened, 25)


@moves
async def test_it_stops_where_it_is_told(robot: RobotRig, opened: Robot) -> None:
    """``resume(until=n)`` comes to a stop after block n - 1; ``resume`` goes on from there."""
    await loaded(robot, 40)
    await opened.resume(until=10)
    executed = await first_blocks(robot, 10)
    assert [one.seq for one in executed] == list(range(10))
    await seen(robot.rests, robot.soon_s)
    await opened.hold()
    progress = await opened.progress()
    assert (progress.state, progress.executed) == ("held", 10)
    await opened.resume()
    assert len(await collected(opened)) == 40


@moves
async def test_hold_returns_when_it_stands(robot: RobotRig, opened: Robot) -> None:
    """``hold`` returns when the robot stands, and may be called again; what was sent stays, and is gone on with."""
    plan = await loaded(robot, 60)
    await opened.resume()
    await first_blocks(robot, 3)
    await opened.hold()
    assert await robot.rests()
    progress = await opened.progress()
    assert progress.state == "held"
    assert (await opened.status()).safe
    await opened.hold()
    assert (await opened.progress()).executed == progress.executed
    await opened.send(plan.segments)
    await opened.resume(until=50)
    assert [one.seq for one in await first_blocks(robot, 50)] == list(range(50))


@moves
async def test_it_lifts_and_the_program_is_over_or_it_refuses_and_goes_on(robot: RobotRig, opened: Robot) -> None:
    """``lift`` returns when the robot stands off the path, and ends the program; or it raises DeviceRefused at once.

    It is the way out where the actuator does not lift: a machine that would have to stop first refuses, and goes on.
    """
    await loaded(robot, 60)
    await opened.resume()
    await first_blocks(robot, 3)
    try:
        await opened.lift(15.0)
    except DeviceRefused:
        assert not await robot.rests()
        return
    assert await robot.rests()
    with pytest.raises(DeviceRefused):
        await opened.resume()
    await loaded(robot, 40)
    await opened.resume()
    assert len(await collected(opened)) == 40


@moves
async def test_make_safe_stops_a_running_robot(robot: RobotRig, opened: Robot) -> None:
    """``make_safe`` returns when the robot stands."""
    await loaded(robot, 40)
    await opened.resume()
    await opened.make_safe()
    assert await robot.rests()


@moves
async def test_make_safe_stops_a_running_robot_after_close(robot: RobotRig, opened: Robot) -> None:
    """``make_safe`` on a closed device whose robot runs connects, and stops it."""
    await loaded(robot, 40)
    await opened.resume(until=39)
    await opened.close()
    await opened.make_safe()
    assert await robot.rests()


@fresh
@moves
async def test_buffer_tells_what_is_ahead(robot: RobotRig, opened: Robot) -> None:
    """``buffer_s`` is 0 without a program, and the wall seconds of motion ahead of the tool with one."""
    assert opened.buffer_s == 0.0
    await loaded(robot, 40)

    async def told() -> bool:
        return opened.buffer_s > 0.0

    await seen(told, robot.soon_s)


@moves
async def test_a_program_cannot_be_changed_while_it_runs(robot: RobotRig, opened: Robot) -> None:
    """``prepare`` while the robot runs raises DeviceRefused: it is held first."""
    await loaded(robot, 40)
    await opened.resume()
    with pytest.raises(DeviceRefused, match="run"):
        await opened.prepare(planned(robot, 1))


@moves
async def test_a_new_program_replaces_the_old(robot: RobotRig, opened: Robot) -> None:
    """``prepare`` drops the program before; the new one's blocks are counted from 0."""
    await loaded(robot, 30)
    await opened.resume()
    assert len(await collected(opened)) == 30
    plan = planned(robot, 1)
    await opened.prepare(plan)
    await opened.send(plan.segments)
    await opened.resume()
    assert [one.seq for one in await collected(opened)] == [0]


@fresh
@moves
async def test_nothing_runs_without_a_program(opened: Robot) -> None:
    """``resume`` without a program raises DeviceRefused, and ``executed`` ends at once."""
    with pytest.raises(DeviceRefused):
        await opened.resume()
    assert await collected(opened) == []


@moves
async def test_blocks_out_of_turn_are_refused(robot: RobotRig, opened: Robot) -> None:
    """Blocks come in order, without gaps, each a single line; else ``send`` raises DeviceRefused and says what it got.

    A block that was accepted and is sent again is no error.
    """
    plan = planned(robot, 5)
    await opened.prepare(plan)
    with pytest.raises(DeviceRefused, match="block 0"):
        await opened.send(plan.segments[1:])
    with pytest.raises(DeviceRefused):
        await opened.send([plan.segments[0], plan.segments[2]])
    with pytest.raises(DeviceRefused, match="line"):
        await opened.send([Segment(0, b"G1\nM2")])


@moves
async def test_a_bad_block_is_refused_when_it_arrives(robot: RobotRig, opened: Robot) -> None:
    """A block that the robot cannot read is refused by ``send``, with DeviceRefused, and the robot stands."""
    good = planned(robot, 1).segments[0].text
    plan = plan_of([good, robot.scope.bad_block, good])
    await opened.prepare(plan)
    with pytest.raises(DeviceRefused):
        await opened.send(plan.segments)
    assert (await opened.progress()).state == "held"


@moves
@cuts
async def test_everybody_who_waits_hears_of_a_cut_link(robot: RobotRig, opened: Robot) -> None:
    """A cut link raises LinkError from ``executed`` and from ``send``, whoever waits in them; ``buffer_s`` is 0."""
    plan = await loaded(robot, 200)
    rest = plan.segments[60:]
    if robot.whole_file:  # nobody waits for credit
        await opened.send(rest)
        rest = ()
    async with asyncio.TaskGroup() as group:
        following = group.create_task(failure_of(collected(opened)))
        waiting = [group.create_task(failure_of(opened.send(rest)))] if rest else []
        await asyncio.sleep(0.05)
        robot.unplug()
        with within(robot.prompt_s):
            await asyncio.wait([following, *waiting])
    assert all(is_lost(task.result()) for task in (following, *waiting))
    assert opened.buffer_s == 0.0
    with pytest.raises(LinkError):
        await opened.progress()
