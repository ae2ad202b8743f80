"""A wire whose answers bear no number: one that comes after its time would be taken for the next request's."""

from __future__ import annotations

import asyncio
import time

from polishd.drivers.transport.address import SerialLine, Tcp
from polishd.drivers.transport.streams import SerialStream, TcpStream, open_stream

OPEN_S = 1.0


class UnnumberedLink:
    """Asks one request at a time; the caller sees to that.

    After silence or nonsense the line is closed, and opened again (which drops what came) only when no answer can be
    due.
    """

    def __init__(self, address: SerialLine | Tcp, silence_s: float) -> None:
        """An answer comes within ``silence_s``; on a serial line one may still come as long after that."""
        self._address = address
        self._silence_s = silence_s
        self._stream: TcpStream | SerialStream | None = None
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

    async def disconnect(self) -> None:
        """Idempotent."""
        stream, self._stream = self._stream, None
        if stream is not None:
            await stream.close()

    async def distrust(self) -> None:
        """What else comes is not to be taken for an answer."""
        self._due_until = time.monotonic() + 2 * self._silence_s
        await self.disconnect()
