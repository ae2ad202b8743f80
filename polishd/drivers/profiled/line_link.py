"""Lines without numbers: one request, one answer, and nothing that comes late is taken for the next one's."""

from __future__ import annotations

import asyncio
import contextlib
import time

from polishd.api import LinkError
from polishd.drivers.transport.address import SerialLine, Tcp, silent
from polishd.drivers.transport.streams import SerialStream, TcpStream, open_stream

OPEN_S = 1.0
LONGEST = 512
"""Bytes of an answer."""


class LineLink:
    """Asks one request at a time; the caller sees to that.

    An answer bears no number, so after silence the line is closed, and opened again (which drops what came) only when
    no answer can be due.
    """

    def __init__(self, address: SerialLine | Tcp, silence_s: float, ending: bytes, answer_ending: bytes) -> None:
        """An answer comes within ``silence_s``; on a serial line one may still come as long after that."""
        self.name = str(address)
        """For messages."""
        self._address = address
        self._silence_s = silence_s
        self._ending, self._answer_ending = ending, answer_ending
        self._stream: TcpStream | SerialStream | None = None
        self._rest = b""
        self._due_until = 0.0

    @property
    def connected(self) -> bool:
        """False before ``connect``, and as soon as answers can no longer be trusted."""
        return self._stream is not None and self._stream.alive

    async def connect(self) -> None:
        """Open the wire; waits until a late answer to an earlier request can no longer come."""
        await self.disconnect()
        if isinstance(self._address, SerialLine):
            await asyncio.sleep(max(self._due_until - time.monotonic(), 0.0))
        self._stream = await open_stream(self._address, OPEN_S)
        self._rest = b""

    async def disconnect(self) -> None:
        """Idempotent."""
        stream, self._stream = self._stream, None
        if stream is not None:
            await stream.close()

    async def distrust(self) -> None:
        """What else comes is not to be taken for an answer."""
        self._due_until = time.monotonic() + 2 * self._silence_s
        await self.disconnect()

    async def tell(self, request: str) -> None:
        """Send what is not answered."""
        if self._stream is None:
            raise LinkError(f"{self.name}: is not open")
        try:
            await self._stream.write(request.encode("ascii") + self._ending)
        except LinkError:
            await self.disconnect()
            raise

    async def ask(self, request: str) -> str:
        """The answer's line without its ending. LinkError where none comes in time."""
        await self._drop_stale()
        await self.tell(request)
        deadline = time.monotonic() + self._silence_s
        self._due_until = deadline + self._silence_s
        try:
            line = await self._line(deadline)
        except LinkError as error:
            await self.disconnect()
            if time.monotonic() < deadline:  # not merely silent: the wire itself is gone
                raise
            raise LinkError(f"{self.name}: {self._unanswered(request)}") from error
        self._due_until = 0.0
        return line.decode("latin-1")

    async def _drop_stale(self) -> None:
        """What came before we ask is no answer."""
        self._rest = b""
        if self._stream is not None:
            with contextlib.suppress(LinkError):  # silence is what is wanted; a dead wire is told by the next write
                while True:
                    await self._stream.read(4096, 0.0)

    async def _line(self, deadline: float) -> bytes:
        stream = self._stream
        while stream is not None:
            line, end, rest = self._rest.partition(self._answer_ending)
            if end:
                self._rest = rest
                if line := line.strip(b"\r\n"):
                    return line
                continue
            if len(self._rest) > LONGEST:
                raise LinkError(f"{self.name}: {len(self._rest)} bytes without the end of a line")
            self._rest += await stream.read(512, max(deadline - time.monotonic(), 0.0))
        raise LinkError(f"{self.name}: is not open")

    def _unanswered(self, request: str) -> str:
        """What silence, or what came instead of an answer, most likely is."""
        if not self._rest:
            how = "way that requests end"
            return f"no answer to {request!r} {silent(self._address, self._silence_s, how)}"
        settings = f" at {self._address.settings}" if isinstance(self._address, SerialLine) else ""
        said = f"no answer to {request!r} within {self._silence_s:g} s{settings}"
        return f"{said}, only {self._rest[:16]!r}; see baud rate, parity and lines.answer_ending"
