"""What devices by a profile share: open to close, how they are read, and how they are brought to rest."""

from __future__ import annotations

import asyncio
import contextlib
from abc import ABC, abstractmethod
from collections.abc import Awaitable, Callable
from typing import Generic, TypeVar

from polishd.api import DeviceIdentity, LinkError, ProtocolError
from polishd.drivers.profiled.codec import Values
from polishd.drivers.profiled.exchange import RequestChannel
from polishd.drivers.profiled.wire import ProfileTransport

ANSWERS_S = 2.0
"""Of ``make_safe``, beyond the action itself: a link that is lost over it is opened again once."""

R = TypeVar("R")
T = TypeVar("T")


class ProfiledDevice(ABC, Generic[R, T]):
    """A device over a wire: R is what it says of itself, T are its times."""

    def __init__(self, wire: ProfileTransport, times: T, watchdog_s: float | None, at_rest: str) -> None:
        """See Exchange for ``watchdog_s`` and ``at_rest``."""
        self._wire = wire
        self._times = times
        self._link = RequestChannel(wire, watchdog_s, at_rest)

    @abstractmethod
    def _reading(self, values: Values) -> R:
        """What the values say; ProtocolError on what the profile does not have."""

    @property
    def times(self) -> T:
        """See the device's port."""
        return self._times

    async def open(self) -> None:
        """See Device. Also writes the watchdog time, where the profile has that."""
        await self._link.open(self._read)

    async def close(self) -> None:
        """See Device."""
        await self._link.close()

    async def identify(self) -> DeviceIdentity:
        """See Device."""
        return await self._link.identify()

    async def _rest(self, go: Callable[[], Awaitable[None]], within_s: float, what: str) -> None:
        """Do what brings it to rest and proves it; a link lost over it is opened again once.

        ``what`` is what could not be confirmed, for the LinkError after ``within_s``.
        """
        opened = self._link.running
        if not opened:
            await self._link.start()
        try:
            async with asyncio.timeout(within_s + ANSWERS_S):
                with contextlib.suppress(LinkError, ProtocolError):
                    return await go()
                return await go()
        except TimeoutError:
            raise LinkError(f"{self._wire.name}: could not confirm that {what}") from None
        finally:
            if not opened:
                await self.close()

    async def _read(self) -> R:
        values = await self._wire.read(self._wire.profile.polled)
        try:
            return self._reading(values)
        except ProtocolError as error:
            raise ProtocolError(f"{self._wire.name}: {error}") from None

    async def _beat(self) -> R:
        """Feed its watchdog, and read it."""
        await self._wire.order("beat")
        return await self._read()

    async def _clear(self, fault: int) -> None:
        """Clear a fault that the profile says may be cleared; leave any other."""
        faults = self._wire.profile.faults
        if faults and fault and fault in faults.clears:
            await self._link.ask(lambda: self._wire.order("clear"), urgent=True)
