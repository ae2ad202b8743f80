"""The LinuxCNC driver against a server that is late, garbled, cut, in a bad state, or not alone."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass
from pathlib import Path

import pytest

from polishd.api import DeviceBusy, DeviceFault, DeviceRefused, ExecutedBlock, LinkError, ProtocolError, RobotTimes
from polishd.drivers.linuxcnc.driver import LinuxCnc
from polishd.drivers.linuxcnc.protocol import RshConnection
from polishd.drivers.transport.address import Tcp
from tests.fakes.linuxcnc import FakeLinuxCnc
from tests.fakes.wires import Once, TcpWire
from tests.programs import plan_of

BLOCKS = [b"G1 X%d F60" % at for at in range(20)]


@dataclass
class Rig:
    fake: FakeLinuxCnc
    wire: TcpWire
    robot: LinuxCnc


@pytest.fixture
async def rig(tmp_path: Path) -> AsyncIterator[Rig]:
    fake = FakeLinuxCnc()
    wire = await TcpWire(fake).start()
    robot = LinuxCnc(Tcp("127.0.0.1", wire.port), tmp_path)
    await robot.open()
    yield Rig(fake, wire, robot)
    await robot.close()
    await wire.close()


async def load(robot: LinuxCnc, approach_blocks: int = 0) -> None:
    plan = plan_of(BLOCKS, approach_blocks)
    await robot.prepare(plan)
    await robot.send(plan.segments)


async def executed(robot: LinuxCnc, count: int = len(BLOCKS)) -> list[ExecutedBlock]:
    found = []
    async for one in robot.executed():
        found.append(one)
        if len(found) == count:
            break
    return found


async def until(robot: LinuxCnc, state: str) -> None:
    while (await robot.progress()).state != state:  # noqa: ASYNC110 -- the port has only progress
        await asyncio.sleep(0.005)


def orders(fake: FakeLinuxCnc) -> list[str]:
    return [said for said in fake.received if said.startswith("set")]


OPENED = ["set echo off", "set verbose on", "set enable EMCTOO", "set set_wait received"]


async def test_opening_proves_control_and_gives_no_order(rig: Rig) -> None:
    await asyncio.sleep(0.05)
    assert orders(rig.fake) == OPENED
    assert "get enable" in rig.fake.received


async def test_it_does_not_open_where_another_client_keeps_control(rig: Rig, tmp_path: Path) -> None:
    await rig.robot.close()
    rig.fake.refuses.add("enable")
    second = LinuxCnc(Tcp("127.0.0.1", rig.wire.port), tmp_path)
    with pytest.raises(DeviceBusy, match="another client controls LinuxCNC"):
        await second.open()
    rig.fake.refuses.clear()
    rig.fake.grants = False
    with pytest.raises(DeviceBusy, match="another client controls LinuxCNC"):
        await second.open()


async def test_make_safe_takes_back_control_that_another_client_took(rig: Rig) -> None:
    await load(rig.robot)
    await rig.robot.resume()
    rig.fake.enabled = False
    await rig.robot.make_safe()
    assert rig.fake.status == "IDLE"


async def test_the_program_is_written_opened_and_interpreted_before_it_runs(rig: Rig, tmp_path: Path) -> None:
    await load(rig.robot)
    assert orders(rig.fake)[len(OPENED) :] == [
        "set abort",
        "set mode auto",
        f"set open {tmp_path}/polishd.ngc",
        "set run -1",
    ]
    assert b"\n".join(BLOCKS) in (tmp_path / "polishd.ngc").read_bytes()
    assert rig.fake.status == "IDLE"


async def test_it_is_opened_by_the_name_that_the_controller_has_for_it(tmp_path: Path) -> None:
    fake = FakeLinuxCnc()
    wire = await TcpWire(fake).start()
    robot = LinuxCnc(Tcp("127.0.0.1", wire.port), tmp_path, controller_dir="/mnt/programs")
    await robot.open()
    fake._obey = lambda name, value: None  # type: ignore[method-assign]
    await load(robot)
    assert "set open /mnt/programs/polishd.ngc" in fake.received
    await robot.close()
    await wire.close()


@pytest.mark.parametrize(("part", "value", "why"), [("estop", "ON", "e-stop"), ("machine", "OFF", "switched off")])
async def test_a_machine_that_is_off_is_neither_switched_on_nor_moved(
    rig: Rig, part: str, value: str, why: str
) -> None:
    setattr(rig.fake, part, value)
    status = await rig.robot.status()
    assert (status.ready, status.safe) == (False, True)
    assert why in status.detail
    with pytest.raises(DeviceRefused, match=why):
        await rig.robot.prepare(plan_of(BLOCKS))
    await rig.robot.make_safe()
    assert not [
        said for said in rig.fake.received if said.startswith(("set estop", "set machine", "set home", "set run"))
    ]


async def test_a_wrong_password_is_refused(rig: Rig, tmp_path: Path) -> None:
    address = Tcp("127.0.0.1", rig.wire.port)
    with pytest.raises(DeviceRefused, match="refuses hello"):
        await LinuxCnc(address, tmp_path, passwords=("WRONG", "EMCTOO")).open()
    with pytest.raises(DeviceRefused, match="another enable password"):
        await LinuxCnc(address, tmp_path, passwords=("EMC", "WRONG")).open()


async def test_an_order_that_is_refused_is_reported_and_the_link_lives(rig: Rig) -> None:
    rig.fake.refuses.add("open")
    with pytest.raises(DeviceRefused, match="set open"):
        await load(rig.robot)
    rig.fake.refuses.clear()
    await load(rig.robot)
    await rig.robot.resume()
    assert len(await executed(rig.robot)) == len(BLOCKS)


@pytest.mark.one_of_each
@pytest.mark.parametrize("lost", ["get program_line", "get time", "get operator_display"])
async def test_an_answer_that_does_not_come_ends_the_link_at_once(rig: Rig, lost: str) -> None:
    await load(rig.robot)
    await rig.robot.resume()
    rig.fake.deaf.add(lost)
    with pytest.raises(LinkError):
        await executed(rig.robot)
    with pytest.raises(LinkError):
        await rig.robot.progress()
    assert rig.robot.buffer_s == 0.0


async def test_a_late_answer_is_never_taken_for_the_next_one(rig: Rig) -> None:
    late = Once(lambda data: [])
    rig.fake.filter = late
    await late.hit.wait()
    with pytest.raises(LinkError):
        await executed_or_status(rig.robot)
    rig.fake.filter = lambda data: [data]
    await rig.robot.open()
    assert (await rig.robot.status()).ready


async def executed_or_status(robot: LinuxCnc) -> None:
    while True:
        await robot.status()
        await asyncio.sleep(0.005)


async def test_nonsense_ends_the_link(rig: Rig) -> None:
    await load(rig.robot)
    rig.fake.value = lambda name: "RUNNING" if name == "program_line" else "0"  # type: ignore[method-assign]
    with pytest.raises((ProtocolError, LinkError)):
        await executed_or_status(rig.robot)


async def test_what_is_lost_goes_on_and_make_safe_aborts_it_over_a_new_connection(rig: Rig) -> None:
    await load(rig.robot)
    await rig.robot.resume()
    await executed(rig.robot, 2)
    rig.wire.drop()
    with pytest.raises(LinkError):
        await executed(rig.robot)
    rig.fake.pass_time()
    assert rig.fake.status == "RUNNING", "LinuxCNC does not care"
    await rig.robot.make_safe()
    assert rig.fake.status == "IDLE"
    assert rig.fake.received.count("set abort") == 2
    with pytest.raises(LinkError):
        await rig.robot.progress()


async def test_a_link_that_is_opened_again_moves_nothing_and_follows_what_runs(rig: Rig) -> None:
    await load(rig.robot, approach_blocks=8)
    await rig.robot.resume()
    await executed(rig.robot, 2)
    rig.wire.drop()
    while rig.fake.status == "RUNNING":
        await asyncio.sleep(0.005)
        rig.fake.pass_time()
    before = orders(rig.fake)
    await rig.robot.open()
    await until(rig.robot, "held")
    assert (await rig.robot.progress()).executed == 8
    await asyncio.sleep(0.1)
    assert orders(rig.fake)[len(before) :] == OPENED, "it stands at the stop, and stays"
    await rig.robot.resume()
    assert len(await executed(rig.robot)) == len(BLOCKS)


async def test_an_unrequested_stop_is_passed(rig: Rig) -> None:
    await load(rig.robot, approach_blocks=8)
    await rig.robot.resume()
    found = await executed(rig.robot)
    assert [one.seq for one in found] == list(range(len(BLOCKS)))
    assert rig.fake.received.count("set resume") == 1


async def test_a_hold_at_such_a_stop_stays_a_hold(rig: Rig) -> None:
    await load(rig.robot, approach_blocks=8)
    await rig.robot.resume(until=8)
    await executed(rig.robot, 8)
    await rig.robot.hold()
    await asyncio.sleep(0.1)
    assert rig.fake.status == "PAUSED"
    assert "set resume" not in rig.fake.received


@pytest.mark.parametrize("how", ["hold", "make_safe"])
@pytest.mark.parametrize("approach_blocks", [0, 8])
async def test_a_hold_during_the_start_holds(
    rig: Rig, monkeypatch: pytest.MonkeyPatch, how: str, approach_blocks: int
) -> None:
    """By command, and past an unwanted stop: the hold overtakes the start, which is then dropped."""
    await load(rig.robot, approach_blocks)
    stays: asyncio.Queue[asyncio.Task[None]] = asyncio.Queue()
    plain = RshConnection.set_if

    async def late(self: RshConnection, wanted: Callable[[], bool], command: str) -> None:
        if (command == "set resume") == bool(approach_blocks):
            stays.put_nowait(asyncio.create_task(getattr(rig.robot, how)()))
            await asyncio.sleep(0)
        await plain(self, wanted, command)

    monkeypatch.setattr(RshConnection, "set_if", late)
    await rig.robot.resume()
    await (await stays.get())
    await asyncio.sleep(0.05)
    assert rig.fake.status != "RUNNING"
    assert rig.fake.received.count("set run") == bool(approach_blocks)
    assert "set resume" not in rig.fake.received
    assert (await rig.robot.progress()).state == "held"


async def test_it_says_where_it_can_stop(rig: Rig) -> None:
    await load(rig.robot, approach_blocks=8)
    await rig.robot.resume(until=8)
    await executed(rig.robot, 8)
    with pytest.raises(DeviceRefused, match="can stop at 8, not at block 11"):
        await rig.robot.resume(until=11)
    await rig.robot.resume(until=3)
    assert (await rig.robot.progress()).state == "held", "that is behind it"


async def test_who_aborts_at_the_controller_ends_the_program(rig: Rig) -> None:
    await load(rig.robot)
    await rig.robot.resume()
    await executed(rig.robot, 2)
    rig.fake.read_ahead, rig.fake.status = 900, "IDLE"
    rig.fake.errors.append("joint 2 following error")
    with pytest.raises(DeviceFault, match="following error"):
        await executed(rig.robot)
    assert (await rig.robot.progress()).executed < len(BLOCKS), "the line read ahead is not executed"
    with pytest.raises(DeviceRefused, match="over"):
        await rig.robot.resume()


async def test_an_aborted_program_is_not_gone_on_with(rig: Rig) -> None:
    await load(rig.robot)
    await rig.robot.resume()
    await rig.robot.make_safe()
    assert len(await executed(rig.robot)) < len(BLOCKS)
    with pytest.raises(DeviceRefused, match="aborted"):
        await rig.robot.resume()


async def test_a_machine_that_does_not_stop_is_a_fault(rig: Rig) -> None:
    rig.robot._times = RobotTimes(stop_s=0.2)
    await load(rig.robot)
    await rig.robot.resume()
    rig.fake.block_s = 1e3
    rig.fake._obey = lambda name, value: None  # type: ignore[method-assign]
    with pytest.raises(DeviceFault, match=r"moving 0\.2 s after pause"):
        await rig.robot.hold()
    with pytest.raises(DeviceFault, match=r"still runs 0\.2 s after abort"):
        await rig.robot.make_safe()
    await rig.robot.close()
    with pytest.raises(DeviceFault, match=r"still moving 0\.2 s after abort"):
        await rig.robot.make_safe()


async def test_a_program_that_stays_paused_after_an_abort_is_a_fault(rig: Rig) -> None:
    """The robot stands, but its operator could continue."""
    rig.robot._times = RobotTimes(stop_s=0.2)
    await load(rig.robot)
    await rig.robot.resume()
    await rig.robot.hold()
    rig.fake._obey = lambda name, value: None  # type: ignore[method-assign]
    with pytest.raises(DeviceFault, match=r"still runs 0\.2 s after abort"):
        await rig.robot.make_safe()


async def test_a_resume_before_the_last_block_waits_for_it(rig: Rig) -> None:
    plan = plan_of(BLOCKS)
    await rig.robot.prepare(plan)
    await rig.robot.send(plan.segments[:5])
    assert rig.robot.buffer_s == 0.0
    await rig.robot.resume()
    assert "set run" not in rig.fake.received
    await rig.robot.send(plan.segments[5:])
    assert len(await executed(rig.robot)) == len(BLOCKS)


async def test_a_hold_takes_such_a_resume_back(rig: Rig) -> None:
    plan = plan_of(BLOCKS)
    await rig.robot.prepare(plan)
    await rig.robot.resume()
    assert (await rig.robot.progress()).state == "running"
    await rig.robot.hold()
    await rig.robot.send(plan.segments)
    assert (await rig.robot.progress()).state == "held"
    assert "set run" not in rig.fake.received


async def test_a_line_too_long_for_linuxcnc_is_refused(rig: Rig) -> None:
    plan = plan_of([b"G1 X1 (" + b"x" * 300 + b")"])
    await rig.robot.prepare(plan)
    with pytest.raises(DeviceRefused, match="252"):
        await rig.robot.send(plan.segments)


async def test_a_foreign_program_is_not_disturbed(rig: Rig) -> None:
    rig.fake.lines, rig.fake.status, rig.fake.block_s = [b"G1 X1"] * 5, "RUNNING", 1e3
    await until(rig.robot, "running")
    with pytest.raises(DeviceRefused, match="running"):
        await rig.robot.prepare(plan_of(BLOCKS))
    assert rig.fake.status == "RUNNING"
