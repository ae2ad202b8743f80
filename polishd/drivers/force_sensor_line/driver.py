"""A ForceSensor on numbered lines: asked for its last conversion as often as it makes one."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator

from polishd.api import DeviceFault, DeviceStatus, SensedForce, SensorTimes
from polishd.drivers.force_sensor_line import codec
from polishd.drivers.force_sensor_line.codec import ForceSensorLineReading, ForceSensorState
from polishd.drivers.transport.address import SerialLine, Tcp
from polishd.drivers.transport.looking import ReadOnlyLineDevice
from polishd.drivers.transport.pace import PeriodicTimer

PERIOD_S = 0.02
"""Between two questions."""


class ForceSensorLine(ReadOnlyLineDevice):
    """A load cell behind an amplifier."""

    def __init__(self, address: SerialLine | Tcp, times: SensorTimes | None = None) -> None:
        self._times = times or SensorTimes()
        super().__init__(address, self._times.silence_s)

    @property
    def times(self) -> SensorTimes:
        """See ForceSensor."""
        return self._times

    async def status(self) -> DeviceStatus:
        """See Device. It is always safe."""
        reading = await self._read()
        return DeviceStatus(not reading.fault, safe=True, state=reading.state.name.lower(), detail=reading.faults)

    async def tare(self) -> None:
        """See ForceSensor. DeviceFault where it has one, or takes too long."""
        deadline = time.monotonic() + self._times.tare_s
        await self._order("TARE")
        while (reading := await self._read()).state is not ForceSensorState.MEASURING:
            if reading.fault:
                raise DeviceFault(f"{self.name}: cannot be tared, fault {reading.fault} ({reading.faults})")
            if time.monotonic() > deadline:
                raise DeviceFault(f"{self.name}: not tared after {self._times.tare_s:g} s; does something shake it?")
            await asyncio.sleep(PERIOD_S)

    async def samples(self) -> AsyncIterator[SensedForce]:
        """See ForceSensor. A conversion that was told before is none: a converter that stands gives silence."""
        pace, last = PeriodicTimer(PERIOD_S), -1
        while True:
            reading = await self._read()
            if reading.count != last and reading.state is not ForceSensorState.TARING:
                yield SensedForce(time.monotonic(), reading.force_n, reading.fault)
            last = reading.count
            await pace.next()

    async def _look(self) -> None:
        """See LineDevice. Others on such lines know who they are, too, and no force."""
        await super()._look()
        await self._read()

    async def _read(self) -> ForceSensorLineReading:
        return codec.force(await self.ask("F?"))
