"""Spindle on a CiA 402 drive, in profile velocity mode."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import AsyncIterator
from dataclasses import dataclass

from polishd.api import DeviceFault, DeviceIdentity, DeviceRefused, DeviceStatus, SpeedSample, SpindleTimes
from polishd.drivers.cia402 import protocol
from polishd.drivers.cia402.drive import POLL_S, CanNodeAddress, CanopenConnection, Cia402Drive, describe
from polishd.drivers.cia402.protocol import Dictionary, DriveState402
from polishd.drivers.transport.background import PeriodicTimer

TOLERANCE = 0.02
ARRIVED = 0.015
"""Deviation at which a speed counts as reached: later readings scatter and must stay within the tolerance."""
STILL_RPM = 1.0
SAMPLE_S = 0.04


@dataclass(frozen=True, slots=True)
class SpindleScale:
    """Units of the drive's objects, and its ramps."""

    rpm_per_unit: float = 1.0
    """Unit of 606Ch and 60FFh; negative: reversed direction."""
    max_rpm: float = 3000.0
    acceleration_rpm_s: float = 1000.0
    deceleration_rpm_s: float = 1000.0
    quick_stop_rpm_s: float = 3000.0

    def units(self, rpm: float) -> int:
        """Return a speed in the drive's unit."""
        return round(rpm / self.rpm_per_unit)

    def ramp(self, rpm_s: float) -> int:
        """Return a ramp in the drive's unit."""
        return max(round(rpm_s / abs(self.rpm_per_unit)), 1)


@dataclass(frozen=True, slots=True)
class Cia402SpindleReading:
    """Reading of the drive."""

    state: DriveState402
    rpm: float
    setpoint_rpm: float
    fault: int
    detail: str

    @property
    def stands(self) -> bool:
        """Whether the drive has no power and no speed."""
        return not self.state.drives and abs(self.rpm) < STILL_RPM

    @property
    def at_speed(self) -> bool:
        """Whether the speed is within tolerance."""
        return self._within(TOLERANCE)

    @property
    def arrived(self) -> bool:
        """Whether the speed is reached, with a margin to the tolerance."""
        return self._within(ARRIVED)

    @property
    def name(self) -> str:
        """State of the spindle."""
        if self.fault:
            return "fault"
        if self.state.drives:
            return "at_speed" if self.at_speed else "ramping"
        return "stopped" if self.stands else "coasting"

    def _within(self, share: float) -> bool:
        return abs(self.rpm - self.setpoint_rpm) <= max(share * abs(self.setpoint_rpm), STILL_RPM)


class Cia402Spindle:
    """A Spindle. Reading sends our heartbeat; without it the drive makes a quick stop."""

    def __init__(self, place: CanNodeAddress, dictionary: Dictionary, scale: SpindleScale, times: SpindleTimes) -> None:
        """ConfigError if the EDS file has no profile velocity mode."""
        self._scale = scale
        self._times = times
        self._max_rpm = 0.0
        self._axis = Cia402Drive(
            place,
            dictionary,
            modes=(protocol.VELOCITY_MODE,),
            on_silence=protocol.ABORT_QUICK_STOPS,
            settings={
                protocol.ACCELERATION: scale.ramp(scale.acceleration_rpm_s),
                protocol.DECELERATION: scale.ramp(scale.deceleration_rpm_s),
                protocol.QUICK_STOP_DECELERATION: scale.ramp(scale.quick_stop_rpm_s),
            },
            read=(protocol.VELOCITY, protocol.TARGET_VELOCITY),
            write=(protocol.TARGET_VELOCITY,),
        )

    @property
    def times(self) -> SpindleTimes:
        """See Spindle."""
        return self._times

    async def open(self) -> None:
        """See Device. Also writes ramps, heartbeats and the drive's reaction to a lost heartbeat."""

        async def look(link: CanopenConnection) -> None:
            self._max_rpm = self._scale.max_rpm
            if protocol.MAX_MOTOR_SPEED in self._axis.dictionary:
                self._max_rpm = min(self._max_rpm, await link.read(protocol.MAX_MOTOR_SPEED))

        await self._axis.open(look)

    async def close(self) -> None:
        """See Device."""
        await self._axis.close()

    async def identify(self) -> DeviceIdentity:
        """See Device."""
        return await self._axis.identify()

    async def status(self) -> DeviceStatus:
        """See Device. Safe means without power and at standstill."""
        reading = await self._read(self._axis.link)
        return DeviceStatus(not reading.fault, reading.stands, reading.name, reading.detail)

    async def set_speed(self, rpm: float) -> None:
        """See Spindle. DeviceRefused outside the drive's range."""
        link = self._axis.link
        if not (math.isfinite(rpm) and abs(rpm) <= self._max_rpm):
            raise DeviceRefused(f"{self._axis.name}: {rpm} rpm is outside the drive's {self._max_rpm:g} rpm")
        if self._scale.units(rpm) == 0:
            return await self._stop(link)
        unless = self._axis.take_over()
        deadline = time.monotonic() + self._times.spin_s
        await self._axis.wake(link)
        if await self._axis.require_sound(link, f"cannot run at {rpm:g} rpm") is not DriveState402.ENABLED:
            await link.write(protocol.TARGET_VELOCITY, 0, unless=unless)
            await self._axis.power_up(link, protocol.VELOCITY_MODE, unless, self._times.spin_s)
        await link.write(protocol.TARGET_VELOCITY, self._scale.units(rpm), unless=unless)
        while not (reading := await self._read(link, cared=True)).arrived:
            unless()
            self._require_running(reading, rpm, deadline)
            await asyncio.sleep(POLL_S)
        unless()
        return None

    async def samples(self) -> AsyncIterator[SpeedSample]:
        """See Spindle. Each sample is requested after the one before it was taken."""
        link = self._axis.link
        pace = PeriodicTimer(SAMPLE_S)
        while True:
            reading = await self._read(link, cared=True)
            yield SpeedSample(time.monotonic(), reading.rpm, reading.setpoint_rpm, reading.fault)
            await pace.next()

    async def make_safe(self) -> None:
        """See Device. Quick stop and confirm standstill; if the link is down, connect once for that."""

        async def calm(link: CanopenConnection) -> None:
            await self._stop(link)
            await self._axis.reset(link)

        await self._axis.reach(calm)

    async def _stop(self, link: CanopenConnection) -> None:
        self._axis.take_over()
        await link.write(protocol.CONTROL_WORD, protocol.QUICK_STOP, urgent=True)
        deadline = time.monotonic() + self._times.spin_s
        while not (reading := await self._read(link, cared=True)).stands:
            if time.monotonic() > deadline:
                raise DeviceFault(
                    f"{self._axis.name}: {reading.state.value} at {reading.rpm:g} rpm, "
                    f"{self._times.spin_s:g} s after the quick stop"
                )
            await asyncio.sleep(POLL_S)

    def _require_running(self, reading: Cia402SpindleReading, rpm: float, deadline: float) -> None:
        if reading.fault or reading.state is not DriveState402.ENABLED:
            why = reading.detail or reading.state.value
            raise DeviceFault(f"{self._axis.name}: {why}, on the way to {rpm:g} rpm")
        if time.monotonic() > deadline:
            raise DeviceFault(f"{self._axis.name}: {rpm:g} rpm not reached, {reading.rpm:g} rpm at the time limit")

    async def _read(self, link: CanopenConnection, *, cared: bool = False) -> Cia402SpindleReading:
        """Read the drive; ``cared``: send our heartbeat, because a caller monitors the spindle."""
        state = await self._axis.state(link)
        if cared:
            link.beat()
        rpm = await link.read(protocol.VELOCITY) * self._scale.rpm_per_unit
        target = await link.read(protocol.TARGET_VELOCITY) if state is DriveState402.ENABLED else 0
        fault = await self._axis.fault(link, state)
        setpoint_rpm = target * self._scale.rpm_per_unit
        return Cia402SpindleReading(
            state, rpm, setpoint_rpm, fault.code if fault else 0, describe(fault) if fault else ""
        )
