"""The Spindle port, over every driver and link."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable

import pytest

from polishd.api import DeviceRefused, LinkError, SpeedSample, Spindle
from tests.conformance.conftest import PROMPT_S, seen
from tests.conformance.rigs import SpindleRig
from tests.patience import SOON_S, within


@pytest.fixture
async def opened(spindle: SpindleRig) -> Spindle:
    await spindle.device.open()
    return spindle.device


async def sample_where(device: Spindle, condition: Callable[[SpeedSample], bool]) -> SpeedSample:
    """The first sample of that kind."""
    async with asyncio.timeout(SOON_S):
        async for sample in device.samples():
            if condition(sample):
                return sample
    raise AssertionError("samples ended")


async def test_it_is_a_spindle(spindle: SpindleRig) -> None:
    assert isinstance(spindle.device, Spindle)


async def test_it_returns_at_speed(opened: Spindle) -> None:
    began_s = time.monotonic()
    await opened.set_speed(1000.0)
    sample = await sample_where(opened, lambda one: True)
    assert sample.rpm == pytest.approx(1000.0, rel=0.02)
    assert sample.setpoint_rpm == 1000.0
    assert sample.fault == 0
    assert began_s < sample.at_s <= time.monotonic()
    assert (await opened.status()).state == "at_speed"


async def test_it_changes_speed_and_direction(opened: Spindle) -> None:
    for rpm in (500.0, 1500.0, -800.0):
        await opened.set_speed(rpm)
        assert (await sample_where(opened, lambda one: True)).rpm == pytest.approx(rpm, rel=0.02)


async def test_zero_returns_when_it_stands(spindle: SpindleRig, opened: Spindle) -> None:
    await opened.set_speed(1000.0)
    assert not (await opened.status()).safe
    await opened.set_speed(0.0)
    assert spindle.safe()
    assert (await opened.status()).safe


async def test_make_safe_stops_it(spindle: SpindleRig, opened: Spindle) -> None:
    await opened.set_speed(1000.0)
    await opened.make_safe()
    assert spindle.safe()


async def test_make_safe_after_close_stops_it(spindle: SpindleRig, opened: Spindle) -> None:
    await opened.set_speed(1000.0)
    await opened.close()
    await opened.make_safe()
    assert spindle.safe()


@pytest.mark.parametrize("rpm", [6001.0, -7000.0, 1e9, float("nan")])
async def test_impossible_speeds_are_refused(spindle: SpindleRig, opened: Spindle, rpm: float) -> None:
    with pytest.raises(DeviceRefused):
        await opened.set_speed(rpm)
    assert spindle.safe()


@pytest.mark.full
async def test_samples_keep_it_running(opened: Spindle) -> None:
    await opened.set_speed(1000.0)
    until = time.monotonic() + 3.0
    sample = await sample_where(opened, lambda one: one.at_s > until or one.fault != 0)
    assert sample.fault == 0
    assert sample.rpm == pytest.approx(1000.0, rel=0.02)


async def test_it_stops_by_itself_when_nobody_cares(spindle: SpindleRig, opened: Spindle) -> None:
    await opened.set_speed(1000.0)
    await seen(spindle.safe)
    await sample_where(opened, lambda one: one.fault != 0)
    status = await opened.status()
    assert not status.ready
    assert status.detail
    await opened.make_safe()
    if not spindle.forgives:
        with pytest.raises(DeviceRefused, match="fault"):
            await opened.set_speed(500.0)
        return
    await sample_where(opened, lambda one: one.fault == 0)
    await opened.set_speed(500.0)


async def test_stopping_wins_over_speeding_up(spindle: SpindleRig, opened: Spindle) -> None:
    speeding = asyncio.create_task(opened.set_speed(6000.0))
    await sample_where(opened, lambda one: one.rpm > 0.0)
    await opened.make_safe()
    with pytest.raises(DeviceRefused, match="on the way"):
        await speeding
    assert spindle.safe()


async def test_samples_end_with_a_cut_link(spindle: SpindleRig, opened: Spindle) -> None:
    await opened.set_speed(1000.0)
    with within(PROMPT_S), pytest.raises(LinkError):
        await sample_where(opened, lambda one: bool(spindle.cut()))


async def test_set_speed_ends_with_a_silent_link(spindle: SpindleRig, opened: Spindle) -> None:
    speeding = asyncio.create_task(opened.set_speed(6000.0))
    await sample_where(opened, lambda one: one.rpm > 0.0)
    spindle.mute()
    with within(PROMPT_S), pytest.raises(LinkError):
        await speeding
