"""The voice coil's requests on numbered lines: a late answer is dropped, so silence costs no reopening."""

from __future__ import annotations

from polishd.api import Identity, ProtocolError
from polishd.drivers.transport.address import SerialLine, Tcp
from polishd.drivers.transport.numbered import NumberedLines
from polishd.drivers.voice_coil import codec
from polishd.drivers.voice_coil.device import Reading


class AsciiWire:
    """A VoiceCoilWire over ASCII lines."""

    def __init__(self, address: SerialLine | Tcp, silence_s: float) -> None:
        """An answer comes within ``silence_s``."""
        self._lines = NumberedLines(address, silence_s)
        self.name = self._lines.name

    @property
    def connected(self) -> bool:
        """See VoiceCoilWire."""
        return self._lines.connected

    async def connect(self) -> None:
        """See VoiceCoilWire."""
        await self._lines.connect()

    async def disconnect(self) -> None:
        """See VoiceCoilWire."""
        await self._lines.disconnect()

    async def identity(self) -> Identity:
        """See VoiceCoilWire."""
        return codec.identity(await self._lines.ask("ID?"))

    async def read(self) -> Reading:
        """See VoiceCoilWire."""
        return codec.status(await self._lines.ask("ST?"))

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
        answer = await self._lines.ask(request)
        if answer != "OK":
            raise ProtocolError(f"{self.name}: {request} was answered by {answer!r}")
