"""A force sensor by its profile: it only reads, and takes what it reads now for no force."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator

from polishd.api import DeviceStatus, Identity, ProtocolError
from polishd.drivers.profiled import meaning
from polishd.drivers.profiled.exchange import Exchange
from polishd.drivers.profiled.wire import Wire

PERIOD_S = 0.05
"""Of readings, at most so often."""


class ProfiledForceSensor:
    """Forces over a wire. Nothing can move by it, so a lost link is opened again by whoever asks next."""

    def __init__(self, wire: Wire) -> None:
        if wire.profile.force_sensor is None:
            raise ValueError(f"profile {wire.profile.name!r} is of no force sensor")
        self._wire = wire
        self._link = Exchange(wire, None, "")

    async def open(self) -> None:
        """See Device."""
        await self._link.open(self._read)

    async def close(self) -> None:
        """See Device."""
        await self._link.close()

    async def identify(self) -> Identity:
        """See Device."""
        return await self._link.identify()

    async def status(self) -> DeviceStatus:
        """See Device. It is always safe."""
        _, fault = await self._link.ask(self._read)
        words = meaning.fault_words(self._wire.profile, fault)
        return DeviceStatus(ready=not fault, safe=True, state="fault" if fault else "measuring", detail=words)

    async def make_safe(self) -> None:
        """See Device. It exerts nothing."""

    async def tare(self) -> None:
        """What it reads now is no force. Only out of contact; the caller sees to that."""
        await self._link.ask(lambda: self._wire.order("tare"))

    async def forces(self) -> AsyncIterator[tuple[float, float, int]]:
        """(monotonic seconds, N, fault), each read after the one before it was taken."""
        due = time.monotonic()
        while True:
            force_n, fault = await self._link.ask(self._read)
            yield time.monotonic(), force_n, fault
            due = max(due + PERIOD_S, time.monotonic())
            await asyncio.sleep(due - time.monotonic())

    async def _read(self) -> tuple[float, int]:
        profile = self._wire.profile
        values = await self._wire.read(profile.polled)
        try:
            fault = meaning.fault_of(profile, values)
            if not fault and profile.states and meaning.state_of(profile, values) == "fault":
                fault = 1
            return meaning.number(values, "force", 0.0), fault
        except ProtocolError as error:
            raise ProtocolError(f"{self._wire.name}: {error}") from None
