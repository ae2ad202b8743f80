"""Numbered lines with a checksum over a byte stream. The number identifies late answers, which are dropped.

A line is ``$`` number ``,`` body ``*`` XOR of the bytes between, two hex digits, CR LF. Each request has one answer.
"""

from __future__ import annotations

import asyncio
import contextlib
import re
import time
from abc import ABC, abstractmethod
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from functools import reduce
from operator import xor
from typing import TypeVar

from polishd.drivers.transport.address import SerialLine, Tcp, garbled, silent
from polishd.drivers.transport.background import RequestQueue
from polishd.drivers.transport.streams import LineReader, open_stream
from polishd.interfaces import ByteStream
from polishd.model.devices import DeviceIdentity
from polishd.model.errors import DeviceRefused, LinkError, ProtocolError

NUMBERED_LINE_BYTES = 120
"""Longest line, bytes."""
OPEN_S = 1.0
_LINE = re.compile(rb"\$([ -)+-~]*)\*([0-9A-F]{2})\r?")


def encode(number: int, body: str) -> bytes:
    """Return a numbered request as a line."""
    text = f"{number},{body}".encode("ascii")
    return b"$%b*%02X\r\n" % (text, _checksum(text))


def decode(line: bytes) -> tuple[int, str] | None:
    """Return number and body of a line without its LF; None if it is broken: such lines are dropped."""
    start = line.rfind(b"$")
    match = _LINE.fullmatch(line[start:]) if start >= 0 and len(line) - start <= NUMBERED_LINE_BYTES else None
    if match is None or int(match[2], 16) != _checksum(match[1]):
        return None
    number, comma, body = match[1].decode("ascii").partition(",")
    if not (comma and number.isdigit() and len(number) <= 5):
        return None
    return int(number), body


def identity(body: str) -> DeviceIdentity:
    """Parse the answer to ``ID?``; ProtocolError if it is invalid."""
    parts = body.split(",")
    if len(parts) != 6 or parts[0] != "ID":
        raise ProtocolError(f"no answer to ID?: {body!r}")
    return DeviceIdentity(parts[1], parts[2], parts[3], parts[4], boot_id=parts[5])


class NumberedLines:
    """Link with numbered lines. The caller sends one request at a time."""

    def __init__(self, address: SerialLine | Tcp, silence_s: float) -> None:
        """An answer comes within ``silence_s``."""
        self.name = str(address)
        """For messages."""
        self._silence_s = silence_s
        self._address = address
        self._stream: ByteStream | None = None
        self._lines: LineReader | None = None
        self._number = 0
        self._broken = b""
        """A line that arrived instead of the answer."""

    @property
    def connected(self) -> bool:
        """False before ``connect``, and once the connection is lost."""
        return self._stream is not None

    async def connect(self) -> None:
        """Open the link; reopen an open one."""
        await self.disconnect()
        self._stream = await open_stream(self._address, OPEN_S)
        self._lines = LineReader(self._stream, longest=NUMBERED_LINE_BYTES)

    async def disconnect(self) -> None:
        """Idempotent."""
        stream, self._stream = self._stream, None
        if stream is not None:
            await stream.close()

    async def ask(self, request: str) -> str:
        """Return the answer's body. LinkError if none arrives in time; DeviceRefused for ``ERR,...``."""
        if self._stream is None or self._lines is None:
            raise LinkError(f"{self.name}: is not open")
        self._number, self._broken = (self._number + 1) & 0xFFFF, b""
        deadline = time.monotonic() + self._silence_s
        try:
            await self._stream.write(encode(self._number, request))
            answer = await self._answer(self._lines, deadline)
        except LinkError as error:
            if time.monotonic() < deadline:  # the connection itself is lost
                await self.disconnect()
                raise LinkError(f"{self.name}: no answer to {request} ({error})") from error
            raise LinkError(f"{self.name}: {self._unanswered(request, self._lines.rest)}") from error
        if answer.startswith("ERR,"):
            why = answer.removeprefix("ERR,")
            other = "; is it another device?" if why.startswith("unknown") else ""
            raise DeviceRefused(f"{self.name}: {request} was refused: {why}{other}")
        return answer

    async def _answer(self, lines: LineReader, deadline: float) -> str:
        while True:
            line = await lines.next(max(deadline - time.monotonic(), 0.0))
            numbered = decode(line)
            if numbered is None:
                self._broken = line.strip() or self._broken
            elif numbered[0] == self._number:
                return numbered[1]

    def _unanswered(self, request: str, rest: bytes) -> str:
        """Describe a missing or garbled answer with its likely cause."""
        if came := self._broken or rest.strip():
            return f"{request}: {garbled(self._address, came, self._silence_s)}"
        return f"no answer to {request} {silent(self._address, self._silence_s)}"


def _checksum(text: bytes) -> int:
    return reduce(xor, text, 0)


# Lines without numbers: the next line that arrives is the answer. Silence ends the link.

T = TypeVar("T")
PLAIN_LINE_BYTES = 1000
"""Longest answer, bytes."""


class PlainLines:
    """Link with plain ASCII lines, over TCP or a serial line, one request at a time; lines end with LF."""

    def __init__(self, address: Tcp | SerialLine, silence_s: float, *, hello: str, refusal: str = "") -> None:
        """Without an answer within ``silence_s`` the link is dead.

        ``hello`` is a request that changes nothing; an answer that begins with ``refusal`` raises DeviceRefused.
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
        """Whether the link is open and not known to be dead."""
        return self._stream is not None

    async def open(self) -> None:
        """Connect and send ``hello``; LinkError without an answer. A failure or cancellation closes the link."""
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
        """Disconnect; waiting calls get LinkError. Idempotent."""
        await self._queue.stop()
        await self._hang_up()

    @asynccontextmanager
    async def opened(self) -> AsyncIterator[None]:
        """Keep the link open during the block; a closed link is opened for the block only."""
        if self.is_open:
            yield
            return
        await self.open()
        try:
            yield
        finally:
            await self.close()

    async def ask(self, line: str, *, urgent: bool = False) -> str:
        """Return the answer; LinkError if the link is closed, dead or silent. An urgent line overtakes others."""
        answer = await self._queue.ask(lambda: self._exchange(line), urgent=urgent)
        if self._refusal and answer.startswith(self._refusal):
            raise DeviceRefused(f"{self.name}: {line} was refused: {answer}")
        return answer

    async def read(self, line: str, parse: Callable[[str], T], *, urgent: bool = False) -> T:
        """Return the parsed answer; ProtocolError if ``parse`` raises ValueError."""
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
            if time.monotonic() >= deadline:  # otherwise the connection itself is lost
                garbage = came and f"{line}: {garbled(self._address, came, self._silence_s)}"
                why = str(garbage or f"no answer to {line} {silent(self._address, self._silence_s)}")
            await self._hang_up()
            raise LinkError(f"{self.name}: {why}") from error
        return answer.decode("ascii", "replace").strip()

    async def _hang_up(self) -> None:
        stream, self._stream = self._stream, None
        if stream is not None:
            await stream.close()


# Devices on numbered lines: one request at a time.

ANSWERS_S = 2.0
"""Time of ``make_safe`` beyond the action: a link that is lost meanwhile is opened again once."""


class LineDevice(ABC):
    """Common base of their drivers. A lost link stays lost until ``open``; only ``make_safe`` reconnects."""

    def __init__(self, address: SerialLine | Tcp, silence_s: float) -> None:
        """An answer comes within ``silence_s``."""
        self._lines = NumberedLines(address, silence_s)
        self._turn = asyncio.Lock()

    @property
    def name(self) -> str:
        """Address, for messages."""
        return self._lines.name

    async def open(self) -> None:
        """See Device."""
        await self._lines.connect()
        try:
            await self._look()
        except BaseException:
            await self.close()
            raise

    async def close(self) -> None:
        """See Device."""
        await self._lines.disconnect()

    async def identify(self) -> DeviceIdentity:
        """See Device."""
        return identity(await self.ask("ID?"))

    @abstractmethod
    async def make_safe(self) -> None:
        """See Device."""

    async def _look(self) -> object:
        """Send a request that shows that the device answers."""
        return await self.identify()

    async def ask(self, request: str) -> str:
        """Return the answer's body; DeviceRefused for ``ERR,...``."""
        async with self._turn:
            return await self._lines.ask(request)

    async def _order(self, request: str) -> None:
        """Send a command; ProtocolError if the answer is not ``OK``."""
        answer = await self.ask(request)
        if answer != "OK":
            raise ProtocolError(f"{self.name}: {request} was answered by {answer!r}")

    async def _rest(self, go: Callable[[], Awaitable[object]], within_s: float, otherwise: str) -> None:
        """Bring the device to rest and confirm it; a link that is lost meanwhile is opened again once.

        After ``within_s`` LinkError with the message ``otherwise``.
        """
        opened = self._lines.connected
        try:
            async with asyncio.timeout(within_s):
                if opened:
                    with contextlib.suppress(LinkError, ProtocolError):
                        await go()
                        return
                await self._lines.connect()
                await go()
        except TimeoutError:
            raise LinkError(f"{self.name}: {otherwise}") from None
        finally:
            if not opened:
                await self.close()


# Read-only devices on numbered lines: nothing to make safe.


class ReadOnlyLineDevice(LineDevice):
    """Common base of their drivers."""

    async def make_safe(self) -> None:
        """See Device. The device exerts no force: only its answer can be confirmed."""
        await self._rest(self._look, ANSWERS_S, f"no answer within {ANSWERS_S:g} s")
