"""Byte streams over TCP and serial lines."""

from __future__ import annotations

import asyncio
import time
from typing import cast

from polishd.api import ByteStream, LinkError
from polishd.drivers.transport.address import SerialLine, Tcp
from polishd.drivers.transport.background import settle
from polishd.drivers.transport.buffer import ReadBuffer
from polishd.drivers.transport.serial_line import open_serial

WRITE_S = 1.0
"""A peer that takes no bytes for so long is dead."""


async def open_stream(address: Tcp | SerialLine, within_s: float = 1.0) -> ByteStream:
    """Connect; LinkError where nobody answers within that time."""
    if isinstance(address, SerialLine):
        return await open_serial(address, within_s)
    loop = asyncio.get_running_loop()
    try:
        async with asyncio.timeout(within_s):
            _, stream = await loop.create_connection(lambda: TcpStream(str(address)), address.host, address.port)
    except TimeoutError:
        raise LinkError(f"{address}: no connection within {within_s:g} s") from None
    except OSError as error:
        raise LinkError(f"{address}: {error}") from error
    return stream


class TcpStream(asyncio.Protocol):
    """A ByteStream over TCP. Data that came before the end of file is read before LinkError is raised."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._buffer = ReadBuffer(name)
        self._transport: asyncio.Transport | None = None
        self._closed: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._writable = asyncio.Event()
        self._writable.set()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Called by asyncio."""
        self._transport = cast("asyncio.Transport", transport)

    def data_received(self, data: bytes) -> None:
        """Called by asyncio."""
        self._buffer.feed(data)

    def eof_received(self) -> None:
        """Called by asyncio."""
        self._buffer.fail("the peer closed the connection")

    def connection_lost(self, exc: Exception | None) -> None:
        """Called by asyncio."""
        self._buffer.fail(str(exc) if exc else "the connection is closed")
        self._writable.set()
        settle(self._closed)

    def pause_writing(self) -> None:
        """Called by asyncio."""
        self._writable.clear()

    def resume_writing(self) -> None:
        """Called by asyncio."""
        self._writable.set()

    async def read(self, at_most: int, within_s: float) -> bytes:
        """See ByteStream."""
        return await self._buffer.take(at_most, within_s)

    async def write(self, data: bytes) -> None:
        """See ByteStream."""
        self._buffer.check()
        if self._transport is None or self._transport.is_closing():
            raise LinkError(f"{self._name}: the connection is closed")
        self._transport.write(data)
        if not self._writable.is_set():
            try:
                async with asyncio.timeout(WRITE_S):
                    await self._writable.wait()
            except TimeoutError:
                self._buffer.fail(f"the peer takes no data for {WRITE_S:g} s")
            self._buffer.check()

    async def close(self) -> None:
        """See ByteStream."""
        if self._transport is not None:
            self._buffer.fail("the connection is closed")
            self._transport.abort()
            await asyncio.wait({self._closed}, timeout=WRITE_S)


class LineReader:
    """Reads lines off a stream; what is longer than allowed is dropped up to its end."""

    def __init__(self, stream: ByteStream, longest: int) -> None:
        self._stream = stream
        self._longest = longest
        self._rest = bytearray()

    async def next(self, within_s: float) -> bytes:
        """The next line without its end; LinkError when it is not complete in time."""
        deadline = time.monotonic() + within_s
        while True:
            line, end, rest = self._rest.partition(b"\n")
            if end:
                self._rest = rest
                if len(line) <= self._longest:
                    return bytes(line)
                continue
            if len(self._rest) > 2 * self._longest:
                del self._rest[: -self._longest - 1]
            self._rest += await self._stream.read(4096, max(deadline - time.monotonic(), 0.0))
