"""The spindle's drive on CAN: objects that are asked for, and process data that come by themselves."""

from __future__ import annotations

import asyncio
import struct
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import pytest

from polishd.drivers import spindle_can
from polishd.drivers.transport.address import SlcanAddress
from polishd.drivers.transport.can_bus import CanFrame, OnFrame
from tests.campaigns.codecs.nasty import WEIGHTS, Nasty, Talk

NODE = 5
OBJECTS = (spindle_can.VENDOR_ID, spindle_can.PRODUCT_CODE, spindle_can.SERIAL_NUMBER, spindle_can.MAXIMUM_SPEED)
STEP = 97
"""All speeds that it tells are so many tenths of rpm, or a multiple."""


class Bus:
    """Frames as bytes: two of the identifier, then the data."""

    def __init__(self, peer: Nasty) -> None:
        self._peer = peer
        self._on_frame: OnFrame = lambda frame: None
        peer.write = lambda data: self._on_frame(CanFrame(int.from_bytes(data[:2], "big"), data[2:]))

    def send(self, frame: CanFrame) -> None:
        self._peer.on_bytes(frame.identifier.to_bytes(2, "big") + frame.data)

    async def receive(self, on_frame: OnFrame) -> None:
        self._on_frame = on_frame
        self._peer.on_connect()
        await asyncio.get_running_loop().create_future()

    async def close(self) -> None:
        self._on_frame = lambda frame: None


class Spindle(Talk):
    """An object's answer names it, and bears no number; each object has one value."""

    name = "spindle, CAN"
    driver = "spindle_can"
    resyncs = False
    pauses = True
    least = 0.02  # of most replies, which are process data, only the last counts
    kinds = frozenset(WEIGHTS) - {"dribbled"}
    period_s = 0.05

    def __init__(self, **how: Any) -> None:
        super().__init__(**how)
        self._link = spindle_can.DriveLink(SlcanAddress(Path("bus")), NODE, self.silence_s)
        self._timer: asyncio.TimerHandle | None = None
        self._asked = b""

    def wired(self, monkeypatch: pytest.MonkeyPatch, nasty: Nasty) -> None:
        async def open_bus(_: object, _node: int) -> Bus:
            return Bus(nasty)

        monkeypatch.setattr(spindle_can, "open_bus", open_bus)

    async def open(self) -> None:
        self._link = spindle_can.DriveLink(SlcanAddress(Path("bus")), NODE, self.silence_s)
        await self._link.open()

    async def close(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
        await self._link.close()

    async def ask(self) -> Any:
        what = OBJECTS[next(self.numbers) % len(OBJECTS)]
        value, rpm = await self._link.upload(what), self._link.status.rpm
        return what.index, what.sub, value if round(10 * rpm) % STEP == 0 else f"{rpm} rpm"

    def greets(self) -> Iterable[bytes]:
        self._tick()
        return ()

    def _tick(self) -> None:
        number = next(self.numbers)
        self._timer = asyncio.get_running_loop().call_later(self.period_s, self._tick)
        self.say(self._frame(spindle_can.HEARTBEAT, b"\5"))
        self.say(self._frame(spindle_can.STATUS, struct.pack("<BBiBx", 2, number % 256, STEP * (number % 500), 0)))

    def replies(self, data: bytes) -> Iterable[bytes]:
        identifier, self._asked = int.from_bytes(data[:2], "big"), data[3:6]
        if identifier == spindle_can.SDO_REQUEST + NODE:
            index, sub = struct.unpack("<HB", self._asked)
            self.truth = (index, sub, index * 7 + sub)
            yield self._frame(spindle_can.SDO_ANSWER, b"\x43" + self._asked + self.truth[2].to_bytes(4, "little"))

    def refusal(self, reply: bytes) -> bytes:
        return b"" if reply[1] & 0x80 == 0 or reply[2] != 0x43 else reply[:2] + b"\x80" + reply[3:6] + b"\0\0\2\6"

    def tells(self, sent: bytes, reply: bytes) -> bool:
        identifier, data = int.from_bytes(sent[:2], "big"), sent[2:]
        if identifier == spindle_can.SDO_ANSWER + NODE:
            return sent == reply or len(data) != 8 or data[0] not in (0x43, 0x80) or data[1:4] != self._asked
        if identifier == spindle_can.STATUS + NODE:
            return len(data) != 8 or data[0] > 3 or struct.unpack_from("<i", data, 2)[0] % STEP == 0
        return identifier != spindle_can.HEARTBEAT + NODE or data != b"\0"

    def _frame(self, kind: int, data: bytes) -> bytes:
        return (kind + NODE).to_bytes(2, "big") + data
