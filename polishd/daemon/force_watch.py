"""The independent force sensor in contact: tared before, watched meanwhile, and asked once more where both disagreed.

A cell without one has nothing to do here.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import AsyncIterator
from contextlib import aclosing
from typing import TypeVar

from polishd.daemon.cell import Cell
from polishd.daemon.force_check import ForceCheck, verdict
from polishd.daemon.listening import read_samples
from polishd.daemon.time_limits import ANSWERS_S
from polishd.daemon.touch import ContactRecord
from polishd.model.devices import SensedForce
from polishd.model.errors import DeviceFault, ForcesApart, LinkError, SafetyStop

T = TypeVar("T")

log = logging.getLogger(__name__)


async def tare(cell: Cell, band_n: float) -> None:
    """Nothing touches: what the sensor reads is 0. DeviceFault where that has moved by more than ``band_n`` since."""
    sensor, name = cell.force_sensor, cell.used.get("force_sensor", "")
    if sensor is None:
        return
    try:
        async with asyncio.timeout(sensor.times.tare_s + ANSWERS_S):
            reading = await _next(sensor.samples())
            _require_sound(reading)
            if name in cell.tared and not abs(reading.force_n) <= band_n:
                raise DeviceFault(
                    f"{name}: reads {reading.force_n:.2f} N with the tool up, and was 0 there before the last contact; "
                    f"at most {band_n:g} N (force_sensor.band_n): look at the sensor, its cable and what hangs on it"
                )
            await sensor.tare()
    except TimeoutError:
        raise LinkError(f"{name}: was not tared within {sensor.times.tare_s + ANSWERS_S:g} s") from None
    cell.hears(name)
    cell.tared.add(name)


async def watch_sensor(cell: Cell, forces: ForceCheck, touch: ContactRecord, landed: asyncio.Event) -> None:
    """Judge each of its readings, until that raises; a silence is a fault."""
    sensor = cell.force_sensor
    if sensor is None:
        return

    def judge(reading: SensedForce) -> None:
        cell.hears(cell.used["force_sensor"])
        cell.live.sensed = reading
        touch.sensed(reading)
        _require_sound(reading)
        if not touch.left:
            forces.sensor(reading.at_s, reading.force_n, landed=landed.is_set())

    await read_samples(sensor.samples(), judge, "force sensor", sensor.times.silence_s)


async def watch_force_signals(cell: Cell, forces: ForceCheck, touch: ContactRecord) -> None:
    """Judge each value of the monitors' signals that measure the force, until that raises."""
    broken: asyncio.Future[None] = asyncio.get_running_loop().create_future()

    def judge(name: str, force_n: float) -> None:
        if touch.left or broken.done():
            return
        try:
            forces.monitor(name, cell.clock.now_s(), force_n)
        except SafetyStop as stop:
            broken.set_exception(stop)

    cell.signals.on_force = judge
    try:
        await broken
    finally:
        cell.signals.on_force = lambda _name, _force_n: None


async def diagnose_force_disagreement(cell: Cell, error: BaseException, band_n: float) -> BaseException:
    """The error; where two forces disagreed, and the tool is up since, with what both read there."""
    sensor = cell.force_sensor
    if not isinstance(error, ForcesApart) or sensor is None or cell.unsafe:
        return error
    try:
        async with asyncio.timeout(sensor.times.delay_s + ANSWERS_S):
            await asyncio.sleep(sensor.times.delay_s)  # what it reads now may be from before the lift
            told, sensed = await _next(cell.actuator.samples()), await _next(sensor.samples())
    except Exception as late:  # noqa: BLE001 - a plugin may raise anything: what ended contact is told all the same
        log.warning("actuator and force sensor are not both asked again: %s", late)
        return error
    return ForcesApart(f"{error}; {verdict(told.force_n, sensed.force_n, band_n)}")


def _require_sound(reading: SensedForce) -> None:
    if reading.fault:
        raise DeviceFault(f"force sensor: fault bits {reading.fault:#06x}; look at it and at its cable")


async def _next(samples: AsyncIterator[T]) -> T:
    async with aclosing(samples) as readings:  # type: ignore[type-var]
        async for reading in readings:
            return reading
    raise LinkError("its samples ended")
