"""The driver of ABB robots at a controller in this process: what operators, other clients and a lost link do."""

from __future__ import annotations

import asyncio
import itertools
import time
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import asynccontextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from polishd.api import DeviceFault, DeviceRefused, ExecutedBlock, ProtocolError, RobotTimes
from polishd.config.simulator_faults import FaultSection
from polishd.drivers.abb_rws.driver import AbbRobot, Tasks
from polishd.drivers.abb_rws.services import RwsServices
from tests.fakes import abb_rws
from tests.fakes.abb_rws import FakeAbb, rapid_move
from tests.programs import plan_of
from tests.time_limits import SOON_S

TIMES = RobotTimes(silence_s=2.0, watchdog_s=8.0, lifts=False)
SPEED = 0.5
"""Speed of the controller's clock: a program of 60 blocks lasts 4 s."""
STOPPED = [{"_type": "rap-execution", "_title": "execution", "ctrlexecstate": "stopped"}]


@asynccontextmanager
async def robot_at(
    folder: Path, times: RobotTimes = TIMES, *, has_watch: bool = True, subscribes: bool = True
) -> AsyncIterator[tuple[AbbRobot, FakeAbb]]:
    fake = await FakeAbb(folder, speed=SPEED, has_watch=has_watch).start()
    robot = AbbRobot(fake.account, times, subscribes=subscribes)
    await robot.open()
    try:
        yield robot, fake
    finally:
        await robot.close()
        await fake.close()


async def run(robot: AbbRobot, blocks: int = 60) -> None:
    plan = plan_of([rapid_move(at) for at in range(blocks)])
    await robot.prepare(plan)
    await robot.send(plan.segments)
    await robot.resume()


async def executed(robot: AbbRobot, count: int) -> list[ExecutedBlock]:
    found = []
    async with asyncio.timeout(SOON_S):
        async for one in robot.executed():
            found.append(one)
            if len(found) == count:
                break
    return found


async def snapshots(robot: AbbRobot, count: int) -> None:
    """Wait for that many new ones."""
    connection = robot._connection
    last = connection.count + count
    assert await connection.until(lambda: connection.count >= last, SOON_S)


async def until(condition: Callable[[], bool]) -> None:
    async with asyncio.timeout(SOON_S):
        while not condition():  # noqa: ASYNC110 -- the machine sends no event
            await asyncio.sleep(0.01)


@pytest.mark.full
@pytest.mark.parametrize(
    ("button", "why"), [("emergency stop", "emergency stop is pressed"), ("manual", "manual mode")]
)
async def test_an_operators_stop_is_a_fault_with_its_name(tmp_path: Path, button: str, why: str) -> None:
    async with robot_at(tmp_path) as (robot, fake):
        await run(robot)
        await executed(robot, 3)
        fake.controller.press(button, time.monotonic())
        with pytest.raises(DeviceFault, match=why):
            await executed(robot, 60)
        await robot.hold()
        assert fake.stands
        with pytest.raises(DeviceRefused, match=why):
            await run(robot)
        fake.controller.press(button, time.monotonic())
        assert fake.stands, "switched back, it stands until it is commanded"
        await robot._connection.until(lambda: not robot._connection.last.obstacle())
        await run(robot, 5)
        assert len(await executed(robot, 5)) == 5


async def test_a_stop_by_another_client_is_seen(tmp_path: Path) -> None:
    async with robot_at(tmp_path) as (robot, fake):
        await run(robot)
        await executed(robot, 3)
        fake.controller.stop()
        with pytest.raises(DeviceFault, match="was stopped at the controller"):
            await executed(robot, 60)


@pytest.mark.full
async def test_the_speed_ratio_is_read_and_refused_below_100(tmp_path: Path) -> None:
    async with robot_at(tmp_path) as (robot, fake):
        await run(robot)
        await executed(robot, 2)
        fake.controller.ratio = 50.0
        await robot._connection.until(lambda: robot._connection.last.speed < 1.0, SOON_S)
        assert (await robot.progress()).override == 0.5
        assert len(await executed(robot, 60)) == 60, "the robot moves on"
        await robot._connection.until(lambda: not robot._connection.last.running, SOON_S)
        with pytest.raises(DeviceRefused, match="speed ratio is 50 %"):
            await run(robot)
        fake.controller.ratio = 100.0


async def test_a_speed_ratio_of_zero_is_a_standstill(tmp_path: Path) -> None:
    async with robot_at(tmp_path) as (robot, fake):
        await run(robot)
        await executed(robot, 2)
        fake.controller.ratio = 0.0
        with pytest.raises(DeviceFault, match="speed ratio is 0 %"):
            await executed(robot, 60)


async def test_a_robot_that_stands_and_says_it_runs_reports_no_block(tmp_path: Path) -> None:
    async with robot_at(tmp_path) as (robot, fake):
        await run(robot)
        await executed(robot, 2)
        fake.controller.override.suffer(FaultSection(device="robot", what="stand", at_s=0.0), on=True)
        await until(lambda: fake.controller.motion.pace == 0.0)
        await snapshots(robot, 2)
        before = (await robot.progress()).executed
        await snapshots(robot, 3)
        assert (await robot.progress()).executed == before
        assert (await robot.progress()).state == "running"


@pytest.mark.parametrize(
    "subscribes", [pytest.param(True, id="subscription"), pytest.param(False, id="polling", marks=pytest.mark.full)]
)
async def test_a_robot_that_moves_after_its_program_has_stopped_is_waited_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, subscribes: bool
) -> None:
    """The controller reports at once that nothing runs, and brakes after the third reading of its joints."""
    async with robot_at(tmp_path, subscribes=subscribes) as (robot, fake):
        await run(robot)
        await executed(robot, 3)
        read = fake.service._jointtarget
        count = itertools.count(1)

        def read_and_brake() -> Mapping[str, Any]:
            if next(count) == 3:
                fake.controller.stop()
            return read()

        monkeypatch.setattr(fake.service, "_jointtarget", read_and_brake)
        monkeypatch.setattr(fake.service, "_execution", lambda *_: STOPPED)
        await robot.close()
        await robot.make_safe()
        assert fake.stands


@pytest.mark.full
async def test_a_robot_that_moves_on_without_a_program_is_a_fault(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with robot_at(tmp_path, replace(TIMES, stop_s=0.5)) as (robot, fake):
        await run(robot)
        await executed(robot, 3)
        monkeypatch.setattr(fake.service, "_execution", lambda *_: STOPPED)
        with pytest.raises(DeviceFault, match=r"still moving 0\.5 s after stop"):
            await robot.make_safe()
        assert not (await robot.status()).safe


async def test_a_mechanical_unit_that_the_controller_does_not_have_is_named(tmp_path: Path) -> None:
    fake = await FakeAbb(tmp_path).start()
    robot = AbbRobot(fake.account, TIMES, Tasks(unit="ROB_7"))
    try:
        with pytest.raises(DeviceRefused, match=r"Correct robot\.mechanical_unit, ROB_7"):
            await robot.open()
    finally:
        await fake.close()


@pytest.mark.full
async def test_without_heartbeats_the_background_task_stops_the_motion(tmp_path: Path) -> None:
    times = replace(TIMES, silence_s=0.5, watchdog_s=1.0)
    async with robot_at(tmp_path, times) as (robot, fake):
        await run(robot, 200)
        await executed(robot, 3)
        await robot.close()
        await until(lambda: fake.controller.move_stopped)
        assert "watchdog" in fake.events
        await until(lambda: fake.controller.motion.state != "running")
        await robot.open()
        await robot.make_safe()
        assert fake.stands
        await run(robot, 5)
        assert len(await executed(robot, 5)) == 5, "prepare allows motion again"


async def test_a_controller_without_the_background_task_is_refused_before_motion(tmp_path: Path) -> None:
    async with robot_at(tmp_path, has_watch=False) as (robot, _):
        with pytest.raises(DeviceRefused, match=r"T_POLISHD does not answer.*polishd_watch\.mod"):
            await robot.prepare(plan_of([rapid_move(0)]))


async def test_a_background_task_that_does_not_take_the_limit_is_refused_before_motion(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(abb_rws, "WATCH", abb_rws.WATCH.replace(b"tripped,polishd_limit]", b"tripped,0]"))
    async with robot_at(tmp_path) as (robot, fake):
        plan = plan_of([rapid_move(0)])
        await robot.prepare(plan)
        with pytest.raises(DeviceRefused, match=r"reports a limit of 0 s .*polishd wrote 8 s .*robot\.watchdog_s"):
            await robot.send(plan.segments)
        assert fake.stands


@pytest.mark.full
async def test_a_limit_that_another_client_changes_ends_the_program_and_the_next_one_writes_it_again(
    tmp_path: Path,
) -> None:
    async with robot_at(tmp_path) as (robot, fake):
        await run(robot)
        await executed(robot, 3)
        await robot._connection.link.write(robot._tasks.watched("polishd_limit"), "0")
        with pytest.raises(DeviceFault, match="reports a limit of 0 s"):
            await executed(robot, 60)
        await robot.hold()
        assert fake.stands
        with pytest.raises(DeviceRefused, match="is over"):
            await robot.resume()
        await run(robot, 5)
        assert len(await executed(robot, 5)) == 5


async def test_a_limit_that_is_changed_before_the_start_refuses_it(tmp_path: Path) -> None:
    async with robot_at(tmp_path) as (robot, _):
        plan = plan_of([rapid_move(0)])
        await robot.prepare(plan)
        await robot.send(plan.segments)
        link = robot._connection
        await link.link.write(robot._tasks.watched("polishd_limit"), "60")
        await link.until(lambda: link.last.limit_s == 60.0, SOON_S)
        with pytest.raises(DeviceRefused, match="reports a limit of 60 s"):
            await robot.resume()


async def test_a_module_that_the_controller_cannot_read_is_refused_by_its_block(tmp_path: Path) -> None:
    async with robot_at(tmp_path) as (robot, fake):
        plan = plan_of([rapid_move(0), b"SpindleOn;", rapid_move(1)])
        await robot.prepare(plan)
        with pytest.raises(DeviceRefused, match=r"unknown entity spindleon.*block 1"):
            await robot.send(plan.segments)
        assert fake.stands


async def test_another_clients_mastership_is_refused(tmp_path: Path) -> None:
    async with robot_at(tmp_path) as (robot, fake):
        other = RwsServices(fake.account, 2.0)
        await other.open()
        await other._post("/rw/mastership/rapid?action=request", {})
        plan = plan_of([rapid_move(0)])
        await robot.prepare(plan)
        with pytest.raises(DeviceRefused, match="another client holds the mastership"):
            await robot.send(plan.segments)
        await other.close()


async def test_a_wrong_password_is_refused(tmp_path: Path) -> None:
    fake = await FakeAbb(tmp_path).start()
    robot = AbbRobot(replace(fake.account, password="wrong"), TIMES)
    with pytest.raises(DeviceRefused, match="refuses user 'Default User'"):
        await robot.open()
    await fake.close()


@pytest.mark.full
async def test_a_reopened_link_follows_the_program_that_still_runs(tmp_path: Path) -> None:
    async with robot_at(tmp_path) as (robot, _):
        await run(robot)
        await executed(robot, 3)
        await robot.close()
        await robot.open()
        assert len(await executed(robot, 60)) == 60


@pytest.mark.full
async def test_blocks_last_as_long_as_the_program_says_and_a_hold_counts_for_none(tmp_path: Path) -> None:
    async with robot_at(tmp_path) as (robot, fake):
        await run(robot, 40)
        await executed(robot, 12)
        await robot.hold()
        assert fake.stands
        await asyncio.sleep(2.0)
        await robot.resume()
        found = await executed(robot, 40)
        moves = fake.controller.motion.executed
        # the traps' delay is up to 12 ms; a hold is known to a cycle of the background task and of this process
        assert found[-1].end_s - found[0].end_s == pytest.approx(moves[39][2] - moves[0][2], abs=0.3)


@pytest.mark.one_of_each
@pytest.mark.parametrize(
    "resource", ["execution", "opmode", "speedratio", "polishd_stop", "polishd_seen", "polishd_state"]
)
async def test_an_answer_that_comes_again_behind_the_next_request_is_not_taken_for_that(
    tmp_path: Path, resource: str
) -> None:
    kept, struck = list[bytes](), list[bytes]()

    def again(data: bytes) -> list[bytes]:
        if kept:
            return [kept.pop(), data]
        if resource.encode() in data and not struck:
            struck.append(data)
            kept.append(data)
        return [data]

    async with robot_at(tmp_path, subscribes=False) as (robot, fake):
        await run(robot)
        await executed(robot, 3)
        before = robot._connection.last
        fake.filter = again
        with pytest.raises(ProtocolError, match=r"another request's|has no|neither|without a request"):
            await robot._connection.until(lambda: False, SOON_S)
        last = robot._connection._report
        assert struck
        assert (last.token, last.mode, last.state, last.speed, last.tripped) == (
            before.token,
            "AUTO",
            "motoron",
            1.0,
            False,
        )
        assert before.count <= last.count <= before.count + 60
        assert last.stop == before.stop


async def test_an_answer_that_comes_twice_ends_the_link(tmp_path: Path) -> None:
    async with robot_at(tmp_path) as (robot, fake):
        fake.filter = lambda data: [data, data]
        with pytest.raises(ProtocolError, match="bytes came without a request"):
            await robot._connection.until(lambda: False, SOON_S)
