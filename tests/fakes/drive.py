"""A spindle drive as the protocol document describes it, behind slcan and behind socketcand."""

from __future__ import annotations

import asyncio
import re
import struct
import time

from tests.fakes.wires import Peer

RAMP_RPM_S = 20_000.0
"""Ten times the real drive's, to spare time."""
WATCHDOG_S = 2.0
"""Longer than the real drive's: a busy machine is silent for a while."""
OBJECTS = {
    (0x1018, 1): 0x439,
    (0x1018, 2): 0x1001,
    (0x1018, 3): 0x20003,
    (0x1018, 4): 12345,
    (0x2000, 0): 7,
    (0x6080, 0): 6000,
}


class Drive:
    """The drive itself: ramps, watches for silence, says how it is every 50 ms."""

    def __init__(self, node: int = 5) -> None:
        self.node = node
        self.send = lambda identifier, data: None
        self.fault = 0
        self.rpm = 0.0
        self.jammed = False
        self.mute: set[int] = set()
        self.commands: list[tuple[int, int]] = []
        self.objects = dict(OBJECTS)
        self._target = 0
        self._counter = 200
        self._heard = self._at = time.monotonic()
        self._ticks = 0
        self._timer = asyncio.get_running_loop().call_later(0.01, self._tick)

    def stop(self) -> None:
        """Switch it off."""
        self._timer.cancel()

    def reboot(self) -> None:
        """Power cycle."""
        self.rpm, self._target, self.fault = 0.0, 0, 0
        self._say(0x700, b"\0")

    def on_frame(self, identifier: int, data: bytes) -> None:
        if identifier == 0x200 + self.node:
            run, counter, rpm = struct.unpack("<BBh4x", data)
            self.commands.append((run, rpm))
            self._heard, self._counter = time.monotonic(), counter
            if not run:
                self.fault &= ~1
                self._target = 0
            elif abs(rpm) > self.objects[0x6080, 0]:
                self.fault |= 2
            elif not self.fault:
                self._target = rpm
        elif identifier == 0x600 + self.node:
            index, sub = struct.unpack_from("<HB", data, 1)
            value = self.objects.get((index, sub))
            answer = (0x80, index, sub, 0x06020000) if value is None else (0x43, index, sub, value)
            self._say(0x580, struct.pack("<BHBI", *answer))

    @property
    def state(self) -> int:
        if self.fault:
            return 3
        if self.rpm == self._target:
            return 2 if self._target else 0
        return 1

    def _tick(self) -> None:
        now = time.monotonic()
        if now > self._heard + WATCHDOG_S and self._target:
            self._target, self.fault = 0, self.fault | 1
        step = 0.0 if self.jammed else RAMP_RPM_S * (now - self._at)
        self._at = now
        self.rpm += min(max(self._target - self.rpm, -step), step)
        self._ticks += 1
        if self._ticks % 5 == 0:
            self._say(0x180, struct.pack("<BBiBx", self.state, self._counter, round(10 * self.rpm), self.fault))
        if self._ticks % 10 == 0:
            self._say(0x700, b"\x05")
        self._timer = asyncio.get_running_loop().call_later(0.01, self._tick)

    def _say(self, base: int, data: bytes) -> None:
        if base not in self.mute:
            self.send(base + self.node, data)


class SlcanPeer(Peer):
    """The drive behind a serial adapter."""

    def __init__(self, drive: Drive) -> None:
        super().__init__()
        self.drive = drive
        self.adapter: list[bytes] = []
        self._bytes = b""
        drive.send = lambda identifier, data: self.send(f"t{identifier:03x}{len(data)}{data.hex()}\r".encode())

    def on_bytes(self, data: bytes) -> None:
        *lines, self._bytes = (self._bytes + data).split(b"\r")
        for line in lines:
            if line[:1] == b"t":
                size = int(line[4:5])
                self.drive.on_frame(int(line[1:4], 16), bytes.fromhex(line[5 : 5 + 2 * size].decode()))
            else:
                self.adapter.append(line)


class SocketcandPeer(Peer):
    """The drive behind a socketcand server."""

    def __init__(self, drive: Drive) -> None:
        super().__init__()
        self.drive = drive
        self.greeting = b"< hi >"
        self._raw = False
        self._bytes = ""
        drive.send = self._frame

    def on_connect(self) -> None:
        self._raw, self._bytes = False, ""
        self.write(self.greeting)

    def on_bytes(self, data: bytes) -> None:
        self._bytes += data.decode()
        while match := re.match(r"\s*< (\w+) ?([^>]*)>", self._bytes):
            self._bytes = self._bytes[match.end() :]
            verb, rest = match.groups()
            if verb == "send":
                identifier, _, *octets = rest.split()
                self.drive.on_frame(int(identifier, 16), bytes(int(octet, 16) for octet in octets))
            else:
                self._raw = verb == "rawmode"
                self.write(b"< ok >")

    def _frame(self, identifier: int, data: bytes) -> None:
        if self._raw:
            self.send(f"< frame {identifier:03X} {time.time():.6f} {data.hex().upper()} >".encode())
