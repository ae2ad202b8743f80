"""A force actuator behind a drive of CiA 402: a voice coil in profile torque mode.

Without current the axis lifts the tool by itself, by a spring or a counterweight: so it does when the drive hears
nothing, and when it has no power. What the drive does beyond that to lift it faster is the config's ``lift``.
"""

from __future__ import annotations

import asyncio
import logging
import time
from collections import deque
from collections.abc import AsyncIterator
from dataclasses import dataclass
from typing import Literal

from polishd.api import ActuatorTimes, DeviceFault, DeviceIdentity, DeviceRefused, DeviceStatus, ForceSample
from polishd.drivers.cia402 import protocol
from polishd.drivers.cia402.drive import POLL_S, CanNodeAddress, CanopenConnection, Cia402Drive, Unless, describe
from polishd.drivers.cia402.protocol import Address, Dictionary, DriveState402
from polishd.drivers.transport.background import PeriodicTimer

# Whether a tool that is pressed touches, by where it is: an axis with a motor has no force sensor. Pure.

WINDOW_S = 0.08
"""Speeds are means over at least so long."""
LANDED_MM_S = 1.0
"""A tool that has landed while the robot stands is slower than that, whatever is told of how fast it travels."""


class ContactDetector:
    """Fed with positions (mm out of the tool's rest) while the tool is pressed outwards.

    In the air the tool travels out, as fast as the drive lets it; on the part it goes with the part. So it touches
    where it is off its rest, short of its end, and travels slower than ``travel_mm_s``, either way.
    """

    def __init__(self, *, rest_mm: float, end_mm: float, travel_mm_s: float) -> None:
        self._rest_mm = rest_mm
        self._end_mm = end_mm
        self._travel_mm_s = travel_mm_s
        self.landed = False
        """As of the last reading, for a robot that stands: it touches, and stands, too."""
        self._positions: deque[tuple[float, float]] = deque()

    def reset(self) -> None:
        """Not pressed: what was seen before says nothing."""
        self._positions.clear()
        self.landed = False

    def feed(self, at_s: float, position_mm: float) -> bool:
        """A reading; whether the tool touches. It takes ``WINDOW_S`` until the first yes."""
        seen = self._positions
        seen.append((at_s, position_mm))
        while len(seen) > 2 and seen[1][0] <= at_s - WINDOW_S:
            seen.popleft()
        began_s, from_mm = seen[0]
        self.landed = False
        if at_s - began_s < WINDOW_S or not self._rest_mm < position_mm < self._end_mm:
            return False
        speed_mm_s = abs(position_mm - from_mm) / (at_s - began_s)
        self.landed = speed_mm_s < min(self._travel_mm_s, LANDED_MM_S)
        return speed_mm_s < self._travel_mm_s


SAMPLE_S = 0.05
MODE_S = 0.5
"""For a change of the mode, with the force off already."""

log = logging.getLogger(__name__)

Lift = Literal["spring", "torque", "position"]


@dataclass(frozen=True, slots=True)
class ActuatorScale:
    """What the drive's numbers mean, and how it lands and lifts."""

    n_per_permille: float
    """Of 6071h and 6077h, positive: presses; negative where a positive torque lifts."""
    mm_per_increment: float
    """Of 6064h, positive: outwards; negative where it counts down."""
    rest_increments: int = 0
    """6064h with the tool at its rest."""
    rest_mm: float = 0.1
    """So near its rest the tool counts as up."""
    balance_n: float = 0.0
    """What the axis lifts with, without current: the drive presses with so much more than the tool does."""
    max_n: float = 50.0
    landing_n: float = 1.0
    """Pressed with so much, at most, until it touches."""
    slope_n_s: float = 500.0
    travel_mm_s: float = 1.0
    """Slower than that, the tool goes with the part; faster, it is in the air."""
    max_speed: int | None = None
    """6080h, in the drive's own unit: no faster does it land. None: left as it is."""
    lift: Lift = "spring"
    lift_n: float = 1.0
    """With ``torque``."""
    lift_mm_s: float = 10.0
    """With ``position``."""

    def torque(self, force_n: float) -> int:
        """The drive's torque for a force of the tool, against what lifts it."""
        return round((force_n + self.balance_n) / self.n_per_permille)

    @property
    def lifting_torque(self) -> int:
        """The drive's torque that lifts, together with what does so by itself."""
        return round(-self.lift_n / self.n_per_permille)

    def force_n(self, torque: int) -> float:
        """And back. What pulls the tool up is no force on the part."""
        return max(torque * self.n_per_permille - self.balance_n, 0.0)

    def position_mm(self, increments: int) -> float:
        """Out of its rest."""
        return (increments - self.rest_increments) * self.mm_per_increment

    def settings(self) -> dict[Address, int]:
        """What the drive is told at open."""
        told = {protocol.TORQUE_SLOPE: max(round(self.slope_n_s / abs(self.n_per_permille)), 1)}
        if self.max_speed is not None:
            told[protocol.MAX_MOTOR_SPEED] = self.max_speed
        if self.lift == "position":
            told[protocol.PROFILE_VELOCITY] = max(round(self.lift_mm_s / abs(self.mm_per_increment)), 1)
        return told


@dataclass(frozen=True, slots=True)
class Cia402ActuatorReading:
    """What the drive says of itself, and what follows."""

    state: DriveState402
    force_n: float
    position_mm: float
    touches: bool
    retracted: bool
    fault: int
    detail: str

    @property
    def name(self) -> str:
        """The state, in an actuator's words."""
        if self.fault:
            return "fault"
        if self.retracted:
            return "retracted"
        if self.state is not DriveState402.ENABLED:
            return "lifting"
        return "contact" if self.touches else "extended"


class Cia402Actuator:
    """A ForceActuator. Our heartbeat goes out with what somebody reads; without it the drive takes the current off.

    A lost link stays lost until ``open``; only ``retract`` and ``make_safe`` connect once by themselves.
    """

    def __init__(
        self, place: CanNodeAddress, dictionary: Dictionary, scale: ActuatorScale, times: ActuatorTimes
    ) -> None:
        """ConfigError where the drive of the EDS file has no profile torque mode, or none to lift with."""
        self._scale = scale
        self._times = times
        lifts = scale.lift == "position"
        self._axis = Cia402Drive(
            place,
            dictionary,
            modes=(protocol.TORQUE_MODE, protocol.POSITION_MODE) if lifts else (protocol.TORQUE_MODE,),
            on_silence=protocol.ABORT_DISABLES,
            settings=scale.settings(),
            read=(protocol.TORQUE, protocol.POSITION, *((protocol.MODE_NOW,) if lifts else ())),
            write=(protocol.TARGET_TORQUE, *((protocol.TARGET_POSITION,) if lifts else ())),
        )
        self._contact = ContactDetector(
            rest_mm=scale.rest_mm, end_mm=times.stroke_mm - scale.rest_mm, travel_mm_s=scale.travel_mm_s
        )
        self._setpoint_n = 0.0

    @property
    def times(self) -> ActuatorTimes:
        """See ForceActuator."""
        return self._times

    async def open(self) -> None:
        """See Device. Also writes slopes, heartbeats and what the drive does in our absence."""

        async def look(link: CanopenConnection) -> None:
            wanted = abs(self._scale.torque(self._scale.max_n))
            if protocol.MAX_TORQUE in self._axis.dictionary and (most := await link.read(protocol.MAX_TORQUE)) < wanted:
                raise DeviceRefused(f"{self._axis.name}: 6072h allows {most} permille, max_n takes {wanted}")

        self._contact.reset()
        await self._axis.open(look)

    async def close(self) -> None:
        """See Device."""
        await self._axis.close()

    async def identify(self) -> DeviceIdentity:
        """See Device."""
        return await self._axis.identify()

    async def status(self) -> DeviceStatus:
        """See Device. Safe means without current, and up."""
        reading = await self._read(self._axis.link)
        return DeviceStatus(not reading.fault, reading.retracted, reading.name, reading.detail)

    async def set_force(self, force_n: float) -> None:
        """See ForceActuator. Returns once the tool touches, or for 0 at once."""
        link = self._axis.link
        if not 0.0 <= force_n <= self._scale.max_n:
            raise DeviceRefused(f"{self._axis.name}: {force_n} N is outside 0 to {self._scale.max_n:g} N")
        unless = self._axis.take_over()
        await self._axis.wake(link)
        reading = await self._read(link, cared=True)
        if force_n == 0.0 and reading.state is not DriveState402.ENABLED:
            return
        if reading.fault:
            raise DeviceRefused(f"{self._axis.name}: cannot press: {reading.detail}")
        if self._scale.lift == "position" and reading.state is DriveState402.ENABLED:
            await self._require_pressing(link)
        self._setpoint_n = force_n
        if force_n and not reading.touches:
            await self._land(link, force_n, unless)
        await link.write(protocol.TARGET_TORQUE, self._scale.torque(force_n), unless=unless)

    async def samples(self) -> AsyncIterator[ForceSample]:
        """See ForceActuator."""
        link = self._axis.link
        pace = PeriodicTimer(SAMPLE_S)
        while True:
            reading = await self._read(link, cared=True)
            yield ForceSample(
                at_s=time.monotonic(),
                force_n=reading.force_n,
                setpoint_n=self._setpoint_n if reading.state is DriveState402.ENABLED else 0.0,
                in_contact=reading.touches,
                retracted=reading.retracted,
                fault=reading.fault,
                position_mm=reading.position_mm,
            )
            await pace.next()

    async def retract(self) -> None:
        """See ForceActuator. Overtakes what waits."""
        await self._axis.reach(self._lift)

    async def make_safe(self) -> None:
        """See Device. Retracts, and reads back that it is so; what a lost connection left behind is reset."""

        async def calm(link: CanopenConnection) -> None:
            await self._lift(link)
            await self._axis.reset(link)

        await self._axis.reach(calm)

    async def _land(self, link: CanopenConnection, force_n: float, unless: Unless) -> None:
        """Press lightly until it has landed. The drive is enabled with no torque: it does not jump."""
        deadline = time.monotonic() + self._times.landing_s
        if await self._axis.state(link) is not DriveState402.ENABLED:
            await link.write(protocol.TARGET_TORQUE, 0, unless=unless)
            await self._axis.power_up(link, protocol.TORQUE_MODE, unless, self._times.landing_s)
        lightly = self._scale.torque(min(force_n, self._scale.landing_n))
        await link.write(protocol.TARGET_TORQUE, lightly, unless=unless)
        while not ((reading := await self._read(link, cared=True)).touches and self._contact.landed):
            unless()
            if reading.fault or reading.state is not DriveState402.ENABLED:
                raise DeviceFault(f"{self._axis.name}: {reading.detail or reading.state.value}, while landing")
            if time.monotonic() > deadline:
                raise DeviceFault(
                    f"{self._axis.name}: no contact after {self._times.landing_s:g} s, {reading.position_mm:.2f} mm out"
                )
            await asyncio.sleep(POLL_S)

    async def _lift(self, link: CanopenConnection) -> None:
        """Force off, then up; the current goes off once the tool is there, and at once where a spring lifts it."""
        self._axis.take_over()
        deadline = time.monotonic() + self._times.lifted_s
        self._setpoint_n = 0.0
        try:
            await link.write(protocol.TARGET_TORQUE, 0, urgent=True)
            if self._scale.lift != "spring" and await self._axis.state(link, urgent=True) is DriveState402.ENABLED:
                await self._pull(link, deadline)
        except DeviceRefused as refused:
            log.warning("%s; the current goes off, and the tool is lifted without it", refused)
        await link.write(protocol.CONTROL_WORD, protocol.DISABLE_VOLTAGE, urgent=True)
        while not (reading := await self._read(link, cared=True)).retracted:
            self._require_time(reading, deadline)
            await asyncio.sleep(POLL_S)

    async def _pull(self, link: CanopenConnection, deadline: float) -> None:
        """Lift by the motor, too, until the tool is up or the drive gives up."""
        if self._scale.lift == "torque":
            await link.write(protocol.TARGET_TORQUE, self._scale.lifting_torque, urgent=True)
        else:
            await self._change_to_position(link)
        while (reading := await self._read(link, cared=True)).position_mm > self._scale.rest_mm:
            self._require_time(reading, deadline)
            if reading.state is not DriveState402.ENABLED:
                return
            await asyncio.sleep(POLL_S)

    async def _change_to_position(self, link: CanopenConnection) -> None:
        await link.write(protocol.TARGET_POSITION, self._scale.rest_increments, urgent=True)
        await link.write(protocol.MODE, protocol.POSITION_MODE, urgent=True)
        deadline = time.monotonic() + MODE_S
        while (mode := await link.read(protocol.MODE_NOW, urgent=True)) != protocol.POSITION_MODE:
            if time.monotonic() > deadline:
                raise DeviceRefused(
                    f"{self._axis.name}: is in mode {mode} still, {MODE_S:g} s after it was to position"
                )
            await asyncio.sleep(POLL_S)
        await link.write(protocol.CONTROL_WORD, protocol.MOVE_NOW, urgent=True)

    async def _require_pressing(self, link: CanopenConnection) -> None:
        if (mode := await link.read(protocol.MODE_NOW)) != protocol.TORQUE_MODE:
            raise DeviceRefused(f"{self._axis.name}: is being lifted (mode {mode}): it can press once it is up")

    def _require_time(self, reading: Cia402ActuatorReading, deadline: float) -> None:
        if time.monotonic() > deadline:
            raise DeviceFault(
                f"{self._axis.name}: {reading.position_mm:.2f} mm out, {self._times.lifted_s:g} s after it was to "
                f"retract ({reading.detail or reading.state.value})"
            )

    async def _read(self, link: CanopenConnection, *, cared: bool = False) -> Cia402ActuatorReading:
        """``cared``: somebody watches the force, which the drive is told."""
        state = await self._axis.state(link)
        if cared:
            link.beat()
        force_n = self._scale.force_n(await link.read(protocol.TORQUE))
        position_mm = self._scale.position_mm(await link.read(protocol.POSITION))
        fault = await self._axis.fault(link, state)
        if state is not DriveState402.ENABLED:
            self._contact.reset()
        return Cia402ActuatorReading(
            state=state,
            force_n=force_n if state is DriveState402.ENABLED else 0.0,
            position_mm=position_mm,
            touches=state is DriveState402.ENABLED and self._contact.feed(time.monotonic(), position_mm),
            retracted=not state.drives and position_mm <= self._scale.rest_mm,
            fault=fault.code if fault else 0,
            detail=describe(fault) if fault else "",
        )
