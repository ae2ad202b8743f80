"""The Spindle port."""

from __future__ import annotations

import asyncio
import math
import time

import pytest
import pytest_asyncio

from polishd.api import DeviceRefused, LinkError, SpeedSample, Spindle
from polishd.testing.device_rig import Rig, cuts, moves, mutes, rig_fixture
from polishd.testing.helpers import failure_of, first, is_lost, seen, within

SpindleRig = Rig[Spindle]

spindle = rig_fixture("spindle")


@pytest_asyncio.fixture
async def opened(spindle: SpindleRig) -> Spindle:
    """Yield an open spindle."""
    await spindle.device.open()
    return spindle.device


async def turning(rig: SpindleRig) -> SpeedSample:
    """Return the next sample."""
    return await first(rig.device.samples(), rig.soon_s)


async def test_it_is_a_spindle(spindle: SpindleRig) -> None:
    """It has every member of Spindle; ``times`` is known before ``open``."""
    assert isinstance(spindle.device, Spindle)
    assert min(spindle.device.times.silence_s, spindle.device.times.watchdog_s, spindle.device.times.spin_s) > 0.0


@moves
async def test_it_returns_at_speed(spindle: SpindleRig, opened: Spindle) -> None:
    """``set_speed`` returns when the speed is reached within 2 %; samples show it, and the commanded speed."""
    began_s = time.monotonic()
    await opened.set_speed(spindle.scope.rpm)
    sample = await turning(spindle)
    assert sample.rpm == pytest.approx(spindle.scope.rpm, rel=0.02)
    assert sample.setpoint_rpm == pytest.approx(spindle.scope.rpm, abs=1.0)
    assert sample.fault == 0
    assert began_s < sample.at_s <= time.monotonic(), "at_s is time.monotonic() of the reading"
    assert not (await opened.status()).safe


@moves
async def test_it_changes_speed_and_direction(spindle: SpindleRig, opened: Spindle) -> None:
    """``set_speed`` of a turning spindle changes its speed; a negative one is the other direction."""
    for share in (0.5, 1.0, -0.8):
        rpm = share * spindle.scope.rpm
        await opened.set_speed(rpm)
        assert (await turning(spindle)).rpm == pytest.approx(rpm, rel=0.02)


@moves
async def test_zero_returns_when_it_stands(spindle: SpindleRig, opened: Spindle) -> None:
    """``set_speed(0)`` returns when the spindle stands still, not before."""
    await opened.set_speed(spindle.scope.rpm)
    await opened.set_speed(0.0)
    assert await spindle.rests()
    assert (await opened.status()).safe


@moves
async def test_make_safe_stops_it(spindle: SpindleRig, opened: Spindle) -> None:
    """``make_safe`` returns when the spindle stands still."""
    await opened.set_speed(spindle.scope.rpm)
    await opened.make_safe()
    assert await spindle.rests()


@moves
async def test_make_safe_after_close_stops_it(spindle: SpindleRig, opened: Spindle) -> None:
    """``make_safe`` on a closed device whose spindle turns connects and stops it."""
    await opened.set_speed(spindle.scope.rpm)
    await opened.close()
    await opened.make_safe()
    assert await spindle.rests()


@moves
@pytest.mark.parametrize("share", [1.01, -1.2, 1e6, float("nan"), float("inf")])
async def test_impossible_speeds_are_refused(spindle: SpindleRig, opened: Spindle, share: float) -> None:
    """A speed above the limit in either direction, NaN and infinity raise DeviceRefused, and nothing is sent."""
    if math.isfinite(share) and spindle.scope.most_rpm is None:
        pytest.skip("the scope gives no speed limit")
    with pytest.raises(DeviceRefused):
        await opened.set_speed(share * (spindle.scope.most_rpm or 1.0))
    assert await spindle.rests()


@moves
async def test_samples_keep_it_running(spindle: SpindleRig, opened: Spindle) -> None:
    """While samples are iterated the drive's watchdog does not run out."""
    await opened.set_speed(spindle.scope.rpm)
    until = time.monotonic() + 3.0
    sample = await first(opened.samples(), spindle.soon_s, lambda one: one.at_s > until or one.fault != 0)
    assert sample.fault == 0
    assert sample.rpm == pytest.approx(spindle.scope.rpm, rel=0.02)


@moves
async def test_without_samples_it_stops(spindle: SpindleRig, opened: Spindle) -> None:
    """If samples are not iterated, the drive stops and reports a fault; ``make_safe`` clears it if that is allowed."""
    await opened.set_speed(spindle.scope.rpm)
    if spindle.safe is None:  # a request could feed its watchdog
        await asyncio.sleep(opened.times.watchdog_s + opened.times.spin_s)
    else:
        await seen(spindle.rests, spindle.soon_s)
    assert (await first(opened.samples(), spindle.soon_s, lambda one: one.fault != 0)).rpm == pytest.approx(0.0, abs=1)
    assert not (await opened.status()).ready
    await opened.make_safe()
    if not spindle.scope.forgives:
        with pytest.raises(DeviceRefused):
            await opened.set_speed(0.5 * spindle.scope.rpm)
        return
    await first(opened.samples(), spindle.soon_s, lambda one: one.fault == 0)
    await opened.set_speed(0.5 * spindle.scope.rpm)


@moves
async def test_stopping_wins_over_speeding_up(spindle: SpindleRig, opened: Spindle) -> None:
    """``make_safe`` overtakes a ``set_speed`` under way, which raises DeviceRefused."""
    async with asyncio.TaskGroup() as group:
        speeding = group.create_task(failure_of(opened.set_speed(spindle.scope.most_rpm or spindle.scope.rpm)))
        await first(opened.samples(), spindle.soon_s, lambda one: one.rpm > 0.0)
        await opened.make_safe()
    failure = speeding.result()
    assert isinstance(failure, DeviceRefused) or (spindle.scope.most_rpm is None and failure is None)
    assert await spindle.rests()


@moves
@cuts
async def test_samples_end_with_a_cut_link(spindle: SpindleRig, opened: Spindle) -> None:
    """A link that is cut ends the samples with LinkError, within ``times.silence_s``."""
    await opened.set_speed(spindle.scope.rpm)
    await turning(spindle)
    spindle.unplug()
    with within(spindle.prompt_s), pytest.raises(LinkError):
        await first(opened.samples(), spindle.soon_s, lambda _one: False)


@moves
@mutes
async def test_set_speed_ends_with_a_silent_link(spindle: SpindleRig, opened: Spindle) -> None:
    """``set_speed`` raises LinkError within ``times.silence_s`` after the link falls silent."""
    async with asyncio.TaskGroup() as group:
        speeding = group.create_task(failure_of(opened.set_speed(spindle.scope.most_rpm or spindle.scope.rpm)))
        await first(opened.samples(), spindle.soon_s, lambda one: one.rpm > 0.0)
        spindle.silence()
        with within(spindle.prompt_s):
            failure = await speeding
    assert is_lost(failure)
