"""The stream on the simulated controller: credits, records, faults of the controller, and what is refused."""

from __future__ import annotations

import asyncio
import json
import re
import time
from collections.abc import AsyncIterator, Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from polishd.api import DeviceBusy, DeviceFault, DeviceRefused, ExecutedBlock, LinkError, Plan, RobotTimes
from polishd.drivers.fanuc_rmi.driver import FanucRmi
from polishd.drivers.fanuc_rmi.protocol import MOST_OUTSTANDING, RmiSession
from polishd.drivers.transport.address import Tcp
from polishd.model.errors import ProtocolError
from tests.fakes.fanuc_rmi import FakeFanuc
from tests.programs import plan_of
from tests.unit.drivers.fanuc_rmi.test_program import program

TIMES = RobotTimes(silence_s=1.0, held_instructions=MOST_OUTSTANDING)
WAITS = [f"WAIT {0.05:.2f}(sec) ;"] * 40


@pytest.fixture
async def fake() -> AsyncIterator[FakeFanuc]:
    found = await FakeFanuc().start()
    yield found
    await found.close()


@pytest.fixture
async def robot(fake: FakeFanuc) -> AsyncIterator[FanucRmi]:
    device = FanucRmi(Tcp("127.0.0.1", fake.port), TIMES)
    await device.open()
    yield device
    await device.close()


async def loaded(robot: FanucRmi, *body: str, timed_s: float | None = None) -> Plan:
    plan = plan_of(program(*body))
    if timed_s is not None:
        block = np.array([at for at, one in enumerate(plan.segments) if b"WAIT" in one.text])
        timed = replace(plan.program, block=block, time_s=np.full(len(block), timed_s), encoding="dwell")
        plan = replace(plan, program=timed, expected_time_s=np.full(len(block), timed_s))
    await robot.prepare(plan)
    asyncio.get_running_loop().create_task(_sent(robot, plan))
    return plan


async def _sent(robot: FanucRmi, plan: Plan) -> None:
    try:
        await robot.send(plan.segments)
    except (DeviceRefused, LinkError):
        return


async def executed(robot: FanucRmi, count: int = 10**6) -> list[ExecutedBlock]:
    found = []
    async for one in robot.executed():
        found.append(one)
        if len(found) >= count:
            break
    return found


async def until(condition: Any) -> None:
    while not condition():  # noqa: ASYNC110 -- the controller sends no event
        await asyncio.sleep(0.005)


@pytest.mark.full
async def test_at_most_eight_instructions_are_outstanding_and_all_are_executed(
    fake: FakeFanuc, robot: FanucRmi
) -> None:
    plan = await loaded(robot, *WAITS)
    await asyncio.sleep(0.1)
    assert fake.held == 0, "nothing is sent before it may run"
    assert robot.buffer_s == pytest.approx(MOST_OUTSTANDING * 0.05), "what the controller would hold"
    await robot.resume()
    found = await executed(robot)
    assert fake.most_held == MOST_OUTSTANDING
    assert [one.seq for one in found] == list(range(len(plan.segments)))
    waited = [one.end_s - one.start_s for one in found if b"WAIT" in plan.segments[one.seq].text]
    assert sum(waited) == pytest.approx(2.0, abs=0.3)
    assert sum(one.end_s - one.start_s for one in found) == pytest.approx(sum(waited)), "other lines take no time"


async def test_a_link_is_not_given_more_motion_than_the_watchdog_time(fake: FakeFanuc) -> None:
    device = FanucRmi(Tcp("127.0.0.1", fake.port), replace(TIMES, watchdog_s=2.0))
    await device.open()
    await loaded(device, *["WAIT 0.90(sec) ;"] * 6)
    await device.resume()
    await until(lambda: fake.held > 0)
    await asyncio.sleep(0.1)
    assert fake.held == 2
    await device.make_safe()
    plan = plan_of(program("WAIT 1.50(sec) ;"))
    await device.prepare(plan)
    with pytest.raises(DeviceRefused, match=r"takes 1.5 s; at most 1 s, half of robot.watchdog_s"):
        await device.send(plan.segments)
    await device.close()


@pytest.mark.full
async def test_it_moves_as_the_program_says_and_stops_before_the_block(fake: FakeFanuc, robot: FanucRmi) -> None:
    plan = await loaded(robot, *(f"L P[{number}] 50mm/sec FINE ;" for number in (1, 2, 3)))
    stop = len(plan.segments) - next(
        at for at, one in enumerate(reversed(plan.segments)) if one.text.strip().startswith(b"3:L")
    )
    await robot.resume(until=stop - 1)
    await until(lambda: len(fake.controller.motion.executed) == 2)
    await robot.hold()
    assert fake.controller.motion.pose[:3] == pytest.approx((10.0, 0.0, 3.5))
    assert (await robot.progress()).state == "held"
    await robot.resume()
    assert len(await executed(robot)) == len(plan.segments)
    assert fake.controller.motion.pose[0] == pytest.approx(20.0)


async def test_hold_pauses_within_a_wait_and_goes_on_with_its_rest(fake: FakeFanuc, robot: FanucRmi) -> None:
    plan = await loaded(robot, "WAIT 0.60(sec) ;")
    await robot.resume()
    await until(lambda: fake.controller.motion.state == "running")
    await robot.hold()
    assert (await robot.status()).safe
    count = len(fake.controller.motion.executed)
    await asyncio.sleep(0.3)
    assert len(fake.controller.motion.executed) == count
    await robot.resume()
    assert len(await executed(robot)) == len(plan.segments)


@pytest.mark.full
@pytest.mark.parametrize(
    ("button", "said"),
    [
        ("pause", "paused at the controller"),
        ("emergency stop", r"(servos|fault).*: SRVO-001 Operator panel E-stop"),
        ("teach pendant", r"(pendant|fault).*: SYST-045 TP is enabled"),
    ],
)
async def test_a_stop_at_the_controller_ends_the_program(
    fake: FakeFanuc, robot: FanucRmi, button: str, said: str
) -> None:
    await loaded(robot, *["WAIT 0.50(sec) ;"] * 10)
    await robot.resume()
    await executed(robot, 5)
    await asyncio.sleep(1.2)  # from then on a pause is another client's
    fake.controller.press(button, time.monotonic())
    with pytest.raises(DeviceFault, match=said):
        await executed(robot)
    with pytest.raises(DeviceRefused, match=r"over|pendant|servos"):
        await robot.resume()


def press(button: str) -> Callable[[FakeFanuc], None]:
    return lambda fake: fake.controller.press(button, time.monotonic())


def turn(name: str, value: object) -> Callable[[FakeFanuc], None]:
    return lambda fake: setattr(fake.controller, name, value)


MODES = {
    "emergency stop": (press("emergency stop"), r"servos are not ready \(release .*: SRVO-001 Operator panel E-stop"),
    "teach pendant": (press("teach pendant"), r"the teach pendant is enabled \(switch it off .*: SYST-045"),
    "T1": (turn("mode", "T1"), r"the controller is in T1 \(turn the mode switch to AUTO\)"),
}
AT_START = {
    "local": (turn("remote", False), r"FRC_Initialize was refused: RMIT-006.* Set the controller to remote"),
    "another frame": (turn("frame_follows", False), r"works in user frame 0 and user tool 1, the program in 1 and 2"),
}


@pytest.mark.parametrize("case", [*MODES, *AT_START])
async def test_a_controller_in_a_wrong_mode_is_refused_before_anything_moves(
    fake: FakeFanuc, robot: FanucRmi, case: str
) -> None:
    change, said = {**MODES, **AT_START}[case]
    change(fake)
    if case in MODES:
        status = await robot.status()
        assert not status.ready
        assert re.search(said, status.detail)
    with pytest.raises(DeviceRefused, match=said):
        await loaded(robot, *WAITS)
    assert fake.held == 0


@pytest.mark.parametrize(
    ("frames", "said"),
    [
        (b"UF : 30, UT : 2", r"RMIT-003, invalid user frame number .* Set up the user frame"),
        (b"UF : 1, UT : 20", r"RMIT-002, invalid user tool number .* Set up the user tool"),
    ],
)
async def test_frames_that_the_controller_lacks_are_refused_with_a_remedy(
    fake: FakeFanuc, robot: FanucRmi, frames: bytes, said: str
) -> None:
    plan = plan_of([line.replace(b"UF : 1, UT : 2", frames) for line in program("L P[1] 20mm/sec FINE ;")])
    with pytest.raises(DeviceRefused, match=said):
        await robot.prepare(plan)


async def test_a_controller_without_extended_status_is_used(fake: FakeFanuc, robot: FanucRmi) -> None:
    fake.filter = lambda data: (
        [b'{"Command":"FRC_GetExtStatus","ErrorID":2556941}\r\n'] if b"FRC_GetExtStatus" in data else [data]
    )
    assert (await robot.status()).ready


@pytest.mark.parametrize("field", ["ErrorID", "Override", "NextSequenceID"])
async def test_a_status_without_a_field_that_it_had_is_not_taken(fake: FakeFanuc, field: str) -> None:
    def without(data: bytes) -> list[bytes]:
        answers = [json.loads(line) for line in data.splitlines()]
        for answer in answers:
            if answer.get("Command") == "FRC_GetStatus":
                del answer[field]
        return [json.dumps(answer).encode() + b"\r\n" for answer in answers]

    session = RmiSession(Tcp("127.0.0.1", fake.port), TIMES)
    await session.open()
    try:
        assert (await session.status()).override == 1.0
        fake.filter = without
        with pytest.raises(ProtocolError, match=field):
            await session.status()
    finally:
        await session.close()


async def test_a_fault_without_its_text_is_reported_all_the_same(fake: FakeFanuc, robot: FanucRmi) -> None:
    await loaded(robot, *["WAIT 0.50(sec) ;"] * 10)
    await robot.resume()
    await executed(robot, 5)
    fake.filter = lambda data: [] if b"FRC_ReadError" in data else [data]
    fake.controller.press("emergency stop", time.monotonic())
    began_s = time.monotonic()
    with pytest.raises(DeviceFault, match=r"the controller reports a fault|servos are not ready"):
        await executed(robot)
    assert time.monotonic() - began_s < TIMES.silence_s


async def test_a_refused_instruction_is_named_by_its_block_and_reset_by_the_next_program(
    fake: FakeFanuc, robot: FanucRmi
) -> None:
    far = program("L P[1] 50mm/sec FINE ;", "L P[2] 50mm/sec FINE ;", x_mm=(0.0, 160.0))
    plan = plan_of(far)
    await robot.prepare(plan)
    await robot.send(plan.segments)
    await robot.resume()
    with pytest.raises(DeviceFault, match="refuses block 5: RMIT-036, the target cannot be reached"):
        await executed(robot)
    assert fake.controller.in_hold
    await loaded(robot, *WAITS[:3])
    await robot.resume()
    await executed(robot)
    assert not fake.controller.in_hold


async def test_the_override_is_reported_and_slows_the_motion(fake: FakeFanuc, robot: FanucRmi) -> None:
    assert (await robot.progress()).override == 1.0
    fake.controller.slider = 0.5
    await until(lambda: robot._poller.last.status.override == 0.5)
    assert (await robot.progress()).override == 0.5


async def test_a_program_whose_link_was_lost_is_over_and_nothing_moves_again(fake: FakeFanuc, robot: FanucRmi) -> None:
    await loaded(robot, *["WAIT 0.20(sec) ;"] * 30)
    await robot.resume()
    await until(lambda: len(fake.controller.motion.executed) >= 2)
    fake.drop_session()
    with pytest.raises(LinkError):
        await executed(robot)
    await until(lambda: fake.stands)
    done = len(fake.controller.motion.executed)
    assert done <= 2 + MOST_OUTSTANDING + 1, "what it held is all that it executes"
    await robot.open()
    assert fake.controller.program != 1, "RMI_MOVE has ended"
    with pytest.raises(DeviceFault, match="link was lost"):
        await executed(robot)
    with pytest.raises(DeviceRefused, match="is over"):
        await robot.resume()


async def test_a_second_client_is_busy(fake: FakeFanuc, robot: FanucRmi) -> None:
    with pytest.raises(DeviceBusy, match="another client"):
        await FanucRmi(Tcp("127.0.0.1", fake.port), TIMES).open()


@pytest.mark.full
async def test_buffer_is_the_planned_time_of_what_the_controller_holds(fake: FakeFanuc, robot: FanucRmi) -> None:
    body = [line for number in range(12) for line in (f"L P[{1 + number % 2}] 50mm/sec FINE ;", "WAIT 0.30(sec) ;")]
    await loaded(robot, *body, timed_s=0.5)
    await until(lambda: robot.buffer_s > 0.0)
    assert robot.buffer_s == pytest.approx(0.2 * 0.0 + 4 * 0.5, abs=0.3), "four points of 0.5 s in eight instructions"
    await robot.resume()
    await until(lambda: len(fake.controller.motion.executed) >= 6)
    assert 3 * 0.5 - 0.1 <= robot.buffer_s <= 4 * 0.5


async def test_messages_are_json_lines_that_end_with_cr_lf(fake: FakeFanuc, robot: FanucRmi) -> None:
    await loaded(robot, *WAITS[:2])
    await robot.resume()
    await executed(robot)
    assert all(line.endswith(b"\r\n") for line in fake.lines)
    sequences = [found["SequenceID"] for line in fake.lines if "SequenceID" in (found := json.loads(line))]
    assert sequences == [1, 2]


@pytest.mark.full
@pytest.mark.parametrize(("pace", "slow"), [(1.0, False), (0.5, True)])
async def test_half_speed_is_measured_while_the_controller_reports_full_speed(
    fake: FakeFanuc, robot: FanucRmi, pace: float, slow: bool
) -> None:
    await loaded(robot, "L P[1] 50mm/sec FINE ;", "L P[2] 20mm/sec FINE ;", "L P[3] 20mm/sec FINE ;")
    fake.controller.motion.set_pace(time.monotonic(), pace)
    await robot.resume()
    await executed(robot)
    progress = await robot.progress()
    assert progress.override == 1.0
    assert (progress.measured_speed is not None) == slow
    assert progress.measured_speed is None or 0.5 <= progress.measured_speed < 0.65
