"""Profile drivers: force actuator, spindle and force sensor."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import AsyncIterator
from dataclasses import dataclass

from polishd.api import (
    ActuatorTimes,
    DeviceFault,
    DeviceRefused,
    DeviceStatus,
    ForceSample,
    SensedForce,
    SensorTimes,
    SpeedSample,
    SpindleTimes,
)
from polishd.config.device_profile import ActuatorTable, DeviceProfile, ForceSensorTable, SpindleTable
from polishd.drivers.profile_device import codec
from polishd.drivers.profile_device.codec import Values
from polishd.drivers.profile_device.device import ProfiledDevice, ProfileTransport
from polishd.drivers.transport.background import PeriodicTimer

ACTUATOR_BEAT_S = 0.05
"""Period of samples and heartbeats."""
TOOL_OFF_REST = "the tool is off its rest: only retracting opens the link again"


@dataclass(frozen=True, slots=True)
class ActuatorReading:
    """Reading of the actuator; the set point is the last written one if the actuator does not report it."""

    state: str
    force_n: float
    setpoint_n: float
    position_mm: float | None
    fault: int
    faults: str
    """In words."""


def reading_of(profile: DeviceProfile, values: Values, asked_n: float = 0.0) -> ActuatorReading:
    """Return the reading; ProtocolError for values that the profile does not have."""
    fault = codec.fault_of(profile, values)
    return ActuatorReading(
        state=codec.state_of(profile, values),
        force_n=codec.number(values, "force", 0.0),
        setpoint_n=codec.number(values, "set_point", asked_n),
        position_mm=codec.number(values, "position", 0.0) if "position" in values else None,
        fault=fault,
        faults=codec.fault_words(profile, fault),
    )


class ProfiledActuator(ProfiledDevice[ActuatorReading, ActuatorTimes]):
    """A ForceActuator on a link."""

    def __init__(self, wire: ProfileTransport, times: ActuatorTimes) -> None:
        table = wire.profile.actuator
        if table is None:
            raise ValueError(f"profile {wire.profile.name!r} is of no actuator")
        super().__init__(wire, times, times.watchdog_s, TOOL_OFF_REST)
        self._table: ActuatorTable = table
        self._asked_n = 0.0
        self._retracts = 0

    async def status(self) -> DeviceStatus:
        """See Device. Safe means retracted."""
        reading = await self._link.ask(self._read)
        ready = not reading.fault and reading.state != "fault"
        return DeviceStatus(ready=ready, safe=reading.state == "retracted", state=reading.state, detail=reading.faults)

    async def set_force(self, force_n: float) -> None:
        """See ForceActuator. Return once the tool is in contact (feeding the watchdog meanwhile), or for 0 at once."""
        if not 0.0 <= force_n <= self._table.max_force_n:
            raise DeviceRefused(f"{self._wire.name}: force {force_n} N is outside 0 to {self._table.max_force_n:g} N")
        retracts = self._retracts
        if force_n > 0.0 and not self._wire.profile.commands.engage:  # the set point alone would land it
            self._require_sound(await self._link.ask(self._beat))
        await self._link.ask(lambda: self._set_point(force_n))
        reading = await self._link.ask(self._beat)
        if force_n == 0.0 or reading.state == "contact":
            return
        self._require_sound(reading)
        if reading.state != "extending":
            await self._link.ask(lambda: self._engage(force_n))
        await self._land(retracts)

    async def samples(self) -> AsyncIterator[ForceSample]:
        """See ForceActuator."""
        pace = PeriodicTimer(ACTUATOR_BEAT_S)
        while True:
            reading = await self._link.ask(self._beat)
            yield ForceSample(
                at_s=time.monotonic(),
                force_n=reading.force_n,
                setpoint_n=reading.setpoint_n,
                in_contact=reading.state == "contact",
                retracted=reading.state == "retracted",
                fault=reading.fault,
                position_mm=reading.position_mm,
            )
            await pace.next()

    async def retract(self) -> None:
        """See ForceActuator. Overtakes waiting requests; leaves the set point at 0."""
        self._retracts += 1
        await self._link.ask(self._let_go, urgent=True)
        deadline = time.monotonic() + self._times.lifted_s
        while (reading := await self._link.ask(self._beat, urgent=True)).state != "retracted":
            if reading.state == "fault":
                raise DeviceFault(f"{self._wire.name}: does not retract, fault {reading.fault} ({reading.faults})")
            if time.monotonic() > deadline:
                raise DeviceFault(f"{self._wire.name}: not retracted after {self._times.lifted_s:g} s")
            await asyncio.sleep(ACTUATOR_BEAT_S)
        await self._clear(reading.fault)
        await self._link.ask(lambda: self._wire.order("rest"), urgent=True)

    async def make_safe(self) -> None:
        """See Device. Retract and confirm it; a link that is lost meanwhile is opened again once."""
        await self._rest(self.retract, self._times.lifted_s, "the tool is retracted")

    def _require_sound(self, reading: ActuatorReading) -> None:
        if reading.fault or reading.state == "fault":
            raise DeviceRefused(f"{self._wire.name}: does not press over fault {reading.fault} ({reading.faults})")

    async def _land(self, retracts: int) -> None:
        deadline = time.monotonic() + self._times.landing_s
        while (reading := await self._link.ask(self._beat)).state != "contact":
            if reading.fault or reading.state == "fault":
                raise DeviceFault(f"{self._wire.name}: fault {reading.fault} while landing ({reading.faults})")
            if self._retracts != retracts:
                raise DeviceRefused(f"{self._wire.name}: was retracted while landing")
            if time.monotonic() > deadline:
                raise DeviceFault(f"{self._wire.name}: no contact after {self._times.landing_s:g} s")
            await asyncio.sleep(ACTUATOR_BEAT_S)

    async def _set_point(self, force_n: float) -> None:
        # without an engage command, the set point alone lands the tool
        self._link.exposed = self._link.exposed or (force_n > 0.0 and not self._wire.profile.commands.engage)
        await self._wire.order("force", force_n)
        self._asked_n = force_n

    async def _engage(self, force_n: float) -> None:
        self._link.exposed = True
        await self._wire.order("engage", force_n)

    async def _let_go(self) -> None:
        await self._wire.order("retract")
        self._asked_n = 0.0

    def _reading(self, values: Values) -> ActuatorReading:
        reading = reading_of(self._wire.profile, values, self._asked_n)
        self._link.exposed = reading.state != "retracted"
        return reading


# Spindle by its profile, for example an inverter.

SPINDLE_BEAT_S = 0.1
"""Period of samples, which feed the drive's watchdog."""
TOLERANCE = 0.02
ARRIVED = 0.015
"""Deviation at which a speed counts as reached: later readings scatter and must stay within the tolerance."""
STANDS_RPM = 1.0
SPINDLE_MAY_TURN = "the spindle may turn: only stopping opens the link again"


@dataclass(frozen=True, slots=True)
class SpindleReading:
    """Reading of the drive. Speed is signed if the profile names the sign; forward is positive."""

    state: str
    rpm: float
    fault: int
    faults: str
    """In words."""

    @property
    def stands(self) -> bool:
        """Standstill by state and by speed."""
        return self.state in {"stopped", "fault"} and abs(self.rpm) < STANDS_RPM

    def at(self, rpm: float, within: float = TOLERANCE) -> bool:
        """Whether the speed is reached."""
        return self.state == "running" and abs(self.rpm - rpm) <= within * abs(rpm)


class ProfiledSpindle(ProfiledDevice[SpindleReading, SpindleTimes]):
    """A Spindle on a link. Its watchdog is fed only while ``samples`` is iterated or ``set_speed`` waits."""

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
        """See Device. Stop and confirm standstill; a link that is lost meanwhile is opened again once."""
        await self._rest(self._stop, self._times.spin_s, "the spindle stands")

    async def set_speed(self, rpm: float) -> None:
        """See Spindle. DeviceRefused outside the drive's range, and backwards where it only turns forward."""
        most, commands = self._table.max_rpm, self._wire.profile.commands
        if not (math.isfinite(rpm) and abs(rpm) <= most):
            raise DeviceRefused(f"{self._wire.name}: {rpm} rpm is outside the drive's {most:g} rpm")
        if rpm < 0.0 and not commands.reverse:
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
        fault = codec.fault_of(profile, values)
        state, rpm = codec.state_of(profile, values), codec.number(values, "speed", 0.0)
        reading = SpindleReading(state, rpm, fault, codec.fault_words(profile, fault))
        self._link.exposed = not reading.stands
        return reading


# Force sensor by its profile: it reads forces and can be tared.


@dataclass(frozen=True, slots=True)
class ForceSensorReading:
    """Reading of the force sensor."""

    force_n: float
    fault: int
    faults: str
    """In words."""
    count: float | None
    """Number of the conversion; None if the sensor does not count them."""
    is_taring: bool
    """The force is not valid yet."""


class ProfiledForceSensor(ProfiledDevice[ForceSensorReading, SensorTimes]):
    """A ForceSensor on a link. A link that is lost while samples are taken stays lost until sampling ends."""

    def __init__(self, wire: ProfileTransport, times: SensorTimes) -> None:
        table = wire.profile.force_sensor
        if table is None:
            raise ValueError(f"profile {wire.profile.name!r} is of no force sensor")
        super().__init__(wire, times, None, "forces were being sampled: missing samples are not replaced")
        self._table: ForceSensorTable = table

    async def status(self) -> DeviceStatus:
        """See Device. It is always safe."""
        reading = await self._link.ask(self._read)
        state = "fault" if reading.fault else "taring" if reading.is_taring else "measuring"
        return DeviceStatus(ready=not reading.fault, safe=True, state=state, detail=reading.faults)

    async def make_safe(self) -> None:
        """See Device. The sensor exerts no force."""
        if not self._link.running:
            await self.open()
            await self.close()
        else:
            await self.status()

    async def tare(self) -> None:
        """See ForceSensor. DeviceFault if it has a fault, or is not tared after ``times.tare_s``."""
        deadline = time.monotonic() + self._times.tare_s
        await self._link.ask(lambda: self._wire.order("tare"))
        reports_taring = any(rule.state == "taring" for rule in self._wire.profile.states)
        while True:
            reading = await self._link.ask(self._read)
            if reading.fault:
                raise DeviceFault(f"{self._wire.name}: cannot be tared, fault {reading.fault} ({reading.faults})")
            if not reading.is_taring and (reports_taring or abs(reading.force_n) <= self._table.zero_n):
                return
            if time.monotonic() > deadline:
                said = f"not tared after {self._times.tare_s:g} s, reads {reading.force_n:g} N"
                raise DeviceFault(f"{self._wire.name}: {said}. Check that nothing shakes the sensor.")
            await asyncio.sleep(self._table.period_s)

    async def samples(self) -> AsyncIterator[SensedForce]:
        """See ForceSensor. If the sensor counts its conversions, a repeated one is not a new reading."""
        pace, last = PeriodicTimer(self._table.period_s), -1.0
        self._link.exposed = True
        try:
            while True:
                reading = await self._link.ask(self._read)
                if not reading.is_taring and (reading.count is None or reading.count != last):
                    yield SensedForce(time.monotonic(), reading.force_n, reading.fault)
                last = -1.0 if reading.count is None else reading.count
                await pace.next()
        finally:
            self._link.exposed = False

    def _reading(self, values: Values) -> ForceSensorReading:
        profile = self._wire.profile
        fault = codec.fault_of(profile, values)
        states = {rule.state for rule in profile.states if rule.holds(values[rule.when])}
        count = codec.number(values, "count", -1.0) if "count" in values else None
        force_n = codec.number(values, "force", 0.0)
        fault_words, is_taring = codec.fault_words(profile, fault), "taring" in states
        return ForceSensorReading(force_n, fault or int("fault" in states), fault_words, count, is_taring)
