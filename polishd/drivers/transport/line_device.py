"""Devices on numbered lines: one request at a time."""

from __future__ import annotations

import asyncio
import contextlib
from abc import ABC, abstractmethod
from collections.abc import Awaitable, Callable

from polishd.api import DeviceIdentity, LinkError, ProtocolError
from polishd.drivers.transport.address import SerialLine, Tcp
from polishd.drivers.transport.numbered import NumberedLines, identity

ANSWERS_S = 2.0
"""Of ``make_safe``, beyond the action itself: a link that is lost over it is opened again once."""


class LineDevice(ABC):
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
        """Ask what shows that it is there."""
        return await self.identify()

    async def ask(self, request: str) -> str:
        """The answer's body; DeviceRefused for ``ERR,...``."""
        async with self._turn:
            return await self._lines.ask(request)

    async def _order(self, request: str) -> None:
        """What is answered by ``OK``; ProtocolError where it is answered by anything else."""
        answer = await self.ask(request)
        if answer != "OK":
            raise ProtocolError(f"{self.name}: {request} was answered by {answer!r}")

    async def _rest(self, go: Callable[[], Awaitable[object]], within_s: float, otherwise: str) -> None:
        """Do what brings it to rest and proves it; a link lost over it is opened again once.

        After ``within_s`` LinkError says ``otherwise``.
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
