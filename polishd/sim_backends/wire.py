"""A device's wire, serial or TCP, with its mischief: bytes in, bytes out."""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
import tty
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from polishd.config.simulator import Faults, Line
from polishd.sim_backends.faults import Mischief, Outlet
from polishd.sim_backends.runtime import LOOPBACK, Runtime
from polishd.sim_backends.truth import stream

MAX_UNSENT = 8 << 20
"""Bytes that a peer may leave unread before it is cut off."""

Feed = Callable[[bytes], None]
"""Takes bytes that came."""


@dataclass(slots=True)
class Wire:
    """Opens the wire, and cuts it now and then where that is asked for."""

    runtime: Runtime
    faults: Faults
    receiver: Callable[[Outlet], Feed]
    """Makes the receiver of one connection, which answers through the outlet."""
    cuts: list[Callable[[], None]] = field(default_factory=list)
    mischief: Mischief = field(init=False)
    _cutting: asyncio.Task[None] | None = None

    def __post_init__(self) -> None:
        """Bad luck of its own."""
        self.mischief = Mischief(self.faults, stream(self.runtime.start.seed, self.runtime.name))

    def open_pty(self, baud: int) -> None:
        """A serial line behind the device's stable name; bytes take the time that the baud rate says."""
        port = PtyPort(self.runtime.start.state / self.runtime.name, lambda _data: None)
        outlet = Outlet(port.write, self.mischief, byte_s=10.0 / baud)
        port.on_bytes = self.receiver(outlet)
        port.open()

        def replug() -> None:
            port.close()
            port.open()

        self.cuts.append(replug)
        self.runtime.group.create_task(outlet.run())

    async def open_tcp(self, port: int, greeting: bytes = b"") -> str:
        """A TCP port on loopback; returns ``host:port``."""
        return f"{LOOPBACK}:{await self.runtime.serve(lambda: Connection(self, greeting), port)}"

    async def open_line(self, config: Line) -> str:
        """Whichever line the section asks for; returns the endpoint."""
        if config.kind == "tcp":
            return f"tcp://{await self.open_tcp(config.port)}"
        self.open_pty(config.baud)
        return f"serial:{self.runtime.start.state / self.runtime.name}?baud={config.baud}"

    def ready(self, endpoint: str) -> None:
        """The device answers there; from now on its faults may come."""
        self.runtime.ready(endpoint)
        self.runtime.on_again.append(self.again)
        self.runtime.button(signal.SIGURG, self.cut)
        self.again()
        self.runtime.group.create_task(self.runtime.reboot_later(self.faults.reboot_after_s))

    def again(self) -> None:
        """From now on, with the faults that the device's section says."""
        self.faults = getattr(self.runtime.start.config, self.runtime.name).faults
        self.mischief.faults = self.faults
        if self._cutting is not None:
            self._cutting.cancel()
        self._cutting = self.runtime.group.create_task(self.cut_now_and_then())

    async def cut_now_and_then(self) -> None:
        """Disconnect everyone every so often."""
        while self.faults.disconnect_every_s:
            await asyncio.sleep(self.faults.disconnect_every_s)
            self.cut()

    def cut(self) -> None:
        """Disconnect everyone, once."""
        self.runtime.link.event("wire_cut")
        for cut in list(self.cuts):
            cut()


class Connection(asyncio.Protocol):
    """One TCP connection to a device."""

    def __init__(self, wire: Wire, greeting: bytes = b"") -> None:
        self._wire, self._greeting = wire, greeting

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Greet."""
        if isinstance(transport, asyncio.Transport):
            self._transport = transport
        self._cut = self._transport.abort
        self._outlet = Outlet(self._write, self._wire.mischief, backlog=self._transport.get_write_buffer_size)
        self._feed = self._wire.receiver(self._outlet)
        self._worker = self._wire.runtime.group.create_task(self._outlet.run())
        self._wire.cuts.append(self._cut)
        self._transport.write(self._greeting)

    def data_received(self, data: bytes) -> None:
        """Hand over."""
        self._feed(data)

    def connection_lost(self, _exc: Exception | None) -> None:
        """Forget it."""
        self._worker.cancel()
        self._wire.cuts.remove(self._cut)
        self._outlet.closed = True
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
        """Pull the plug: whoever has it open reads an error."""
        if self._master < 0:
            return
        asyncio.get_running_loop().remove_reader(self._master)
        os.close(self._master)
        os.close(self._slave)
        self._master = self._slave = -1

    def write(self, data: bytes) -> None:
        """Send; what nobody reads is lost once the line is full."""
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
