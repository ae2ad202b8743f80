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
    """An open one."""
    await force_sensor.device.open()
    return force_sensor.device


async def readings(device: ForceSensor, count: int) -> list[SensedForce]:
    """The next ones."""
    found: list[SensedForce] = []
    async with asyncio.timeout(SOON_S), aclosing(device.samples()) as samples:  # type: ignore[type-var]
        async for one in samples:
            found.append(one)
            if len(found) == count:
                break
    return found


async def test_it_is_a_force_sensor(force_sensor: ForceSensorRig) -> None:
    """It has every member of ForceSensor, ``times`` among them, which is known before ``open``."""
    assert isinstance(force_sensor.device, ForceSensor)
    assert force_sensor.device.times.silence_s > 0


async def test_readings_come_one_after_the_other(opened: ForceSensor) -> None:
    """``samples`` gives readings whose times grow, none of them with a fault."""
    found = await readings(opened, 5)
    assert all(one.at_s < other.at_s for one, other in pairwise(found))
    assert not any(one.fault for one in found)


async def test_what_it_carries_is_nothing_after_a_tare(opened: ForceSensor) -> None:
    """After ``tare`` what it carries reads as nothing."""
    (before,) = await readings(opened, 1)
    assert abs(before.force_n) > 0.5
    await opened.tare()
    assert all(abs(one.force_n) < 0.2 for one in await readings(opened, 5))
    assert (await opened.status()).ready


async def test_it_may_be_asked_for_its_state_while_it_is_read(opened: ForceSensor) -> None:
    """``status`` is answered while it is read."""
    async with asyncio.TaskGroup() as group:
        samples = group.create_task(readings(opened, 20))
        for _ in range(5):
            assert (await opened.status()).safe
    assert len(samples.result()) == 20


async def test_two_tares_at_once_both_end(opened: ForceSensor) -> None:
    """Two ``tare`` at once both end, the second perhaps refused."""
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
    """``samples`` raises LinkError where the link is cut."""
    await readings(opened, 1)
    force_sensor.unplug()
    with within(force_sensor.prompt_s), pytest.raises(LinkError):
        await readings(opened, 10_000)
