"""Far ends of wires: a TCP listener and a pseudo-terminal, without tasks, in the loop of the test."""

from __future__ import annotations

import asyncio
import os
import pty
import tty
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable
from functools import reduce
from operator import xor
from pathlib import Path

Filter = Callable[[bytes], Iterable[bytes]]


def unchanged(data: bytes) -> Iterable[bytes]:
    """Return the data unchanged."""
    return [data]


def dribbled(data: bytes) -> Iterable[bytes]:
    """Return the data byte by byte."""
    return [data[at : at + 1] for at in range(len(data))]


class Once:
    """Fault for one message; later messages are unchanged. ``hit`` is set when the fault has acted."""

    def __init__(self, fault: Filter) -> None:
        self._fault: Filter | None = fault
        self.hit = asyncio.Event()

    def __call__(self, data: bytes) -> Iterable[bytes]:
        fault, self._fault = self._fault, None
        if fault is None:
            return [data]
        self.hit.set()
        return fault(data)


class Peer(ABC):
    """Device at a wire. Subclasses implement ``on_bytes``; answers go through ``filter``."""

    def __init__(self) -> None:
        self.filter: Filter = unchanged
        self.silent = False
        self.write: Callable[[bytes], None] = lambda data: None

    @abstractmethod
    def on_bytes(self, data: bytes) -> None:
        """Process received bytes."""

    def on_connect(self) -> None:  # noqa: B027 - optional
        """Process a new connection."""

    def send(self, data: bytes) -> None:
        """Send an answer through the filter."""
        if not self.silent:
            for part in self.filter(data):
                self.write(part)


class NumberedPeer(Peer):
    """Peer that answers numbered lines with a checksum; it drops damaged ones."""

    def __init__(self) -> None:
        super().__init__()
        self.requests: list[str] = []
        self._bytes = b""

    def on_bytes(self, data: bytes) -> None:
        *lines, self._bytes = (self._bytes + data).split(b"\n")
        for line in lines:
            body, _, check = line.rstrip(b"\r").removeprefix(b"$").partition(b"*")
            if check == b"%02X" % reduce(xor, body, 0):
                number, _, request = body.decode().partition(",")
                self.requests.append(request)
                answer = f"{number},{self._answer(request)}".encode()
                self.send(b"$%b*%02X\r\n" % (answer, reduce(xor, answer, 0)))

    @abstractmethod
    def _answer(self, request: str) -> str:
        """Return the answer to a request, both without number and checksum."""


class PtyWire:
    """Pseudo-terminal with a peer at its far end."""

    def __init__(self, peer: Peer, link: Path) -> None:
        self.peer = peer
        self._master, self._slave = pty.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.path = link
        link.symlink_to(os.ttyname(self._slave))
        self._loop = asyncio.get_running_loop()
        self._loop.add_reader(self._master, self._readable)
        peer.write = self.write

    def write(self, data: bytes) -> None:
        """Send bytes to the process that has opened the terminal."""
        if self._master >= 0:
            os.write(self._master, data)

    def cut(self) -> None:
        """Close the terminal; idempotent, because the kernel reuses the number of a closed one for any process."""
        if self._master >= 0:
            self.path.unlink(missing_ok=True)
            self._loop.remove_reader(self._master)
            os.close(self._master)
            os.close(self._slave)
            self._master = -1

    async def close(self) -> None:
        """Close the terminal and remove its link."""
        self.cut()

    def _readable(self) -> None:
        try:
            data = os.read(self._master, 4096)
        except OSError:
            return
        self.peer.on_bytes(data)


class TcpWire:
    """TCP listener for one peer, which answers the newest client."""

    def __init__(self, peer: Peer) -> None:
        self.peer = peer
        self.port = 0
        self._server: asyncio.Server | None = None
        self._clients: list[asyncio.Transport] = []
        peer.write = self.write

    async def start(self, port: int = 0) -> TcpWire:
        """Listen on loopback."""
        loop = asyncio.get_running_loop()
        self._server = await loop.create_server(lambda: _Client(self), "127.0.0.1", port)
        self.port = self._server.sockets[0].getsockname()[1]
        return self

    def write(self, data: bytes) -> None:
        """Send bytes to the newest client."""
        if self._clients:
            self._clients[-1].write(data)

    def drop(self) -> None:
        """Cut all connections; new ones are accepted."""
        for client in self._clients:
            client.abort()
        self._clients.clear()

    def cut(self) -> None:
        """Cut all connections and refuse new ones; idempotent."""
        if self._server is not None:
            self._server.close()
        self.drop()

    async def close(self) -> None:
        """Close the listener and all connections."""
        self.cut()
        if self._server is not None:
            await self._server.wait_closed()
        await asyncio.sleep(0)

    def connected(self, client: asyncio.Transport) -> None:
        """Add a client."""
        self._clients.append(client)
        self.peer.on_connect()

    def disconnected(self, client: asyncio.Transport) -> None:
        """Remove a client."""
        if client in self._clients:
            self._clients.remove(client)


class _Client(asyncio.Protocol):
    def __init__(self, wire: TcpWire) -> None:
        self._wire = wire
        self._transport: asyncio.Transport | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        self._transport = transport
        self._wire.connected(transport)

    def data_received(self, data: bytes) -> None:
        self._wire.peer.on_bytes(data)

    def connection_lost(self, exc: Exception | None) -> None:
        if self._transport is not None:
            self._wire.disconnected(self._transport)
