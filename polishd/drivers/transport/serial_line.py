"""A byte stream over a serial line. pyserial configures and locks the port; reading and writing never block."""

from __future__ import annotations

import asyncio
import os
from functools import partial

import serial

from polishd.api import ByteStream, LinkError
from polishd.drivers.transport.address import SerialLine
from polishd.drivers.transport.background import open_blocking, settle
from polishd.drivers.transport.buffer import ReadBuffer

WRITE_S = 1.0
"""A line that takes no bytes for so long is dead."""


async def open_serial(address: SerialLine, within_s: float) -> ByteStream:
    """Open a serial line for ourselves alone; what was received before is dropped."""
    make = partial(serial.Serial, str(address.path), address.baud, timeout=0, write_timeout=0, exclusive=True)
    try:
        port = await open_blocking(make, serial.Serial.close, within_s, str(address))
    except OSError as error:  # SerialException is one
        raise LinkError(f"{address}: {error}") from error
    return SerialStream(str(address), port)


class SerialStream:
    """A ByteStream over an open pyserial port, which it owns."""

    def __init__(self, name: str, port: serial.Serial) -> None:
        self._port = port
        self._buffer = ReadBuffer(name)
        self._loop = asyncio.get_running_loop()
        self._fd: int = port.fileno()
        self._loop.add_reader(self._fd, self._readable)

    async def read(self, at_most: int, within_s: float) -> bytes:
        """See ByteStream."""
        return await self._buffer.take(at_most, within_s)

    async def write(self, data: bytes) -> None:
        """See ByteStream."""
        view = memoryview(data)
        while view:
            self._buffer.check()
            try:
                view = view[os.write(self._fd, view) :]
            except BlockingIOError:
                await self._writable()
            except OSError as error:
                self._fail(str(error))

    async def close(self) -> None:
        """See ByteStream."""
        self._fail("the line is closed")
        if self._port.is_open:
            self._port.close()

    def _readable(self) -> None:
        try:
            data = os.read(self._fd, 4096)
        except BlockingIOError:
            return
        except OSError as error:
            self._fail(str(error))
            return
        if data:
            self._buffer.feed(data)
        else:
            self._fail("the line was hung up")

    def _fail(self, reason: str) -> None:
        if self._port.is_open:
            self._loop.remove_reader(self._fd)
        self._buffer.fail(reason)

    async def _writable(self) -> None:
        ready: asyncio.Future[None] = self._loop.create_future()
        self._loop.add_writer(self._fd, settle, ready)
        try:
            await asyncio.wait({ready}, timeout=WRITE_S)
        finally:
            self._loop.remove_writer(self._fd)
        if not ready.done():
            self._fail(f"the line takes no data for {WRITE_S:g} s")
