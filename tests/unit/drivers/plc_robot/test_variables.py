"""A controller's variables and deliveries in a recording, and the recording played to the driver."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Sequence
from pathlib import Path

import pytest

from polishd.api import DeviceRefused, ExecutedBlock, LinkError, Plan
from polishd.drivers.plc_robot.driver import PlcRobot
from polishd.drivers.plc_robot.variables import Recorded, RecordedDelivery
from polishd.drivers.transport.file_delivery import Delivery, Folder
from polishd.model.errors import ConfigError
from polishd.testing.replay import RecordedController, Replayed, replayed, replayed_controller
from polishd.util.wire_recording import (
    WireMessage,
    header_line,
    passed_line,
    read_recording,
    record_received,
    record_sent,
)
from tests.fakes.plc_robot import PROFILE, Direct, FakePlc, cycling
from tests.programs import plan_of
from tests.time_limits import SOON_S

LINK = "opc.tcp://plc:4840"
FOLDER = "ftp://operator@plc/programs"
BLOCKS = 20


class Refuses:
    """A Delivery whose disk is full."""

    async def put(self, name: str, text: bytes) -> None:
        raise DeviceRefused(f"{name}: no space left")


def plan() -> Plan:
    return plan_of([*(b"G1 X%d F600" % at for at in range(1, BLOCKS)), b"M2"])


def recorded(fake: FakePlc, place: Delivery) -> PlcRobot:
    delivery = RecordedDelivery(place, FOLDER)
    return PlcRobot("test PLC", PROFILE, lambda: Recorded(Direct(fake), LINK, delivery), delivery)


async def polished(robot: PlcRobot) -> list[ExecutedBlock]:
    """All of the program."""
    program = plan()
    try:
        async with asyncio.timeout(SOON_S):
            with record_sent("robot"):
                await robot.open()
            await robot.prepare(program)
            await robot.send(program.segments)
            await robot.resume()
            return [one async for one in robot.executed()]
    finally:
        await robot.close()


def written(path: Path, messages: Sequence[WireMessage]) -> Path:
    path.write_bytes(
        header_line("0", "cell", "", {}) + b"".join(passed_line(one, messages[0].at_s) for one in messages)
    )
    return path


async def played(path: Path, act: Callable[[RecordedController, Replayed], Awaitable[None]]) -> None:
    """Replay a recording; the action must end the link with an error of the driver."""
    async with replayed_controller(path, "robot") as plc:
        link = plc.variables()
        await link.open()
        with pytest.raises(LinkError, match="the recording has"):
            await act(plc, link)


async def test_values_are_recorded_and_read_again(tmp_path: Path) -> None:
    fake, messages = FakePlc(tmp_path), list[WireMessage]()
    with record_received(messages.append), record_sent("robot"):
        link = Recorded(Direct(fake), LINK, RecordedDelivery(Folder(tmp_path), FOLDER))
        await link.open()
        read = await link.read()
        await link.write({"hold": False, "heartbeat": 41})
        fake.dead = True
        with pytest.raises(LinkError):
            await link.read()
        await link.close()
    assert [one.way for one in messages] == ["open", "in", "out", "end"], "an end is recorded once"
    assert messages[-1].why
    path = written(tmp_path / "case.jsonl", messages)
    found = read_recording(path)
    assert [one.values for one in found.passed] == [None, read.values, {"hold": False, "heartbeat": 41}, None]
    assert found.passed[1].clock_s == read.time_s
    assert {(one.role, one.link) for one in found.passed} == {("robot", LINK)}
    with pytest.raises(ConfigError, match="robot is recorded as values of variables"):
        async with replayed(path, "robot"):
            pass
    async with replayed_controller(path, "robot") as plc:
        again = plc.variables()
        await again.open()
        assert await again.read() == read
        assert await again.read() == read, "another look before the next order"
        await again.write({"hold": False, "heartbeat": 41})
        with pytest.raises(LinkError, match="answers no more"):
            await again.read()


async def test_a_case_is_played_to_its_driver(tmp_path: Path) -> None:
    fake, messages = FakePlc(tmp_path), list[WireMessage]()
    with record_received(messages.append):
        async with cycling(fake):
            executed = await polished(recorded(fake, Folder(tmp_path)))
    files = [one for one in messages if one.link == "ftp://plc/programs"]
    assert [(one.role, one.way) for one in files] == [("robot", "open"), ("robot", "out"), ("robot", "end")]
    assert files[1].values is not None
    assert files[1].values["bytes"] == (tmp_path / str(files[1].values["file"])).stat().st_size
    path = written(tmp_path / "case.jsonl", messages)
    async with replayed_controller(path, "robot") as plc:
        again = await polished(PlcRobot("test PLC", PROFILE, plc.variables, plc))
    assert [one.seq for one in again] == [one.seq for one in executed] == list(range(BLOCKS))
    assert again[-1].end_s == pytest.approx(executed[-1].end_s, abs=PROFILE.report_ms / 1e3)


async def test_a_slower_machine_s_heartbeat_may_come_sooner_than_the_first_that_was_recorded(tmp_path: Path) -> None:
    fake, messages = FakePlc(tmp_path), list[WireMessage]()
    with record_received(messages.append), record_sent("robot"):
        link = Recorded(Direct(fake), LINK, RecordedDelivery(Folder(tmp_path), FOLDER))
        await link.open()
        await link.read()
        await link.write({"load": True})
        await link.write({"heartbeat": 1})
        await link.close()
    async with replayed_controller(written(tmp_path / "case.jsonl", messages), "robot") as plc:
        again = plc.variables()
        with pytest.raises(LinkError, match="is not open"):
            await again.write({"heartbeat": 1})
        await again.open()
        await again.write({"heartbeat": 1})
        await again.write({"load": True})
        await again.write({"heartbeat": 2})


async def test_an_order_may_be_taken_back_sooner_than_then(tmp_path: Path) -> None:
    fake, messages = FakePlc(tmp_path), list[WireMessage]()
    orders = [{"reset": True}, {"hold": True}, {"reset": False}, {"load": True}]
    with record_received(messages.append), record_sent("robot"):
        link = Recorded(Direct(fake), LINK, RecordedDelivery(Folder(tmp_path), FOLDER))
        await link.open()
        for values in orders:
            await link.read()
            await link.write(values)
        await link.close()
    path = written(tmp_path / "case.jsonl", messages)
    async with replayed_controller(path, "robot") as plc:
        again = plc.variables()
        await again.open()
        for at in (0, 2, 1, 3):
            await again.read()
            await again.write(orders[at])
    with pytest.raises(AssertionError, match=r"the driver sent '{\"load\": true}'; the recording has"):
        await played(path, lambda plc, link: link.write(orders[3]))


async def test_an_order_that_is_not_recorded_ends_the_link_and_the_block(tmp_path: Path) -> None:
    fake, messages = FakePlc(tmp_path), list[WireMessage]()
    with record_received(messages.append):
        async with cycling(fake):
            await polished(recorded(fake, Folder(tmp_path)))
    path = written(tmp_path / "case.jsonl", messages)
    with pytest.raises(
        AssertionError, match=r"^case.jsonl, robot on opc.tcp://plc:4840: the driver sent .*\(line \d+\)$"
    ):
        await played(path, lambda plc, link: link.write({"start": True}))
    with pytest.raises(AssertionError, match=r"the driver delivered 'other.nc'; the recording has '\S+' \(line \d+\)$"):
        await played(path, lambda plc, link: plc.put("other.nc", b"M2"))


async def test_a_file_that_was_refused_is_refused_again(tmp_path: Path) -> None:
    fake, messages = FakePlc(tmp_path), list[WireMessage]()
    with record_received(messages.append):
        async with cycling(fake):
            with pytest.raises(DeviceRefused, match="no space left"):
                await polished(recorded(fake, Refuses()))
    path = written(tmp_path / "case.jsonl", messages)
    async with replayed_controller(path, "robot") as plc:
        with pytest.raises(DeviceRefused, match="no space left"):
            await polished(PlcRobot("test PLC", PROFILE, plc.variables, plc))
    bytes_only = written(tmp_path / "bytes.jsonl", [WireMessage(0.0, "robot", "tcp://h:1", "in", b"up")])
    with pytest.raises(ConfigError, match="robot is recorded as bytes"):
        async with replayed_controller(bytes_only, "robot"):
            pass
