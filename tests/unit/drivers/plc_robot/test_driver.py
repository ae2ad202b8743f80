"""The handover driver at a simulated PLC's own variables: what goes wrong at the controller, and what is never done.

The link that is looked at all the time.
"""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import AsyncIterator
from dataclasses import replace
from pathlib import Path

import pytest

from polishd.api import DeviceFault, DeviceRefused, ExecutedBlock, LinkError, Plan
from polishd.config.controller_profile import ControllerProfile
from polishd.drivers.plc_robot.driver import PlcPoller, PlcRobot
from polishd.drivers.plc_robot.program_tracker import ControllerReport
from tests.fakes.plc_robot import PROFILE, Direct, FakePlc, direct
from tests.programs import plan_of
from tests.time_limits import SOON_S

SLOW = 20.0
"""Speed of the PLC's clock: a block lasts 50 ms."""


def plan(blocks: int = 60, approach: int = 5) -> Plan:
    lines = [b"G1 X%d F60" % (at + 1) for at in range(blocks - 1)]
    return replace(plan_of([*lines, b"M2"], approach_blocks=approach), contact_blocks=blocks - 5)


async def take(robot: PlcRobot, count: int, from_seq: int = 0) -> list[ExecutedBlock]:
    found: list[ExecutedBlock] = []
    async for one in robot.executed(from_seq):
        found.append(one)
        if len(found) == count:
            break
    return found


async def in_contact(robot: PlcRobot, program: Plan) -> None:
    """Opened, loaded, on the way beyond the landing."""
    await robot.open()
    await robot.prepare(program)
    await robot.send(program.segments)
    await robot.resume(until=program.approach_blocks)
    await take(robot, program.approach_blocks)
    await robot.resume(until=program.contact_blocks)
    await take(robot, program.approach_blocks + 3)


@pytest.fixture
async def rig(tmp_path: Path) -> AsyncIterator[tuple[FakePlc, PlcRobot]]:
    fake = FakePlc(tmp_path, speed=SLOW)
    async with direct(fake) as robot:
        yield fake, robot


async def seen(condition: object) -> None:
    assert callable(condition)
    while not condition():  # noqa: ASYNC110 -- the machine sends no event
        await asyncio.sleep(0.005)


async def test_it_stands_at_the_landing_when_the_approach_is_reported(rig: tuple[FakePlc, PlcRobot]) -> None:
    """The dwells of the proof are over by then: a tool that landed earlier would dig in them."""
    fake, robot = rig
    program = plan()
    await robot.open()
    await robot.prepare(program)
    await robot.send(program.segments)
    await robot.resume(until=5)
    await take(robot, 5)
    line = bytes(fake.plc.program.lines[len(fake.plc.motion.executed) - 1]) if fake.plc.program is not None else b""
    assert line.startswith(b"M0") or fake.plc.motion.path.kind[len(fake.plc.motion.executed)] == 3, line
    await seen(lambda: fake.stands)


async def test_a_feed_hold_at_the_controller_is_a_fault_at_once(rig: tuple[FakePlc, PlcRobot]) -> None:
    fake, robot = rig
    await in_contact(robot, plan())
    fake.plc.press("feed hold", time.monotonic())
    with pytest.raises(DeviceFault, match="feed is held at the controller"):
        await take(robot, 60)
    with pytest.raises(DeviceRefused, match="feed is held"):
        await robot.resume()
    fake.plc.press("feed hold", time.monotonic())


async def test_a_reader_that_runs_ahead_is_found_out_before_contact(tmp_path: Path) -> None:
    fake = FakePlc(tmp_path, speed=SLOW, read_ahead_lines=2)
    async with direct(fake) as robot:
        with pytest.raises(DeviceFault, match="not the executed block"):
            await in_contact(robot, plan())
        await robot.make_safe()
        assert fake.stands


async def test_a_silent_computer_is_noticed_by_the_controller(tmp_path: Path) -> None:
    fake = FakePlc(tmp_path, speed=SLOW, watchdog_s=0.5)
    async with direct(fake) as robot:
        await in_contact(robot, plan(400))
        await robot.close()
        await seen(lambda: fake.stands)
        assert "watchdog" in fake.events


@pytest.mark.full
async def test_nothing_starts_when_the_link_is_opened_again(rig: tuple[FakePlc, PlcRobot]) -> None:
    fake, robot = rig
    await in_contact(robot, plan())
    await robot.hold()
    executed = (await robot.progress()).executed
    await robot.close()
    fake.written.clear()
    await robot.open()
    await asyncio.sleep(0.1)
    assert fake.stands
    assert {name for values in fake.written for name in values} <= {"heartbeat"}
    assert (await robot.progress()).executed == executed
    await robot.resume(until=55)
    assert [one.seq for one in await take(robot, 55)] == list(range(55)), "and it goes on where it stood"


async def test_an_order_that_a_lost_link_left_standing_is_taken_back_before_the_next(
    rig: tuple[FakePlc, PlcRobot],
) -> None:
    fake, robot = rig
    fake.plc.inputs |= {"start": True, "load": True, "reset": True}
    await asyncio.sleep(0.02)
    await in_contact(robot, plan())
    assert not fake.stands


async def test_a_controller_that_was_started_anew_is_noticed(rig: tuple[FakePlc, PlcRobot]) -> None:
    fake, robot = rig
    await in_contact(robot, plan())
    fake.plc.boot_id = "boot-2"
    with pytest.raises(LinkError, match="has restarted"):
        await take(robot, 60)
    await robot.open()
    assert (await robot.progress()).detail == "the controller has restarted"
    with pytest.raises(DeviceRefused, match="is over"):
        await robot.resume()


async def test_an_emergency_stop_is_reported_in_the_controllers_words(rig: tuple[FakePlc, PlcRobot]) -> None:
    fake, robot = rig
    await in_contact(robot, plan())
    fake.plc.press("emergency stop", time.monotonic())
    with pytest.raises(DeviceFault, match="alarm 99: emergency stop"):
        await take(robot, 60)
    with pytest.raises(DeviceRefused, match="emergency stop"):
        await robot.prepare(plan())


@pytest.mark.parametrize("percent", [80.0, 0.0, 120.0])
async def test_another_feed_than_the_programs_is_refused(rig: tuple[FakePlc, PlcRobot], percent: float) -> None:
    fake, robot = rig
    fake.override = percent
    await robot.open()
    with pytest.raises(DeviceRefused, match="feed override is"):
        await robot.prepare(plan())


async def test_a_hold_overtakes_a_start_that_waits(rig: tuple[FakePlc, PlcRobot]) -> None:
    """The start waits until the command before it is reset; a hold meanwhile wins."""
    fake, robot = rig
    program = plan()
    await robot.open()
    await robot.prepare(program)
    await robot.send(program.segments)
    await robot.resume(until=5)
    await seen(lambda: not fake.stands)
    await robot.hold()
    starting = asyncio.create_task(robot.resume(until=5))
    await asyncio.sleep(0)
    await robot.hold()
    await starting
    await asyncio.sleep(0.3)
    assert fake.stands


async def test_the_file_is_the_program_with_pauses_and_a_proof(rig: tuple[FakePlc, PlcRobot]) -> None:
    fake, robot = rig
    program = plan(10, 3)
    await robot.open()
    await robot.prepare(program)
    await robot.send(program.segments)
    lines = (fake.folder / "polishd.nc").read_bytes().splitlines()
    assert [line for line in lines if not line.endswith(b"(polishd)")] == [one.text for one in program.segments]
    ours = [(at, line[:2]) for at, line in enumerate(lines) if line.endswith(b"(polishd)")]
    assert ours == [(3, b"G4"), (4, b"G4"), (5, b"M0"), (8, b"M0")]
    first = lines[3]
    await robot.prepare(program)
    await robot.send(program.segments)
    assert (fake.folder / "polishd.nc").read_bytes().splitlines()[3] != first, "another file has other times"


async def test_a_program_with_a_file_beside_it_is_refused(rig: tuple[FakePlc, PlcRobot]) -> None:
    plan = plan_of([b"M2"])
    await rig[1].open()
    with pytest.raises(DeviceRefused, match="delivers the program without the file beside it"):
        await rig[1].prepare(replace(plan, program=replace(plan.program, beside=b"<Database />")))


async def test_what_cannot_be_handed_over_is_refused(tmp_path: Path) -> None:
    fake = FakePlc(tmp_path)
    async with direct(fake) as robot:
        await robot.open()
        await robot.prepare(plan())
        fake.folder.chmod(0o755)
        (tmp_path / "polishd.nc").mkdir()
        with pytest.raises(DeviceRefused, match=r"polishd\.nc: .*\[robot\] delivery"):
            await robot.send(plan().segments)


def test_its_times_are_the_profiles() -> None:
    robot = PlcRobot("x", PROFILE, list, None)  # type: ignore[arg-type]
    assert (robot.times.watchdog_s, robot.times.unseen_stop_s) == (8.0, pytest.approx(0.05))
    deaf = PROFILE.variables.model_copy(update={"heartbeat": None})
    changed: ControllerProfile = PROFILE.model_copy(
        update={"watchdog_s": None, "variables": deaf, "in_motion_wired": True}
    )
    robot = PlcRobot("x", changed, list, None)  # type: ignore[arg-type]
    assert (robot.times.watchdog_s, robot.times.unseen_stop_s) == (math.inf, 0.0)


async def test_a_clock_that_stands_between_two_looks_is_no_pace_of_nothing(tmp_path: Path) -> None:
    """A busy controller renews it at every third look: what a dwell may last longer is counted in its seconds."""
    fake = FakePlc(tmp_path)
    began_s = time.monotonic()
    looks, paces = 0, []

    async def look(_: ControllerReport) -> None:
        nonlocal looks
        looks += 1
        if looks % 3 == 0:
            fake.plc.shown["clock"] = 4.0 * (time.monotonic() - began_s)
        paces.append(following.pace)

    following = PlcPoller("it", lambda: Direct(fake), PROFILE, look)
    fake.plc.shown["clock"] = 0.0
    await following.open()
    assert await following.until(lambda: looks >= 30, SOON_S)
    await following.close()
    assert min(paces[5:]) > 0.0
