"""Numbered requests over a byte stream: a late answer is dropped by its number, so silence costs no reopening."""

from __future__ import annotations

import time

from polishd.api import ByteStream, DeviceRefused, Identity, LinkError, ProtocolError
from polishd.drivers.transport.address import SerialLine, Tcp
from polishd.drivers.transport.streams import LineReader, open_stream
from polishd.drivers.voice_coil import codec
from polishd.drivers.voice_coil.device import Reading

OPEN_S = 1.0


class AsciiWire:
    """A VoiceCoilWire over ASCII lines."""

    def __init__(self, address: SerialLine | Tcp, silence_s: float) -> None:
        """An answer comes within ``silence_s``."""
        self._silence_s = silence_s
        self.name = str(address)
        self._address = address
        self._stream: ByteStream | None = None
        self._lines: LineReader | None = None
        self._number = 0

    @property
    def connected(self) -> bool:
        """See VoiceCoilWire."""
        return self._stream is not None

    async def connect(self) -> None:
        """See VoiceCoilWire."""
        await self.disconnect()
        self._stream = await open_stream(self._address, OPEN_S)
        self._lines = LineReader(self._stream, longest=codec.LONGEST)

    async def disconnect(self) -> None:
        """See VoiceCoilWire."""
        stream, self._stream = self._stream, None
        if stream is not None:
            await stream.close()

    async def identity(self) -> Identity:
        """See VoiceCoilWire."""
        return codec.identity(await self._ask("ID?"))

    async def read(self) -> Reading:
        """See VoiceCoilWire."""
        return codec.status(await self._ask("ST?"))

    async def beat(self) -> None:
        """See VoiceCoilWire."""
        await self._tell("HB")

    async def set_watchdog(self, watchdog_ms: int) -> None:
        """See VoiceCoilWire."""
        await self._tell(f"WD,{watchdog_ms}")

    async def set_point(self, force_n: float) -> None:
        """See VoiceCoilWire."""
        await self._tell(f"F,{force_n:.2f}")

    async def command(self, *, engage: bool) -> None:
        """See VoiceCoilWire."""
        await self._tell("ENG" if engage else "RET")

    async def _tell(self, request: str) -> None:
        answer = await self._ask(request)
        if answer != "OK":
            raise ProtocolError(f"{self.name}: {request} was answered by {answer!r}")

    async def _ask(self, request: str) -> str:
        if self._stream is None or self._lines is None:
            raise LinkError(f"{self.name}: is not open")
        self._number = (self._number + 1) & 0xFFFF
        deadline = time.monotonic() + self._silence_s
        try:
            await self._stream.write(codec.encode(self._number, request))
            answer = await self._answer(self._lines, deadline)
        except LinkError as error:
            if time.monotonic() < deadline:  # not merely silent: the wire itself is gone
                await self.disconnect()
            raise LinkError(f"{self.name}: no answer to {request} ({error})") from error
        if answer.startswith("ERR,"):
            raise DeviceRefused(f"{self.name}: {request} was refused: {answer.removeprefix('ERR,')}")
        return answer

    async def _answer(self, lines: LineReader, deadline: float) -> str:
        while True:
            numbered = codec.decode(await lines.next(max(deadline - time.monotonic(), 0.0)))
            if numbered is not None and numbered[0] == self._number:
                return numbered[1]
