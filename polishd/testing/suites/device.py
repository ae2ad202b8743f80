"""Suite of all devices, independent of port, driver and link."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from polishd.api import Device, LinkError
from polishd.config.cell import PORTS
from polishd.daemon.cell.device_polling import missing_members
from polishd.testing.device_rig import Rig, cuts, mutes, rig_fixture
from polishd.testing.helpers import until_lost, within

AnyRig = Rig[Any]

any_device = rig_fixture("any_device")


async def test_it_identifies_itself(any_device: AnyRig) -> None:
    """An open device reports its vendor, model, serial number and firmware, each time the same."""
    device = any_device.device
    assert isinstance(device, Device)
    await device.open()
    identity = await device.identify()
    assert identity.vendor
    assert identity.model
    assert identity.serial
    assert identity.firmware
    assert identity == await device.identify()


async def test_it_has_all_members_of_its_port(any_device: AnyRig) -> None:
    """It has every member of its port, each of the same kind: coroutine function, async generator or property."""
    ports = [port.protocol for port in PORTS.values() if isinstance(any_device.device, port.protocol)]
    assert len(ports) == 1, f"it has the members of {len(ports)} ports, not of one"
    assert missing_members(any_device.device, ports[0]) == []


async def test_opening_changes_nothing(any_device: AnyRig) -> None:
    """Opening causes no motion and no force: a device that was at rest is ready, safe and has a state."""
    await any_device.device.open()
    status = await any_device.device.status()
    assert status.ready
    assert status.safe
    assert status.state
    assert await any_device.rests()


async def test_nothing_works_before_it_is_open(any_device: AnyRig) -> None:
    """Before ``open``, ``status`` and ``identify`` raise LinkError."""
    with pytest.raises(LinkError):
        await any_device.device.status()
    with pytest.raises(LinkError):
        await any_device.device.identify()


async def test_nothing_works_after_it_is_closed(any_device: AnyRig) -> None:
    """``close`` may be called twice; after it ``status`` raises LinkError."""
    await any_device.device.open()
    await any_device.device.close()
    await any_device.device.close()
    with pytest.raises(LinkError):
        await any_device.device.status()


async def test_it_can_be_opened_again(any_device: AnyRig) -> None:
    """``open`` reconnects an open device, and connects again after ``close``."""
    for _ in range(3):
        await any_device.device.open()
        assert (await any_device.device.status()).ready
    await any_device.device.close()
    await any_device.device.open()
    assert (await any_device.device.status()).ready


async def test_make_safe_is_allowed_at_any_time(any_device: AnyRig) -> None:
    """``make_safe`` works before ``open``, while open, twice, and after ``close``: it connects if necessary."""
    device = any_device.device
    await device.make_safe()
    await device.open()
    await device.make_safe()
    await device.make_safe()
    assert (await device.status()).safe
    await device.close()
    await device.make_safe()
    assert await any_device.rests()


async def test_make_safe_does_not_leave_it_open(any_device: AnyRig) -> None:
    """``make_safe`` on a closed device leaves it closed."""
    await any_device.device.make_safe()
    with pytest.raises(LinkError):
        await any_device.device.status()


async def test_making_safe_by_many_at_once(any_device: AnyRig) -> None:
    """Several callers may call ``make_safe`` at the same time; all return, and the device is safe."""
    await any_device.device.open()
    await asyncio.gather(*(any_device.device.make_safe() for _ in range(4)))
    assert await any_device.rests()


@cuts
async def test_a_cut_link_is_known_at_once(any_device: AnyRig) -> None:
    """A cut link raises LinkError from ``status``, within ``times.silence_s``; the driver does not reopen it."""
    await any_device.device.open()
    any_device.unplug()
    with within(any_device.prompt_s), pytest.raises(LinkError):
        await until_lost(any_device.device.status)


@mutes
async def test_a_silent_link_is_known_at_once(any_device: AnyRig) -> None:
    """A silent link raises LinkError from ``status``, within ``times.silence_s``."""
    await any_device.device.open()
    any_device.silence()
    with within(any_device.prompt_s), pytest.raises(LinkError):
        await until_lost(any_device.device.status)


@cuts
async def test_make_safe_on_a_cut_link_fails_in_bounded_time(any_device: AnyRig) -> None:
    """``make_safe`` without a connection raises LinkError in bounded time: it never returns without confirmation."""
    await any_device.device.open()
    any_device.unplug()
    with within(any_device.bound_s), pytest.raises(LinkError):
        await any_device.device.make_safe()


@mutes
async def test_make_safe_on_a_silent_link_fails_in_bounded_time(any_device: AnyRig) -> None:
    """``make_safe`` without an answer raises LinkError in bounded time: it never returns without confirmation."""
    await any_device.device.open()
    any_device.silence()
    with within(any_device.bound_s), pytest.raises(LinkError):
        await any_device.device.make_safe()


@cuts
async def test_opening_a_dead_link_fails_in_bounded_time(any_device: AnyRig) -> None:
    """``open`` of a dead link raises LinkError in bounded time; so does ``make_safe``."""
    any_device.unplug()
    with within(any_device.bound_s), pytest.raises(LinkError):
        await any_device.device.open()
    with within(any_device.bound_s), pytest.raises(LinkError):
        await any_device.device.make_safe()


@mutes
async def test_opening_a_silent_link_fails_in_bounded_time(any_device: AnyRig) -> None:
    """``open`` sends a request, and raises LinkError in bounded time without an answer."""
    any_device.silence()
    with within(any_device.bound_s), pytest.raises(LinkError):
        await any_device.device.open()


async def test_a_cancelled_call_harms_no_later_one(any_device: AnyRig) -> None:
    """The answer to a cancelled call is dropped: the next call gets its own answer."""
    device = any_device.device
    await device.open()
    for _ in range(5):
        with pytest.raises(TimeoutError):
            async with asyncio.timeout(0):
                await device.make_safe()
        assert (await device.status()).ready
    await device.make_safe()
    assert await any_device.rests()
