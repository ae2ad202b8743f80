"""The Robot port, over every driver and link."""

from __future__ import annotations

import asyncio
import hashlib
from itertools import pairwise

import pytest

from polishd.api import DeviceRefused, Executed, LinkError, Plan, Robot, Segment
from tests.conformance.conftest import PROMPT_S, seen
from tests.conformance.rigs import RobotRig
from tests.patience import within
from tests.programs import plan_of


@pytest.fixture
async def opened(robot: RobotRig) -> Robot:
    await robot.device.open()
    return robot.device


async def loaded(robot: RobotRig, blocks: int) -> Plan:
    """Give the robot a program, or the first 60 blocks. The plan has it stop at 50, or LinuxCNC could not."""
    lines = robot.written([b"G1 X%d F60" % at for at in range(blocks)])
    plan = plan_of(lines, approach_blocks=min(50, blocks))
    await robot.device.prepare(plan)
    await robot.device.send(plan.segments[:60])
    return plan


async def collected(robot: Robot, from_seq: int = 0) -> list[Executed]:
    return [one async for one in robot.executed(from_seq)]


async def first(robot: Robot, count: int) -> list[Executed]:
    found = []
    async for one in robot.executed():
        found.append(one)
        if len(found) == count:
            break
    return found


async def test_it_is_a_robot(robot: RobotRig) -> None:
    assert isinstance(robot.device, Robot)


async def test_a_prepared_robot_stands_and_knows_its_program(robot: RobotRig, opened: Robot) -> None:
    plan = plan_of(robot.written([b"G1 X1 F60", b"M2"]))
    await opened.prepare(plan)
    progress = await opened.progress()
    assert progress.state == "held"
    assert progress.program_sha256 == hashlib.sha256(plan.program.text).hexdigest()
    assert (progress.accepted, progress.executed) == (0, 0)


async def test_accepted_is_not_executed(robot: RobotRig, opened: Robot) -> None:
    await loaded(robot, 40)
    progress = await opened.progress()
    assert (progress.accepted, progress.executed, progress.state) == (40, 0, "held")
    assert await collected_so_far(opened) == []


async def collected_so_far(robot: Robot) -> list[Executed]:
    found = []
    try:
        async with asyncio.timeout(0.15):
            async for one in robot.executed():
                found.append(one)  # noqa: PERF401
    except TimeoutError:
        return found
    return found


async def test_all_is_executed_in_order_and_once(robot: RobotRig, opened: Robot) -> None:
    plan = await loaded(robot, 150)
    await opened.resume()

    async def stream() -> None:
        for at in range(40, 150, 20):
            await opened.send(plan.segments[at : at + 20])

    async with asyncio.TaskGroup() as group:
        group.create_task(stream())
        executed = await collected(opened)
    assert [one.seq for one in executed] == list(range(150))
    assert all(one.end_s > one.start_s for one in executed)
    assert all(a.end_s <= b.start_s + 1e-9 for a, b in pairwise(executed))
    assert (await opened.progress()).state == "done"


async def test_executed_can_be_followed_by_many_from_anywhere(robot: RobotRig, opened: Robot) -> None:
    await loaded(robot, 40)
    await opened.resume()
    whole, rest = await asyncio.gather(collected(opened), collected(opened, 25))
    assert len(whole) == 40
    assert rest == whole[25:] == await collected(opened, 25)


async def test_it_stops_where_it_is_told(robot: RobotRig, opened: Robot) -> None:
    await loaded(robot, 40)
    await opened.resume(until=10)
    executed = await first(opened, 10)
    assert [one.seq for one in executed] == list(range(10))
    await seen(robot.safe)
    await opened.hold()
    progress = await opened.progress()
    assert (progress.state, progress.executed) == ("held", 10)
    await opened.resume()
    assert len(await collected(opened)) == 40


async def test_hold_returns_when_it_stands(robot: RobotRig, opened: Robot) -> None:
    plan = await loaded(robot, 60)
    await opened.resume()
    await first(opened, 3)
    await opened.hold()
    assert robot.safe()
    progress = await opened.progress()
    assert progress.state == "held"
    assert (await opened.status()).safe
    await opened.hold()
    assert (await opened.progress()).executed == progress.executed
    await opened.send(plan.segments)
    await opened.resume(until=50)
    assert [one.seq for one in await first(opened, 50)] == list(range(50))


async def test_it_lifts_and_the_program_is_over_or_it_refuses_and_goes_on(robot: RobotRig, opened: Robot) -> None:
    """The way out where the actuator does not lift; a machine that would have to stop first refuses."""
    await loaded(robot, 60)
    await opened.resume()
    await first(opened, 3)
    try:
        await opened.lift(15.0)
    except DeviceRefused:
        assert not robot.safe()
        return
    assert robot.safe()
    with pytest.raises(DeviceRefused):
        await opened.resume()
    assert len(await collected(await reloaded(robot))) == 40


async def reloaded(robot: RobotRig) -> Robot:
    """Ready for something new, and told to run."""
    await loaded(robot, 40)
    await robot.device.resume()
    return robot.device


async def test_it_says_how_long_it_takes(robot: RobotRig) -> None:
    times = robot.device.times
    assert 0.0 < times.silence_s < times.watchdog_s or times.watchdog_s == 0.0
    assert times.stop_s > 0.0


async def test_make_safe_stops_a_running_robot(robot: RobotRig, opened: Robot) -> None:
    await loaded(robot, 40)
    await opened.resume()
    await opened.make_safe()
    assert robot.safe()


async def test_make_safe_stops_a_running_robot_after_close(robot: RobotRig, opened: Robot) -> None:
    await loaded(robot, 40)
    await opened.resume(until=39)
    await opened.close()
    await opened.make_safe()
    assert robot.safe()


async def test_buffer_tells_what_is_ahead(robot: RobotRig, opened: Robot) -> None:
    assert opened.buffer_s == 0.0
    await loaded(robot, 40)
    await seen(lambda: opened.buffer_s > 0.0)


async def test_a_program_cannot_be_changed_while_it_runs(robot: RobotRig, opened: Robot) -> None:
    await loaded(robot, 40)
    await opened.resume()
    with pytest.raises(DeviceRefused, match="running"):
        await opened.prepare(plan_of(robot.written([b"M2"])))


async def test_a_new_program_replaces_the_old(robot: RobotRig, opened: Robot) -> None:
    await loaded(robot, 30)
    await opened.resume()
    assert len(await collected(opened)) == 30
    plan = plan_of(robot.written([b"M2"]))
    await opened.prepare(plan)
    await opened.send(plan.segments)
    await opened.resume()
    assert [one.seq for one in await collected(opened)] == [0]


async def test_nothing_runs_without_a_program(opened: Robot) -> None:
    with pytest.raises(DeviceRefused):
        await opened.resume()
    assert await collected(opened) == []


async def test_blocks_out_of_turn_are_refused(robot: RobotRig, opened: Robot) -> None:
    plan = plan_of(robot.written([b"M2"] * 5))
    await opened.prepare(plan)
    with pytest.raises(DeviceRefused, match="expects block 0"):
        await opened.send(plan.segments[1:])
    with pytest.raises(DeviceRefused, match="one by one"):
        await opened.send([plan.segments[0], plan.segments[2]])
    with pytest.raises(DeviceRefused, match="single line"):
        await opened.send([Segment(0, b"G1\nM2")])


async def test_a_bad_block_is_refused_when_it_arrives(robot: RobotRig, opened: Robot) -> None:
    plan = plan_of(robot.written([b"G1", b"?what", b"M2"]))
    await opened.prepare(plan)
    with pytest.raises(DeviceRefused, match=r"block 1|Bad character"):
        await opened.send(plan.segments)
    assert (await opened.progress()).state == "held"


async def test_everybody_who_waits_hears_of_a_cut_link(robot: RobotRig, opened: Robot) -> None:
    plan = await loaded(robot, 200)
    rest = plan.segments[60:]
    if robot.whole_file:  # nobody waits for credit
        await opened.send(rest)
        rest = ()

    async def cut() -> None:
        await asyncio.sleep(0.05)
        robot.cut()

    with within(PROMPT_S):
        async with asyncio.TaskGroup() as group:
            group.create_task(cut())
            errors = await asyncio.gather(
                collected(opened), *([opened.send(rest)] if rest else []), return_exceptions=True
            )
    assert {type(error) for error in errors} == {LinkError}
    assert opened.buffer_s == 0.0
