"""The Loader port."""

from __future__ import annotations

import asyncio

import pytest
import pytest_asyncio

from polishd.api import DeviceRefused, PartLoader, WrongPart
from polishd.testing.device_rig import Rig, moves, mutes, rig_fixture
from polishd.testing.helpers import failure_of, is_lost, within

LoaderRig = Rig[PartLoader]

loader = rig_fixture("loader")


@pytest_asyncio.fixture
async def opened(loader: LoaderRig) -> PartLoader:
    """Yield an open loader."""
    await loader.device.open()
    return loader.device


async def moving(rig: LoaderRig) -> None:
    """Wait until the loader moves; TimeoutError if its status stays safe for too long."""
    async with asyncio.timeout(rig.soon_s):
        while (await rig.device.status()).safe:  # noqa: ASYNC110 -- the machine sends no event
            await asyncio.sleep(0)


async def test_it_is_a_loader(loader: LoaderRig) -> None:
    """It has every member of PartLoader; ``times`` is known before ``open``."""
    assert isinstance(loader.device, PartLoader)
    assert min(loader.device.times.silence_s, loader.device.times.change_s, loader.device.times.stop_s) > 0.0


@moves
async def test_parts_are_changed(loader: LoaderRig, opened: PartLoader) -> None:
    """``load`` and ``unload`` return when the loader is clear of the cell; ``loaded`` returns the part on the seat."""
    assert await opened.loaded() is None
    for part in loader.scope.parts:
        await opened.load(part)
        assert await loader.rests()
        assert await opened.loaded() == part
        await opened.unload()
        assert await opened.loaded() is None


@moves
async def test_an_empty_seat_is_unloaded_already(opened: PartLoader) -> None:
    """``unload`` of an empty seat is no error."""
    await opened.unload()
    assert await opened.loaded() is None


@moves
async def test_a_part_that_is_there_stays(loader: LoaderRig, opened: PartLoader) -> None:
    """``load`` of the part that is on the seat leaves it there."""
    other = loader.scope.parts[1]
    for _ in range(2):
        await opened.load(other)
        assert await opened.loaded() == other


@moves
async def test_a_missing_part_is_the_wrong_part(loader: LoaderRig, opened: PartLoader) -> None:
    """``load`` of a missing part raises WrongPart, which names the part; the seat stays empty."""
    with pytest.raises(WrongPart) as wrong:
        await opened.load(loader.scope.no_part)
    assert loader.scope.no_part in str(wrong.value)
    assert await opened.loaded() is None


@moves
async def test_two_parts_never_come_onto_one_seat(loader: LoaderRig, opened: PartLoader) -> None:
    """``load`` while another part is on the seat raises DeviceRefused, and that part stays."""
    part, other = loader.scope.parts
    await opened.load(part)
    with pytest.raises(DeviceRefused):
        await opened.load(other)
    assert await opened.loaded() == part


@moves
async def test_it_is_not_safe_while_it_moves(loader: LoaderRig, opened: PartLoader) -> None:
    """During a change a concurrent ``status`` is not safe; afterwards it is."""
    async with asyncio.TaskGroup() as group:
        loading = group.create_task(opened.load(loader.scope.parts[0]))
        await moving(loader)
        await loading
    assert (await opened.status()).safe


@moves
async def test_make_safe_stops_it_and_load_continues(loader: LoaderRig, opened: PartLoader) -> None:
    """``make_safe`` stops it, and the call under way raises DeviceRefused; ``load`` continues from there."""
    part = loader.scope.parts[0]
    async with asyncio.TaskGroup() as group:
        loading = group.create_task(failure_of(opened.load(part)))
        await moving(loader)
        await opened.make_safe()
        assert await loader.rests()
    assert isinstance(loading.result(), DeviceRefused)
    assert (await opened.status()).safe
    await opened.load(part)
    assert await opened.loaded() == part


@moves
@mutes
async def test_a_change_ends_with_a_silent_link(loader: LoaderRig, opened: PartLoader) -> None:
    """A change raises LinkError within ``times.silence_s`` after the link falls silent."""
    async with asyncio.TaskGroup() as group:
        loading = group.create_task(failure_of(opened.load(loader.scope.parts[0])))
        await moving(loader)
        loader.silence()
        with within(loader.prompt_s):
            failure = await loading
    assert is_lost(failure)
