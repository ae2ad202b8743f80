"""A spindle by its profile: an inverter, or whatever else turns."""

from __future__ import annotations

import asyncio
import contextlib
import math
import time
from collections.abc import AsyncIterator
from dataclasses import dataclass

from polishd.api import (
    DeviceFault,
    DeviceRefused,
    DeviceStatus,
    Identity,
    LinkError,
    ProtocolError,
    SpeedSample,
    SpindleTimes,
)
from polishd.config.device_tables import SpindleTable
from polishd.drivers.profiled import meaning
from polishd.drivers.profiled.exchange import Exchange
from polishd.drivers.profiled.wire import Wire

BEAT_S = 0.1
"""Period of samples, which feed the drive's watchdog."""
ANSWERS_S = 2.0
"""Beyond the stop itself: a link that is lost over it is opened again once."""
TOLERANCE = 0.02
STANDS_RPM = 1.0
AT_REST = "the spindle may turn: only stopping opens the link again"


@dataclass(frozen=True, slots=True)
class Reading:
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

    def at(self, rpm: float) -> bool:
        """At that speed within 2 %."""
        return self.state == "running" and abs(self.rpm - rpm) <= TOLERANCE * abs(rpm)


class ProfiledSpindle:
    """A Spindle over a wire. Its drive is fed only while somebody iterates ``samples`` or waits in ``set_speed``."""

    def __init__(self, wire: Wire, times: SpindleTimes) -> None:
        table = wire.profile.spindle
        if table is None:
            raise ValueError(f"profile {wire.profile.name!r} is of no spindle")
        self._table: SpindleTable = table
        self._wire = wire
        self._times = times
        self._link = Exchange(wire, times.watchdog_s, AT_REST)
        self._asked_rpm = 0.0
        self._orders = 0

    @property
    def times(self) -> SpindleTimes:
        """See Spindle."""
        return self._times

    async def open(self) -> None:
        """See Device. Also writes the watchdog time, where the profile has that."""
        await self._link.open(self._read)

    async def close(self) -> None:
        """See Device."""
        await self._link.close()

    async def identify(self) -> Identity:
        """See Device."""
        return await self._link.identify()

    async def status(self) -> DeviceStatus:
        """See Device. Safe means stopped."""
        reading = await self._link.ask(self._read)
        ready = not reading.fault and reading.state != "fault"
        state = "at_speed" if self._asked_rpm and reading.at(self._asked_rpm) else reading.state
        return DeviceStatus(ready=ready, safe=reading.stands, state=state, detail=reading.faults)

    async def make_safe(self) -> None:
        """See Device. Stops, and sees that it stands; a link lost over it is opened again once."""
        opened = self._link.running
        if not opened:
            await self._link.start()
        try:
            async with asyncio.timeout(self._times.spin_s + ANSWERS_S):
                with contextlib.suppress(LinkError, ProtocolError):
                    return await self._stop()
                return await self._stop()
        except TimeoutError:
            raise LinkError(f"{self._wire.name}: could not confirm that the spindle stands") from None
        finally:
            if not opened:
                await self.close()

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
        due = time.monotonic()
        while True:
            reading = await self._link.ask(self._beat)
            yield SpeedSample(time.monotonic(), reading.rpm, self._asked_rpm, reading.fault)
            due = max(due + BEAT_S, time.monotonic())
            await asyncio.sleep(due - time.monotonic())

    async def _reach(self, rpm: float, order: int) -> None:
        deadline = time.monotonic() + self._times.spin_s
        while not (reading := await self._link.ask(self._beat)).at(rpm):
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
            await asyncio.sleep(BEAT_S)

    async def _stop(self) -> None:
        self._orders += 1
        await self._link.ask(self._halt, urgent=True)
        deadline = time.monotonic() + self._times.spin_s
        while not (reading := await self._link.ask(self._beat, urgent=True)).stands:
            if time.monotonic() > deadline:
                said = f"still at {reading.rpm:g} rpm {self._times.spin_s:.1f} s after the stop command"
                raise DeviceFault(f"{self._wire.name}: {said}")
            await asyncio.sleep(BEAT_S)
        faults = self._wire.profile.faults
        if faults and reading.fault and reading.fault in faults.clears:
            await self._link.ask(lambda: self._wire.order("clear"), urgent=True)

    async def _turn(self, rpm: float) -> None:
        self._link.exposed = True
        await self._wire.order("forward" if rpm > 0.0 else "reverse", abs(rpm))
        self._asked_rpm = rpm

    async def _halt(self) -> None:
        await self._wire.order("stop")
        self._asked_rpm = 0.0

    async def _read(self) -> Reading:
        profile = self._wire.profile
        values = await self._wire.read(profile.polled)
        try:
            fault = meaning.fault_of(profile, values)
            state, rpm = meaning.state_of(profile, values), meaning.number(values, "speed", 0.0)
        except ProtocolError as error:
            raise ProtocolError(f"{self._wire.name}: {error}") from None
        reading = Reading(state, rpm, fault, meaning.fault_words(profile, fault))
        self._link.exposed = not reading.stands
        return reading

    async def _beat(self) -> Reading:
        await self._wire.order("beat")
        return await self._read()
