"""Variables over HSES: frames byte by byte, and the link at the simulated controller's own server."""

from __future__ import annotations

import asyncio
import struct
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from polishd.api import ConfigError, DeviceFault, DeviceRefused, LinkError, ProtocolError
from polishd.config.controller_profile import ControllerProfile, Variable, load_controller_profile
from polishd.drivers.plc_robot.driver import PlcRobot
from polishd.drivers.plc_robot.hses import (
    STATUS,
    Hses,
    HsesAnswer,
    HsesVariable,
    Standstill,
    answer_of,
    order_of,
    place,
    status_values,
)
from polishd.drivers.transport.address import Tcp
from polishd.drivers.transport.file_delivery import Folder
from tests.fakes.plc_robot import FakePlc, ServedDatagrams, cycling, datagrams
from tests.programs import plan_of
from tests.time_limits import SOON_S

PROFILE = load_controller_profile("yaskawa-hses", Path())
PATIENT = PROFILE.model_copy(update={"link_ms": 100.0})
"""For the robot in real time: a reading that a busy machine delays is a delay of the controller."""
HEAD = "59455243 2000"
JOB = [b"/JOB", b"//NAME POLISH", b"//POS", b"///RECTAN"]
JOB += [b"C%05d=%d,0,0,180,0,0" % (at, at) for at in range(30)]
JOB += [b"//INST", b"NOP", *(b"MOVL C%05d V=50.0 PL=0" % at for at in range(30)), b"END"]
FIRST = JOB.index(b"NOP")


# frames


def test_a_request_is_what_the_manual_says() -> None:
    assert STATUS.packed(7) == bytes.fromhex(f"{HEAD} 0000 03 01 00 07 00000000 3939393939393939 7200 0100 00 01 0000")
    write = HsesVariable("D010", "int32").write(-2).packed(255)
    assert write == bytes.fromhex(f"{HEAD} 0400 03 01 00 ff 00000000 3939393939393939 7c00 0a00 01 10 0000 feffffff")


def test_an_answer_is_read_where_the_manual_puts_it() -> None:
    refused = bytes.fromhex(f"{HEAD} 0000 03 01 01 07 00000080 3939393939393939 90 1f 01 00 5020 0000")
    found = answer_of(refused)
    assert found == HsesAnswer(7, 0x10, 0x1F, 0x2050, b"")
    assert found.refusal == "hold by a command (status 0x1f, added status 0x2050)"
    undefined = answer_of(bytes.fromhex(f"{HEAD} 0000 03 01 01 07 00000080 3939393939393939 90 08 00 00 0000 0000"))
    assert undefined is not None
    assert undefined.refusal.startswith("unknown command")


@given(st.binary(max_size=60))
def test_what_is_no_answer_is_none(junk: bytes) -> None:
    assert answer_of(junk) is None
    assert answer_of(STATUS.packed(1) + junk) is None, "a request is none"


@pytest.mark.parametrize(
    ("one", "two", "line", "state", "why"),
    [
        (0xCA, 0x40, 0, "running", ""),
        (0xC2, 0x40, 0, "top", ""),
        (0xC2, 0x48, 9, "stopped", ""),
        (0xCA, 0x50, 9, "fault", "alarm 4107: OUT OF RANGE"),
        (0xCA, 0x60, 9, "fault", "error 4107: OUT OF RANGE"),
        (0x22, 0x40, 9, "fault", "the mode is teach"),
        (0x42, 0x40, 9, "fault", "command remote is off"),
        (0xC2, 0x00, 9, "fault", "the servo power is off"),
        (0xC4, 0x40, 0, "fault", "the cycle is not 1 CYCLE: the job would begin again at its end"),
    ],
)
def test_values_of_a_status(one: int, two: int, line: int, state: str, why: str) -> None:
    job = b"POLISH".ljust(32, b"\0") + struct.pack("<III", line, 3, 7500)
    alarm = struct.pack("<III16s32s", 4107, 0, 1, b"2026/11/29 12:00", b"OUT OF RANGE")
    found = status_values(struct.pack("<II", one, two), job, alarm if two & 0x30 else b"")
    assert (found["status.state"], found["alarm.text"], found["job.name"]) == (state, why, "POLISH.JBI")
    assert (found["job.line"], found["job.override"]) == (line, 7500)
    assert status_values(struct.pack("<II", one, two), bytes(44))["job.name"] == "", "no job is selected"


def variable(address: str, kind: str) -> Variable:
    return Variable.model_validate({"address": address, "type": kind})


@pytest.mark.parametrize(
    ("address", "kind", "role", "said"),
    [
        ("X010", "int16", "read", "write B010"),
        ("B1000", "int16", "read", "write B010"),
        ("hold", "bool", "read", "write B010"),
        ("job.line", "int32", "written", "or one of hold, start, reset, select"),
        ("D010", "float", "read", "type 'float': D010 is one of bool, int32"),
        ("job.name", "int32", "read", "job.name is one of string"),
        ("B010", "int16", "written", "B holds 0 to 255, write an I or D variable"),
    ],
)
def test_addresses_that_are_none(address: str, kind: str, role: Any, said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        place("x", variable(address, kind), role)


def test_values_that_do_not_fit_and_names_that_are_none() -> None:
    with pytest.raises(ProtocolError, match="300 does not fit into B001"):
        HsesVariable("B001", "uint16").write(300)
    with pytest.raises(ProtocolError, match="fit into R001"):
        HsesVariable("R001", "double").write(1e300)
    with pytest.raises(ProtocolError, match="S001: at most 32 characters"):
        HsesVariable("S001", "string").write("x" * 33)
    (select,) = order_of("select", "C:\\JOB\\POLISH.JBI")
    assert select.data == b"POLISH".ljust(36, b"\0")
    for name in ("", "J" * 33, "D\xfcse"):
        with pytest.raises(ProtocolError, match="is no name of a job"):
            order_of("select", name)


def test_creep_is_no_standstill_and_the_end_of_a_move_is_seen() -> None:
    still, at = Standstill(), (0, 0, 0)
    assert not still.moves(0.0, at)
    creep = [still.moves(0.01 * k, (k // 2, 0, 0)) for k in range(1, 100)]
    assert creep[20:] == [True] * 79, "50 um/s, read each 10 ms: no two readings differ by more than 1 um"
    assert still.moves(1.1, (49, 0, 0))
    assert not still.moves(1.3, (49, 0, 0))


# the link


@dataclass
class Linked:
    link: Hses
    served: ServedDatagrams
    fake: FakePlc

    def sent(self, command: int) -> int:
        """How often this command came."""
        return sum(struct.unpack_from("<H", datagram, 24)[0] == command for datagram in self.served.asked)

    def loses(self, command: int, count: int, *, request: bool = False) -> None:
        """Drop this number of answers or requests."""
        left = [count]

        def pass_on(asked: Callable[[], bytes]) -> Callable[[bytes], list[bytes]]:
            def treat(datagram: bytes) -> list[bytes]:
                if left[0] and struct.unpack_from("<H", asked(), 24)[0] == command:
                    left[0] -= 1
                    return []
                return [datagram]

            return treat

        treat = pass_on(lambda: self.served.asked[-1])
        if request:
            self.served.into = treat
        else:
            self.served.out = treat


@asynccontextmanager
async def linked(folder: Path, profile: ControllerProfile = PROFILE, *, again_s: float = 0.02) -> AsyncIterator[Linked]:
    fake = FakePlc(folder)
    async with cycling(fake), datagrams(fake) as (port, served):
        link = Hses(Tcp("127.0.0.1", port), profile.variables, 5.0, again_s)
        try:
            await link.open()
            yield Linked(link, served, fake)
        finally:
            await link.close()


@asynccontextmanager
async def ready(folder: Path) -> AsyncIterator[Linked]:
    """Linked, with the job selected."""
    (folder / "POLISH.JBI").write_bytes(b"\r\n".join([*JOB, b""]))
    async with linked(folder) as found:
        await found.link.write({"program": "POLISH.JBI"})
        await shows(found.link, loaded="POLISH.JBI", state="top")
        yield found


async def shows(link: Hses, **values: Any) -> None:
    async with asyncio.timeout(SOON_S):
        while not values.items() <= (await link.read()).values.items():
            pass


async def test_variables_of_each_letter_and_the_identity(tmp_path: Path) -> None:
    point = {"address": "R010", "type": "double"}
    clock = PROFILE.variables.line.model_copy(update={"address": "I010", "type": "int16"})
    table = PROFILE.variables.model_copy(
        update={
            "line": clock,
            "session": variable("S010", "string"),
            "controller_heartbeat": variable("B010", "uint16"),
            "alarm_text": Variable.model_validate(point),
        }
    )
    async with linked(tmp_path, PROFILE.model_copy(update={"variables": table})) as found:
        for command, data in ((0x7B, "fbff"), (0x8C, "4142" + "00" * 30), (0x7A, "c8"), (0x7D, "0000c03f")):
            raw = bytes.fromhex(data)
            head = struct.pack(
                "<4sHHBBBBI8sHHBBH", b"YERC", 32, len(raw), 3, 1, 0, 1, 0, b"99999999", command, 10, 1, 16, 0
            )
            assert found.served.server.answer(head + raw)[25] == 0
        values = (await found.link.read()).values
        seen = [values[name] for name in ("line", "session", "controller_heartbeat", "alarm_text")]
        assert seen == [-5, "AB", 200, 1.5]
        await found.link.write({"heartbeat": 41})
        assert found.fake.plc.inputs["heartbeat"] == 41
        who = await found.link.identify()
        assert (who.vendor, who.model) == ("Yaskawa", "polishd sim")


async def test_a_lost_answer_to_a_reading_is_asked_for_again(tmp_path: Path) -> None:
    async with linked(tmp_path) as found:
        found.loses(0x72, 3)
        before = found.sent(0x72)
        assert (await found.link.read()).values["state"] == "top"
        assert found.sent(0x72) >= before + 4


async def test_a_start_is_sent_once_even_if_its_answer_is_lost(tmp_path: Path) -> None:
    async with ready(tmp_path) as found:
        found.loses(0x86, 1)
        found.link._silence_s = 0.3
        with pytest.raises(LinkError, match="whether command 0x86 was executed is unknown"):
            await found.link.write({"hold": False, "start": True})
        assert found.sent(0x86) == 1
        assert found.fake.plc.motion.state in {"running", "done"}, "it did run"
        with pytest.raises(LinkError, match="is not open"):
            await found.link.read()


async def test_a_refused_datagram_ends_the_link_and_leaves_an_order_unknown(tmp_path: Path) -> None:
    async with ready(tmp_path) as found:

        def refuse(_request: bytes) -> list[bytes]:
            found.link.failed(ConnectionRefusedError("nothing listens"))
            return []

        found.served.into = refuse
        with pytest.raises(LinkError, match="nothing listens; whether command 0x83 was executed is unknown"):
            await found.link.write({"hold": False, "start": True})
        with pytest.raises(LinkError, match="is not open"):
            await found.link.read()


async def test_a_hold_is_sent_until_it_is_answered(tmp_path: Path) -> None:
    async with ready(tmp_path) as found:
        await found.link.write({"start": True})
        found.loses(0x83, 3, request=True)
        await found.link.write({"hold": True})
        assert found.sent(0x83) >= 4
        assert found.fake.plc.inputs["hold"] is True


async def test_a_hold_that_is_refused_while_the_job_stops_is_asked_for_again(tmp_path: Path) -> None:
    async with linked(tmp_path, again_s=0.4) as found:  # longer than a busy machine delays an answer
        left = [2]

        def still_runs(answer: bytes) -> list[bytes]:
            if left[0] and struct.unpack_from("<H", found.served.asked[-1], 24)[0] == 0x72:
                left[0] -= 1
                return [answer[:32] + bytes([answer[32] | 0x08]) + answer[33:]]
            return [answer]

        found.fake.plc.press("manual", 0.0)
        found.served.out = still_runs
        await found.link.write({"hold": True})
        assert found.sent(0x83) == 3


@pytest.mark.full
async def test_a_hold_off_is_sent_once(tmp_path: Path) -> None:
    async with linked(tmp_path) as found:
        found.loses(0x83, 1, request=True)
        found.link._silence_s = 0.1
        with pytest.raises(LinkError, match="unknown"):
            await found.link.write({"hold": False})
        assert found.sent(0x83) == 1


async def test_answers_that_are_late_or_repeated_or_of_others_are_dropped(tmp_path: Path) -> None:
    async with ready(tmp_path) as found:
        late: list[bytes] = []

        def treat(answer: bytes) -> list[bytes]:
            """Each answer comes twice, after the one before, and after one with another number."""
            other = answer[:11] + bytes([answer[11] ^ 0x80]) + answer[12:]
            came = [*late, other, b"YERC", answer, answer]
            late[:] = [answer]
            return came

        found.served.out = treat
        for beat in range(20):
            await found.link.write({"heartbeat": beat})
            values = (await found.link.read()).values
            assert (values["loaded"], values["line"], found.fake.plc.inputs["heartbeat"]) == ("POLISH.JBI", 0, beat)


async def test_orders_that_the_network_repeats_are_executed_once(tmp_path: Path) -> None:
    async with ready(tmp_path) as found:
        found.served.into = lambda request: [request, request]
        await found.link.write({"hold": False, "start": True})
        assert found.fake.plc.motion.state in {"running", "done"}
        await found.link.write({"hold": True})
        await shows(found.link, feed_hold=False)
        assert found.fake.plc.motion.state != "running" or found.fake.plc.motion.stopping


async def test_nothing_that_listens_and_silence_are_a_lost_link(tmp_path: Path) -> None:
    async with linked(tmp_path) as found:
        found.served.out = lambda _: []
        found.link._silence_s = 0.2
        with pytest.raises(LinkError, match=r"does not answer within 0\.2 s"):
            await found.link.read()
    with pytest.raises(LinkError, match="does not answer"):
        await found.link.open()


@pytest.mark.parametrize(
    ("before", "said"),
    [
        (lambda plc: plc.press("manual", 0.0), "refuses start: wrong mode"),
        (lambda plc: plc.press("emergency stop", 0.0), "refuses start: the servo power is off"),
        (lambda plc: plc.press("feed hold", 0.0), "refuses start: hold at the pendant"),
        (lambda plc: plc.inputs.update(hold=True), "refuses start: hold by a command"),
    ],
)
async def test_a_start_that_the_controller_refuses(tmp_path: Path, before: Callable[[Any], None], said: str) -> None:
    async with ready(tmp_path) as found:
        before(found.fake.plc)
        with pytest.raises(DeviceRefused, match=said):
            await found.link.write({"start": True})
        assert found.fake.plc.motion.state == "held"


async def test_a_job_that_is_not_there_and_a_hold_in_teach(tmp_path: Path) -> None:
    async with linked(tmp_path) as found:
        with pytest.raises(DeviceRefused, match="refuses select: no such job"):
            await found.link.write({"program": "OTHER.JBI"})
        with pytest.raises(DeviceRefused, match="refuses start: no job is selected"):
            await found.link.write({"start": True})
        found.fake.plc.press("manual", 0.0)
        await found.link.write({"hold": True, "reset": True})
        await shows(found.link, state="fault", alarm="the mode is teach")


# the robot


@asynccontextmanager
async def robot_at(folder: Path) -> AsyncIterator[tuple[PlcRobot, ServedDatagrams, FakePlc]]:
    fake = FakePlc(folder, speed=1.0)
    async with cycling(fake), datagrams(fake) as (port, served):
        make = lambda: Hses(Tcp("127.0.0.1", port), PATIENT.variables, 5.0, 0.04)  # noqa: E731
        robot = PlcRobot("test Yaskawa", PATIENT, make, Folder(folder))
        try:
            yield robot, served, fake
        finally:
            await robot.close()


@pytest.mark.full
async def test_a_whole_job_with_datagrams_lost_and_repeated(tmp_path: Path) -> None:
    plan = plan_of(JOB, approach_blocks=FIRST + 5)
    async with robot_at(tmp_path) as (robot, served, _):
        count = [0]

        def treat(answer: bytes) -> list[bytes]:
            count[0] += 1
            is_order = answer[24] == 0x90
            return [answer] if is_order or count[0] % 7 else [answer, answer] if count[0] % 14 else []

        served.out = treat
        await robot.open()
        await robot.prepare(plan)
        await robot.send(plan.segments)
        await robot.resume()
        assert [one.seq async for one in robot.executed()] == list(range(len(JOB)))
        text = (tmp_path / "POLISH.JBI").read_bytes().split(b"\r\n")
        assert text[-4:] == [b"MOVL C00029 V=50.0 PL=0", b"PAUSE", b"END", b""]


@pytest.mark.full
async def test_a_job_that_goes_back_to_its_top_did_not_end(tmp_path: Path) -> None:
    plan = plan_of(JOB, approach_blocks=FIRST + 5)
    async with robot_at(tmp_path) as (robot, _, fake):
        await robot.open()
        await robot.prepare(plan)
        await robot.send(plan.segments)
        await robot.resume()
        async for one in robot.executed():
            if one.seq > FIRST + 8:
                break
        fake.plc.motion.load(fake.plc.motion.path)  # as by a job select at the pendant
        with pytest.raises(DeviceFault, match="ended at the controller"):
            _ = [one async for one in robot.executed(len(JOB) - 1)]
