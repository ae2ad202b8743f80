"""What the amplifier's answers mean. Raises ProtocolError on what the protocol does not have."""

from __future__ import annotations

import asyncio
import re
import time
from collections.abc import AsyncIterator
from dataclasses import dataclass
from enum import IntEnum
from typing import Annotated

from pydantic import Field

from polishd.api import (
    DeviceContext,
    DeviceFault,
    DeviceStatus,
    DeviceType,
    ForceSensor,
    ProtocolError,
    SensedForce,
    SensorTimes,
)
from polishd.config.fields import ConfigSection
from polishd.drivers.transport.address import SerialLine, Tcp, line_address
from polishd.drivers.transport.background import PeriodicTimer
from polishd.drivers.transport.lines import ReadOnlyLineDevice

FAULTS = {1: "over its range", 2: "no cell connected", 4: "its converter fails"}
_FORCE = re.compile(r"F,([0-2]),(\d{1,5}),([+-]\d{1,5}\.\d{1,4}),(\d{1,5})", re.ASCII)


class ForceSensorState(IntEnum):
    """The amplifier's states, as the wire numbers them."""

    MEASURING = 0
    TARING = 1
    """What it reads meanwhile says nothing."""
    FAULT = 2


@dataclass(frozen=True, slots=True)
class ForceSensorLineReading:
    """What the amplifier says."""

    state: ForceSensorState
    count: int
    """Of its conversions, modulo 65536: the same again is no new reading."""
    force_n: float
    fault: int

    @property
    def faults(self) -> str:
        """Fault bits in words."""
        return ", ".join(text for bit, text in FAULTS.items() if self.fault & bit)


def force(body: str) -> ForceSensorLineReading:
    """The answer to ``F?``."""
    match = _FORCE.fullmatch(body)
    if match is None:
        raise ProtocolError(f"no answer to F?: {body!r}")
    state, count, force_n, fault = match.groups()
    return ForceSensorLineReading(ForceSensorState(int(state)), int(count), float(force_n), int(fault))


# A ForceSensor on numbered lines: asked for its last conversion as often as it makes one.

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
        return force(await self.ask("F?"))


# The independent force sensor: the device type ``force_sensor_line``.

_TIMES = SensorTimes()


class ForceSensorLineOptions(ConfigSection):
    """Keys of ``[force_sensor]`` with ``type = "force_sensor_line"``."""

    address: str
    """``serial:PATH?baud=115200`` or ``tcp://host:port``."""
    silence_s: Annotated[float, Field(ge=0.15, le=5.0)] = _TIMES.silence_s
    """No new reading for so long: contact is left, as over a silent actuator."""
    delay_s: Annotated[float, Field(ge=0.0, le=5.0)] = _TIMES.delay_s
    """Longest from a force that acts to its reading: the amplifier's filter, and the link."""
    tare_s: Annotated[float, Field(gt=0.0, le=60.0)] = _TIMES.tare_s
    """Longest from the order until what it read then is 0."""


def _build(options: ForceSensorLineOptions, context: DeviceContext) -> ForceSensor:
    address = line_address(options.address, context.base_dir, "a force sensor")
    return ForceSensorLine(address, SensorTimes(options.silence_s, options.delay_s, options.tare_s))


DEVICE_TYPES = [
    DeviceType(
        "force_sensor_line", "force_sensor", ForceSensorLineOptions, _build, simulated_by="force_sensor", substitute={}
    )
]
