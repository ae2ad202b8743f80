"""The driver at a controller that is the simulator's machine: modes, override, stops, links, and what it refuses."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from polishd.api import DeviceFault, DeviceRefused, LinkError
from polishd.drivers.kuka_kvp import driver
from polishd.drivers.kuka_kvp.driver import TIMER_S, KukaRobot
from polishd.drivers.kuka_kvp.protocol import KvpLink
from polishd.drivers.transport.address import Tcp
from tests.fakes.kuka import TIMES, FakeKuka, krl, kuka_robot
from tests.programs import plan_of

LINES = [krl(at) for at in range(40)]
SLOW = [b"$VEL.CP=0.001", *LINES]


@pytest.fixture
async def fake(tmp_path: Path) -> AsyncIterator[FakeKuka]:
    found = await FakeKuka(tmp_path).start()
    yield found
    await found.close()


@pytest.fixture
async def robot(fake: FakeKuka) -> AsyncIterator[KukaRobot]:
    found = kuka_robot(fake)
    await found.open()
    yield found
    await found.close()


async def prepared(robot: KukaRobot, lines: list[bytes], beside: bytes = b"") -> None:
    plan = plan_of(lines)
    plan = replace(plan, program=replace(plan.program, beside=beside))
    await robot.prepare(plan)
    await robot.send(plan.segments)


async def executed(robot: KukaRobot, count: int) -> int:
    found = 0
    async for _ in robot.executed():
        found += 1
        if found == count:
            break
    return found


async def until(condition: Callable[[], Any]) -> None:
    async with asyncio.timeout(20.0):
        while not condition():  # noqa: ASYNC110 -- the machine sends no event
            await asyncio.sleep(0.01)


async def test_selecting_and_starting_the_module_moves_nothing(fake: FakeKuka, robot: KukaRobot) -> None:
    await prepared(robot, LINES)
    assert (fake.machine.state, fake.machine.name) == ("#P_ACTIVE", "POLISHD")
    await asyncio.sleep(0.2)
    assert fake.stands
    assert (await robot.progress()).state == "held"


async def test_it_says_who_it_is(robot: KukaRobot) -> None:
    found = await robot.identify()
    assert (found.vendor, found.model, found.serial) == ("KUKA", "KR10R1100SIXX_SIM", "970001")
    assert int(found.boot_id) > 0


HAPPENS: dict[str, tuple[Callable[[FakeKuka], object], str]] = {
    "manual mode": (lambda fake: fake.machine.turn_to_manual(), "mode T1"),
    "emergency stop": (lambda fake: fake.machine.emergency_stop(), "a stop message is active"),
    "override": (lambda fake: fake.machine.write("$OV_PRO", 50), "override is at 50 %"),
    "stop key": (lambda fake: fake.machine.stop(), "stopped at the controller"),
}


@pytest.mark.parametrize("what", HAPPENS)
async def test_what_an_operator_does_in_motion_is_a_fault_at_once(fake: FakeKuka, robot: KukaRobot, what: str) -> None:
    happens, said = HAPPENS[what]
    await prepared(robot, SLOW)
    await robot.resume()
    await executed(robot, 3)
    happens(fake)
    with pytest.raises(DeviceFault, match=said):
        async with asyncio.timeout(2.0):
            await executed(robot, len(SLOW))
    await robot.make_safe()
    assert fake.stands


def select_another(fake: FakeKuka, *, runs: bool = False) -> None:
    (fake.folder / "cell.src").write_text("DEF CELL( )\nWAIT SEC 60\nEND\n")
    fake.select("/R1/CELL", lambda _code: None)
    assert not runs or fake.machine.start()


def stop_submit(fake: FakeKuka) -> None:
    fake.machine._submit, fake.machine.values["$PRO_STATE0"] = None, "#P_STOP"


WRONG: dict[str, tuple[Callable[[FakeKuka], object], str]] = {
    **{name: HAPPENS[name] for name in ("manual mode", "emergency stop", "override")},
    "override 0": (lambda fake: fake.machine.write("$OV_PRO", 0), "override is at 0 % .set it to 100 %"),
    "drives off": (lambda fake: setattr(fake.machine, "drives_on", False), "drives are off .switch them on"),
    "another program selected": (select_another, "program CELL is selected .deselect it at the pendant"),
    "another program runs": (partial(select_another, runs=True), "program CELL is selected"),
    "submit interpreter": (stop_submit, "submit interpreter does not run .select and start SPS"),
}


@pytest.mark.parametrize("what", WRONG)
async def test_a_controller_in_the_wrong_state_is_refused_before_it_gets_a_program(
    fake: FakeKuka, robot: KukaRobot, what: str
) -> None:
    happens, said = WRONG[what]
    happens(fake)
    before = (fake.machine.state, fake.machine.name)
    count = robot._connection.count
    await until(lambda: robot._connection.count > count + 2)
    with pytest.raises(DeviceRefused, match=said):
        await robot.prepare(plan_of(LINES))
    assert (fake.machine.state, fake.machine.name) == before
    assert not (await robot.status()).ready


async def test_without_its_watchdog_a_program_is_refused_at_once(fake: FakeKuka) -> None:
    fake.machine._submit = None  # the interpreter runs, without a call of POLISHD_WATCH
    robot = kuka_robot(fake)
    await robot.open()
    try:
        with pytest.raises(DeviceRefused, match=r"watchdog does not run \(call POLISHD_WATCH"):
            await robot.prepare(plan_of(LINES))
    finally:
        await robot.close()


async def test_without_polishds_variables_the_link_is_refused(fake: FakeKuka) -> None:
    del fake.machine.values["POLISHD_CLOCK"]
    robot = kuka_robot(fake)
    with pytest.raises(DeviceRefused, match=r"no variable POLISHD_CLOCK\. Install polishd_watch"):
        await robot.open()


async def test_kukavarproxy_alone_is_refused(tmp_path: Path) -> None:
    fake = await FakeKuka(tmp_path, has_c3=False).start()
    robot = kuka_robot(fake)
    try:
        with pytest.raises(DeviceRefused, match="Install C3 Bridge"):
            await robot.open()
    finally:
        await robot.close()
        await fake.close()


async def test_a_line_that_the_controller_cannot_read_is_refused_and_nothing_is_selected(
    fake: FakeKuka, robot: KukaRobot
) -> None:
    with pytest.raises(DeviceRefused, match=r"does not select /R1/PROGRAM/POLISHD: general error\. Read"):
        await prepared(robot, [*LINES, b"LIN {X 1}}"])
    assert fake.machine.state == "#P_FREE"


def listed(x: float) -> bytes:
    """Return a file beside the program that declares XP1 at that x."""
    return b"DEFDAT part PUBLIC\nDECL GLOBAL E6POS XP1={X %.1f,Y 0,Z 60,A 0,B 0,C 180,S 2,T 35}\nENDDAT\n" % x


async def test_the_positions_of_the_file_beside_the_program_reach_the_robot(fake: FakeKuka, robot: KukaRobot) -> None:
    for x in (2.0, 3.0):  # the second does not go where the first went
        await prepared(robot, [b"DEF part( )", b"$VEL.CP=0.05", b"LIN XP1", b"END"], listed(x))
        await robot.resume()
        assert await executed(robot, 4) == 4
        assert fake.machine.path.pose.xyz_mm[0] == pytest.approx(x)
    await prepared(robot, LINES)
    assert b"XP1" not in (fake.folder / "polishd.dat").read_bytes()


async def test_a_name_that_nothing_declares_is_refused_and_nothing_is_delivered(
    fake: FakeKuka, robot: KukaRobot
) -> None:
    with pytest.raises(DeviceRefused, match=r"line 1: neither .* declares XHOME"):
        await prepared(robot, [b"PTP XHOME", b"LIN XP1"], listed(1.0))
    assert not list(fake.folder.iterdir())


async def test_the_controller_refuses_a_name_that_nothing_declares(
    fake: FakeKuka, robot: KukaRobot, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(driver, "require_declared", lambda _lines, _beside: None)
    with pytest.raises(DeviceRefused, match=r"does not select /R1/PROGRAM/POLISHD"):
        await prepared(robot, [b"LIN XP1"])
    assert "XP1 is not declared" in fake.complaints[0][1]


async def test_a_share_that_cannot_be_written_is_refused(fake: FakeKuka) -> None:
    fake.folder = fake.folder / "nowhere"
    robot = kuka_robot(fake)
    await robot.open()
    try:
        with pytest.raises(DeviceRefused, match=r"Check \[robot\] delivery"):
            await prepared(robot, LINES)
    finally:
        await robot.close()


@pytest.mark.full
async def test_a_lost_link_stops_the_motion_by_the_controllers_watchdog(fake: FakeKuka) -> None:
    robot = kuka_robot(fake, replace(TIMES, watchdog_s=3.0))
    await robot.open()
    await prepared(robot, SLOW)
    await robot.resume()
    await executed(robot, 3)
    fake.drop()
    with pytest.raises(LinkError):
        await executed(robot, len(SLOW))
    assert not fake.stands
    await until(lambda: fake.stands)
    assert fake.machine.state == "#P_STOP"
    assert fake.machine.program_override == 0
    await robot.make_safe()  # connects anew
    assert fake.machine.state == "#P_FREE"
    await until(lambda: fake.machine.program_override == 100)
    await robot.open()
    await prepared(robot, LINES)
    await robot.resume()
    assert await executed(robot, len(LINES)) == len(LINES)
    await robot.close()


@pytest.mark.full
async def test_it_goes_on_following_after_a_short_loss(fake: FakeKuka, robot: KukaRobot) -> None:
    await prepared(robot, SLOW)
    await robot.resume()
    await executed(robot, 3)
    fake.drop()
    with pytest.raises(LinkError):
        await executed(robot, len(SLOW))
    await robot.open()
    assert (await robot.progress()).state == "running"
    assert await executed(robot, 6) == 6
    await robot.make_safe()


async def test_a_restarted_controller_has_lost_the_program(fake: FakeKuka, robot: KukaRobot) -> None:
    await prepared(robot, SLOW)
    await robot.resume()
    await executed(robot, 3)
    fake.machine.write("POLISHD_SESSION", 5)
    with pytest.raises(LinkError, match="has restarted"):
        await executed(robot, len(SLOW))


@pytest.mark.full
async def test_the_watchdogs_timer_may_start_again_in_a_pass(fake: FakeKuka, robot: KukaRobot) -> None:
    fake.machine.write("$TIMER[16]", 1_000_000_000 - 1500)
    await prepared(robot, [line for at in range(10) for line in (krl(at), b"WAIT SEC 0.200")])
    assert robot._connection.last.time_s > TIMER_S
    await robot.resume()
    dwells = [one.end_s - one.start_s async for one in robot.executed() if one.seq % 2]
    assert dwells == pytest.approx([0.2] * 10, abs=0.02)
    assert robot._connection.last.time_s < 60.0


@pytest.mark.parametrize(
    ("before_s", "after_s", "restarted"), [(1e6, 0.0, False), (2147483.628, -2147483.648, False), (8e5, 0.0, True)]
)
async def test_a_clock_that_falls_is_a_restart_unless_its_timer_was_full(
    robot: KukaRobot, before_s: float, after_s: float, restarted: bool
) -> None:
    connection = robot._connection
    sample = replace(connection.last, time_s=before_s)
    connection._recent = (sample,)
    with pytest.raises(LinkError, match="has restarted") if restarted else contextlib.nullcontext():
        connection._require_clock(replace(sample, time_s=after_s))


async def test_a_dwell_is_executed_as_long_as_it_is_programmed(fake: FakeKuka, robot: KukaRobot) -> None:
    lines = [line for at in range(5) for line in (krl(at), b"WAIT SEC 0.200")]
    await prepared(robot, lines)
    await robot.resume()
    dwells = [one.end_s - one.start_s async for one in robot.executed() if one.seq % 2]
    assert dwells == pytest.approx([0.2] * 5, abs=0.02)


async def test_feed_timed_blocks_through_blends_last_as_long_as_programmed(fake: FakeKuka, robot: KukaRobot) -> None:
    lines = [b"$APO.CDIS=0.5", b"$VEL.CP=0.010"]
    lines += [b"LIN {X %d,Y 0,Z 60,A 0,B 0,C 180} C_DIS" % at for at in range(1, 12)]
    await prepared(robot, lines)
    await robot.resume()
    found = [one.end_s - one.start_s async for one in robot.executed() if 4 <= one.seq < 12]
    assert found == pytest.approx([0.1] * 8, abs=0.02)


@pytest.mark.full
async def test_a_snapshot_starts_nothing_while_resume_does(
    fake: FakeKuka, robot: KukaRobot, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The stop at which it stands is not wanted any more once ``resume`` has begun: two starts, the second refused."""
    await prepared(robot, LINES)
    await robot.resume(until=10)
    assert await executed(robot, 10) == 10
    await robot.hold()
    connect = KvpLink.connect

    async def late(address: Tcp, silence_s: float) -> KvpLink:
        await asyncio.sleep(0.05)  # a slow network: ten snapshots
        return await connect(address, silence_s)

    monkeypatch.setattr(KvpLink, "connect", late)
    await robot.resume()
    assert await executed(robot, len(LINES)) == len(LINES)
    assert (await robot.progress()).state == "done"
