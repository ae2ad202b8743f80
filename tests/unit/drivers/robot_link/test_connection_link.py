"""The robot driver against a robot that drops, garbles, delays and restarts."""

from __future__ import annotations

import asyncio
import dataclasses
import hashlib
import random
from collections.abc import Callable, Iterable

import pytest

from polishd.api import DeviceFault, ExecutedBlock, LinkError, ProtocolError
from polishd.drivers.robot_link import driver as link_driver
from polishd.drivers.robot_link.driver import RobotLink
from polishd.drivers.transport.address import Tcp
from tests.fakes import robot as wire
from tests.programs import plan_of
from tests.time_limits import SOON_S, within
from tests.unit.drivers.conftest import PLAN, Pair


async def collect(
    robot: RobotLink, into: list[ExecutedBlock], from_seq: int = 0, when_seq_10: Callable[[], None] = lambda: None
) -> None:
    async for one in robot.executed(from_seq):
        into.append(one)
        if one.seq == 10:
            when_seq_10()


async def test_no_server_listens() -> None:
    robot = RobotLink(Tcp("127.0.0.1", 9))
    with pytest.raises(LinkError):
        await robot.open()
    with pytest.raises(LinkError):
        await robot.make_safe()
    assert robot.buffer_s == 0.0


async def test_readers_see_it_all(pair: Pair) -> None:
    robot, fake = pair
    reader = RobotLink(Tcp("127.0.0.1", fake.port), role="reader")
    await robot.prepare(PLAN)
    await robot.send(PLAN.segments[:50])
    await reader.open()
    await robot.resume(until=50)
    seen: list[ExecutedBlock] = []
    async for one in reader.executed():
        seen.append(one)
        if one.seq == 49:
            break
    assert [one.seq for one in seen] == list(range(50))
    await reader.close()


@pytest.mark.full
async def test_pings_keep_it_running(pair: Pair) -> None:
    robot, fake = pair
    fake.block_s, fake.watchdog_s = 1.8, 1.2
    await robot.prepare(PLAN)
    await robot.send(PLAN.segments[:10])
    await robot.resume()
    seen: list[ExecutedBlock] = []
    async with asyncio.timeout(SOON_S):
        async for one in robot.executed():
            seen.append(one)
            break
    assert fake.state == "running"
    assert fake.received.count(wire.PING) >= 3


async def test_a_robot_that_hears_nothing_holds(pair: Pair) -> None:
    robot, fake = pair
    fake.block_s = 0.5
    fake.watchdog_s = 0.1
    await robot.prepare(PLAN)
    await robot.send(PLAN.segments[:10])
    await robot.resume()
    async with asyncio.timeout(SOON_S):
        while fake.state == "running":  # noqa: ASYNC110
            await asyncio.sleep(0.01)
    await robot.hold()
    progress = await robot.progress()
    assert (progress.state, progress.detail) == ("held", "watchdog")


async def test_missed_records_come_after_a_reconnect(pair: Pair) -> None:
    robot, fake = pair
    await robot.prepare(PLAN)
    await robot.send(PLAN.segments[:64])
    await robot.resume(until=60)
    seen: list[ExecutedBlock] = []
    with pytest.raises(LinkError):
        await collect(robot, seen, when_seq_10=fake.drop)
    assert len(seen) > 10
    with pytest.raises(LinkError):
        await robot.progress()
    while fake.state == "running":  # noqa: ASYNC110
        await asyncio.sleep(0.01)
    await robot.open()
    async for one in robot.executed(len(seen)):
        seen.append(one)
        if one.seq == 59:
            break
    assert [one.seq for one in seen] == list(range(60))
    assert fake.state == "held"
    await robot.send(PLAN.segments[50:100])
    await robot.resume()


async def test_a_new_process_hears_it_from_the_beginning(pair: Pair) -> None:
    robot, fake = pair
    short = plan_of([b"G1"] * 30)
    await robot.prepare(short)
    await robot.send(short.segments)
    await robot.resume()
    seen: list[ExecutedBlock] = []
    await collect(robot, seen)
    await robot.close()
    other = RobotLink(Tcp("127.0.0.1", fake.port))
    await other.open()
    assert (await other.progress()).program_sha256 == short.program.sha256
    again: list[ExecutedBlock] = []
    await collect(other, again)
    assert again == seen
    await other.close()


async def test_a_restart_loses_the_program_and_says_so(pair: Pair) -> None:
    robot, fake = pair
    await robot.prepare(PLAN)
    await robot.send(PLAN.segments[:60])
    await robot.resume()
    async for one in robot.executed():
        if one.seq == 5:
            break
    before = await robot.identify()
    fake.reboot()
    with pytest.raises(LinkError):
        await collect(robot, [])
    await robot.open()
    after = await robot.identify()
    assert before.boot_id != after.boot_id
    progress = await robot.progress()
    assert (progress.state, progress.program_sha256, progress.executed) == ("idle", "", 0)
    seen: list[ExecutedBlock] = []
    await collect(robot, seen)
    assert seen == []


async def test_another_program_meanwhile_is_reported_from_its_beginning(pair: Pair) -> None:
    robot, fake = pair
    await robot.prepare(PLAN)
    await robot.send(PLAN.segments[:60])
    await robot.resume(until=20)
    async for one in robot.executed():
        if one.seq == 19:
            break
    await robot.close()
    other_plan = plan_of([b"M2"] * 30)
    other = RobotLink(Tcp("127.0.0.1", fake.port))
    await other.open()
    await other.hold()
    await other.prepare(other_plan)
    await other.send(other_plan.segments)
    await other.resume()
    await collect(other, [])
    await other.close()
    await robot.open()
    seen: list[ExecutedBlock] = []
    await collect(robot, seen)
    assert [one.seq for one in seen] == list(range(30))


async def run_through(robot: RobotLink, blocks: int) -> list[int]:
    plan = plan_of([b"G1 X%d" % at for at in range(blocks)])
    await robot.prepare(plan)
    await robot.send(plan.segments[:40])
    await robot.resume()
    seen: list[ExecutedBlock] = []
    async with asyncio.TaskGroup() as group:
        group.create_task(collect(robot, seen))
        for at in range(40, blocks, 30):
            await robot.send(plan.segments[at : at + 30])
    return [one.seq for one in seen]


@pytest.mark.one_of_each
@pytest.mark.parametrize("seed", range(5))
async def test_lost_blocks_are_sent_again(pair: Pair, monkeypatch: pytest.MonkeyPatch, seed: int) -> None:
    robot, fake = pair
    monkeypatch.setattr(link_driver, "RESEND_S", 0.05)
    monkeypatch.setattr(link_driver, "RESENDS", 20)
    monkeypatch.setattr(link_driver, "MAX_BLOCKS", 5)
    fake.window = 500
    chance = random.Random(seed)
    fake.ignores = lambda kind, payload: kind == wire.BLOCKS and chance.random() < 0.3
    await robot.prepare(PLAN)
    await robot.send(PLAN.segments)
    assert fake.lines == [segment.text for segment in PLAN.segments]


async def test_lost_accepted_is_survived(pair: Pair) -> None:
    robot, fake = pair
    chance = random.Random(7)

    def lossy(kind: int, frame: bytes) -> Iterable[bytes]:
        return [] if kind in (wire.ACCEPTED, wire.RESEND) and chance.random() < 0.5 else [frame]

    fake.outgoing = lossy
    assert await run_through(robot, 100) == list(range(100))


async def test_garbled_status_and_doubled_records_are_survived(pair: Pair) -> None:
    robot, fake = pair

    def faulty(kind: int, frame: bytes) -> Iterable[bytes]:
        if kind == wire.STATUS:
            broken = bytearray(frame)
            broken[-1] ^= 1
            return [bytes(broken), frame]
        return [frame, frame] if kind == wire.EXECUTED else [b"PL\0garbage", frame]

    fake.outgoing = faulty
    assert await run_through(robot, 100) == list(range(100))


async def test_lost_records_end_the_link_and_come_after_a_reconnect(pair: Pair) -> None:
    robot, fake = pair
    plan = plan_of([b"G1"] * 40)
    await robot.prepare(plan)
    await robot.send(plan.segments)
    lost: list[bytes] = []

    def lossy(kind: int, frame: bytes) -> Iterable[bytes]:
        if kind == wire.EXECUTED and not lost:
            lost.append(frame)
            return []
        return [frame]

    fake.outgoing = lossy
    await robot.resume()
    with pytest.raises(LinkError, match="lost on the link"):
        await collect(robot, [])
    await robot.open()
    while fake.state == "running":  # noqa: ASYNC110
        await asyncio.sleep(0.01)
    seen: list[ExecutedBlock] = []
    await collect(robot, seen)
    assert [one.seq for one in seen] == list(range(40))


async def test_a_robot_that_takes_no_blocks_is_not_asked_for_ever(pair: Pair, monkeypatch: pytest.MonkeyPatch) -> None:
    robot, fake = pair
    monkeypatch.setattr(link_driver, "RESEND_S", 0.03)
    await robot.prepare(PLAN)
    fake.ignores = lambda kind, payload: kind == wire.BLOCKS
    with pytest.raises(ProtocolError, match="does not accept block 0"):
        await robot.send(PLAN.segments[:5])
    fake.ignores = lambda kind, payload: False
    await robot.send(PLAN.segments[:5])


async def test_commands_are_sent_once(pair: Pair, monkeypatch: pytest.MonkeyPatch) -> None:
    robot, fake = pair
    monkeypatch.setattr(link_driver.RobotLinkConnection.command, "__defaults__", (0.1,))
    await robot.prepare(PLAN)
    await robot.send(PLAN.segments[:5])
    fake.ignores = lambda kind, payload: kind == wire.RESUME
    with pytest.raises(LinkError, match="no answer"):
        await robot.resume()
    assert fake.received.count(wire.RESUME) == 1


async def test_another_program_than_announced(pair: Pair) -> None:
    robot, fake = pair
    forget = fake.forget
    fake.forget = lambda sha="", blocks=0: forget("0" * 64, blocks)  # type: ignore[method-assign]
    with pytest.raises(ProtocolError, match="holds '0000"):
        await robot.prepare(PLAN)


async def test_records_come_before_the_fault(pair: Pair) -> None:
    robot, fake = pair
    await robot.prepare(PLAN)
    await robot.send(PLAN.segments[:40])
    await robot.resume()
    seen: list[ExecutedBlock] = []

    def break_down() -> None:
        fake.state, fake.detail = "fault", "servo"

    with pytest.raises(DeviceFault, match="servo"):
        await collect(robot, seen, when_seq_10=break_down)
    assert len(seen) == len(fake.done)
    status = await robot.status()
    assert (status.ready, status.safe, status.detail) == (False, False, "servo")


async def test_many_commands_at_once(pair: Pair) -> None:
    robot, fake = pair
    await robot.prepare(PLAN)
    await robot.send(PLAN.segments[:40])
    await asyncio.gather(*(robot.hold() for _ in range(5)))
    await asyncio.gather(*(robot.resume(until=0) for _ in range(5)))
    assert fake.received.count(wire.RESUME) == 5


async def test_load_names_the_program_and_the_blocks(pair: Pair) -> None:
    robot, fake = pair
    plan = plan_of([b"G1 X1 F60", b"M2", b""])
    await robot.prepare(dataclasses.replace(plan, segments=plan.segments[:2]))
    assert fake.loads[-1]["program_sha256"] == hashlib.sha256(b"G1 X1 F60\nM2\n").hexdigest()
    assert fake.loads[-1]["blocks_sha256"] == hashlib.sha256(b"G1 X1 F60\nM2\n").hexdigest()
    assert fake.loads[-1]["blocks"] == 2
    await robot.prepare(plan)
    assert fake.loads[-1]["blocks_sha256"] == hashlib.sha256(b"G1 X1 F60\nM2\n\n").hexdigest()


async def test_a_cancelled_send_goes_on_where_it_was(pair: Pair) -> None:
    robot, fake = pair
    await robot.prepare(PLAN)
    with pytest.raises(TimeoutError):
        async with asyncio.timeout(0.05):
            await robot.send(PLAN.segments[:100])
    await robot.resume()
    await robot.send(PLAN.segments[:100])
    assert fake.lines == [segment.text for segment in PLAN.segments[:100]]


async def test_sending_is_fast(pair: Pair) -> None:
    robot, fake = pair
    fake.window = 100_000
    plan = plan_of([b"G1 X%d Y12.345 F1200" % at for at in range(20_000)])
    await robot.prepare(plan)
    fake.say_all(wire.ACCEPTED, fake.accepted())
    with within(3.0):
        await robot.send(plan.segments)
    assert len(fake.lines) == 20_000
