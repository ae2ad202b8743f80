"""Modbus: a profile's device on RTU and TCP, and the registers of a controller that loads files."""

from __future__ import annotations

import random
import struct
from abc import abstractmethod
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from polishd.config.controller_profile import load_controller_profile
from polishd.drivers.plc_robot.modbus import Modbus, ModbusAddress, place
from polishd.drivers.plc_robot.variables import watched
from polishd.drivers.transport.address import Tcp
from polishd.drivers.transport.modbus_link import ModbusLink
from tests.campaigns.codecs.faulty_peer import Talk
from tests.campaigns.codecs.lines import HOST, LINE

UNIT = 3
MBAP = struct.Struct(">HHHB")


def _crc_table() -> list[int]:
    table = []
    for byte in range(256):
        value = byte
        for _ in range(8):
            value = value >> 1 ^ (0xA001 if value & 1 else 0)
        table.append(value)
    return table


CRC = _crc_table()


def crc(data: bytes) -> bytes:
    """Of a frame on a serial line."""
    value = 0xFFFF
    for byte in data:
        value = value >> 8 ^ CRC[(value ^ byte) & 0xFF]
    return value.to_bytes(2, "little")


class Slave(Talk):
    """Answers reads by words or bits of new numbers, and writes by their echo."""

    def __init__(self, **how: Any) -> None:
        super().__init__(**how)
        self._asked: tuple[int, int, int, int] = (0, 0, 0, 0)
        """Number, function, address, count or value."""

    @abstractmethod
    def frame(self, number: int, unit: int, body: bytes) -> bytes:
        """An answer."""

    @abstractmethod
    def requests(self, data: bytes) -> Iterable[tuple[int, bytes]]:
        """(number, function and data) of each."""

    def replies(self, data: bytes) -> Iterable[bytes]:
        for number, request in self.requests(data):
            self._asked = (number, *struct.unpack_from(">BHH", request))
            yield self.frame(number, UNIT, self.body())

    def body(self) -> bytes:
        """Function code and data; sets the truth."""
        _, function, address, count = self._asked
        if function in (5, 6, 15, 16):
            self.truth = None
            return struct.pack(">BHH", function, address, count)
        number = next(self.numbers)
        words = [(number >> 14) & 0x3FFF, number & 0x3FFF, *((number + at) & 0x3FFF for at in range(count))][:count]
        data = struct.pack(f">{count}H", *words)
        if function in (1, 2):
            data = (number & (1 << count) - 1).to_bytes(-(-count // 8), "little")
            words = [number >> at & 1 for at in range(count)]
        self.heard(function, words)
        return bytes([function, len(data)]) + data

    def heard(self, function: int, words: list[int]) -> None:
        """What was answered."""
        self.truth = words

    def refusal(self, reply: bytes) -> bytes:
        number, function, *_ = self._asked
        return self.frame(number, UNIT, bytes([function | 0x80, 2]))

    def damages(self, rng: random.Random, reply: bytes) -> Sequence[bytes]:
        number, function, address, count = self._asked
        body = self.body_of(reply)
        stale = body[:-1] + bytes([body[-1] ^ 1])
        longer = bytes([function, body[1] + 2]) + body[2:] + b"\0\7"
        other = struct.pack(">BHH", function, address + 1, count) if function > 4 else longer
        return [
            self.frame(number, (UNIT + rng.randrange(1, 250)) % 256, stale),
            self.frame(number, UNIT, bytes([function ^ rng.choice((1, 2, 7, 16))]) + stale[1:]),
            self.frame(number, UNIT, body[:1]),
            self.frame(number, UNIT, body[:-1]),
            self.frame(number, UNIT, bytes([function, body[1] ^ 4]) + body[2:]),
            self.frame(number, UNIT, other),
            self.frame(number, UNIT, rng.randbytes(rng.randrange(1, 12))),
        ]

    @abstractmethod
    def body_of(self, reply: bytes) -> bytes:
        """Function and data of it."""

    def could_be(self, body: bytes, good: bytes) -> bool:
        """It is of the right kind and length: an answer as good as that one."""
        return len(body) == len(good) and body[:2] == good[:2] and (body[0] < 5 or body == good) and body != good


class TcpSlave(Slave):
    """Nothing finds the next message after one whose length is wrong: broken ones come in place of good ones."""

    resyncs = False

    def frame(self, number: int, unit: int, body: bytes) -> bytes:
        return MBAP.pack(number, 0, 1 + len(body), unit) + body

    def requests(self, data: bytes) -> Iterable[tuple[int, bytes]]:
        number, _, _, _ = MBAP.unpack_from(data)
        yield number, data[MBAP.size :]

    def body_of(self, reply: bytes) -> bytes:
        return reply[MBAP.size :]

    def damages(self, rng: random.Random, reply: bytes) -> Sequence[bytes]:
        number, body = self._asked[0], self.body_of(reply)
        stale = body[:-1] + bytes([body[-1] ^ 1])
        return [
            *super().damages(rng, reply),
            self.frame(number ^ 1 << rng.randrange(16), UNIT, stale),
            self.frame(0, UNIT, stale),
            self.frame((number - 1) % 65536, UNIT, stale),
            reply[:2] + b"\0\1" + reply[4:-1] + stale[-1:],
        ]

    def distinguishes(self, sent: bytes, reply: bytes) -> bool:
        good, at = self.body_of(reply), 0
        while len(sent) - at >= MBAP.size:
            number, protocol, size, unit = MBAP.unpack_from(sent, at)
            body = sent[at + MBAP.size : at + MBAP.size - 1 + size]
            ours = (number, protocol, unit) == (self._asked[0], 0, UNIT) and len(body) == size - 1
            if ours and (self.could_be(body, good) or (len(body) == 2 and body[0] == good[0] | 0x80)):
                return False
            at += max(MBAP.size - 1 + size, 1)
        return True


class RtuSlave(Slave):
    """Its frames have a checksum, and no number: late answers come to the next connection, too."""

    def frame(self, number: int, unit: int, body: bytes) -> bytes:
        data = bytes([unit]) + body
        return data + crc(data)

    def requests(self, data: bytes) -> Iterable[tuple[int, bytes]]:
        yield 0, data[1:-2]

    def body_of(self, reply: bytes) -> bytes:
        return reply[1:-2]

    def distinguishes(self, sent: bytes, reply: bytes) -> bool:
        size, good = len(reply), self.body_of(reply)
        for at in range(len(sent)):
            for end in (at + size, at + 5):
                one = sent[at:end]
                refusal = len(one) == 5 and one[1] == good[0] | 0x80
                sound = len(one) > 4 and one[0] == UNIT and (refusal or self.could_be(one[1:-2], good))
                if sound and crc(one[:-2]) == one[-2:]:
                    return False
        return True


class ProfiledTcp(TcpSlave):
    """Words and bits are read, words are written, in turn."""

    name = "profile, Modbus TCP"
    driver = "profile_device"

    def __init__(self, address: Any = HOST, **how: Any) -> None:
        super().__init__(**how)
        self._link = ModbusLink(address, UNIT, self.silence_s, 0.0, {})
        self._turn = 0

    async def open(self) -> None:
        await self._link.connect()

    async def close(self) -> None:
        await self._link.disconnect()

    async def ask(self) -> list[int] | None:
        self._turn += 1
        match self._turn % 8:
            case 0:
                await self._link.write("holding", 5, [self._turn % 65536], many=False)
            case 1:
                await self._link.write("holding", 7, [1, self._turn % 65536], many=True)
            case 2:
                return await self._link.read("discrete", 3, 20)
            case 3 | 4:
                return await self._link.read("input", 40, 3)
            case _:
                return await self._link.read("holding", 10, 2)
        return None


class ProfiledRtu(RtuSlave, ProfiledTcp):
    name = "profile, Modbus RTU"
    pauses = True

    def __init__(self, address: Any = LINE, **how: Any) -> None:
        super().__init__(address, **how)


class Controller(TcpSlave):
    """The shipped profile of a PLC; its registers are read in three requests."""

    name = "PLC robot, Modbus"
    driver = "plc_robot"
    least = 0.2  # two answers are one reading

    def __init__(self, address: Tcp = HOST, **how: Any) -> None:
        super().__init__(**how)
        table = load_controller_profile("plc-modbus", Path()).variables
        self._variables = Modbus(address, table, self.silence_s, unit=UNIT)
        self._places: dict[str, ModbusAddress] = {
            name: place(name, one, little=False) for name, one in watched(table).items()
        }
        self._words: dict[str, list[int]] = {}
        self._beats = 0

    async def open(self) -> None:
        await self._variables.open()

    async def close(self) -> None:
        await self._variables.close()

    def heard(self, function: int, words: list[int]) -> None:
        self._words["discrete" if function == 2 else "input"] = words
        self.truth = {
            name: one.value(self._words[one.table][one.address :][: one.count])
            for name, one in self._places.items()
            if one.table in self._words
        }

    async def ask(self) -> Any:
        self._beats += 1
        if self._beats % 4 == 0:
            await self._variables.write({"heartbeat": self._beats % 65536})
            return None
        return (await self._variables.read()).values
