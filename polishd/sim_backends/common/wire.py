"""A device's link, serial or TCP, with its faults: bytes in, bytes out.

A device that only answers numbered lines (the framing of docs/protocols/loader.md) is served here, too.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
import time
import tty
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

from polishd.config.simulator_devices import SimLineSection
from polishd.sim_backends.common.faults import PROTOCOLS, FaultScript, FrameAction, LinkDirection, protocols
from polishd.sim_backends.common.framing import MAX_LINE, body, line
from polishd.sim_backends.common.runtime import LOOPBACK, SimRuntime

# Frames on their way through a link: late, lost and damaged as the script demands, at the speed of the line.


@dataclass(eq=False, slots=True)
class FaultyLink:
    """One direction of one connection. With ``byte_s`` above 0 it has the speed of a serial line."""

    write: Callable[[bytes], None]
    script: FaultScript
    way: LinkDirection
    byte_s: float = 0.0
    chunk: int = 16
    backlog: Callable[[], int] = lambda: 0
    """Bytes that the other end has not read yet."""
    on_closed: Callable[[], None] = lambda: None
    """Called when the other end is gone."""
    closed: bool = False
    _queue: asyncio.Queue[tuple[float, bytes]] = field(default_factory=asyncio.Queue)
    _under_way: int = 0
    _rest: bytes = b""
    """The begin of a frame."""

    def send(self, data: bytes, delay_s: float = 0.0) -> None:
        """Send after a delay; never wait."""
        if self.closed:
            return
        if not (self.script.troubles or self.byte_s or delay_s or self._under_way or self._rest):
            self.write(data)
        else:
            self._under_way += 1
            self._queue.put_nowait((delay_s, data))

    async def run(self) -> None:
        """Work off the queue until cancelled."""
        loop = asyncio.get_running_loop()
        while True:
            wait_s, data = await self._queue.get()
            if wait_s > 0.0:
                await asyncio.sleep(wait_s)
            for frame in self._frames(data):
                await self._pass(self.script.treat(frame, self.way, loop.time()), loop)
            self._under_way -= 1

    def _frames(self, data: bytes) -> Iterator[bytes]:
        """Return whole frames; without a script, all bytes that are there."""
        self._rest += data
        while self._rest:
            size = PROTOCOLS[self.way.protocol].cut(self._rest) if self.script.troubles else len(self._rest)
            if not size:
                return
            frame, self._rest = self._rest[:size], self._rest[size:]
            yield frame

    async def _pass(self, fate: FrameAction, loop: asyncio.AbstractEventLoop) -> None:
        free_s = loop.time() + fate.delay_s
        byte_s = max(self.byte_s, fate.byte_s)
        step = 1 if fate.byte_s else self.chunk if byte_s else max(len(fate.data), 1)
        for _ in range(fate.copies):
            if fate.late_s:
                loop.call_later(fate.late_s, self._late, fate.data)
                continue
            for start in range(0, len(fate.data), step):
                part = fate.data[start : start + step]
                free_s += len(part) * byte_s
                if free_s > loop.time():
                    await asyncio.sleep(free_s - loop.time())
                self.write(part)

    def _late(self, data: bytes) -> None:
        if not self.closed:
            self.write(data)


MAX_UNSENT = 8 << 20
"""Bytes that a peer may leave unread before it is cut off."""

Feed = Callable[[bytes], None]
"""Takes received bytes."""


@dataclass(slots=True)
class SimWire:
    """Open one link of a device, and disconnect it on request."""

    runtime: SimRuntime
    receiver: Callable[[FaultyLink], Feed]
    """Makes the receiver of one connection, which answers through the outlet."""
    link: str = ""
    """Name of the link, where the device has several."""
    cuts: list[Callable[[], None]] = field(default_factory=list)
    pulled: bool = False
    """The other end cannot be connected now."""
    _port: PtyPort | None = None

    def __post_init__(self) -> None:
        """Start the script: from now on its faults may begin."""
        self.runtime.script.unplug.append((self.link, self.pull, self.plug))

    def outlet(self, write: Callable[[bytes], None], direction: str, **more: Any) -> FaultyLink:
        """Make one direction of a connection, with its faults."""
        protocol = protocols(self.runtime.start.config, self.runtime.name)[self.link]
        return FaultyLink(write, self.runtime.script, LinkDirection(self.link, protocol, direction), **more)

    def inlet(self, outlet: FaultyLink) -> FaultyLink:
        """Return the other direction of the connection that has this outlet."""
        return self.outlet(self.receiver(outlet), "to_device")

    def open_pty(self, baud: int) -> None:
        """Open a serial line under the device's stable name; bytes take the time of the baud rate."""
        port = self._port = PtyPort(self.runtime.start.state / self.runtime.name, lambda _data: None)
        outlet = self.outlet(port.write, "to_host", byte_s=10.0 / baud)
        inlet = self.inlet(outlet)
        port.on_bytes = inlet.send
        port.open()

        def replug() -> None:
            port.close()
            if not self.pulled:
                port.open()

        self.cuts.append(replug)
        for way in (outlet, inlet):
            self.runtime.group.create_task(way.run())

    async def open_tcp(self, port: int, greeting: bytes = b"") -> str:
        """Open a TCP port on loopback; return ``host:port``."""
        return f"{LOOPBACK}:{await self.runtime.serve(lambda: SimTcpConnection(self, greeting), port)}"

    async def open_line(self, config: SimLineSection) -> str:
        """Open the line that the section configures; return the endpoint."""
        if config.kind == "tcp":
            return f"tcp://{await self.open_tcp(config.port)}"
        self.open_pty(config.baud)
        return f"serial:{self.runtime.start.state / self.runtime.name}?baud={config.baud}"

    def ready(self, endpoint: str) -> None:
        """Announce the endpoint and start the script."""
        self.runtime.ready(endpoint)
        self.runtime.button(signal.SIGURG, self.cut)
        self.runtime.begin_script()

    def pull(self) -> None:
        """Disconnect all clients and refuse new connections."""
        self.pulled = True
        self.cut()

    def plug(self) -> None:
        """Accept connections again."""
        if self.pulled and self._port is not None:
            self._port.open()
        self.pulled = False

    def cut(self) -> None:
        """Disconnect all clients once."""
        self.runtime.link.event("wire_cut")
        for cut in list(self.cuts):
            cut()


class SimTcpConnection(asyncio.Protocol):
    """One TCP connection to a device."""

    def __init__(self, wire: SimWire, greeting: bytes = b"") -> None:
        self._wire, self._greeting = wire, greeting

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Greet."""
        if isinstance(transport, asyncio.Transport):
            self._transport = transport
        self._cut = self._transport.abort
        wire = self._wire
        self._outlet = wire.outlet(self._write, "to_host", backlog=self._transport.get_write_buffer_size)
        self._inlet = wire.inlet(self._outlet)
        self._workers = [wire.runtime.group.create_task(way.run()) for way in (self._outlet, self._inlet)]
        wire.cuts.append(self._cut)
        if wire.pulled:
            self._cut()
        else:
            self._transport.write(self._greeting)

    def data_received(self, data: bytes) -> None:
        """Pass the bytes on."""
        self._inlet.send(data)

    def connection_lost(self, _exc: Exception | None) -> None:
        """Drop the connection."""
        for worker in self._workers:
            worker.cancel()
        self._wire.cuts.remove(self._cut)
        self._outlet.closed = self._inlet.closed = True
        self._outlet.on_closed()

    def _write(self, data: bytes) -> None:
        if self._outlet.backlog() > MAX_UNSENT:
            self._cut()
        elif not self._transport.is_closing():
            self._transport.write(data)


@dataclass(slots=True)
class PtyPort:
    """The device's end. ``link`` is a symbolic link to the end that the controller opens."""

    link: Path
    on_bytes: Feed
    _master: int = field(default=-1, init=False)
    _slave: int = field(default=-1, init=False)

    def open(self) -> None:
        """Make the terminal, raw, and move the link to it in one step."""
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        asyncio.get_running_loop().add_reader(self._master, self._readable)
        beside = self.link.with_name(f".{self.link.name}.{os.getpid()}")
        beside.unlink(missing_ok=True)
        beside.symlink_to(os.ttyname(self._slave))
        beside.replace(self.link)

    def close(self) -> None:
        """Remove the terminal: a client that has it open reads an error, and a new one finds no file.

        The kernel reuses the number of a closed terminal: a link left behind leads to the device of another cell.
        """
        if self._master < 0:
            return
        self.link.unlink(missing_ok=True)
        asyncio.get_running_loop().remove_reader(self._master)
        os.close(self._master)
        os.close(self._slave)
        self._master = self._slave = -1

    def write(self, data: bytes) -> None:
        """Send bytes; a full line drops those that the client does not read."""
        if self._master >= 0:
            with contextlib.suppress(BlockingIOError):
                os.write(self._master, data)

    def _readable(self) -> None:
        try:
            data = os.read(self._master, 4096)
        except (BlockingIOError, OSError):
            return
        if data:
            self.on_bytes(data)


# The device side of numbered lines, for devices that only answer.

Answer = Callable[[str], str]
"""Returns the answer to a request."""


class LineDeviceModel(Protocol):
    """The machine behind the line."""

    def step(self, now_s: float) -> None:
        """Advance to the present."""
        ...


@dataclass(slots=True)
class NumberedSlave:
    """Answer each intact line by one line."""

    answer: Answer
    _buffer: bytes = b""

    def feed(self, data: bytes) -> Iterable[bytes]:
        """Return the answer to each whole request."""
        self._buffer += data
        while b"\n" in self._buffer:
            raw, self._buffer = self._buffer.split(b"\n", 1)
            number, _, request = (body(raw.rstrip(b"\r")) or "").partition(",")
            if number.isdigit() and int(number) <= 65535:
                yield line(f"{number},{self.answer(request)}")
        self._buffer = self._buffer[-MAX_LINE:]


async def serve(
    runtime: SimRuntime, config: SimLineSection, machine: LineDeviceModel, answer: Answer, tick_s: float
) -> None:
    """Answer for the machine until cancelled. It is advanced before each answer and every ``tick_s``."""

    def receiver(outlet: FaultyLink) -> Feed:
        slave = NumberedSlave(answer)

        def feed(data: bytes) -> None:
            machine.step(time.monotonic())
            for reply in slave.feed(data):
                outlet.send(reply)

        return feed

    wire = SimWire(runtime, receiver)
    wire.ready(await wire.open_line(config))
    while True:
        machine.step(time.monotonic())
        await asyncio.sleep(tick_s)
