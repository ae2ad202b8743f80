"""A force sensor by its profile: it only reads, and takes what it reads now for no force."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator
from dataclasses import dataclass

from polishd.api import DeviceFault, DeviceStatus, SensedForce, SensorTimes
from polishd.config.device_tables import ForceSensorTable
from polishd.drivers.profiled import meaning
from polishd.drivers.profiled.codec import Values
from polishd.drivers.profiled.device import ProfiledDevice
from polishd.drivers.profiled.wire import ProfileTransport
from polishd.drivers.transport.pace import PeriodicTimer

PERIOD_S = 0.05
"""Of readings, at most so often."""


@dataclass(frozen=True, slots=True)
class ForceSensorReading:
    """What the sensor says."""

    force_n: float
    fault: int
    faults: str
    """In words."""
    count: float | None
    """Of conversions; None where it has no such counter."""


class ProfiledForceSensor(ProfiledDevice[ForceSensorReading, SensorTimes]):
    """A ForceSensor over a wire. A link that is lost while samples are taken stays so until that has ended."""

    def __init__(self, wire: ProfileTransport, times: SensorTimes) -> None:
        table = wire.profile.force_sensor
        if table is None:
            raise ValueError(f"profile {wire.profile.name!r} is of no force sensor")
        super().__init__(wire, times, None, "forces were being taken: what is missing is not made up for")
        self._table: ForceSensorTable = table

    async def status(self) -> DeviceStatus:
        """See Device. It is always safe."""
        reading = await self._link.ask(self._read)
        state = "fault" if reading.fault else "measuring"
        return DeviceStatus(ready=not reading.fault, safe=True, state=state, detail=reading.faults)

    async def make_safe(self) -> None:
        """See Device. It exerts nothing."""
        if not self._link.running:
            await self.open()
            await self.close()
        else:
            await self.status()

    async def tare(self) -> None:
        """See ForceSensor. DeviceFault where it has one, or still reads a force after ``times.tare_s``."""
        deadline = time.monotonic() + self._times.tare_s
        await self._link.ask(lambda: self._wire.order("tare"))
        while abs((reading := await self._link.ask(self._read)).force_n) > self._table.zero_n or reading.fault:
            if reading.fault:
                raise DeviceFault(f"{self._wire.name}: cannot be tared, fault {reading.fault} ({reading.faults})")
            if time.monotonic() > deadline:
                said = f"still reads {reading.force_n:g} N {self._times.tare_s:g} s after its tare"
                raise DeviceFault(f"{self._wire.name}: {said}; does something shake it?")
            await asyncio.sleep(PERIOD_S)

    async def samples(self) -> AsyncIterator[SensedForce]:
        """See ForceSensor. Where the sensor counts its conversions, one that was told before is none."""
        pace, last = PeriodicTimer(PERIOD_S), -1.0
        self._link.exposed = True
        try:
            while True:
                reading = await self._link.ask(self._read)
                if reading.count is None or reading.count != last:
                    yield SensedForce(time.monotonic(), reading.force_n, reading.fault)
                last = -1.0 if reading.count is None else reading.count
                await pace.next()
        finally:
            self._link.exposed = False

    def _reading(self, values: Values) -> ForceSensorReading:
        profile = self._wire.profile
        fault = meaning.fault_of(profile, values)
        broken = any(rule.holds(values[rule.when]) for rule in profile.states)  # it has no state but that one
        count = meaning.number(values, "count", -1.0) if "count" in values else None
        force_n = meaning.number(values, "force", 0.0)
        return ForceSensorReading(force_n, fault or int(broken), meaning.fault_words(profile, fault), count)
