"""Fake robot according to docs/protocols/robot_link.md. Each block takes ``block_s``, whatever its text."""

from __future__ import annotations

import asyncio
import json
import struct
import time
from collections.abc import Callable, Iterable
from typing import Any
from zlib import crc32

HELLO, LOAD, BLOCKS, RESUME, HOLD, ABORT, PING, LIFT = range(1, 9)
WELCOME, ACK, NAK, ACCEPTED, EXECUTED, STATUS, RESEND = range(0x81, 0x88)


class FakeRobot:
    """Robot on a TCP port, in the loop of the test without tasks."""

    def __init__(self, *, window: int = 64, block_s: float = 0.005, watchdog_s: float = 3.0) -> None:
        self.window, self.block_s, self.watchdog_s = window, block_s, watchdog_s
        self.boots = 1
        self.stops = 0
        self.port = 0
        self.silent = False
        self.brake_s = 0.02
        self.outgoing: Callable[[int, bytes], Iterable[bytes]] = lambda kind, frame: [frame]
        self.ignores: Callable[[int, bytes], bool] = lambda kind, payload: False
        self.received: list[int] = []
        self.hellos: list[dict[str, Any]] = []
        self.loads: list[dict[str, Any]] = []
        self.clients: list[_Client] = []
        self.writer: _Client | None = None
        self.forget()
        self._server: asyncio.Server | None = None
        self._timer: asyncio.TimerHandle | None = None

    def forget(self, sha: str = "", blocks: int = 0) -> None:
        """Drop the program."""
        self.state, self.detail = ("held" if sha else "idle"), ""
        self.sha, self.blocks = sha, blocks
        self.lines: list[bytes] = []
        self.done: list[tuple[int, float, float]] = []
        self.lifted_mm = 0.0
        self.until: int | None = None
        self.clock_s = 0.0
        self.stops_at: float | None = None
        self._gap = False

    async def start(self, port: int = 0) -> FakeRobot:
        """Listen on loopback."""
        loop = asyncio.get_running_loop()
        self._server = await loop.create_server(lambda: _Client(self), "127.0.0.1", port)
        self.port = self._server.sockets[0].getsockname()[1]
        self._last = self._fed = self._said = time.monotonic()
        self._tick()
        return self

    def drop(self) -> None:
        """Cut all connections."""
        for client in list(self.clients):
            client.transport.abort()

    def cut(self) -> None:
        """Cut all connections and refuse new ones."""
        if self._server is not None:
            self._server.close()
        self.drop()

    async def close(self) -> None:
        """Close all connections."""
        self.cut()
        if self._timer is not None:
            self._timer.cancel()
        if self._server is not None:
            await self._server.wait_closed()
        await asyncio.sleep(0)

    def reboot(self) -> None:
        """Simulate a power cycle: the robot loses its state."""
        self.boots += 1
        self.forget()
        self.drop()

    def status(self) -> dict[str, Any]:
        ahead = len(self.lines) - len(self.done)
        return {
            "state": self.state,
            "program_sha256": self.sha,
            "accepted": len(self.lines),
            "executed": len(self.done),
            "buffer_s": ahead * self.block_s,
            "boot_id": f"boot-{self.boots}",
            "stops": self.stops,
            "detail": self.detail,
            "time_s": self.clock_s,
        }

    def on_frame(self, client: _Client, kind: int, payload: bytes) -> None:
        self.received.append(kind)
        if self.ignores(kind, payload):
            return
        if client is self.writer:
            self._fed = time.monotonic()
        if kind == BLOCKS:
            self._blocks(client, payload)
            return
        content = json.loads(payload)
        if kind == HELLO:
            self._hello(client, content)
        elif kind == PING:
            client.say(STATUS, self.status())
        elif kind == HOLD:
            self._hold(client, HOLD)
        elif client is not self.writer:
            client.say(NAK, {"of": kind, "code": "reader", "text": "readers only watch"})
        else:
            self._obey(client, kind, content)

    def _obey(self, client: _Client, kind: int, content: dict[str, Any]) -> None:
        if kind == LOAD:
            self._load(client, content)
        elif kind == RESUME:
            self._resume(client, content)
        elif kind == LIFT:
            self.lifted_mm = content["distance_mm"]
            self._hold(client, LIFT)
        elif kind == ABORT:
            self.forget()
            client.say(ACK, {"of": ABORT, "status": self.status()})

    def accepted(self) -> bytes:
        credit = self.window - (len(self.lines) - len(self.done))
        return struct.pack(">IId", len(self.lines), credit, (len(self.lines) - len(self.done)) * self.block_s)

    def say_all(self, kind: int, payload: Any) -> None:
        for client in self.clients:
            if client.welcome:
                client.say(kind, payload)

    def _hello(self, client: _Client, content: dict[str, Any]) -> None:
        self.hellos.append(content)
        if content["role"] == "writer":
            if self.writer is not None:
                client.say(NAK, {"of": HELLO, "code": "busy", "text": "another client writes"})
                return
            self.writer = client
        client.welcome = True
        hello = {"vendor": "Fake", "model": "UPU", "serial": "R1", "firmware": "0.1", "boot_id": f"boot-{self.boots}"}
        hello |= {"protocol": 1, "watchdog_s": self.watchdog_s, "window": self.window, "status": self.status()}
        hello |= {"lease": "" if content["role"] == "reader" else f"lease of {content['client']}"}
        client.say(WELCOME, hello)
        client.say(ACCEPTED, self.accepted())
        if records := self.done[content["executed_from"] :]:
            client.say(EXECUTED, _records(records))

    def _load(self, client: _Client, content: dict[str, Any]) -> None:
        self.loads.append(content)
        if self.state == "running":
            client.say(NAK, {"of": LOAD, "code": "running", "text": "hold first"})
            return
        self.forget(content["program_sha256"], content["blocks"])
        client.say(ACK, {"of": LOAD, "status": self.status()})

    def _blocks(self, client: _Client, payload: bytes) -> None:
        first, count = struct.unpack_from(">IH", payload)
        at = 6
        for seq in range(first, first + count):
            (size,) = struct.unpack_from(">H", payload, at)
            line = payload[at + 2 : at + 2 + size]
            at += 2 + size
            if seq > len(self.lines):
                if not self._gap:
                    client.say(RESEND, struct.pack(">I", len(self.lines)))
                self._gap = True
                return
            if seq < len(self.lines) or len(self.lines) - len(self.done) >= self.window:
                continue
            if line.startswith(b"?"):
                client.say(NAK, {"of": BLOCKS, "code": "syntax", "text": f"block {seq}: {line.decode()}"})
                return
            self.lines.append(line)
            self._gap = False
        client.say(ACCEPTED, self.accepted())

    def _resume(self, client: _Client, content: dict[str, Any]) -> None:
        if not self.sha:
            client.say(NAK, {"of": RESUME, "code": "no_program", "text": "load one"})
            return
        if self.lifted_mm:
            client.say(NAK, {"of": RESUME, "code": "no_program", "text": "lifted off the path"})
            return
        if content["stops"] != self.stops:
            client.say(NAK, {"of": RESUME, "code": "stale", "text": f"{self.stops} stops"})
            return
        self.until, self.detail = content["until"], ""
        self.state, self.stops_at = "running", None
        client.say(ACK, {"of": RESUME, "status": self.status()})

    def _hold(self, client: _Client, kind: int) -> None:
        self.stops += 1
        if self.state == "running":
            self.stops_at = time.monotonic() + self.brake_s
            client.waits_for_stop = kind
        else:
            client.say(ACK, {"of": kind, "status": self.status()})

    def _tick(self) -> None:
        now = time.monotonic()
        if self.state == "running":
            self._run(now)
        if now >= self._said + 0.05:
            self._said = now
            self.say_all(STATUS, self.status())
        self._last = now
        self._timer = asyncio.get_running_loop().call_later(0.005, self._tick)

    def _run(self, now: float) -> None:
        executed = []
        self.clock_s += now - self._last
        end_s = self.done[-1][2] if self.done else 0.0
        goal = min(len(self.lines), self.blocks if self.until is None else self.until)
        while len(self.done) < goal and end_s + self.block_s <= self.clock_s:
            executed.append((len(self.done), end_s, end_s + self.block_s))
            self.done.append(executed[-1])
            end_s += self.block_s
        for at in range(0, len(executed), 100):
            self.say_all(EXECUTED, _records(executed[at : at + 100]))
        if executed:
            self.say_all(ACCEPTED, self.accepted())
        self.clock_s = min(self.clock_s, end_s + self.block_s)
        self._stop_where_due(now)

    def _stop_where_due(self, now: float) -> None:
        if self.blocks and len(self.done) == self.blocks:
            self.state = "done"
        elif (self.until is not None and len(self.done) >= self.until) or (self.stops_at or now + 1.0) <= now:
            self.state = "held"
        elif now > self._fed + self.watchdog_s:
            self.state, self.detail = "held", "watchdog"
        elif len(self.done) == len(self.lines):
            self.state, self.detail = "held", "underrun"
        if self.state != "running":
            for client in self.clients:
                if kind := client.waits_for_stop:
                    client.waits_for_stop = 0
                    client.say(ACK, {"of": kind, "status": self.status()})


class _Client(asyncio.Protocol):
    def __init__(self, robot: FakeRobot) -> None:
        self._robot = robot
        self._bytes = b""
        self.welcome, self.waits_for_stop = False, 0
        self.transport: Any = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self.transport = transport
        self._robot.clients.append(self)

    def connection_lost(self, exc: Exception | None) -> None:
        self._robot.clients.remove(self)
        if self._robot.writer is self:
            self._robot.writer = None

    def data_received(self, data: bytes) -> None:
        self._bytes += data
        while (start := self._bytes.find(b"PL")) >= 0:
            self._bytes = self._bytes[start:]
            if len(self._bytes) < 8 or len(self._bytes) < (end := 8 + int.from_bytes(self._bytes[4:8], "big")) + 4:
                return
            if crc32(self._bytes[:end]) != int.from_bytes(self._bytes[end : end + 4], "big"):
                self._bytes = self._bytes[2:]
                continue
            frame, self._bytes = self._bytes[:end], self._bytes[end + 4 :]
            self._robot.on_frame(self, frame[2], frame[8:])

    def say(self, kind: int, payload: Any) -> None:
        if self._robot.silent:
            return
        for part in self._robot.outgoing(kind, frame(kind, payload)):
            self.transport.write(part)


def frame(kind: int, payload: Any) -> bytes:
    """Return the bytes of a frame; a payload of another type is written as JSON."""
    content = payload if isinstance(payload, bytes) else json.dumps(payload).encode()
    check = crc32(struct.pack(">BI", kind, len(content))) & 0xFF
    body = struct.pack(">2sBBI", b"PL", kind, check, len(content)) + content
    return body + struct.pack(">I", crc32(body))


def _records(records: list[tuple[int, float, float]]) -> bytes:
    return struct.pack(">H", len(records)) + b"".join(struct.pack(">Idd", *record) for record in records)
