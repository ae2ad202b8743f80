"""The driver against a controller that is cut off, stopped, paused, slowed down, or not alone.

What the robot does is asserted from the machine's side.
"""

from __future__ import annotations

import asyncio
import math
import socket
import struct
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass, replace
from itertools import pairwise

import pytest

from polishd.api import DeviceBusy, DeviceFault, DeviceRefused, ExecutedBlock, LinkError, RobotTimes
from polishd.drivers.transport.address import Tcp
from polishd.drivers.universal_robots import driver
from polishd.drivers.universal_robots.driver import UniversalRobot
from polishd.drivers.universal_robots.rtde import UrRegisters
from polishd.drivers.universal_robots.script import Settings
from polishd.sim_backends.universal_robots import arm as m
from polishd.sim_backends.universal_robots.arm import turned
from polishd.sim_backends.universal_robots.controller import UrController
from polishd.sim_backends.universal_robots.device import DATA, SET_INPUTS, VERSION, pack
from tests.fakes.universal_robot import LOOPBACK, FakeController
from tests.programs import plan_of

TIMES = RobotTimes(silence_s=1.0, watchdog_s=4.0, stop_s=4.0)
STEPS = 20
SLOW = [b"movel(p[%.3f, 0, 0.06, 3.14159, 0, 0], a=1, v=0.02)" % (0.002 * (at + 1)) for at in range(STEPS)]
"""0.12 s each."""


@dataclass
class Rig:
    fake: FakeController
    robot: UniversalRobot

    @property
    def machine(self) -> UrController:
        return self.fake.machine


def robot_at(fake: FakeController, times: RobotTimes = TIMES) -> UniversalRobot:
    return UniversalRobot(fake.addresses, Settings(UrRegisters(), times.watchdog_s), times)


@pytest.fixture
async def rig() -> AsyncIterator[Rig]:
    fake = await FakeController().start()
    robot = robot_at(fake)
    await robot.open()
    yield Rig(fake, robot)
    await robot.close()
    await fake.close()


async def load(robot: UniversalRobot, lines: list[bytes] = SLOW) -> None:
    plan = plan_of(lines)
    await robot.prepare(plan)
    await robot.send(plan.segments)


async def executed(robot: UniversalRobot, count: int = STEPS) -> list[ExecutedBlock]:
    found = []
    async for one in robot.executed():
        found.append(one)
        if len(found) == count:
            break
    return found


async def run(rig: Rig, blocks: int = 3) -> None:
    """In the middle of its program."""
    await load(rig.robot)
    await rig.robot.resume()
    await executed(rig.robot, blocks)
    assert rig.machine.active


async def confirm_at_once(_address: Tcp, _within_s: float) -> None:
    """The dashboard's stop, confirmed although nothing stops."""


async def until(condition: Callable[[], bool]) -> None:
    while not condition():  # noqa: ASYNC110 -- the machine sends no event
        await asyncio.sleep(0.005)


# What comes from the controller's side: who does it, and what the driver says of it.
FAULTS: dict[str, tuple[Callable[[UrController], object], str]] = {
    "protective stop": (UrController.protective_stop, "protective stop"),
    "emergency stop": (UrController.emergency_stop, "switched off|emergency stop"),
    "power off": (UrController.power_off, "switched off"),
    "pause": (UrController.pause, "paused at the controller"),
    "stop": (UrController.stop, "stopped at the controller"),
    "another script": (lambda machine: machine.load("def other():\n  sleep(9)\nend"), "another program"),
    "slider": (lambda machine: setattr(machine, "slider", 0.3), "speed slider is at 30 %"),
    "slider at zero": (lambda machine: setattr(machine, "slider", 0.0), "speed slider is at 0 %"),
    "started anew": (lambda machine: machine.ints_out.__setitem__(24, 0), "has restarted"),
}


@pytest.mark.one_of_each
@pytest.mark.parametrize("fault", FAULTS)
async def test_events_at_the_controller_are_reported_at_once_and_end_with_a_robot_that_stands(
    rig: Rig, fault: str
) -> None:
    happens, said = FAULTS[fault]
    await run(rig)
    before = (await rig.robot.progress()).executed
    happens(rig.machine)
    with pytest.raises(DeviceFault, match=said):
        await executed(rig.robot)
    assert (await rig.robot.progress()).state == "fault"
    assert before <= (await rig.robot.progress()).executed < STEPS
    with pytest.raises(DeviceRefused, match="over"):
        await rig.robot.resume()
    await rig.robot.make_safe()
    assert rig.machine.runtime == m.STOPPED
    assert not rig.machine.arm.moves


async def test_a_robot_slowed_down_goes_on_until_it_is_stopped(rig: Rig) -> None:
    """The tool is still on the part at this report: it must not stand still there."""
    await run(rig)
    rig.machine.slider = 0.5
    with pytest.raises(DeviceFault, match="slider"):
        await executed(rig.robot)
    assert rig.machine.runtime == m.PLAYING
    assert rig.machine.active
    await rig.robot.make_safe()
    assert rig.fake.stands


async def test_the_dashboard_serves_another_client_beside_the_driver(rig: Rig) -> None:
    """As a real one does: `ur_rtde` holds a connection as long as it lives. Each client has its own answers."""
    address = rig.fake.addresses.dashboard
    others = [await asyncio.open_connection(address.host, address.port) for _ in range(2)]

    async def asked(at: int, question: bytes) -> bytes:
        others[at][1].write(question + b"\n")
        return await asyncio.wait_for(others[at][0].readline(), TIMES.silence_s)

    try:
        for reader, _ in others:
            assert (await reader.readline()).startswith(b"Connected: Universal Robots Dashboard Server")
        await run(rig)
        assert await asked(0, b"running") == b"Program running: true\n"
        rig.fake.wires[0].drop()
        await rig.robot.make_safe()
        assert rig.machine.runtime == m.STOPPED
        assert await asked(1, b"get robot model") == b"UR5\n"
        assert await asked(0, b"running") == b"Program running: false\n"
    finally:
        for _, writer in others:
            writer.close()


async def test_a_cut_link_leaves_it_running_and_make_safe_stops_it_by_the_dashboard(rig: Rig) -> None:
    await run(rig)
    rig.fake.wires[0].drop()
    with pytest.raises(LinkError):
        await executed(rig.robot)
    assert rig.robot.buffer_s == 0.0
    assert rig.machine.active
    await rig.robot.make_safe()
    assert rig.machine.runtime == m.STOPPED
    assert not rig.machine.arm.moves
    await until(lambda: not rig.fake.clients)  # the connection that showed it is closed


async def test_a_stop_that_rtde_does_not_show_is_not_confirmed(rig: Rig) -> None:
    await run(rig)
    rig.fake.wires[0].cut()
    with pytest.raises(LinkError, match="RTDE does not show that the robot stands"):
        await rig.robot.make_safe()
    assert rig.machine.runtime == m.STOPPED, "the dashboard stopped it all the same"


async def test_a_robot_that_moves_after_the_dashboards_answer_is_waited_for(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The robot moves for five more samples of the new connection."""
    await run(rig)
    rig.fake.wires[0].drop()
    samples: list[bytes] = []

    def stop_late(data: bytes) -> list[bytes]:
        samples.extend([data] if data[2] == DATA else [])
        if len(samples) == 5:
            rig.machine.stop()
        return [data]

    monkeypatch.setattr(driver, "stop", confirm_at_once)
    rig.fake.filter = stop_late
    await rig.robot.make_safe()
    assert len(samples) > 5
    assert rig.fake.stands


@pytest.mark.full
async def test_a_robot_that_goes_on_after_the_dashboards_answer_is_a_fault(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    await run(rig)
    rig.fake.wires[0].drop()
    monkeypatch.setattr(driver, "stop", confirm_at_once)
    rig.robot._times = replace(TIMES, stop_s=0.2)
    with pytest.raises(DeviceFault, match=r"moving 0\.2 s after stop"):
        await rig.robot.make_safe()


async def test_inputs_that_another_client_writes_do_not_hinder_a_stop(rig: Rig) -> None:
    """As those of the lost link, until the controller has noticed the loss."""
    await run(rig)
    await rig.robot.close()
    await until(lambda: not rig.fake.held.by)
    with socket.create_connection((LOOPBACK, rig.fake.addresses.rtde.port)) as other:
        other.sendall(pack(VERSION, b"\0\2") + pack(SET_INPUTS, b"input_int_register_26"))
        await until(lambda: "input_int_register_26" in rig.fake.held.by)
        await rig.robot.make_safe()
    assert rig.fake.stands


@pytest.mark.full
async def test_a_link_that_comes_back_in_time_has_lost_no_block_and_moves_nothing_by_itself(rig: Rig) -> None:
    await load(rig.robot)
    await rig.robot.resume(until=6)
    await executed(rig.robot, 3)
    rig.fake.drop()
    with pytest.raises(LinkError):
        await executed(rig.robot)
    await rig.robot.open()
    found = await executed(rig.robot, 6)
    assert [one.seq for one in found] == list(range(6))
    assert all(one.end_s > one.start_s for one in found)
    await asyncio.sleep(0.2)
    assert not rig.machine.active, "it waits at the given block"
    assert rig.machine.runtime == m.PLAYING
    await rig.robot.resume()
    assert len(await executed(rig.robot)) == STEPS


@pytest.mark.full
async def test_a_program_that_hears_nothing_more_is_stopped_by_the_controller_itself(rig: Rig) -> None:
    robot = robot_at(rig.fake, replace(TIMES, watchdog_s=0.6))
    await rig.robot.close()
    await robot.open()
    await load(robot)
    await robot.resume()
    await executed(robot, 1)
    await asyncio.sleep(1.0)
    assert rig.machine.active, "heartbeats keep it"
    await robot.close()
    await until(lambda: rig.machine.runtime == m.STOPPED and not rig.machine.active)
    assert rig.machine.ints_out[25] < STEPS
    await robot.open()
    with pytest.raises(DeviceFault, match="stopped at the controller"):
        await executed(robot)
    await robot.close()


@pytest.mark.full
async def test_a_silent_controller_is_a_lost_link(rig: Rig) -> None:
    await run(rig)
    rig.fake.silent = True
    with pytest.raises(LinkError, match="silent"):
        await executed(rig.robot)
    with pytest.raises(LinkError):
        await rig.robot.make_safe()


@pytest.mark.one_of_each
@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"remote": False}, "local control"),
        ({"robot_mode": m.POWER_OFF}, "switched off"),
        ({"robot_mode": 5}, "brakes are not released"),
        ({"safety_mode": m.PROTECTIVE_STOP}, "protective stop"),
        ({"safety_mode": 2}, "reduced"),
        ({"slider": 0.99}, "speed slider is at 99 %"),
    ],
)
async def test_a_robot_that_would_not_run_it_as_written_takes_no_program(
    rig: Rig, change: dict[str, int], said: str
) -> None:
    for name, value in change.items():
        setattr(rig.machine, name, value)
    await asyncio.sleep(0.05)
    status = await rig.robot.status()
    assert not status.ready
    assert said in status.detail
    with pytest.raises(DeviceRefused, match=said):
        await rig.robot.prepare(plan_of(SLOW))
    assert rig.fake.scripts == []


async def test_what_is_sent_moves_nothing_until_it_is_started(rig: Rig) -> None:
    rig.machine.ints_in[25:29] = [1, 9999, 0, 0]
    await load(rig.robot)
    await asyncio.sleep(0.2)
    assert rig.machine.runtime == m.PLAYING
    assert not rig.machine.active
    assert rig.machine.ints_out[25] == 0


@pytest.mark.full
async def test_a_paused_foreign_program_is_stopped_first(rig: Rig) -> None:
    """A script that comes while one is paused only stops that (as reported of the real one)."""
    rig.machine.load("def other():\n  sleep(9)\nend")
    rig.machine.pause()
    await asyncio.sleep(0.3)
    await load(rig.robot)
    await rig.robot.resume()
    assert len(await executed(rig.robot)) == STEPS


async def test_a_running_foreign_program_is_left_alone_until_it_is_held(rig: Rig) -> None:
    rig.machine.load("def other():\n  movel(p[0.1, 0, 0.06, 3.14159, 0, 0], a=1, v=0.01)\nend")
    await asyncio.sleep(0.1)
    with pytest.raises(DeviceRefused, match="running"):
        await rig.robot.prepare(plan_of(SLOW))
    assert (await rig.robot.progress()).state == "running"
    await rig.robot.hold()
    assert rig.fake.stands


async def test_registers_that_another_client_writes_are_busy(rig: Rig) -> None:
    with socket.create_connection((LOOPBACK, rig.fake.addresses.rtde.port)) as other:
        await rig.robot.close()
        await until(lambda: not rig.fake.held.by)
        other.sendall(pack(VERSION, b"\0\2") + pack(SET_INPUTS, b"input_int_register_26"))
        await until(lambda: "input_int_register_26" in rig.fake.held.by)
        with pytest.raises(DeviceBusy, match="input_int_register_26"):
            await rig.robot.open()


@pytest.mark.full
async def test_a_slider_moved_over_rtde_is_noticed(rig: Rig) -> None:
    await run(rig)
    with socket.create_connection((LOOPBACK, rig.fake.addresses.rtde.port)) as other:
        other.sendall(pack(VERSION, b"\0\2") + pack(SET_INPUTS, b"speed_slider_mask,speed_slider_fraction"))
        other.sendall(pack(DATA, b"\1" + struct.pack(">Id", 1, 0.25)))
        with pytest.raises(DeviceFault, match="25 %"):
            await executed(rig.robot)


async def test_a_line_that_the_controller_cannot_read_is_named(rig: Rig) -> None:
    with pytest.raises(DeviceRefused, match=r"block 4: Compile error: name 'moveh' is not defined"):
        await load(rig.robot, [*SLOW[:4], b"moveh(1)", *SLOW[4:]])
    assert rig.machine.runtime == m.STOPPED
    assert not rig.machine.active


@pytest.mark.full
async def test_an_error_while_it_runs_ends_the_program(rig: Rig) -> None:
    await load(rig.robot, [*SLOW[:3], b"movel(p[0, 0, 0.06], a=1, v=0.1)", *SLOW[3:]])
    await rig.robot.resume()
    with pytest.raises(DeviceFault, match="stopped at the controller"):
        await executed(rig.robot)
    assert (await rig.robot.progress()).executed == 3


@pytest.mark.full
async def test_out_of_its_range_is_a_protective_stop(rig: Rig) -> None:
    await load(rig.robot, [b"movel(p[0.9, 0, 0.06, 3.14159, 0, 0], a=10, v=0.1)"])
    await rig.robot.resume()
    with pytest.raises(DeviceFault, match="protective stop"):
        await executed(rig.robot, 1)


async def test_a_dwell_that_was_held_lasts_as_long_as_it_asks_for(rig: Rig) -> None:
    await load(rig.robot, [SLOW[0], b"sleep(0.4)", SLOW[1]])
    await rig.robot.resume()
    await executed(rig.robot, 1)
    await asyncio.sleep(0.15)
    await rig.robot.hold()
    assert rig.machine.runtime == m.STOPPED
    await asyncio.sleep(0.3)
    await rig.robot.resume()
    dwell = (await executed(rig.robot, 3))[1]
    assert dwell.end_s - dwell.start_s == pytest.approx(0.4, abs=0.05)


@pytest.mark.full
async def test_a_move_that_was_held_goes_on_from_where_it_stood(rig: Rig) -> None:
    await run(rig)
    await rig.robot.hold()
    stood = rig.machine.arm.place.xyz_mm
    assert stood[0] % 2.0 > 0.01, "within a block"
    await rig.robot.resume()
    assert [one.seq for one in await executed(rig.robot)] == list(range(STEPS))
    assert rig.machine.arm.place.xyz_mm == pytest.approx((2.0 * STEPS, 0.0, 60.0), abs=1e-6)


@pytest.mark.one_of_each
@pytest.mark.parametrize("dip_rad", [0.0, 0.3])
async def test_it_lifts_along_the_tools_axis_and_never_stands_on_its_way(rig: Rig, dip_rad: float) -> None:
    lines = [b"movel(p[%.3f, 0, 0.06, %.4f, 0, 0], a=1, v=0.02)" % (x / 500, math.pi - dip_rad) for x in range(1, 20)]
    await load(rig.robot, lines)
    await rig.robot.resume()
    await executed(rig.robot, 4)
    rig.machine.rows.clear()
    begin = rig.machine.arm.place.xyz_mm
    await rig.robot.lift(15.0)
    place = rig.machine.arm.place
    up = [-part for part in turned(place.turn, (0.0, 0.0, 1.0))]
    way = [end - start for end, start in zip(place.xyz_mm, begin, strict=True)]
    assert sum(a * b for a, b in zip(way, up, strict=True)) == pytest.approx(15.0, abs=0.6)
    assert math.dist(way, [15.0 * part for part in up]) < 3.0, "what it still went along the path"
    places = [row[4:7] for row in rig.machine.rows]
    speeds = [math.dist(a, b) / 0.008 for a, b in pairwise(places)]
    assert min(speeds[: len(speeds) // 2]) > 3.0, "mm/s: it never stood on the part"
    assert (await rig.robot.progress()).detail == "lifted off the path"


@pytest.mark.full
async def test_it_lifts_only_out_of_a_program_of_its_own(rig: Rig) -> None:
    with pytest.raises(DeviceRefused, match="no program"):
        await rig.robot.lift(15.0)
    await run(rig)
    await rig.robot.hold()
    with pytest.raises(DeviceRefused, match="no program"):
        await rig.robot.lift(15.0)


async def test_times_are_the_controllers_own_within_a_sample(rig: Rig) -> None:
    """Against the machine's own rows: each block, and the sum."""
    rig.machine.rows.clear()
    await load(rig.robot, [line for move in SLOW[:8] for line in (move, b"sleep(0.1)")])
    await rig.robot.resume()
    found = await executed(rig.robot, 16)
    was = [sum(row[3] for row in rig.machine.rows if row[0] == seq) for seq in range(16)]
    measured = [one.end_s - one.start_s for one in found]
    assert measured == pytest.approx(was, abs=0.0085)
    assert sum(measured) == pytest.approx(sum(was), abs=0.0165)
