"""Numbered lines with a checksum over a byte stream: a late answer is dropped by its number, never taken for another.

A line is ``$`` number ``,`` body ``*`` XOR of what stands between, two hex digits, CR LF. Each request has one answer.
"""

from __future__ import annotations

import re
import time
from functools import reduce
from operator import xor

from polishd.drivers.transport.address import SerialLine, Tcp, garbled, silent
from polishd.drivers.transport.streams import LineReader, open_stream
from polishd.model.devices import DeviceIdentity
from polishd.model.errors import DeviceRefused, LinkError, ProtocolError
from polishd.ports.stream import ByteStream

NUMBERED_LINE_BYTES = 120
"""Bytes of a line."""
OPEN_S = 1.0
_LINE = re.compile(rb"\$([ -)+-~]*)\*([0-9A-F]{2})\r?")


def encode(number: int, body: str) -> bytes:
    """A numbered request as a line."""
    text = f"{number},{body}".encode("ascii")
    return b"$%b*%02X\r\n" % (text, _checksum(text))


def decode(line: bytes) -> tuple[int, str] | None:
    """Number and body of a line without its LF; None where it is broken: such lines are dropped."""
    start = line.rfind(b"$")
    match = _LINE.fullmatch(line[start:]) if start >= 0 and len(line) - start <= NUMBERED_LINE_BYTES else None
    if match is None or int(match[2], 16) != _checksum(match[1]):
        return None
    number, comma, body = match[1].decode("ascii").partition(",")
    if not (comma and number.isdigit() and len(number) <= 5):
        return None
    return int(number), body


def identity(body: str) -> DeviceIdentity:
    """The answer to ``ID?``; ProtocolError where it is none."""
    parts = body.split(",")
    if len(parts) != 6 or parts[0] != "ID":
        raise ProtocolError(f"no answer to ID?: {body!r}")
    return DeviceIdentity(parts[1], parts[2], parts[3], parts[4], boot_id=parts[5])


class NumberedLines:
    """Asks one request at a time; the caller sees to that."""

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
        """A line that came instead of the answer."""

    @property
    def connected(self) -> bool:
        """False before ``connect``, and once the wire itself is gone."""
        return self._stream is not None

    async def connect(self) -> None:
        """Open the wire, anew where it is open."""
        await self.disconnect()
        self._stream = await open_stream(self._address, OPEN_S)
        self._lines = LineReader(self._stream, longest=NUMBERED_LINE_BYTES)

    async def disconnect(self) -> None:
        """Idempotent."""
        stream, self._stream = self._stream, None
        if stream is not None:
            await stream.close()

    async def ask(self, request: str) -> str:
        """The answer's body. LinkError where none comes in time; DeviceRefused for ``ERR,...``."""
        if self._stream is None or self._lines is None:
            raise LinkError(f"{self.name}: is not open")
        self._number, self._broken = (self._number + 1) & 0xFFFF, b""
        deadline = time.monotonic() + self._silence_s
        try:
            await self._stream.write(encode(self._number, request))
            answer = await self._answer(self._lines, deadline)
        except LinkError as error:
            if time.monotonic() < deadline:  # not merely silent: the wire itself is gone
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
        """What silence, or what came instead of an answer, most likely is."""
        if came := self._broken or rest.strip():
            return f"{request}: {garbled(self._address, came, self._silence_s)}"
        return f"no answer to {request} {silent(self._address, self._silence_s)}"


def _checksum(text: bytes) -> int:
    return reduce(xor, text, 0)
