"""Waiting for what a machine does, and for calls that go on beside others."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable
from typing import TypeVar

from polishd.api import DeviceError, LinkError

T = TypeVar("T")


async def seen(condition: Callable[[], Awaitable[bool]], within_s: float) -> None:
    """Look until it is so; AssertionError where it does not come to that in time."""
    try:
        async with asyncio.timeout(within_s):
            while not await condition():  # noqa: ASYNC110 -- the machine tells nobody
                await asyncio.sleep(0.01)
    except TimeoutError:
        raise AssertionError(f"it did not come to that within {within_s:g} s") from None


async def first(items: AsyncIterator[T], within_s: float, where: Callable[[T], bool] = lambda _item: True) -> T:
    """The first of that kind; AssertionError where none comes in time, or they end."""
    last: T | None = None
    try:
        async with asyncio.timeout(within_s):
            async for item in items:
                last = item
                if where(item):
                    return item
    except TimeoutError:
        raise AssertionError(f"no such one came within {within_s:g} s; the last was {last}") from None
    raise AssertionError(f"they ended; the last was {last}")


async def failure_of(call: Awaitable[object]) -> DeviceError | None:
    """What it failed with; for calls that go on beside others."""
    try:
        await call
    except DeviceError as error:
        return error
    return None


async def until_lost(ask: Callable[[], Awaitable[object]]) -> None:
    """Ask again and again; LinkError as soon as that fails so."""
    while True:
        await ask()
        await asyncio.sleep(0.01)


def is_lost(error: DeviceError | None) -> bool:
    """The link is dead or silent, says the call."""
    return isinstance(error, LinkError)
