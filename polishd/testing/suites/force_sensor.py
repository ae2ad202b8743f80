"""The ForceSensor port."""

from __future__ import annotations

import asyncio
from contextlib import aclosing
from itertools import pairwise

import pytest
import pytest_asyncio

from polishd.api import DeviceRefused, ForceSensor, LinkError, SensedForce
from polishd.testing.device_rig import Rig, cuts, mutes, rig_fixture
from polishd.testing.helpers import SOON_S, within

ForceSensorRig = Rig[ForceSensor]

force_sensor = rig_fixture("force_sensor")


@pytest_asyncio.fixture
async def opened(force_sensor: ForceSensorRig) -> ForceSensor:
    """Yield an open force sensor."""
    await force_sensor.device.open()
    return force_sensor.device


async def readings(device: ForceSensor, count: int) -> list[SensedForce]:
    """Return the next readings."""
    found: list[SensedForce] = []
    async with asyncio.timeout(SOON_S), aclosing(device.samples()) as samples:  # type: ignore[type-var]
        async for one in samples:
            found.append(one)
            if len(found) == count:
                break
    return found


async def test_it_is_a_force_sensor(force_sensor: ForceSensorRig) -> None:
    """It has every member of ForceSensor; ``times`` is known before ``open``."""
    assert isinstance(force_sensor.device, ForceSensor)
    assert force_sensor.device.times.silence_s > 0


async def test_readings_come_one_after_the_other(opened: ForceSensor) -> None:
    """``samples`` yields readings with increasing times and no fault."""
    found = await readings(opened, 5)
    assert all(one.at_s < other.at_s for one, other in pairwise(found))
    assert not any(one.fault for one in found)


async def test_the_reading_is_zero_after_a_tare(opened: ForceSensor) -> None:
    """After ``tare`` the present load reads 0."""
    (before,) = await readings(opened, 1)
    assert abs(before.force_n) > 0.5
    await opened.tare()
    assert all(abs(one.force_n) < 0.2 for one in await readings(opened, 5))
    assert (await opened.status()).ready


async def test_status_works_while_samples_are_read(opened: ForceSensor) -> None:
    """``status`` works while samples are read."""
    async with asyncio.TaskGroup() as group:
        samples = group.create_task(readings(opened, 20))
        for _ in range(5):
            assert (await opened.status()).safe
    assert len(samples.result()) == 20


async def test_two_tares_at_once_both_end(opened: ForceSensor) -> None:
    """Two concurrent ``tare`` calls both end; the second may be refused."""
    both = await asyncio.gather(opened.tare(), opened.tare(), return_exceptions=True)
    assert [one for one in both if one is not None and not isinstance(one, DeviceRefused)] == []
    assert all(abs(one.force_n) < 0.2 for one in await readings(opened, 3))


@mutes
async def test_readings_end_with_a_silent_link(force_sensor: ForceSensorRig, opened: ForceSensor) -> None:
    """``samples`` and ``tare`` raise LinkError once the peer has been silent for ``times.silence_s``."""
    await readings(opened, 1)
    force_sensor.silence()
    with within(force_sensor.prompt_s), pytest.raises(LinkError):
        await readings(opened, 10_000)
    with within(force_sensor.prompt_s), pytest.raises(LinkError):
        await opened.tare()


@cuts
async def test_readings_end_with_a_cut_link(force_sensor: ForceSensorRig, opened: ForceSensor) -> None:
    """``samples`` raises LinkError if the link is cut."""
    await readings(opened, 1)
    force_sensor.unplug()
    with within(force_sensor.prompt_s), pytest.raises(LinkError):
        await readings(opened, 10_000)
