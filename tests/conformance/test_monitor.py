"""The Monitor port, over every driver and link."""

from __future__ import annotations

import asyncio
from contextlib import aclosing

import pytest

from polishd.api import LinkError, Monitor, Signal
from tests.conformance.conftest import PROMPT_S
from tests.conformance.rigs import MonitorRig
from tests.patience import SOON_S, within


@pytest.fixture
async def opened(monitor: MonitorRig) -> Monitor:
    await monitor.device.open()
    return monitor.device


async def rounds(device: Monitor, count: int) -> dict[str, list[Signal]]:
    """All signals so often, by name."""
    found: dict[str, list[Signal]] = {}
    async with asyncio.timeout(SOON_S), aclosing(device.signals()) as signals:  # type: ignore[type-var]
        async for one in signals:
            if len(found.get(one.name, ())) == count:
                break
            found.setdefault(one.name, []).append(one)
    return found


async def test_it_is_a_monitor(monitor: MonitorRig) -> None:
    assert isinstance(monitor.device, Monitor)
    assert monitor.device.times.silence_s > 0


async def test_all_signals_come_in_turn_with_their_values(opened: Monitor) -> None:
    found = await rounds(opened, 3)
    assert {len(signals) for signals in found.values()} == {3}
    kinds = {type(one.value) for signals in found.values() for one in signals}
    assert kinds >= {float, bool}, "each rig has a number and a state"
    times = sorted((one.at_s, name) for name, signals in found.items() for one in signals)
    assert [name for _, name in times] == list(found) * 3


async def test_it_may_be_asked_for_its_state_while_it_is_read(opened: Monitor) -> None:
    signals = asyncio.ensure_future(rounds(opened, 3))
    status = await opened.status()
    assert status.ready
    assert all(name in status.detail for name in await signals)


async def test_signals_end_with_a_silent_link(monitor: MonitorRig, opened: Monitor) -> None:
    await rounds(opened, 1)
    monitor.mute()
    with within(PROMPT_S), pytest.raises(LinkError):
        await rounds(opened, 10_000)


async def test_signals_end_with_a_cut_link(monitor: MonitorRig, opened: Monitor) -> None:
    await rounds(opened, 1)
    monitor.cut()
    with within(PROMPT_S), pytest.raises(LinkError):
        await rounds(opened, 10_000)
