"""A device's wire, serial or TCP, with its mischief: bytes in, bytes out."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import dataclass, field

from polishd.config.simulator import Faults
from polishd.sim_backends.faults import Mischief, Outlet
from polishd.sim_backends.pty_port import PtyPort
from polishd.sim_backends.runtime import LOOPBACK, Runtime
from polishd.sim_backends.truth import stream

Send = Callable[..., None]
Feed = Callable[[bytes, Send], None]
"""(bytes, send): take bytes; answer through ``send(data, delay_s=0)``."""


@dataclass(slots=True)
class Wire:
    """Opens the wire, and cuts it now and then where that is asked for."""

    runtime: Runtime
    faults: Faults
    feed: Callable[[], Feed]
    """Makes the receiver of one connection."""
    outlets: list[Outlet] = field(default_factory=list)
    cuts: list[Callable[[], None]] = field(default_factory=list)
    _mischief: Mischief = field(init=False)

    def __post_init__(self) -> None:
        """Bad luck of its own."""
        self._mischief = Mischief(self.faults, stream(self.runtime.start.seed, self.runtime.name))

    def open_pty(self, baud: int) -> None:
        """A serial line behind the device's stable name; bytes take the time that the baud rate says."""
        port = PtyPort(self.runtime.start.state / self.runtime.name, lambda _data: None)
        outlet = Outlet(port.write, self._mischief, byte_s=10.0 / baud)
        feed = self.feed()
        port.on_bytes = lambda data: feed(data, outlet.send)
        port.open()

        def replug() -> None:
            port.close()
            port.open()

        self.outlets.append(outlet)
        self.cuts.append(replug)
        self.runtime.group.create_task(outlet.run())

    async def open_tcp(self, port: int, greeting: bytes = b"") -> str:
        """A TCP port on loopback; returns ``host:port``."""
        return f"{LOOPBACK}:{await self.runtime.serve(lambda: _Connection(self, greeting), port)}"

    def add(self, write: Callable[[bytes], None], cut: Callable[[], None]) -> Outlet:
        """A new connection's outlet."""
        outlet = Outlet(write, self._mischief)
        self.outlets.append(outlet)
        self.cuts.append(cut)
        return outlet

    async def cut_now_and_then(self) -> None:
        """Disconnect everyone every so often."""
        while self.faults.disconnect_every_s:
            await asyncio.sleep(self.faults.disconnect_every_s)
            self.runtime.link.event("wire_cut")
            for cut in list(self.cuts):
                cut()


class _Connection(asyncio.Protocol):
    """One TCP connection to a device."""

    def __init__(self, wire: Wire, greeting: bytes) -> None:
        self._wire, self._greeting, self._feed = wire, greeting, wire.feed()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Greet."""
        if isinstance(transport, asyncio.Transport):
            self._transport = transport
        self._cut = self._transport.abort
        self._outlet = self._wire.add(self._transport.write, self._cut)
        self._worker = self._wire.runtime.group.create_task(self._outlet.run())
        self._transport.write(self._greeting)

    def data_received(self, data: bytes) -> None:
        """Hand over."""
        self._feed(data, self._outlet.send)

    def connection_lost(self, _exc: Exception | None) -> None:
        """Forget it."""
        self._worker.cancel()
        self._outlet.closed = True
        self._wire.outlets.remove(self._outlet)
        self._wire.cuts.remove(self._cut)
