"""The Loader port, over every driver and link."""

from __future__ import annotations

import asyncio

import pytest

from polishd.api import DeviceRefused, LinkError, Loader, WrongPart
from tests.conformance.conftest import PROMPT_S
from tests.conformance.rigs import LoaderRig
from tests.patience import within

PART, OTHER = "P-1", "lens 7"
"""Both are in the magazine of every rig; the seat is empty at first."""


@pytest.fixture
async def opened(loader: LoaderRig) -> Loader:
    await loader.device.open()
    return loader.device


async def moving(device: Loader) -> None:
    """Returns while it moves."""
    while (await device.status()).safe:  # noqa: ASYNC110 -- the machine tells nobody
        await asyncio.sleep(0)


async def test_it_is_a_loader(loader: LoaderRig) -> None:
    assert isinstance(loader.device, Loader)


async def test_parts_are_changed(loader: LoaderRig, opened: Loader) -> None:
    assert await opened.loaded() is None
    for part in (PART, OTHER):
        await opened.load(part)
        assert loader.safe()
        assert await opened.loaded() == part
        await opened.unload()
        assert await opened.loaded() is None


async def test_an_empty_seat_is_unloaded_already(opened: Loader) -> None:
    await opened.unload()
    assert await opened.loaded() is None


async def test_a_part_that_is_there_stays(opened: Loader) -> None:
    for _ in range(2):
        await opened.load(OTHER)
        assert await opened.loaded() == OTHER


async def test_a_part_that_it_has_not_is_the_wrong_part(opened: Loader) -> None:
    with pytest.raises(WrongPart, match="has no part 'P-2'"):
        await opened.load("P-2")
    assert await opened.loaded() is None


async def test_two_parts_never_come_onto_one_seat(opened: Loader) -> None:
    await opened.load(PART)
    with pytest.raises(DeviceRefused, match="occupied"):
        await opened.load(OTHER)
    assert await opened.loaded() == PART


async def test_it_is_not_safe_while_it_moves(opened: Loader) -> None:
    loading = asyncio.create_task(opened.load(PART))
    await moving(opened)
    await loading
    assert (await opened.status()).safe


async def test_make_safe_stops_it_and_it_goes_on_from_there(loader: LoaderRig, opened: Loader) -> None:
    loading = asyncio.create_task(opened.load(PART))
    await moving(opened)
    await opened.make_safe()
    assert loader.safe()
    with pytest.raises(DeviceRefused, match="was stopped"):
        await loading
    assert (await opened.status()).state == "stopped"
    await opened.load(PART)
    assert await opened.loaded() == PART


async def test_a_change_ends_with_a_silent_link(loader: LoaderRig, opened: Loader) -> None:
    loading = asyncio.create_task(opened.load(PART))
    await moving(opened)
    loader.mute()
    with within(PROMPT_S), pytest.raises(LinkError):
        await loading
