"""A force actuator by its profile: landing, heartbeat, retracting."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator
from dataclasses import dataclass

from polishd.api import (
    ActuatorTimes,
    DeviceFault,
    DeviceRefused,
    DeviceStatus,
    ForceSample,
)
from polishd.config.device_profile import DeviceProfile
from polishd.config.device_tables import ActuatorTable
from polishd.drivers.profiled import meaning
from polishd.drivers.profiled.codec import Values
from polishd.drivers.profiled.device import ProfiledDevice
from polishd.drivers.profiled.wire import ProfileTransport
from polishd.drivers.transport.pace import PeriodicTimer

ACTUATOR_BEAT_S = 0.05
"""Period of samples and heartbeats."""
TOOL_OFF_REST = "the tool is off its rest: only retracting opens the link again"


@dataclass(frozen=True, slots=True)
class ActuatorReading:
    """What the actuator says of itself; the set point is the last that was written where it does not say."""

    state: str
    force_n: float
    setpoint_n: float
    position_mm: float | None
    fault: int
    faults: str
    """In words."""


def reading_of(profile: DeviceProfile, values: Values, asked_n: float = 0.0) -> ActuatorReading:
    """What the values say; ProtocolError on what the profile does not have."""
    fault = meaning.fault_of(profile, values)
    return ActuatorReading(
        state=meaning.state_of(profile, values),
        force_n=meaning.number(values, "force", 0.0),
        setpoint_n=meaning.number(values, "set_point", asked_n),
        position_mm=meaning.number(values, "position", 0.0) if "position" in values else None,
        fault=fault,
        faults=meaning.fault_words(profile, fault),
    )


class ProfiledActuator(ProfiledDevice[ActuatorReading, ActuatorTimes]):
    """A ForceActuator over a wire."""

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
        """See ForceActuator. Returns once the tool is in contact (feeding the watchdog meanwhile), or for 0 at once."""
        if not 0.0 <= force_n <= self._table.max_force_n:
            raise DeviceRefused(f"{self._wire.name}: force {force_n} N is outside 0 to {self._table.max_force_n:g} N")
        retracts = self._retracts
        if force_n > 0.0 and not self._wire.profile.orders.engage:  # the set point alone would land it
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
        """See ForceActuator. Overtakes requests that wait; leaves the set point at 0."""
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
        """See Device. Retracts, and reads back that it is so; a link lost over it is opened again once."""
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
        # where no order engages, the set point alone lands it
        self._link.exposed = self._link.exposed or (force_n > 0.0 and not self._wire.profile.orders.engage)
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
