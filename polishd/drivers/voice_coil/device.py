"""A voice-coil actuator on any wire: landing, heartbeat, retracting, and when a lost link may be retried."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from dataclasses import dataclass
from enum import IntEnum
from typing import Protocol, TypeVar

from polishd.api import (
    ActuatorTimes,
    DeviceFault,
    DeviceRefused,
    DeviceStatus,
    ForceSample,
    Identity,
    LinkError,
    ProtocolError,
)
from polishd.drivers.transport.requests import RequestQueue

T = TypeVar("T")

MAX_FORCE_N = 50.0
BEAT_S = 0.05
"""Period of samples and heartbeats."""
ANSWERS_S = 2.0
"""Beyond the lift itself: a link that is lost over it is opened again once."""
FAULTS = {1: "watchdog ran out", 2: "over-force", 4: "drive", 8: "encoder"}


class State(IntEnum):
    """The actuator's states, as both wires number them."""

    RETRACTED = 0
    EXTENDING = 1
    CONTACT = 2
    RETRACTING = 3
    FAULT = 4


@dataclass(frozen=True, slots=True)
class Reading:
    """What the actuator says of itself."""

    state: State
    force_n: float
    setpoint_n: float
    position_um: int
    fault: int

    @property
    def faults(self) -> str:
        """Fault bits in words."""
        return ", ".join(text for bit, text in FAULTS.items() if self.fault & bit)


class VoiceCoilWire(Protocol):
    """One request and one answer at a time. A call raises LinkError or ProtocolError and is never repeated."""

    @property
    def connected(self) -> bool:
        """False before ``connect``, and as soon as answers can no longer be trusted."""
        ...

    @property
    def name(self) -> str:
        """Address, for messages."""
        ...

    async def connect(self) -> None:
        """Open the wire; waits until a late answer to an earlier request can no longer come."""
        ...

    async def disconnect(self) -> None:
        """Idempotent."""
        ...

    async def identity(self) -> Identity:
        """Who is there."""
        ...

    async def read(self) -> Reading:
        """State, force and faults."""
        ...

    async def beat(self) -> None:
        """Feed the actuator's watchdog."""
        ...

    async def set_watchdog(self, watchdog_ms: int) -> None:
        """Time without heartbeat after which the actuator retracts by itself."""
        ...

    async def set_point(self, force_n: float) -> None:
        """Write the force set point."""
        ...

    async def command(self, *, engage: bool) -> None:
        """Engage, or retract (force to 0 first; clears a watchdog fault)."""
        ...


class VoiceCoil:
    """A ForceActuator over a wire.

    A lost link is opened again by the next request only while the actuator is known to be retracted. In contact all
    requests raise LinkError until ``open``; only ``retract`` and ``make_safe`` try to reach it again.
    """

    def __init__(self, wire: VoiceCoilWire, times: ActuatorTimes) -> None:
        self._wire = wire
        self._times = times
        self._queue = RequestQueue(wire.name)
        self._exposed = False
        """The tool may be off its rest: by the last reading, or by a command whose outcome is not known."""
        self._retracts = 0
        self._lost = f"{wire.name}: the link was lost"
        """How the link was lost last: whoever asks next is told that, too."""

    @property
    def times(self) -> ActuatorTimes:
        """See ForceActuator."""
        return self._times

    async def open(self) -> None:
        """See Device. Also writes the watchdog time."""
        await self.close()
        self._exposed = False
        await self._queue.start()
        try:
            await self._ask(self._read)
        except BaseException:
            await self.close()
            raise

    async def close(self) -> None:
        """See Device."""
        await self._queue.stop()
        await self._wire.disconnect()

    async def identify(self) -> Identity:
        """See Device."""
        return await self._ask(self._wire.identity)

    async def status(self) -> DeviceStatus:
        """See Device. Safe means retracted."""
        reading = await self._ask(self._read)
        ready = not reading.fault and reading.state is not State.FAULT
        safe = reading.state is State.RETRACTED
        return DeviceStatus(ready=ready, safe=safe, state=reading.state.name.lower(), detail=reading.faults)

    async def set_force(self, force_n: float) -> None:
        """See ForceActuator. Returns once the tool is in contact (feeding the watchdog meanwhile), or for 0 at once."""
        if not 0.0 <= force_n <= MAX_FORCE_N:
            raise DeviceRefused(f"{self._wire.name}: force {force_n} N is outside 0 to {MAX_FORCE_N:g} N")
        retracts = self._retracts
        await self._ask(lambda: self._wire.set_point(force_n))
        reading = await self._ask(self._beat)
        if force_n == 0.0 or reading.state is State.CONTACT:
            return
        if reading.state is not State.EXTENDING:
            await self._ask(self._engage)
        await self._land(retracts)

    async def samples(self) -> AsyncIterator[ForceSample]:
        """See ForceActuator."""
        due = time.monotonic()
        while True:
            reading = await self._ask(self._beat)
            yield ForceSample(
                at_s=time.monotonic(),
                force_n=reading.force_n,
                setpoint_n=reading.setpoint_n,
                in_contact=reading.state is State.CONTACT,
                retracted=reading.state is State.RETRACTED,
                fault=reading.fault,
                position_mm=reading.position_um / 1000,
            )
            due = max(due + BEAT_S, time.monotonic())
            await asyncio.sleep(due - time.monotonic())

    async def retract(self) -> None:
        """See ForceActuator. Overtakes requests that wait; leaves the set point at 0."""
        self._retracts += 1
        await self._ask(lambda: self._wire.command(engage=False), urgent=True)
        deadline = time.monotonic() + self._times.lifted_s
        while (reading := await self._ask(self._beat, urgent=True)).state is not State.RETRACTED:
            if reading.state is State.FAULT:
                raise DeviceFault(f"{self._wire.name}: does not retract, fault {reading.fault} ({reading.faults})")
            if time.monotonic() > deadline:
                raise DeviceFault(f"{self._wire.name}: not retracted after {self._times.lifted_s:g} s")
            await asyncio.sleep(BEAT_S)
        await self._ask(lambda: self._wire.set_point(0.0), urgent=True)

    async def make_safe(self) -> None:
        """See Device. Retracts, and reads back that it is so; a link lost over it is opened again once."""
        opened = self._queue.running
        if not opened:
            await self.close()
            await self._queue.start()
        try:
            async with asyncio.timeout(self._times.lifted_s + ANSWERS_S):
                with contextlib.suppress(LinkError, ProtocolError):
                    return await self.retract()
                return await self.retract()
        except TimeoutError:
            raise LinkError(f"{self._wire.name}: could not confirm that the tool is retracted") from None
        finally:
            if not opened:
                await self.close()

    async def _land(self, retracts: int) -> None:
        deadline = time.monotonic() + self._times.landing_s
        while (reading := await self._ask(self._beat)).state is not State.CONTACT:
            if reading.fault or reading.state is State.FAULT:
                raise DeviceFault(f"{self._wire.name}: fault {reading.fault} while landing ({reading.faults})")
            if self._retracts != retracts:
                raise DeviceRefused(f"{self._wire.name}: was retracted while landing")
            if time.monotonic() > deadline:
                raise DeviceFault(f"{self._wire.name}: no contact after {self._times.landing_s:g} s")
            await asyncio.sleep(BEAT_S)

    async def _engage(self) -> None:
        self._exposed = True
        await self._wire.command(engage=True)

    async def _read(self) -> Reading:
        reading = await self._wire.read()
        self._exposed = reading.state is not State.RETRACTED
        return reading

    async def _beat(self) -> Reading:
        await self._wire.beat()
        return await self._read()

    async def _ask(self, work: Callable[[], Awaitable[T]], *, urgent: bool = False) -> T:
        async def connected() -> T:
            if not self._wire.connected:
                if self._exposed and not urgent:
                    raise LinkError(f"{self._lost}; the tool is off its rest: only retracting opens the link again")
                await self._wire.connect()
                if not urgent:
                    await self._wire.set_watchdog(round(1000 * self._times.watchdog_s))
            try:
                return await work()
            except LinkError as error:
                self._lost = str(error)
                raise

        return await self._queue.ask(connected, urgent=urgent)
