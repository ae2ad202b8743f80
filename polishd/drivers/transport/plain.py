"""Lines without numbers: each has one answer, the next line that comes. Silence ends the link.

A late answer could not be told from that to the next line. So what comes before a line is sent is dropped, and where no
answer comes in time nothing is asked any more before ``open``; and a caller that is cancelled leaves its answer to be
read, and dropped.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from typing import TypeVar

from polishd.drivers.transport.address import SerialLine, Tcp, garbled, silent
from polishd.drivers.transport.requests import RequestQueue
from polishd.drivers.transport.streams import LineReader, open_stream
from polishd.model.errors import DeviceRefused, LinkError, ProtocolError
from polishd.ports.stream import ByteStream

T = TypeVar("T")
PLAIN_LINE_BYTES = 1000
"""Bytes of an answer."""


class PlainLines:
    """Asks one line at a time, over TCP or a serial line, in ASCII; lines end with LF."""

    def __init__(self, address: Tcp | SerialLine, silence_s: float, *, hello: str, refusal: str = "") -> None:
        """An answer comes within ``silence_s``, or the link is dead.

        ``hello`` is a question that changes nothing; an answer that begins with ``refusal`` raises DeviceRefused.
        """
        self.name = str(address)
        """For messages."""
        self._address = address
        self._silence_s = silence_s
        self._hello = hello
        self._refusal = refusal
        self._queue = RequestQueue(self.name)
        self._stream: ByteStream | None = None
        self._lines: LineReader | None = None
        self._opening = asyncio.Lock()

    @property
    def is_open(self) -> bool:
        """Opened, not closed, and not found dead since."""
        return self._stream is not None

    async def open(self) -> None:
        """Connect anew, and say hello; LinkError where nobody answers. Cancelled, or in vain, it is closed."""
        async with self._opening:
            await self.close()
            try:
                self._stream = await open_stream(self._address, self._silence_s)
                self._lines = LineReader(self._stream, PLAIN_LINE_BYTES)
                await self._queue.start()
                await self.ask(self._hello)
            except BaseException:
                await self.close()
                raise

    async def close(self) -> None:
        """Disconnect; whoever waits gets LinkError. Idempotent."""
        await self._queue.stop()
        await self._hang_up()

    @asynccontextmanager
    async def opened(self) -> AsyncIterator[None]:
        """It is open in this block, for what may be asked in any state: as it is, or else for the time of the block."""
        if self.is_open:
            yield
            return
        await self.open()
        try:
            yield
        finally:
            await self.close()

    async def ask(self, line: str, *, urgent: bool = False) -> str:
        """The answer; LinkError where the link is not open, dead or silent. An urgent line overtakes others."""
        answer = await self._queue.ask(lambda: self._exchange(line), urgent=urgent)
        if self._refusal and answer.startswith(self._refusal):
            raise DeviceRefused(f"{self.name}: {line} was refused: {answer}")
        return answer

    async def read(self, line: str, parse: Callable[[str], T], *, urgent: bool = False) -> T:
        """What ``parse`` makes of the answer; ProtocolError where that raises ValueError."""
        answer = await self.ask(line, urgent=urgent)
        try:
            return parse(answer)
        except ValueError as error:
            raise ProtocolError(f"{self.name}: {line} was answered by {answer!r}: {error}") from error

    async def _exchange(self, line: str) -> str:
        if self._stream is None or self._lines is None:
            raise LinkError(f"{self.name}: the link was lost")
        deadline = time.monotonic() + self._silence_s
        try:
            await self._lines.restart()
            await self._stream.write(line.encode("ascii") + b"\n")
            answer = await self._lines.next(self._silence_s)
        except LinkError as error:
            why, came = f"no answer to {line} ({error})", self._lines.rest
            if time.monotonic() >= deadline:  # else the wire itself is gone
                garbage = came and f"{line}: {garbled(self._address, came, self._silence_s)}"
                why = str(garbage or f"no answer to {line} {silent(self._address, self._silence_s)}")
            await self._hang_up()
            raise LinkError(f"{self.name}: {why}") from error
        return answer.decode("ascii", "replace").strip()

    async def _hang_up(self) -> None:
        stream, self._stream = self._stream, None
        if stream is not None:
            await stream.close()
