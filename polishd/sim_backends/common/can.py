"""Two ways to the CAN bus: the serial dialect of an slcan adapter, and the protocol of socketcand."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, field

from polishd.sim_backends.common.runtime import SimRuntime
from polishd.sim_backends.common.wire import FaultyLink, Feed, SimWire

Frame = tuple[int, bytes]
"""(identifier, data)."""

_SOCKETCAND = re.compile(rb"<\s*([^<>]*?)\s*>")


def slcan_line(frame: Frame) -> bytes:
    """Format a standard data frame as an adapter sends it."""
    identifier, data = frame
    return b"t%03X%d%s\r" % (identifier, len(data), data.hex().encode())


def slcan_frame(line: bytes) -> Frame | None:
    """Parse the standard data frame of a line (without its end); None if it is none."""
    try:
        identifier, size, data = int(line[1:4], 16), int(line[4:5]), bytes.fromhex(line[5:].decode())
    except ValueError:
        return None
    return (identifier, data) if line[:1] == b"t" and size == len(data) <= 8 else None


@dataclass(slots=True)
class SlcanHost:
    """An adapter: lines ended by CR. It passes no frame of the bus before ``O``."""

    on_frame: Callable[[int, bytes], list[Frame]]
    opened: bool = False
    _buffer: bytes = b""

    def feed(self, data: bytes) -> bytes:
        """Take bytes from the host; return the answer."""
        self._buffer += data
        answer = b""
        while b"\r" in self._buffer:
            line, self._buffer = self._buffer.split(b"\r", 1)
            answer += self._line(line.strip(b"\n"))
        self._buffer = self._buffer[-64:]
        return answer

    def send(self, frames: list[Frame]) -> bytes:
        """Format frames of the bus for the host."""
        return b"".join(map(slcan_line, frames)) if self.opened else b""

    def _line(self, line: bytes) -> bytes:
        if line[:1] == b"t":
            frame = slcan_frame(line)
            if frame is None or not self.opened:
                return b"\a"
            return b"z\r" + self.send(self.on_frame(*frame))
        if line[:1] in {b"O", b"C"}:
            self.opened = line[:1] == b"O"
        known: dict[bytes, bytes] = {b"V": b"V1013\r", b"N": b"NSIM1\r", b"F": b"F00\r"}
        return known.get(line[:1], b"\r" if line[:1] in {b"", b"O", b"C", b"S", b"L", b"M", b"m"} else b"\a")


@dataclass(slots=True)
class SocketcandHost:
    """One socketcand connection in raw mode."""

    on_frame: Callable[[int, bytes], list[Frame]]
    opened: bool = False
    _buffer: bytes = b""

    greeting = b"< hi >"

    def feed(self, data: bytes) -> bytes:
        """Take bytes from the client; return the answer."""
        self._buffer += data
        answer = b""
        while (match := _SOCKETCAND.search(self._buffer)) is not None:
            self._buffer = self._buffer[match.end() :]
            answer += self._command(match[1].split())
        self._buffer = self._buffer[-256:]
        return answer

    def send(self, frames: list[Frame]) -> bytes:
        """Format frames of the bus for the client."""
        if not self.opened:
            return b""
        return b"".join(b"< frame %03X 0.000000 %s >" % (ident, data.hex().upper().encode()) for ident, data in frames)

    def _command(self, words: list[bytes]) -> bytes:
        if words[:1] == [b"rawmode"]:
            self.opened = True
        if words[:1] in ([b"open"], [b"rawmode"], [b"echo"]):
            return b"< echo >" if words[0] == b"echo" else b"< ok >"
        if words[:1] != [b"send"] or len(words) < 3:
            return b"< error unknown command >"
        try:
            identifier, size = int(words[1], 16), int(words[2])
            data = bytes(int(word, 16) for word in words[3:])
        except ValueError:
            return b"< error malformed frame >"
        if size != len(data) or size > 8:
            return b"< error malformed frame >"
        return self.send(self.on_frame(identifier, data))


# A CAN bus as its hosts see it: every host that has opened the adapter or the server gets every frame.

ADAPTER_BAUD = 1_000_000
"""Baud rate of the slcan adapter's serial side."""


@dataclass(slots=True)
class CanWire:
    """The bus of one simulated device."""

    runtime: SimRuntime
    kind: str
    """``slcan`` or ``socketcand``."""
    port: int
    on_frame: Callable[[int, bytes], list[Frame]]
    """Takes a host's frame; returns the device's immediate answers."""
    hosts: list[tuple[SlcanHost | SocketcandHost, FaultyLink]] = field(default_factory=list)

    async def open(self) -> None:
        """Open the endpoint and announce its address."""
        wire = SimWire(self.runtime, self._connected)
        if self.kind == "slcan":
            wire.open_pty(ADAPTER_BAUD)
            wire.ready(f"slcan:{self.runtime.start.state / self.runtime.name}?bitrate=500000")
        else:
            wire.ready(f"socketcand://{await wire.open_tcp(self.port, SocketcandHost.greeting)}/can0")

    def say(self, frames: list[Frame]) -> None:
        """Pass frames of the bus to each host that has opened it; before that, a client waits for an answer."""
        for host, outlet in self.hosts if frames else []:
            for frame in frames:
                if heard := host.send([frame]):
                    outlet.send(heard)

    def _connected(self, outlet: FaultyLink) -> Feed:
        host = (SlcanHost if self.kind == "slcan" else SocketcandHost)(self.on_frame)
        self.hosts.append((host, outlet))
        outlet.on_closed = lambda: self.hosts.remove((host, outlet))

        def feed(data: bytes) -> None:
            if answer := host.feed(data):
                outlet.send(answer)

        return feed
