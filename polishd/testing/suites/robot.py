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
    """Yield an open robot."""
    await robot.device.open()
    return robot.device


def planned(rig: RobotRig, blocks: int) -> Plan:
    """Return a plan of so many blocks, with a stop at 50 for robots that stop only at planned stops (LinuxCNC)."""
    block = rig.scope.block or pytest.skip("the scope gives no motion for the robot")
    return plan_of([block(at) for at in range(blocks)], approach_blocks=min(50, blocks))


async def loaded(rig: RobotRig, blocks: int) -> Plan:
    """Send the robot a program, or its first 60 blocks."""
    plan = planned(rig, blocks)
    await rig.device.prepare(plan)
    await rig.device.send(plan.segments[:60])
    return plan


async def collected(robot: Robot, from_seq: int = 0) -> list[ExecutedBlock]:
    """Return all executed blocks, to the end."""
    return [one async for one in robot.executed(from_seq)]


async def first_blocks(rig: RobotRig, count: int) -> list[ExecutedBlock]:
    """Return the first blocks as soon as they are executed."""
    found = []
    async with asyncio.timeout(rig.soon_s):
        async for one in rig.device.executed():
            found.append(one)
            if len(found) == count:
                break
    return found


async def collected_so_far(robot: Robot) -> list[ExecutedBlock]:
    """Return the blocks that are executed within a short time."""
    found = []
    try:
        async with asyncio.timeout(0.15):
            async for one in robot.executed():
                found.append(one)  # noqa: PERF401
    except TimeoutError:
        return found
    return found


async def test_it_is_a_robot(robot: RobotRig) -> None:
    """It has every member of Robot; ``times`` is known before ``open``."""
    assert isinstance(robot.device, Robot)


async def test_its_times_are_consistent(robot: RobotRig) -> None:
    """``times`` is known before ``open``; the robot's watchdog is longer than the silence, or 0 if it has none."""
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
    """``send`` returns when blocks are accepted: they count as accepted, none is executed, the robot stands still."""
    await loaded(robot, 40)
    progress = await opened.progress()
    assert (progress.accepted, progress.executed, progress.state) == (40, 0, "held")
    assert await collected_so_far(opened) == []


@moves
async def test_all_is_executed_in_order_and_once(robot: RobotRig, opened: Robot) -> None:
    """``executed`` yields each block once, in order, with times that do not overlap; then the state is done."""
    plan = await loaded(robot, 150)
    await opened.resume()

    async def stream() -> None:
        for at in range(40, 150, 20):  # repeated blocks are no error
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
async def test_executed_can_be_iterated_by_many_from_any_block(robot: RobotRig, opened: Robot) -> None:
    """``executed(from_seq)`` may be iterated by several callers, also later, and yields the same records to each."""
    await loaded(robot, 40)
    await opened.resume()
    whole, rest = await asyncio.gather(collected(opened), collected(opened, 25))
    assert len(whole) == 40
    assert rest == whole[25:] == await collected(opened, 25)


@moves
async def test_it_stops_at_the_given_block(robot: RobotRig, opened: Robot) -> None:
    """``resume(until=n)`` stops after block n - 1; ``resume`` continues from there."""
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
    """``hold`` returns at standstill, and may be called again; the blocks stay, and ``resume`` continues with them."""
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
async def test_it_lifts_and_ends_the_program_or_refuses_and_continues(robot: RobotRig, opened: Robot) -> None:
    """``lift`` returns at standstill off the path, and ends the program; or it raises DeviceRefused at once.

    It is used if the actuator does not lift. A machine that would have to stop first refuses, and continues.
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
    """``make_safe`` returns when the robot stands still."""
    await loaded(robot, 40)
    await opened.resume()
    await opened.make_safe()
    assert await robot.rests()


@moves
async def test_make_safe_stops_a_running_robot_after_close(robot: RobotRig, opened: Robot) -> None:
    """``make_safe`` on a closed device whose robot runs connects and stops it."""
    await loaded(robot, 40)
    await opened.resume(until=39)
    await opened.close()
    await opened.make_safe()
    assert await robot.rests()


@fresh
@moves
async def test_buffer_is_the_motion_ahead(robot: RobotRig, opened: Robot) -> None:
    """``buffer_s`` is 0 without a program, and the wall seconds of motion ahead of the tool with one."""
    assert opened.buffer_s == 0.0
    await loaded(robot, 40)

    async def is_reported() -> bool:
        return opened.buffer_s > 0.0

    await seen(is_reported, robot.soon_s)


@moves
async def test_a_program_cannot_be_changed_while_it_runs(robot: RobotRig, opened: Robot) -> None:
    """``prepare`` while the robot runs raises DeviceRefused: hold it first."""
    await loaded(robot, 40)
    await opened.resume()
    with pytest.raises(DeviceRefused, match="run"):
        await opened.prepare(planned(robot, 1))


@moves
async def test_a_new_program_replaces_the_old(robot: RobotRig, opened: Robot) -> None:
    """``prepare`` drops the old program; the new one's blocks count from 0."""
    await loaded(robot, 30)
    await opened.resume()
    assert len(await collected(opened)) == 30
    plan = planned(robot, 1)
    await opened.prepare(plan)
    await opened.send(plan.segments)
    await opened.resume()
    assert [one.seq for one in await collected(opened)] == [0]


@moves
async def test_the_next_program_follows_the_last_block(robot: RobotRig, opened: Robot) -> None:
    """``prepare`` right after the last block is executed waits for the old program's end: it does not refuse."""
    await loaded(robot, 30)
    await opened.resume()
    await first_blocks(robot, 30)
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
    """``send`` raises DeviceRefused, with the block, for blocks out of order, gaps, and blocks of several lines.

    Sending an accepted block again is no error.
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
    """``send`` raises DeviceRefused for a block that the robot cannot read, and the robot stands still."""
    good = planned(robot, 1).segments[0].text
    plan = plan_of([good, robot.scope.bad_block, good])
    await opened.prepare(plan)
    with pytest.raises(DeviceRefused):
        await opened.send(plan.segments)
    assert (await opened.progress()).state == "held"


@moves
@cuts
async def test_all_waiting_calls_end_with_a_cut_link(robot: RobotRig, opened: Robot) -> None:
    """A cut link raises LinkError in all waiting ``executed`` and ``send`` calls; ``buffer_s`` is 0."""
    plan = await loaded(robot, 200)
    rest = plan.segments[60:]
    if robot.whole_file:  # send does not wait for credit
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
