"""The receiving half of a byte stream: fed by callbacks, emptied by one reader."""

from __future__ import annotations

import asyncio

from polishd.api import LinkError


class ReadBuffer:
    """Bytes that came and were not read yet, and the reason why no more will come."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._bytes = bytearray()
        self._failure: str | None = None
        self._waiter: asyncio.Future[None] | None = None

    def feed(self, data: bytes) -> None:
        """Bytes came."""
        self._bytes += data
        self._wake()

    def fail(self, reason: str) -> None:
        """No more will come. The first reason counts."""
        if self._failure is None:
            self._failure = reason
        self._wake()

    def check(self) -> None:
        """LinkError once the link has failed."""
        if self._failure is not None:
            raise LinkError(f"{self._name}: {self._failure}")

    async def take(self, at_most: int, within_s: float) -> bytes:
        """At least one byte, or LinkError. Bytes that came in time are not lost to a late wake-up."""
        if not self._bytes and self._failure is None:
            self._waiter = asyncio.get_running_loop().create_future()
            await asyncio.wait({self._waiter}, timeout=within_s)
        if self._bytes:
            data = bytes(self._bytes[:at_most])
            del self._bytes[:at_most]
            return data
        self.check()
        raise LinkError(f"{self._name}: silent for {within_s:.2g} s")

    def _wake(self) -> None:
        if self._waiter is not None and not self._waiter.done():
            self._waiter.set_result(None)
