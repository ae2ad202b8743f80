"""Lines without numbers: one request, one answer, and nothing that comes late is taken for the next one's."""

from __future__ import annotations

import time

from polishd.api import LinkError
from polishd.drivers.profiled.unnumbered import UnnumberedLink
from polishd.drivers.transport.address import SerialLine, Tcp, garbled, silent
from polishd.drivers.transport.streams import drop_stale

LONGEST = 512
"""Bytes of an answer."""


class LineLink(UnnumberedLink):
    """One request, one answer."""

    def __init__(self, address: SerialLine | Tcp, silence_s: float, ending: bytes, answer_ending: bytes) -> None:
        """See UnnumberedLink; requests and answers end with theirs."""
        super().__init__(address, silence_s)
        self.name = str(address)
        """For messages."""
        self._ending, self._answer_ending = ending, answer_ending
        self._rest = b""

    async def connect(self) -> None:
        """See UnnumberedLink."""
        await super().connect()
        self._rest = b""

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
            await drop_stale(self._stream)

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
        return f"{request!r}: {garbled(self._address, self._rest, self._silence_s, 'lines.answer_ending')}"
