"""A spindle by its profile: an inverter, or whatever else turns."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import AsyncIterator
from dataclasses import dataclass

from polishd.api import (
    DeviceFault,
    DeviceRefused,
    DeviceStatus,
    SpeedSample,
    SpindleTimes,
)
from polishd.config.device_tables import SpindleTable
from polishd.drivers.profiled import meaning
from polishd.drivers.profiled.codec import Values
from polishd.drivers.profiled.device import ProfiledDevice
from polishd.drivers.profiled.wire import ProfileTransport
from polishd.drivers.transport.pace import PeriodicTimer

SPINDLE_BEAT_S = 0.1
"""Period of samples, which feed the drive's watchdog."""
TOLERANCE = 0.02
ARRIVED = 0.015
"""At which a speed counts as reached: the readings after it scatter, and are to stay within the tolerance."""
STANDS_RPM = 1.0
SPINDLE_MAY_TURN = "the spindle may turn: only stopping opens the link again"


@dataclass(frozen=True, slots=True)
class SpindleReading:
    """What the drive says of itself. Speed is signed where the profile says by what; forward is positive."""

    state: str
    rpm: float
    fault: int
    faults: str
    """In words."""

    @property
    def stands(self) -> bool:
        """It does not turn, by state and by speed."""
        return self.state in {"stopped", "fault"} and abs(self.rpm) < STANDS_RPM

    def at(self, rpm: float, within: float = TOLERANCE) -> bool:
        """At that speed."""
        return self.state == "running" and abs(self.rpm - rpm) <= within * abs(rpm)


class ProfiledSpindle(ProfiledDevice[SpindleReading, SpindleTimes]):
    """A Spindle over a wire. Its drive is fed only while somebody iterates ``samples`` or waits in ``set_speed``."""

    def __init__(self, wire: ProfileTransport, times: SpindleTimes) -> None:
        table = wire.profile.spindle
        if table is None:
            raise ValueError(f"profile {wire.profile.name!r} is of no spindle")
        super().__init__(wire, times, times.watchdog_s, SPINDLE_MAY_TURN)
        self._table: SpindleTable = table
        self._asked_rpm = 0.0
        self._orders = 0

    async def status(self) -> DeviceStatus:
        """See Device. Safe means stopped."""
        reading = await self._link.ask(self._read)
        ready = not reading.fault and reading.state != "fault"
        state = "at_speed" if self._asked_rpm and reading.at(self._asked_rpm) else reading.state
        return DeviceStatus(ready=ready, safe=reading.stands, state=state, detail=reading.faults)

    async def make_safe(self) -> None:
        """See Device. Stops, and sees that it stands; a link lost over it is opened again once."""
        await self._rest(self._stop, self._times.spin_s, "the spindle stands")

    async def set_speed(self, rpm: float) -> None:
        """See Spindle. DeviceRefused outside the drive's range, and backwards where it only turns forward."""
        most, orders = self._table.max_rpm, self._wire.profile.orders
        if not (math.isfinite(rpm) and abs(rpm) <= most):
            raise DeviceRefused(f"{self._wire.name}: {rpm} rpm is outside the drive's {most:g} rpm")
        if rpm < 0.0 and not orders.reverse:
            raise DeviceRefused(f"{self._wire.name}: {rpm:g} rpm: profile {self._wire.profile.name!r} has no way back")
        if rpm == 0.0:
            return await self._stop()
        fault = await self._link.ask(self._beat)
        if fault.fault or fault.state == "fault":
            raise DeviceRefused(f"{self._wire.name}: does not start over fault {fault.fault} ({fault.faults})")
        self._orders += 1
        await self._link.ask(lambda: self._turn(rpm))
        await self._reach(rpm, self._orders)
        return None

    async def samples(self) -> AsyncIterator[SpeedSample]:
        """See Spindle."""
        pace = PeriodicTimer(SPINDLE_BEAT_S)
        while True:
            reading = await self._link.ask(self._beat)
            yield SpeedSample(time.monotonic(), reading.rpm, self._asked_rpm, reading.fault)
            await pace.next()

    async def _reach(self, rpm: float, order: int) -> None:
        deadline = time.monotonic() + self._times.spin_s
        while not (reading := await self._link.ask(self._beat)).at(rpm, ARRIVED):
            if self._orders != order:
                raise DeviceRefused(
                    f"{self._wire.name}: was commanded to {self._asked_rpm:g} rpm on the way to {rpm:g} rpm"
                )
            if reading.fault or reading.state == "fault":
                said = f"fault {reading.fault} ({reading.faults}) on the way to {rpm:g} rpm"
                raise DeviceFault(f"{self._wire.name}: {said}")
            if time.monotonic() > deadline:
                said = f"{rpm:g} rpm not reached, {reading.rpm:g} rpm after {self._times.spin_s:.1f} s"
                raise DeviceFault(f"{self._wire.name}: {said}")
            await asyncio.sleep(SPINDLE_BEAT_S)

    async def _stop(self) -> None:
        self._orders += 1
        await self._link.ask(self._halt, urgent=True)
        deadline = time.monotonic() + self._times.spin_s
        while not (reading := await self._link.ask(self._beat, urgent=True)).stands:
            if time.monotonic() > deadline:
                said = f"still at {reading.rpm:g} rpm {self._times.spin_s:.1f} s after the stop command"
                raise DeviceFault(f"{self._wire.name}: {said}")
            await asyncio.sleep(SPINDLE_BEAT_S)
        await self._clear(reading.fault)

    async def _turn(self, rpm: float) -> None:
        self._link.exposed = True
        await self._wire.order("forward" if rpm > 0.0 else "reverse", abs(rpm))
        self._asked_rpm = rpm

    async def _halt(self) -> None:
        await self._wire.order("stop")
        self._asked_rpm = 0.0

    def _reading(self, values: Values) -> SpindleReading:
        profile = self._wire.profile
        fault = meaning.fault_of(profile, values)
        state, rpm = meaning.state_of(profile, values), meaning.number(values, "speed", 0.0)
        reading = SpindleReading(state, rpm, fault, meaning.fault_words(profile, fault))
        self._link.exposed = not reading.stands
        return reading
