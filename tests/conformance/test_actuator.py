"""The ForceActuator port, over every driver and link."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable

import pytest

from polishd.api import DeviceRefused, ForceActuator, ForceSample, LinkError
from tests.conformance.conftest import PROMPT_S, seen
from tests.conformance.rigs import ActuatorRig
from tests.patience import SOON_S, within


@pytest.fixture
async def opened(actuator: ActuatorRig) -> ForceActuator:
    await actuator.device.open()
    return actuator.device


async def sample_where(device: ForceActuator, condition: Callable[[ForceSample], bool]) -> ForceSample:
    """The first sample of that kind."""
    async with asyncio.timeout(SOON_S):
        async for sample in device.samples():
            if condition(sample):
                return sample
    raise AssertionError("samples ended")


async def test_it_is_an_actuator(actuator: ActuatorRig) -> None:
    assert isinstance(actuator.device, ForceActuator)


async def test_it_lands_and_regulates(opened: ForceActuator) -> None:
    began_s = time.monotonic()
    await opened.set_force(12.0)
    sample = await sample_where(opened, lambda one: True)
    assert sample.in_contact
    assert not sample.retracted
    assert sample.force_n == pytest.approx(12.0)
    assert sample.setpoint_n == pytest.approx(12.0)
    assert sample.fault == 0
    assert began_s < sample.at_s <= time.monotonic()


async def test_it_tells_how_far_the_tool_is_out(opened: ForceActuator) -> None:
    assert (await sample_where(opened, lambda one: one.retracted)).position_mm == 0.0
    await opened.set_force(0.8)
    assert (await sample_where(opened, lambda one: one.in_contact)).position_mm == pytest.approx(5.0)


async def test_it_changes_force_in_contact(opened: ForceActuator) -> None:
    await opened.set_force(12.0)
    await opened.set_force(7.25)
    assert (await sample_where(opened, lambda one: True)).force_n == pytest.approx(7.25)


async def test_no_force_stays_extended(opened: ForceActuator) -> None:
    await opened.set_force(12.0)
    await opened.set_force(0.0)
    sample = await sample_where(opened, lambda one: True)
    assert sample.in_contact
    assert sample.force_n == 0.0


async def test_no_force_from_retracted_stays_retracted(opened: ForceActuator) -> None:
    await opened.set_force(0.0)
    assert (await sample_where(opened, lambda one: True)).retracted


async def test_retract_returns_when_it_is_off(actuator: ActuatorRig, opened: ForceActuator) -> None:
    await opened.set_force(12.0)
    await opened.retract()
    assert actuator.safe()
    sample = await sample_where(opened, lambda one: True)
    assert sample.retracted
    assert (sample.force_n, sample.setpoint_n) == (0.0, 0.0)
    await opened.retract()
    assert (await opened.status()).safe


async def test_make_safe_in_contact(actuator: ActuatorRig, opened: ForceActuator) -> None:
    await opened.set_force(12.0)
    assert not (await opened.status()).safe
    await opened.make_safe()
    assert actuator.safe()


async def test_make_safe_after_close_in_contact(actuator: ActuatorRig, opened: ForceActuator) -> None:
    await opened.set_force(12.0)
    await opened.close()
    await opened.make_safe()
    assert actuator.safe()


@pytest.mark.one_of_each("force_n")
@pytest.mark.parametrize("force_n", [-1.0, 50.5, float("nan"), float("inf")])
async def test_impossible_forces_are_refused(opened: ForceActuator, force_n: float) -> None:
    with pytest.raises(DeviceRefused):
        await opened.set_force(force_n)
    assert (await opened.status()).safe


async def test_samples_come_at_a_steady_rate(opened: ForceActuator) -> None:
    at = []
    async for sample in opened.samples():
        at.append(sample.at_s)
        if len(at) == 11:
            break
    assert at == sorted(at)
    assert 0.45 < at[-1] - at[0] < 1.5


@pytest.mark.full
async def test_samples_feed_the_watchdog(opened: ForceActuator) -> None:
    await opened.set_force(12.0)
    until = time.monotonic() + 0.8
    sample = await sample_where(opened, lambda one: one.at_s > until)
    assert sample.in_contact
    assert sample.fault == 0


@pytest.mark.one_of_each
async def test_without_samples_it_retracts_by_itself(actuator: ActuatorRig, opened: ForceActuator) -> None:
    await opened.set_force(12.0)
    await seen(actuator.safe)
    assert actuator.safe()
    status = await opened.status()
    assert not status.ready
    assert status.detail.startswith("watchdog ran out")
    with pytest.raises(DeviceRefused):
        await opened.set_force(12.0)
    await opened.make_safe()
    await opened.set_force(12.0)
    await opened.retract()


async def test_samples_go_on_beside_everything_else(opened: ForceActuator) -> None:
    seen: list[ForceSample] = []

    async def watch() -> None:
        async for sample in opened.samples():
            seen.append(sample)  # noqa: PERF401

    watcher = asyncio.create_task(watch())
    await opened.set_force(5.0)
    await opened.set_force(9.0)
    await sample_where(opened, lambda one: one.force_n == 9.0)
    await opened.retract()
    await sample_where(opened, lambda one: one.retracted)
    watcher.cancel()
    await asyncio.wait({watcher})
    assert {5.0, 9.0} & {sample.setpoint_n for sample in seen}
    assert all(sample.fault == 0 for sample in seen)


async def test_retracting_wins_over_landing(actuator: ActuatorRig, opened: ForceActuator) -> None:
    landing = asyncio.create_task(opened.set_force(12.0))
    await sample_where(opened, lambda one: not one.retracted)
    await opened.retract()
    await asyncio.wait({landing})  # it may have landed just before
    assert landing.exception() is None or isinstance(landing.exception(), DeviceRefused)
    assert actuator.safe()


async def test_samples_end_with_a_cut_link(actuator: ActuatorRig, opened: ForceActuator) -> None:
    await opened.set_force(12.0)
    with within(PROMPT_S), pytest.raises(LinkError):
        await sample_where(opened, lambda one: bool(actuator.cut()))


async def test_a_link_lost_in_contact_is_not_taken_up_again(actuator: ActuatorRig, opened: ForceActuator) -> None:
    await opened.set_force(12.0)
    actuator.cut()
    for _ in range(3):
        with pytest.raises(LinkError):
            await opened.set_force(13.0)
