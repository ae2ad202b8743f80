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
    """Forces over a wire. A link that is lost while somebody takes them is not opened again until he has ended."""

    def __init__(self, wire: Wire) -> None:
        if wire.profile.force_sensor is None:
            raise ValueError(f"profile {wire.profile.name!r} is of no force sensor")
        self._wire = wire
        self._link = Exchange(wire, None, "forces were being taken: what is missing is not made up for")

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
        self._link.exposed = True
        try:
            while True:
                force_n, fault = await self._link.ask(self._read)
                yield time.monotonic(), force_n, fault
                due = max(due + PERIOD_S, time.monotonic())
                await asyncio.sleep(due - time.monotonic())
        finally:
            self._link.exposed = False

    async def _read(self) -> tuple[float, int]:
        profile = self._wire.profile
        values = await self._wire.read(profile.polled)
        try:
            fault = meaning.fault_of(profile, values)
            broken = any(rule.holds(values[rule.when]) for rule in profile.states)  # it has no state but that one
            return meaning.number(values, "force", 0.0), fault or int(broken)
        except ProtocolError as error:
            raise ProtocolError(f"{self._wire.name}: {error}") from None
