"""The ForceActuator port."""

from __future__ import annotations

import asyncio
import math
import time

import pytest
import pytest_asyncio

from polishd.api import DeviceRefused, ForceActuator, ForceSample, LinkError
from polishd.testing.device_rig import Rig, cuts, presses, rig_fixture
from polishd.testing.helpers import failure_of, first, is_lost, seen, within

ActuatorRig = Rig[ForceActuator]
ROUNDED_N = 0.02
"""Tolerance of a rounded set point."""

actuator = rig_fixture("actuator")


@pytest_asyncio.fixture
async def opened(actuator: ActuatorRig) -> ForceActuator:
    """Yield an open actuator."""
    await actuator.device.open()
    return actuator.device


async def pressing(rig: ActuatorRig, force_n: float) -> ForceSample:
    """Return the first sample in contact with that set point and a force within the band."""

    def reached(one: ForceSample) -> bool:
        near = abs(one.force_n - force_n) <= rig.scope.band * force_n + ROUNDED_N
        return one.in_contact and near and abs(one.setpoint_n - force_n) <= ROUNDED_N

    return await first(rig.device.samples(), rig.soon_s, reached)


async def sampled(rig: ActuatorRig) -> ForceSample:
    """Return the next sample."""
    return await first(rig.device.samples(), rig.soon_s)


async def test_it_is_an_actuator(actuator: ActuatorRig) -> None:
    """It has every member of ForceActuator; ``times`` is known before ``open``."""
    assert isinstance(actuator.device, ForceActuator)
    times = actuator.device.times
    assert 0.0 < times.silence_s < times.watchdog_s, "a late answer must not look like a dead controller"
    assert min(times.landing_s, times.release_s, times.retract_s, times.stroke_mm) > 0.0


@presses
async def test_it_lands_and_regulates(actuator: ActuatorRig, opened: ForceActuator) -> None:
    """``set_force`` from retracted lands, returns in contact, and samples reach that force, with their time."""
    began_s = time.monotonic()
    await opened.set_force(actuator.scope.force_n)
    assert (await sampled(actuator)).in_contact, "set_force returned before the tool was in contact"
    sample = await pressing(actuator, actuator.scope.force_n)
    assert not sample.retracted
    assert sample.fault == 0
    assert began_s < sample.at_s <= time.monotonic(), "at_s is time.monotonic() of the reading"


@presses
async def test_it_reports_the_position_of_the_tool(actuator: ActuatorRig, opened: ForceActuator) -> None:
    """``position_mm`` is 0 at rest and increases outward, in mm; always None if the device does not report it."""
    resting = await first(opened.samples(), actuator.soon_s, lambda one: one.retracted)
    await opened.set_force(min(0.8, actuator.scope.force_n))
    touching = await first(opened.samples(), actuator.soon_s, lambda one: one.in_contact)
    if resting.position_mm is None or touching.position_mm is None:
        assert resting.position_mm is touching.position_mm
        return
    assert resting.position_mm == pytest.approx(0.0, abs=0.05)
    assert 0.0 < touching.position_mm <= actuator.device.times.stroke_mm
    assert touching.position_mm == pytest.approx(actuator.scope.touch_mm or touching.position_mm)


@presses
async def test_it_changes_force_in_contact(actuator: ActuatorRig, opened: ForceActuator) -> None:
    """``set_force`` in contact changes the force and stays in contact."""
    await opened.set_force(actuator.scope.force_n)
    await opened.set_force(0.6 * actuator.scope.force_n)
    assert (await pressing(actuator, 0.6 * actuator.scope.force_n)).in_contact


@presses
async def test_no_force_stays_extended(actuator: ActuatorRig, opened: ForceActuator) -> None:
    """``set_force(0)`` in contact takes the force off and keeps the tool extended."""
    await opened.set_force(actuator.scope.force_n)
    await opened.set_force(0.0)
    sample = await first(opened.samples(), actuator.soon_s, lambda one: abs(one.force_n) < 0.1)
    assert sample.in_contact
    assert not sample.retracted


async def test_no_force_from_retracted_stays_retracted(actuator: ActuatorRig, opened: ForceActuator) -> None:
    """``set_force(0)`` on a retracted tool does not land it."""
    await opened.set_force(0.0)
    assert (await sampled(actuator)).retracted


@presses
async def test_retract_returns_when_it_is_off(actuator: ActuatorRig, opened: ForceActuator) -> None:
    """``retract`` returns when the tool is off the part, as the device reports, and may be called again."""
    await opened.set_force(actuator.scope.force_n)
    await opened.retract()
    assert await actuator.rests()
    sample = await sampled(actuator)
    assert sample.retracted
    assert sample.force_n == pytest.approx(0.0, abs=0.1)
    assert sample.setpoint_n == 0.0
    await opened.retract()
    assert (await opened.status()).safe


@presses
async def test_make_safe_in_contact(actuator: ActuatorRig, opened: ForceActuator) -> None:
    """In contact the status is not safe; ``make_safe`` takes the force off, retracts, and returns when that is done."""
    await opened.set_force(actuator.scope.force_n)
    assert not (await opened.status()).safe
    await opened.make_safe()
    assert await actuator.rests()


@presses
async def test_make_safe_after_close_in_contact(actuator: ActuatorRig, opened: ForceActuator) -> None:
    """``make_safe`` on a closed device whose tool is in contact connects, and lifts it."""
    await opened.set_force(actuator.scope.force_n)
    await opened.close()
    await opened.make_safe()
    assert await actuator.rests()


@presses
@pytest.mark.parametrize("force_n", [-1.0, 50.5, float("nan"), float("inf")])
async def test_impossible_forces_are_refused(actuator: ActuatorRig, opened: ForceActuator, force_n: float) -> None:
    """A force below 0, more than the device may exert, NaN and infinity raise DeviceRefused, and nothing is sent."""
    if 0.0 < force_n < math.inf:
        if actuator.scope.most_n is None:
            pytest.skip("the scope gives no force limit")
        force_n = 1.01 * actuator.scope.most_n
    with pytest.raises(DeviceRefused):
        await opened.set_force(force_n)
    assert (await opened.status()).safe


async def test_samples_come_at_a_steady_rate(actuator: ActuatorRig, opened: ForceActuator) -> None:
    """Samples arrive in order, at the driver's rate, each read after the one before it was taken."""
    at = []
    async for sample in opened.samples():
        at.append(sample.at_s)
        if len(at) == 11:
            break
    assert at == sorted(at)
    if actuator.scope.period_s is None:
        assert at[-1] - at[0] < 10 * opened.times.watchdog_s / 2
    else:
        assert 9 * actuator.scope.period_s < at[-1] - at[0] < 30 * actuator.scope.period_s


@presses
async def test_samples_feed_the_watchdog(actuator: ActuatorRig, opened: ForceActuator) -> None:
    """While samples are iterated the device's watchdog does not run out."""
    await opened.set_force(actuator.scope.force_n)
    until = time.monotonic() + 0.8
    sample = await first(opened.samples(), actuator.soon_s, lambda one: one.at_s > until)
    assert sample.in_contact
    assert sample.fault == 0


@presses
async def test_without_samples_it_retracts(actuator: ActuatorRig, opened: ForceActuator) -> None:
    """If samples are not iterated, the device takes the force off, lifts, says why, and refuses to press.

    ``make_safe`` clears that.
    """
    await opened.set_force(actuator.scope.force_n)
    if actuator.safe is None:  # a request could feed its watchdog
        await asyncio.sleep(opened.times.alone_s)
        assert (await sampled(actuator)).force_n == pytest.approx(0.0, abs=0.1)
    else:
        await seen(actuator.rests, actuator.soon_s)
    status = await opened.status()
    assert not status.ready
    assert status.detail, "a device that is not ready reports why"
    with pytest.raises(DeviceRefused):
        await opened.set_force(actuator.scope.force_n)
    await opened.make_safe()
    await opened.set_force(actuator.scope.force_n)
    await opened.retract()


@presses
async def test_samples_go_on_beside_everything_else(actuator: ActuatorRig, opened: ForceActuator) -> None:
    """Several callers may iterate samples during other calls, and the samples show the effect of those calls."""
    lower_n, upper_n = 0.4 * actuator.scope.force_n, 0.75 * actuator.scope.force_n
    found: list[ForceSample] = []

    async def watch() -> None:
        async for sample in opened.samples():
            found.append(sample)  # noqa: PERF401

    async with asyncio.TaskGroup() as group:
        watcher = group.create_task(watch())
        await opened.set_force(lower_n)
        await opened.set_force(upper_n)
        await pressing(actuator, upper_n)
        await opened.retract()
        await first(opened.samples(), actuator.soon_s, lambda one: one.retracted)
        watcher.cancel()
    assert any(abs(one.setpoint_n - asked) <= ROUNDED_N for one in found for asked in (lower_n, upper_n))
    assert all(sample.fault == 0 for sample in found)


@presses
async def test_retracting_wins_over_landing(actuator: ActuatorRig, opened: ForceActuator) -> None:
    """``retract`` while ``set_force`` lands overtakes it: the tool is up, and ``set_force`` raises DeviceRefused."""
    async with asyncio.TaskGroup() as group:
        landing = group.create_task(failure_of(opened.set_force(actuator.scope.force_n)))
        await first(opened.samples(), actuator.soon_s, lambda one: not one.retracted)
        await opened.retract()
    failure = landing.result()  # it may have landed just before
    assert failure is None or isinstance(failure, DeviceRefused)
    assert await actuator.rests()


@presses
@cuts
async def test_samples_end_with_a_cut_link(actuator: ActuatorRig, opened: ForceActuator) -> None:
    """A link that is cut in contact ends the samples with LinkError, within ``times.silence_s``."""
    await opened.set_force(actuator.scope.force_n)
    await sampled(actuator)
    actuator.unplug()
    with within(actuator.prompt_s):
        assert is_lost(await failure_of(first(opened.samples(), actuator.soon_s, lambda _one: False)))


@presses
@cuts
async def test_a_link_lost_in_contact_is_not_reopened(actuator: ActuatorRig, opened: ForceActuator) -> None:
    """A link that was lost in contact stays lost until ``open``; only ``retract`` and ``make_safe`` reconnect."""
    await opened.set_force(actuator.scope.force_n)
    actuator.unplug()
    for _ in range(3):
        with pytest.raises(LinkError):
            await opened.set_force(0.9 * actuator.scope.force_n)
