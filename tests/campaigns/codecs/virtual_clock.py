"""A loop whose time goes on only where nothing is left to do, and wires of no length in it."""

from __future__ import annotations

import asyncio
import selectors
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import pytest

from polishd.drivers.transport import streams
from polishd.drivers.transport.streams import ReadBuffer
from polishd.util import address_claims
from polishd.util.address_claims import KeptClaims
from tests.fakes.wires import Peer


class VirtualLoop(asyncio.SelectorEventLoop):
    """Waiting takes no time. Each connection is one to ``peer``."""

    def __init__(self) -> None:
        super().__init__(_Jumping(self))
        self.now_s = 0.0
        self.peer: Peer | None = None
        self.port: VirtualPort | None = None
        self.failures: list[dict[str, Any]] = []
        self.set_exception_handler(lambda _, failure: self.failures.append(failure))

    def time(self) -> float:
        return self.now_s

    async def getaddrinfo(self, host: Any, port: Any, **_: Any) -> Any:
        """Resolve each host to loopback at once: a name server would be asked in a thread."""
        return [(socket.AF_INET, socket.SOCK_STREAM, 0, "", ("127.0.0.1", port))]

    async def create_connection(self, protocol_factory: Callable[[], Any], *_: Any, **__: Any) -> Any:
        """In place of a socket: a connection to the peer."""
        protocol = protocol_factory()
        wire = VirtualTransport(self, protocol)
        protocol.connection_made(wire)
        if self.peer is not None:
            self.peer.write = wire.say
            self.peer.on_connect()
        return wire, protocol

    async def create_datagram_endpoint(self, protocol_factory: Callable[[], Any], *_: Any, **__: Any) -> Any:
        """In place of a UDP socket: one that is connected to the peer."""
        protocol = protocol_factory()
        wire = VirtualDatagrams(self, protocol)
        protocol.connection_made(wire)
        if self.peer is not None:
            self.peer.write = wire.say
        return wire, protocol

    def say(self, data: bytes) -> None:
        """The far end of the line: what comes late comes to the connection that has the port open then."""
        if self.port is not None:
            self.port.feed(data)

    async def open_serial(self, address: object, within_s: float) -> VirtualPort:
        """In place of a serial port: one whose far end is the peer; what came before is dropped."""
        return VirtualPort(str(address), self)


class _Jumping(selectors.DefaultSelector):
    """Moves the clock instead of waiting. No file is watched but the loop's own, so nothing is polled for."""

    def __init__(self, loop: VirtualLoop) -> None:
        super().__init__()
        self._loop = loop

    def select(self, timeout: float | None = None) -> list[Any]:
        if timeout is None:  # no timer is set: only a thread can go on
            return super().select(None)
        self._loop.now_s += timeout
        return []


class VirtualTransport(asyncio.Transport):
    """One TCP connection: what comes after its end is lost."""

    def __init__(self, loop: VirtualLoop, protocol: Any) -> None:
        super().__init__()
        self._loop, self._protocol, self._closed = loop, protocol, False

    def say(self, data: bytes) -> None:
        """The peer's end."""
        if not self._closed:
            try:
                self._protocol.data_received(data)
            except Exception as error:  # noqa: BLE001 -- as asyncio's own transports do
                self._closed = True
                self._loop.call_soon(self._protocol.connection_lost, error)

    def write(self, data: Any) -> None:
        if not self._closed and self._loop.peer is not None:
            self._loop.peer.on_bytes(bytes(data))  # which answers later

    def is_closing(self) -> bool:
        return self._closed

    def abort(self) -> None:
        if not self._closed:
            self._closed = True
            self._loop.call_soon(self._protocol.connection_lost, None)

    def close(self) -> None:
        self.abort()


class VirtualDatagrams(asyncio.DatagramTransport):
    """One UDP socket: datagrams that come after its end are lost."""

    def __init__(self, loop: VirtualLoop, protocol: Any) -> None:
        super().__init__()
        self._loop, self._protocol, self._closed = loop, protocol, False

    def say(self, data: bytes) -> None:
        """Pass a datagram of the peer on."""
        if not self._closed:
            self._protocol.datagram_received(data, ("127.0.0.1", 1))

    def sendto(self, data: Any, addr: Any = None) -> None:
        if not self._closed and self._loop.peer is not None:
            self._loop.peer.on_bytes(bytes(data))

    def is_closing(self) -> bool:
        return self._closed

    def close(self) -> None:
        if not self._closed:
            self._closed = True
            self._loop.call_soon(self._protocol.connection_lost, None)


class VirtualPort(ReadBuffer):
    """A ByteStream. The line outlives it: what was due to the one before may come to it."""

    def __init__(self, name: str, loop: VirtualLoop) -> None:
        super().__init__(name)
        self._loop = loop
        if loop.peer is not None:
            loop.peer.write = loop.say
        loop.port = self

    async def write(self, data: bytes) -> None:
        self.check()
        if self._loop.peer is not None:
            self._loop.peer.on_bytes(data)

    async def close(self) -> None:
        self.fail("the line is closed")


@contextmanager
def virtual(monkeypatch: pytest.MonkeyPatch) -> Iterator[VirtualLoop]:
    """The loop, for the time of the block; all clocks are its own, and nothing is left running in it.

    Claims on addresses are kept for the time of the block, as the daemon keeps them while a connection is lost: their
    files took more time than the drivers. The files are in a folder of this block, so that processes can run side by
    side.
    """
    loop, claims = VirtualLoop(), KeptClaims()
    with monkeypatch.context() as patch, TemporaryDirectory() as folder, claims.keeping():
        patch.setattr(address_claims, "FOLDERS", (Path(folder),))
        patch.setattr(time, "monotonic", loop.time)
        patch.setattr(streams, "_open_serial", loop.open_serial)
        try:
            yield loop
            loop.run_until_complete(asyncio.sleep(10.0))
            assert asyncio.all_tasks(loop) == set()
            assert loop.failures == [], loop.failures[:3]
        finally:
            loop.close()
            claims.release()
