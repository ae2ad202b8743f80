"""Byte streams over TCP and serial lines. pyserial configures and locks a port; reading and writing never block."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import os
import socket
import ssl
import termios
import time
from functools import partial
from typing import cast

import serial

from polishd.drivers.transport.address import SerialLine, Tcp
from polishd.drivers.transport.background import open_blocking, settle
from polishd.drivers.transport.claims import claim_address
from polishd.interfaces import ByteStream
from polishd.model.errors import LinkError
from polishd.util.address_claims import Claim
from polishd.util.wire_recording import tap

WRITE_S = 1.0
"""Time after which a peer or a line that accepts no bytes is dead."""


async def open_stream(
    address: Tcp | SerialLine, within_s: float = 1.0, tls: ssl.SSLContext | None = None
) -> TcpStream | SerialStream:
    """Connect; LinkError without an answer in that time. ``tls``: encrypt a TCP connection.

    DeviceClaimed if another program on this computer has the address: then nothing is connected.
    """
    claimed = await claim_address(address)
    try:
        opened = await connect_unclaimed(address, within_s, tls)
    except BaseException:
        claimed.release()
        raise
    opened.claimed = claimed
    return opened


async def connect_unclaimed(
    address: Tcp | SerialLine, within_s: float, tls: ssl.SSLContext | None = None
) -> TcpStream | SerialStream:
    """Connect to an address that the caller has claimed."""
    if isinstance(address, SerialLine):
        return await _open_serial(address, within_s)
    loop = asyncio.get_running_loop()
    try:
        async with asyncio.timeout(within_s):
            make = partial(TcpStream, str(address))
            _, stream = await loop.create_connection(make, address.host, address.port, ssl=tls)
    except TimeoutError:
        raise LinkError(f"{address}: no connection within {within_s:g} s") from None
    except OSError as error:
        raise LinkError(f"{address}: {_why_not_connected(error)}") from error
    return stream


def _why_not_connected(error: OSError) -> str:
    """Return the error in the address, and what to do."""
    if isinstance(error, ssl.SSLError):
        why = getattr(error, "verify_message", "") or error.reason
        return f"no encrypted connection: {why}. Check the port, and the certificate in the cell's file."
    if isinstance(error, socket.gaierror):
        return "no host has that name. Correct it, or check the name server."
    match error.errno:
        case errno.ECONNREFUSED:
            return "the port is closed. Check the port number, and whether the device is on."
        case errno.EHOSTUNREACH | errno.ENETUNREACH:
            return "no route to that host. Check the cable and this computer's network."
    return str(error)


async def _open_serial(address: SerialLine, within_s: float) -> SerialStream:
    """Open a serial line exclusively; bytes received before are dropped."""
    make = partial(
        serial.Serial,
        str(address.path),
        address.baud,
        parity=address.parity[0].upper(),
        stopbits=address.stop_bits,
        timeout=0,
        write_timeout=0,
        exclusive=True,
    )
    try:
        port = await open_blocking(make, serial.Serial.close, within_s, str(address))
    except (OSError, ValueError, termios.error) as error:  # SerialException is the first
        raise LinkError(f"{address}: {why_closed(error, address.settings)}") from error
    return SerialStream(str(address), port)


def why_closed(error: BaseException, settings: str) -> str:
    """Return why pyserial did not open a serial port, and what to do."""
    cause = error.__context__ if isinstance(error.__context__, termios.error) else error
    match cause.args[0] if cause.args else None:
        case errno.EAGAIN | errno.EBUSY:
            return "another program has the port open. End that program (lsof names it)."
        case errno.EACCES | errno.EPERM:
            return "no permission to open the port. Add the user to the group that owns it (often dialout)."
        case errno.ENOENT | errno.ENXIO | errno.ENODEV:
            return "the port does not exist. Plug the adapter in, or correct the path."
        case errno.ENOTTY | errno.EINVAL | errno.EISDIR:
            return f"it is not a serial port, or does not support {settings}. Correct the path or the settings."
    return str(error)


class ReadBuffer:
    """Receiving half of a stream: bytes not read yet, and the reason why no more will arrive."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._bytes = bytearray()
        self._failure: str | None = None
        self._cause: BaseException | None = None
        self._tap = tap(name)
        self._waiter: asyncio.Future[None] | None = None
        self.claimed = Claim()
        """Claim on the address, until the stream is closed."""

    def feed(self, data: bytes) -> None:
        """Add received bytes."""
        if self._tap is not None:
            self._tap("in", data)
        self._bytes += data
        self._wake()

    def fail(self, reason: str | BaseException) -> None:
        """Mark the stream as failed: no more bytes will arrive. The first reason is kept."""
        if self._failure is None:
            self._cause = reason if isinstance(reason, BaseException) else None
            self._failure = reason = str(reason) or type(reason).__name__
            if self._tap is not None:
                self._tap("end", why=reason)
        self._wake()

    @property
    def alive(self) -> bool:
        """Whether no failure of the link is known."""
        return self._failure is None

    def check(self) -> None:
        """Raise LinkError once the link has failed."""
        if self._failure is not None:
            raise LinkError(f"{self._name}: {self._failure}") from self._cause

    def wrote(self, data: bytes) -> None:
        """Record sent bytes."""
        if self._tap is not None:
            self._tap("out", data)

    async def read(self, at_most: int, within_s: float) -> bytes:
        """See ByteStream. A late wake-up loses no bytes that arrived in time."""
        if not self._bytes and self._failure is None:
            self._waiter = asyncio.get_running_loop().create_future()
            await asyncio.wait({self._waiter}, timeout=within_s)
        if self._bytes:
            data = bytes(self._bytes[:at_most])
            del self._bytes[:at_most]
            return data
        self.check()
        raise LinkError(f"{self._name}: silent for {within_s:.2g} s")

    def _wake(self) -> None:
        if self._waiter is not None:
            settle(self._waiter)


class SerialStream(ReadBuffer):
    """A ByteStream that owns an open pyserial port."""

    def __init__(self, name: str, port: serial.Serial) -> None:
        super().__init__(name)
        self._port = port
        self._loop = asyncio.get_running_loop()
        self._fd: int = port.fileno()
        self._loop.add_reader(self._fd, self._readable)

    async def write(self, data: bytes) -> None:
        """See ByteStream."""
        view = memoryview(data)
        self.check()
        self.wrote(data)
        while view:
            self.check()
            try:
                view = view[os.write(self._fd, view) :]
            except BlockingIOError:
                await self._writable()
            except OSError as error:
                self.fail(error)

    async def close(self) -> None:
        """See ByteStream."""
        self.fail("the line is closed")
        if self._port.is_open:
            self._port.close()
        self.claimed.release()

    def _readable(self) -> None:
        try:
            data = os.read(self._fd, 4096)
        except BlockingIOError:
            return
        except (OSError, MemoryError) as error:
            self.fail(error)
            return
        if data:
            self.feed(data)
        else:
            self.fail("the line was hung up")

    def fail(self, reason: str | BaseException) -> None:
        """See ReadBuffer."""
        if self._port.is_open:
            self._loop.remove_reader(self._fd)
        super().fail(reason)

    async def _writable(self) -> None:
        ready: asyncio.Future[None] = self._loop.create_future()
        self._loop.add_writer(self._fd, settle, ready)
        try:
            await asyncio.wait({ready}, timeout=WRITE_S)
        finally:
            self._loop.remove_writer(self._fd)
        if not ready.done():
            self.fail(f"the line takes no data for {WRITE_S:g} s")


class TcpStream(ReadBuffer, asyncio.Protocol):
    """A ByteStream over TCP. Data received before the end of file is read before LinkError is raised."""

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self._transport: asyncio.Transport | None = None
        self._closed: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._writable = asyncio.Event()
        self._writable.set()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Called by asyncio."""
        self._transport = cast("asyncio.Transport", transport)

    def data_received(self, data: bytes) -> None:
        """Called by asyncio."""
        self.feed(data)

    def eof_received(self) -> None:
        """Called by asyncio."""
        self.fail("the peer closed the connection")

    def connection_lost(self, exc: Exception | None) -> None:
        """Called by asyncio."""
        self.fail(exc or "the connection is closed")
        self._writable.set()
        settle(self._closed)

    def pause_writing(self) -> None:
        """Called by asyncio."""
        self._writable.clear()

    def resume_writing(self) -> None:
        """Called by asyncio."""
        self._writable.set()

    async def write(self, data: bytes) -> None:
        """See ByteStream."""
        self.check()
        if self._transport is None or self._transport.is_closing():
            raise LinkError(f"{self._name}: the connection is closed")
        self.wrote(data)
        self._transport.write(data)
        if not self._writable.is_set():
            try:
                async with asyncio.timeout(WRITE_S):
                    await self._writable.wait()
            except TimeoutError:
                self.fail(f"the peer takes no data for {WRITE_S:g} s")
            self.check()

    async def close(self) -> None:
        """See ByteStream."""
        if self._transport is not None:
            self.fail("the connection is closed")
            self._transport.abort()
            try:
                await asyncio.wait({self._closed}, timeout=WRITE_S)
            finally:
                self.claimed.release()


async def drop_stale(stream: ByteStream) -> None:
    """Drop received bytes: they arrived before the request. The next write reports a dead link."""
    with contextlib.suppress(LinkError):
        while True:
            await stream.read(4096, 0.0)


class LineReader:
    """Reads lines off a stream; what is longer than allowed is dropped up to its end."""

    def __init__(self, stream: ByteStream, longest: int) -> None:
        self._stream = stream
        self._longest = longest
        self._rest = bytearray()

    @property
    def rest(self) -> bytes:
        """What came after the last line."""
        return bytes(self._rest)

    async def restart(self) -> None:
        """Drop what has come; see ``drop_stale``."""
        self._rest.clear()
        await drop_stale(self._stream)

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
