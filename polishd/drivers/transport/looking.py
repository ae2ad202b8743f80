"""Devices that only look, on numbered lines: one request at a time, and nothing to make safe."""

from __future__ import annotations

import asyncio
import contextlib

from polishd.api import Identity, LinkError, ProtocolError
from polishd.drivers.transport.address import SerialLine, Tcp
from polishd.drivers.transport.numbered import NumberedLines, identity

ANSWERS_S = 2.0
"""Of ``make_safe``: a link that is lost over it is opened again once."""


class LookingLine:
    """What their drivers share. A link that is lost stays so until ``open``; only ``make_safe`` tries to reach it."""

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
            await self.identify()
        except BaseException:
            await self.close()
            raise

    async def close(self) -> None:
        """See Device."""
        await self._lines.disconnect()

    async def identify(self) -> Identity:
        """See Device."""
        return identity(await self.ask("ID?"))

    async def make_safe(self) -> None:
        """See Device. It exerts nothing: that it answers is all that can be confirmed."""
        opened = self._lines.connected
        try:
            async with asyncio.timeout(ANSWERS_S):
                if opened:
                    with contextlib.suppress(LinkError, ProtocolError):
                        await self.identify()
                        return
                await self._lines.connect()
                await self.identify()
        except TimeoutError:
            raise LinkError(f"{self.name}: no answer within {ANSWERS_S:g} s") from None
        finally:
            if not opened:
                await self.close()

    async def ask(self, request: str) -> str:
        """The answer's body; DeviceRefused for ``ERR,...``."""
        async with self._turn:
            return await self._lines.ask(request)
