"""Yaskawa's High-Speed Ethernet Server: a request and its answer are a datagram each, with a number of 8 bits.

An answer repeats the number and the service of its request, not the command, and has no checksum. An answer that comes
when its number is used again cannot be distinguished from the right one: here answers take so long that it never does.
"""

from __future__ import annotations

import random
import struct
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from polishd.config.controller_profile import load_controller_profile
from polishd.drivers.plc_robot.hses import Hses
from polishd.drivers.transport.address import Tcp
from tests.campaigns.codecs.faulty_peer import WEIGHTS, Talk
from tests.campaigns.codecs.lines import HOST

REQUEST, ANSWER = struct.Struct("<4sHHBBBBI8sHHBBH"), struct.Struct("<4sHHBBBBI8sBBBBHH")
GET_ALL, GET, SET = 0x01, 0x0E, 0x10
ALARM, STATUS, JOB, POSITION, VARIABLE = 0x70, 0x72, 0x73, 0x75, 0x7C
SIZE_COUNTS = (ALARM, STATUS, JOB, POSITION)
"""Commands whose data is read: the rest is a confirmation, whatever its data."""
AGAIN_S = 0.1


def answer(number: int, service: int, data: bytes, status: int = 0, **other: Any) -> bytes:
    """Return an answer; ``other`` replaces fields of its header."""
    head = {"magic": b"YERC", "head": ANSWER.size, "size": len(data), "division": 1, "ack": 1, **other}
    return (
        ANSWER.pack(
            head["magic"], head["head"], head["size"], 3, head["division"], head["ack"], number, 1 << 31, b"99999999",
            service, status, 1 if status else 0, 0, 0x2010 if status else 0, 0,
        )
        + data
    )  # fmt: skip


class Controller(Talk):
    """The shipped profile of a Yaskawa controller: readings, the heartbeat and the start in turn."""

    name = "PLC robot, HSES"
    driver = "plc_robot"
    pauses = True  # a double is a datagram more
    kinds = frozenset(WEIGHTS) - {"dribbled"}
    least = 0.1  # three or four answers are one reading
    answers_in_s = 0.005  # 256 of them take longer than the latest of late ones

    def __init__(self, address: Tcp = HOST, **how: Any) -> None:
        super().__init__(**how)
        table = load_controller_profile("yaskawa-hses", Path()).variables
        self._link = Hses(address, table, self.silence_s, AGAIN_S)
        self._turn = 0
        self._asked = b""
        """The last request, without its number."""
        self._command, self._service = 0, 0
        self._numbers: set[int] = set()
        """Those of the last request, which may have been sent several times."""
        self._number = 0
        self._found: dict[int, dict[str, Any]] = {}
        """By command: the value that its last answer means."""

    async def open(self) -> None:
        await self._link.open()

    async def close(self) -> None:
        await self._link.close()

    async def ask(self) -> Any:
        self._turn += 1
        if self._turn % 4 == 0:
            await self._link.write({"heartbeat": self._turn})
            return "D010", self._turn
        if self._turn % 4 == 2:
            await self._link.write({"start": True})
            return "start", 1
        return {**(await self._link.read()).values, "axes": self._link._standstill._axes}

    def replies(self, data: bytes) -> Iterable[bytes]:
        _, _, _, _, _, _, self._number, _, _, self._command, _, _, self._service, _ = REQUEST.unpack_from(data)
        asked = data[:11] + data[12:]
        self._numbers = {self._number} | (self._numbers if asked == self._asked else set())
        self._asked = asked
        yield answer(self._number, self._service | 0x80, self._data(data[REQUEST.size :]))

    def _data(self, written: bytes) -> bytes:
        """Return the data of the answer; sets the truth."""
        if self._service == SET:
            self.truth = ("D010" if self._command == VARIABLE else "start", *struct.unpack("<I", written))
            return b""
        number = next(self.numbers)
        match self._command:
            case 0x73:
                name, line = f"JOB{number}", number % 3 and number
                self._found[JOB] = {"loaded": f"{name}.JBI", "line": line, "feed_override": number % 20_000}
                data = struct.pack("<32sIII", name.encode(), line, number, number % 20_000)
            case 0x72:
                is_running, is_held, is_alarm = number % 2 == 0, number % 5 == 0, number % 7 == 0
                self._found[STATUS] = {"running": is_running, "feed_hold": is_held, "is_alarm": is_alarm}
                one, two = 0x82 | 0x08 * is_running, 0x40 | 0x02 * is_held | 0x10 * is_alarm
                data = struct.pack("<II", one, two)
            case 0x70:
                self._found[ALARM] = {"alarm": f"alarm {number}: text {number}"}
                data = struct.pack("<III16s32s", number, 0, 1, b"2026/01/01 00:00", b"text %d" % number)
            case 0x75:
                axes = tuple(10 * number + at for at in range(8))  # each reading has moved
                self._found[POSITION] = {"axes": axes}
                data = struct.pack("<5I8i", 16, 0, 0, 0, 0, *axes)
            case _:
                return struct.pack("<I", number)
        self.truth = self._reading()
        return data

    def _reading(self) -> dict[str, Any]:
        job, status = self._found.get(JOB, {"line": 0}), self._found.get(STATUS, {"is_alarm": False, "running": False})
        alarm = self._found.get(ALARM, {}).get("alarm") if status["is_alarm"] else ""
        state = (
            "fault" if status["is_alarm"] else "running" if status["running"] else "stopped" if job["line"] else "top"
        )
        flags = {"feed_hold": status.get("feed_hold"), "in_motion": True}
        return {**job, **flags, "alarm": alarm, "state": state, **self._found.get(POSITION, {})}

    def refusal(self, reply: bytes) -> bytes:
        return answer(self._number, self._service | 0x80, b"", 0x1F)

    def distinguishes_each(self, sent: Sequence[bytes], reply: bytes) -> bool:
        return all(self.distinguishes(one, reply) for one in sent)

    def distinguishes(self, sent: bytes, reply: bytes) -> bool:
        """False for other data in an answer of the right number, service and size."""
        if len(sent) != len(reply) or self._command not in SIZE_COUNTS or sent[ANSWER.size :] == reply[ANSWER.size :]:
            return True
        magic, head, size, _, division, ack, number, _, _, service, status, *_ = ANSWER.unpack_from(sent)
        good = (b"YERC", ANSWER.size, len(reply) - ANSWER.size, 1, 1, self._service | 0x80, 0)
        return (magic, head, size, division, ack, service, status) != good or number not in self._numbers

    def damages(self, rng: random.Random, reply: bytes) -> Sequence[bytes]:
        data, number, service = reply[ANSWER.size :], self._number, self._service | 0x80
        other = bytes(byte ^ 1 for byte in data) or b"\1"
        return [
            answer(number ^ 1 << rng.randrange(8), service, other),
            answer((number + rng.choice([-1, 1])) % 256, service, other),
            answer(number, service ^ rng.choice([0x01, 0x0F, 0x10, 0x11, 0x80]), other),
            answer(number, service, other, magic=rng.choice([b"YERD", b"\0" * 4, b"CREY"])),
            answer(number, service, other, head=rng.choice([0, 31, 33, 0xFFFF])),
            answer(number, service, other, size=rng.choice([0, len(other) + 1, 0xFFFF])),
            answer(number, service, other, division=rng.choice([0, 2, 3])),
            answer(number, service, other, ack=rng.choice([0, 2])),
            answer(number, service, other, rng.choice([0x08, 0x1F, 0xFF])),
            answer(number, service, other[: rng.randrange(len(other))]),
            answer(number, service, other + rng.randbytes(rng.randrange(1, 9))),
            answer(number, service, b""),
        ]
