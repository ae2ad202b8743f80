"""What all devices have in common, whatever the port, the driver and the link."""

from __future__ import annotations

import asyncio

import pytest

from polishd.api import Device, ForceActuator, ForceSensor, LinkError, Loader, Monitor, Robot, Spindle
from polishd.config.cell import PORTS
from polishd.daemon.port_checks import lacking
from tests.conformance.conftest import BOUND_S, PROMPT_S
from tests.conformance.rigs import Rig
from tests.patience import within

AnyRig = Rig[Robot] | Rig[ForceActuator] | Rig[Spindle] | Rig[Loader] | Rig[ForceSensor] | Rig[Monitor]


async def watch(device: Device) -> None:
    """Ask for its status until that fails."""
    while True:
        await device.status()
        await asyncio.sleep(0.01)


async def test_it_says_who_it_is(any_device: AnyRig) -> None:
    device = any_device.device
    assert isinstance(device, Device)
    await device.open()
    identity = await device.identify()
    assert identity.vendor
    assert identity.model
    assert identity.serial
    assert identity.firmware
    assert identity == await device.identify()


async def test_it_has_all_that_its_port_asks(any_device: AnyRig) -> None:
    (port,) = (port.protocol for port in PORTS.values() if isinstance(any_device.device, port.protocol))
    assert lacking(any_device.device, port) == []


async def test_opening_changes_nothing(any_device: AnyRig) -> None:
    await any_device.device.open()
    status = await any_device.device.status()
    assert status.ready
    assert status.safe
    assert status.state
    assert any_device.safe()


async def test_nothing_works_before_it_is_open(any_device: AnyRig) -> None:
    with pytest.raises(LinkError):
        await any_device.device.status()
    with pytest.raises(LinkError):
        await any_device.device.identify()


async def test_nothing_works_after_it_is_closed(any_device: AnyRig) -> None:
    await any_device.device.open()
    await any_device.device.close()
    await any_device.device.close()
    with pytest.raises(LinkError):
        await any_device.device.status()


async def test_it_can_be_opened_again(any_device: AnyRig) -> None:
    for _ in range(3):
        await any_device.device.open()
        assert (await any_device.device.status()).ready
    await any_device.device.close()
    await any_device.device.open()
    assert (await any_device.device.status()).ready


async def test_make_safe_is_allowed_at_any_time(any_device: AnyRig) -> None:
    device = any_device.device
    await device.make_safe()
    await device.open()
    await device.make_safe()
    await device.make_safe()
    assert (await device.status()).safe
    await device.close()
    await device.make_safe()
    assert any_device.safe()


async def test_make_safe_does_not_leave_it_open(any_device: AnyRig) -> None:
    await any_device.device.make_safe()
    with pytest.raises(LinkError):
        await any_device.device.status()


async def test_making_safe_by_many_at_once(any_device: AnyRig) -> None:
    await any_device.device.open()
    await asyncio.gather(*(any_device.device.make_safe() for _ in range(4)))
    assert any_device.safe()


async def test_a_cut_link_is_known_at_once(any_device: AnyRig) -> None:
    await any_device.device.open()
    any_device.cut()
    with within(PROMPT_S), pytest.raises(LinkError):
        await watch(any_device.device)


@pytest.mark.one_of_each
async def test_a_silent_link_is_known_at_once(any_device: AnyRig) -> None:
    await any_device.device.open()
    any_device.mute()
    with within(PROMPT_S), pytest.raises(LinkError):
        await watch(any_device.device)


async def test_make_safe_on_a_cut_link_says_so_in_bounded_time(any_device: AnyRig) -> None:
    await any_device.device.open()
    any_device.cut()
    with within(BOUND_S), pytest.raises(LinkError):
        await any_device.device.make_safe()


@pytest.mark.one_of_each
async def test_make_safe_on_a_silent_link_says_so_in_bounded_time(any_device: AnyRig) -> None:
    await any_device.device.open()
    any_device.mute()
    with within(BOUND_S), pytest.raises(LinkError):
        await any_device.device.make_safe()


async def test_opening_a_dead_link_says_so_in_bounded_time(any_device: AnyRig) -> None:
    any_device.cut()
    with within(BOUND_S), pytest.raises(LinkError):
        await any_device.device.open()
    with within(BOUND_S), pytest.raises(LinkError):
        await any_device.device.make_safe()


@pytest.mark.one_of_each
async def test_opening_a_silent_link_says_so_in_bounded_time(any_device: AnyRig) -> None:
    any_device.mute()
    with within(BOUND_S), pytest.raises(LinkError):
        await any_device.device.open()


async def test_a_cancelled_call_harms_no_later_one(any_device: AnyRig) -> None:
    device = any_device.device
    await device.open()
    for _ in range(5):
        with pytest.raises(TimeoutError):
            async with asyncio.timeout(0):
                await device.make_safe()
        assert (await device.status()).ready
    await device.make_safe()
    assert any_device.safe()
