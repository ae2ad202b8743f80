"""The Monitor port."""

from __future__ import annotations

import asyncio
from contextlib import aclosing

import pytest
import pytest_asyncio

from polishd.api import LinkError, Monitor, Signal
from polishd.testing.device_rig import Rig, cuts, mutes, rig_fixture
from polishd.testing.helpers import SOON_S, within

MonitorRig = Rig[Monitor]

monitor = rig_fixture("monitor")


@pytest_asyncio.fixture
async def opened(monitor: MonitorRig) -> Monitor:
    """Yield an open monitor."""
    await monitor.device.open()
    return monitor.device


async def rounds(device: Monitor, count: int) -> dict[str, list[Signal]]:
    """Return ``count`` values of each signal, by name."""
    found: dict[str, list[Signal]] = {}
    async with asyncio.timeout(SOON_S), aclosing(device.signals()) as signals:  # type: ignore[type-var]
        async for one in signals:
            if len(found.get(one.name, ())) == count:
                break
            found.setdefault(one.name, []).append(one)
    return found


async def test_it_is_a_monitor(monitor: MonitorRig) -> None:
    """It has every member of Monitor; ``times`` is known before ``open``."""
    assert isinstance(monitor.device, Monitor)
    assert monitor.device.times.silence_s > 0


async def test_all_signals_come_in_turn_with_their_values(opened: Monitor) -> None:
    """``signals`` yields all of its signals in turn, repeatedly, each with a number or a state, and a time."""
    found = await rounds(opened, 3)
    assert {len(signals) for signals in found.values()} == {3}
    kinds = {type(one.value) for signals in found.values() for one in signals}
    assert kinds >= {float, bool}, "each rig has a number and a state"
    times = sorted((one.at_s, name) for name, signals in found.items() for one in signals)
    assert [name for _, name in times] == list(found) * 3


async def test_status_works_while_signals_are_read(opened: Monitor) -> None:
    """``status`` works while signals are read."""
    async with asyncio.TaskGroup() as group:
        signals = group.create_task(rounds(opened, 3))
        status = await opened.status()
    assert status.ready
    assert all(name in status.detail for name in signals.result())


@mutes
async def test_signals_end_with_a_silent_link(monitor: MonitorRig, opened: Monitor) -> None:
    """``signals`` raises LinkError once the peer has been silent for ``times.silence_s``."""
    await rounds(opened, 1)
    monitor.silence()
    with within(monitor.prompt_s), pytest.raises(LinkError):
        await rounds(opened, 10_000)


@cuts
async def test_signals_end_with_a_cut_link(monitor: MonitorRig, opened: Monitor) -> None:
    """``signals`` raises LinkError if the link is cut."""
    await rounds(opened, 1)
    monitor.unplug()
    with within(monitor.prompt_s), pytest.raises(LinkError):
        await rounds(opened, 10_000)
