"""Force actuator on a CiA 402 drive: a voice coil in profile torque mode.

Without current a spring or a counterweight lifts the tool: when the drive receives no heartbeat, and without power.
The config's ``lift`` says how the motor adds to that.
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

# Contact detection by position: a motor axis has no force sensor. Pure.

WINDOW_S = 0.08
"""Shortest time over which a speed is averaged, s."""
LANDED_MM_S = 1.0
"""Upper speed limit of a landed tool while the robot stands still, whatever the configured travel speed is."""


class ContactDetector:
    """Contact detector, fed with positions (mm from the tool's rest) while the tool is pressed outward.

    In the air the tool travels outward at the drive's speed limit; on the part it follows the part. It is in contact
    if it is off its rest, short of its end, and slower than ``travel_mm_s`` in both directions.
    """

    def __init__(self, *, rest_mm: float, end_mm: float, travel_mm_s: float) -> None:
        self._rest_mm = rest_mm
        self._end_mm = end_mm
        self._travel_mm_s = travel_mm_s
        self.landed = False
        """At the last reading, for a robot at standstill: the tool is in contact and stands still."""
        self._positions: deque[tuple[float, float]] = deque()

    def reset(self) -> None:
        """Forget the positions: the tool is not pressed."""
        self._positions.clear()
        self.landed = False

    def feed(self, at_s: float, position_mm: float) -> bool:
        """Add a reading; return whether the tool is in contact. True after ``WINDOW_S`` at the earliest."""
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
"""Longest time of a mode change, with the force off."""

log = logging.getLogger(__name__)

Lift = Literal["spring", "torque", "position"]


@dataclass(frozen=True, slots=True)
class ActuatorScale:
    """Units of the drive's objects, and parameters for landing and lifting."""

    n_per_permille: float
    """Unit of 6071h and 6077h. Positive: a positive torque presses; negative: it lifts."""
    mm_per_increment: float
    """Unit of 6064h. Positive: it counts up outward; negative: down."""
    rest_increments: int = 0
    """6064h with the tool at rest."""
    rest_mm: float = 0.1
    """Distance from its rest within which the tool is up."""
    balance_n: float = 0.0
    """Lifting force of the axis without current; the drive adds it to the pressing force."""
    max_n: float = 50.0
    landing_n: float = 1.0
    """Largest force of landing, until contact."""
    slope_n_s: float = 500.0
    travel_mm_s: float = 1.0
    """Below this speed the tool follows the part; above, it is in the air."""
    max_speed: int | None = None
    """6080h, the speed limit of landing, in the drive's unit. None: unchanged."""
    lift: Lift = "spring"
    lift_n: float = 1.0
    """Lifting force with ``torque``."""
    lift_mm_s: float = 10.0
    """Lifting speed with ``position``."""

    def torque(self, force_n: float) -> int:
        """Return the drive's torque for a tool force, against the lifting force."""
        return round((force_n + self.balance_n) / self.n_per_permille)

    @property
    def lifting_torque(self) -> int:
        """Torque of the drive that adds to the lifting force of the axis."""
        return round(-self.lift_n / self.n_per_permille)

    def force_n(self, torque: int) -> float:
        """Return the tool force of a torque, 0 for a lifting torque."""
        return max(torque * self.n_per_permille - self.balance_n, 0.0)

    def position_mm(self, increments: int) -> float:
        """Return the distance from the rest."""
        return (increments - self.rest_increments) * self.mm_per_increment

    def settings(self) -> dict[Address, int]:
        """Return the objects that ``open`` writes to the drive."""
        settings = {protocol.TORQUE_SLOPE: max(round(self.slope_n_s / abs(self.n_per_permille)), 1)}
        if self.max_speed is not None:
            settings[protocol.MAX_MOTOR_SPEED] = self.max_speed
        if self.lift == "position":
            settings[protocol.PROFILE_VELOCITY] = max(round(self.lift_mm_s / abs(self.mm_per_increment)), 1)
        return settings


@dataclass(frozen=True, slots=True)
class Cia402ActuatorReading:
    """Reading of the drive, and the tool's state."""

    state: DriveState402
    force_n: float
    position_mm: float
    touches: bool
    retracted: bool
    fault: int
    detail: str

    @property
    def name(self) -> str:
        """State of the actuator."""
        if self.fault:
            return "fault"
        if self.retracted:
            return "retracted"
        if self.state is not DriveState402.ENABLED:
            return "lifting"
        return "contact" if self.touches else "extended"


class Cia402Actuator:
    """A ForceActuator. Reading sends our heartbeat; without it the drive switches the current off.

    A lost link stays lost until ``open``; only ``retract`` and ``make_safe`` reconnect once.
    """

    def __init__(
        self, place: CanNodeAddress, dictionary: Dictionary, scale: ActuatorScale, times: ActuatorTimes
    ) -> None:
        """ConfigError if the EDS file has no profile torque mode, or no mode for lifting."""
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
        """See Device. Also writes slopes, heartbeats and the drive's reaction to a lost heartbeat."""

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
        """See Device. Safe means without current and lifted."""
        reading = await self._read(self._axis.link)
        return DeviceStatus(not reading.fault, reading.retracted, reading.name, reading.detail)

    async def set_force(self, force_n: float) -> None:
        """See ForceActuator. Return once the tool is in contact, or for 0 at once."""
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
        """See ForceActuator. Overtakes waiting requests."""
        await self._axis.reach(self._lift)

    async def make_safe(self) -> None:
        """See Device. Retract and confirm it; reset the faults that a lost connection left."""

        async def calm(link: CanopenConnection) -> None:
            await self._lift(link)
            await self._axis.reset(link)

        await self._axis.reach(calm)

    async def _land(self, link: CanopenConnection, force_n: float, unless: Unless) -> None:
        """Press lightly until contact. The drive is enabled with zero torque, so that it does not jump."""
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
        """Force off, then lift; switch the current off once the tool is up, or at once if a spring lifts it."""
        self._axis.take_over()
        deadline = time.monotonic() + self._times.lifted_s
        self._setpoint_n = 0.0
        try:
            await link.write(protocol.TARGET_TORQUE, 0, urgent=True)
            if self._scale.lift != "spring" and await self._axis.state(link, urgent=True) is DriveState402.ENABLED:
                await self._pull(link, deadline)
        except DeviceRefused as refused:
            log.warning("%s. The current is switched off; the axis lifts the tool without it.", refused)
        await link.write(protocol.CONTROL_WORD, protocol.DISABLE_VOLTAGE, urgent=True)
        while not (reading := await self._read(link, cared=True)).retracted:
            self._require_time(reading, deadline)
            await asyncio.sleep(POLL_S)

    async def _pull(self, link: CanopenConnection, deadline: float) -> None:
        """Lift with the motor until the tool is up or the drive fails."""
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
                raise DeviceRefused(f"{self._axis.name}: is in mode {mode} {MODE_S:g} s after the command to position")
            await asyncio.sleep(POLL_S)
        await link.write(protocol.CONTROL_WORD, protocol.MOVE_NOW, urgent=True)

    async def _require_pressing(self, link: CanopenConnection) -> None:
        if (mode := await link.read(protocol.MODE_NOW)) != protocol.TORQUE_MODE:
            raise DeviceRefused(f"{self._axis.name}: is lifting (mode {mode}). It can press once the tool is up.")

    def _require_time(self, reading: Cia402ActuatorReading, deadline: float) -> None:
        if time.monotonic() > deadline:
            raise DeviceFault(
                f"{self._axis.name}: {reading.position_mm:.2f} mm out, {self._times.lifted_s:g} s after the "
                f"retract command ({reading.detail or reading.state.value})"
            )

    async def _read(self, link: CanopenConnection, *, cared: bool = False) -> Cia402ActuatorReading:
        """Read the drive; ``cared``: send our heartbeat, because a caller monitors the force."""
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
