"""A force actuator on Modbus, RTU or TCP, with the registers of docs/protocols/voice_coil_modbus.md."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Sequence
from typing import Annotated, NamedTuple, TypeVar

from pydantic import BaseModel, ConfigDict, Field

from polishd.api import (
    ActuatorTimes,
    DeviceContext,
    DeviceFault,
    DeviceIdentity,
    DeviceRefused,
    DeviceStatus,
    DeviceType,
    ForceSample,
    LinkError,
    ModbusLink,
    PeriodicTimer,
    ProtocolError,
    RequestQueue,
    SerialLine,
    Tcp,
    hookimpl,
    line_address,
)

POLISHD_API = 1

T = TypeVar("T")

COMMAND, SET_POINT, WATCHDOG, BEAT = range(4)
"""Holding registers; the set point in 0.01 N, the watchdog in ms."""
STATES = ("retracted", "extending", "contact", "retracting", "fault")
TEXTS = ((0, 8), (8, 8), (16, 8), (24, 4))
"""Vendor, model, serial number and firmware: first word from input register 100, and words."""
MOST_N = 50.0
BEAT_S = 0.05
"""Period of samples and heartbeats."""
ANSWERS_S = 2.0
"""Time of ``make_safe`` beyond the action."""


class Reading(NamedTuple):
    """State that the actuator reports."""

    state: str
    force_n: float
    set_point_n: float
    position_mm: float
    fault: int


class Actuator:
    """A ForceActuator. One request at a time; a retraction overtakes the others."""

    def __init__(self, address: Tcp | SerialLine, unit: int, times: ActuatorTimes) -> None:
        """Create the closed device."""
        self._link = ModbusLink(address, unit, times.silence_s, refusals={4: "refused: a fault is set"})
        self._queue = RequestQueue(self._link.name)
        self._times = times
        self._count = 0
        self._retracts = 0

    @property
    def times(self) -> ActuatorTimes:
        """See ForceActuator."""
        return self._times

    async def open(self) -> None:
        """See Device. Also write the watchdog time."""
        await self.close()
        await self._queue.start()
        try:
            await self._ask(self._read, urgent=True)  # the device is verified; nothing was written before
            await self._write(WATCHDOG, round(1000 * self._times.watchdog_s))
        except BaseException:
            await self.close()
            raise

    async def close(self) -> None:
        """See Device."""
        await self._queue.stop()
        await self._link.disconnect()

    async def identify(self) -> DeviceIdentity:
        """See Device."""
        words = await self._ask(lambda: self._link.read("input", 100, 30))
        vendor, model, serial, firmware = (_text(words[first : first + count]) for first, count in TEXTS)
        return DeviceIdentity(vendor, model, serial, firmware, str(words[28] << 16 | words[29]))

    async def status(self) -> DeviceStatus:
        """See Device. Safe means retracted."""
        reading = await self._ask(self._read)
        ready = not reading.fault and reading.state != "fault"
        return DeviceStatus(ready=ready, safe=reading.state == "retracted", state=reading.state, detail=_fault(reading))

    async def set_force(self, force_n: float) -> None:
        """See ForceActuator. Returns once the tool is in contact, or for 0 at once."""
        if not 0.0 <= force_n <= MOST_N:
            raise DeviceRefused(f"{self._link.name}: force {force_n:g} N is outside 0 to {MOST_N:g} N")
        retracts = self._retracts
        await self._write(SET_POINT, round(100 * force_n))
        reading = await self._ask(self._beat)
        if force_n == 0.0 or reading.state == "contact":
            return
        if reading.fault or reading.state == "fault":
            raise DeviceRefused(f"{self._link.name}: does not press over {_fault(reading)}")
        await self._write(COMMAND, 1)
        deadline = time.monotonic() + self._times.landing_s
        while (reading := await self._ask(self._beat)).state != "contact":
            if reading.fault or reading.state == "fault":
                raise DeviceFault(f"{self._link.name}: {_fault(reading)} while landing")
            if self._retracts != retracts:
                raise DeviceRefused(f"{self._link.name}: was retracted while landing")
            if time.monotonic() > deadline:
                raise DeviceFault(f"{self._link.name}: no contact after {self._times.landing_s:g} s")
            await asyncio.sleep(BEAT_S)

    async def samples(self) -> AsyncIterator[ForceSample]:
        """See ForceActuator."""
        pace = PeriodicTimer(BEAT_S)
        while True:
            reading = await self._ask(self._beat)
            yield ForceSample(
                at_s=time.monotonic(),
                force_n=reading.force_n,
                setpoint_n=reading.set_point_n,
                in_contact=reading.state == "contact",
                retracted=reading.state == "retracted",
                fault=reading.fault,
                position_mm=reading.position_mm,
            )
            await pace.next()

    async def retract(self) -> None:
        """See ForceActuator. The device takes the force off first."""
        self._retracts += 1
        await self._write(COMMAND, 0, urgent=True)
        deadline = time.monotonic() + self._times.lifted_s
        while (reading := await self._ask(self._beat, urgent=True)).state != "retracted":
            if reading.state == "fault":
                raise DeviceFault(f"{self._link.name}: does not retract, {_fault(reading)}")
            if time.monotonic() > deadline:
                raise DeviceFault(f"{self._link.name}: not retracted after {self._times.lifted_s:g} s")
            await asyncio.sleep(BEAT_S)
        await self._write(SET_POINT, 0, urgent=True)

    async def make_safe(self) -> None:
        """See Device. A lost link is opened again once."""
        was_open = self._queue.running
        if not was_open:
            await self._queue.start()
        try:
            async with asyncio.timeout(self._times.lifted_s + ANSWERS_S):
                with contextlib.suppress(LinkError, ProtocolError):
                    return await self.retract()
                return await self.retract()
        except TimeoutError:
            raise LinkError(f"{self._link.name}: could not confirm that the tool is retracted") from None
        finally:
            if not was_open:
                await self.close()

    async def _ask(self, work: Callable[[], Awaitable[T]], *, urgent: bool = False) -> T:
        """Run ``work`` in its turn. Only a retraction opens a lost link again."""

        async def connected() -> T:
            if not self._link.connected:
                if not urgent:
                    raise LinkError(f"{self._link.name}: the link was lost. Open the device again")
                await self._link.connect()
            return await work()

        return await self._queue.ask(connected, urgent=urgent)

    async def _write(self, register: int, value: int, *, urgent: bool = False) -> None:
        await self._ask(lambda: self._link.write("holding", register, [value], many=False), urgent=urgent)

    async def _beat(self) -> Reading:
        """Feed the watchdog, and read: the echo distinguishes a fresh answer from a stale one."""
        self._count = (self._count + 1) & 0xFFFF
        await self._link.write("holding", BEAT, [self._count], many=False)
        return await self._read(self._count)

    async def _read(self, count: int | None = None) -> Reading:
        state, force, set_point, position, fault, echo = await self._link.read("input", 0, 6)
        if state >= len(STATES):
            raise ProtocolError(
                f"{self._link.name}: unknown state {state}. Check that the address is that of this device"
            )
        if count is not None and echo != count:
            await self._link.distrust()
            raise ProtocolError(f"{self._link.name}: heartbeat {echo}, expected {count}")
        signed = force - 0x10000 if force & 0x8000 else force
        return Reading(STATES[state], signed / 100, set_point / 100, position / 1000, fault)


def _text(words: Sequence[int]) -> str:
    return b"".join(word.to_bytes(2, "big") for word in words).rstrip(b"\0 ").decode("ascii", "replace")


def _fault(reading: Reading) -> str:
    return f"fault {reading.fault}" if reading.fault else ""


class Options(BaseModel):
    """Keys of ``[actuator]`` besides ``type``."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    address: str
    """``serial:PATH?baud=115200`` or ``tcp://host:port``."""
    unit: Annotated[int, Field(ge=1, le=247)] = 1
    """Modbus unit number. [1]"""
    watchdog_ms: Annotated[int, Field(ge=100, le=5000)] = 1000
    """Time without heartbeat after which the actuator retracts."""

    @property
    def times(self) -> ActuatorTimes:
        """As the port expects them."""
        return ActuatorTimes(watchdog_s=self.watchdog_ms / 1000)


def build(options: Options, context: DeviceContext) -> Actuator:
    """Return the closed device."""
    return Actuator(line_address(options.address, context.base_dir, "a Modbus device"), options.unit, options.times)


@hookimpl
def polishd_device_types() -> list[DeviceType]:
    """Declare the type."""
    return [DeviceType("example_modbus", "actuator", Options, build)]
