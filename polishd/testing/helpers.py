"""Waiting for conditions of a machine, and for concurrent calls."""

from __future__ import annotations

import asyncio
import hashlib
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TypeVar

import numpy as np

from polishd.api import DeviceError, LinkError, Plan, Program, Segment

T = TypeVar("T")


async def seen(condition: Callable[[], Awaitable[bool]], within_s: float) -> None:
    """Poll until the condition holds; AssertionError on timeout."""
    try:
        async with asyncio.timeout(within_s):
            while not await condition():  # noqa: ASYNC110 -- the machine sends no event
                await asyncio.sleep(0.01)
    except TimeoutError:
        raise AssertionError(f"the condition did not hold within {within_s:g} s") from None


async def first(items: AsyncIterator[T], within_s: float, where: Callable[[T], bool] = lambda _item: True) -> T:
    """Return the first matching item; AssertionError on timeout, or if the items end."""
    last: T | None = None
    try:
        async with asyncio.timeout(within_s):
            async for item in items:
                last = item
                if where(item):
                    return item
    except TimeoutError:
        raise AssertionError(f"no matching item within {within_s:g} s; the last was {last}") from None
    raise AssertionError(f"the items ended; the last was {last}")


async def failure_of(call: Awaitable[object]) -> DeviceError | None:
    """Return the error of a concurrent call, or None."""
    try:
        await call
    except DeviceError as error:
        return error
    return None


async def until_lost(ask: Callable[[], Awaitable[object]]) -> None:
    """Repeat the call until it raises LinkError, and raise that."""
    while True:
        await ask()
        await asyncio.sleep(0.01)


def is_lost(error: DeviceError | None) -> bool:
    """Whether the error reports a dead or silent link."""
    return isinstance(error, LinkError)


# Time limits for a busy computer: time in which this process waited for a processor does not count.

SOON_S = 240.0
"""Limit for calls that end at once on an idle computer; only a hanging call takes longer on a busy one."""


def waits() -> dict[str, int]:
    """Return the time that each thread of this process waited for a processor, ns; only Linux reports it."""
    found = {}
    for task in Path("/proc/self/task").glob("*"):
        try:
            found[task.name] = int((task / "schedstat").read_text().split()[1])
        except (OSError, IndexError):
            continue  # a thread that ended meanwhile
    return found


class OwnClock:
    """``time.monotonic`` without the time in which this process waited for a processor."""

    def __init__(self) -> None:
        self._last = waits()
        self._kept_s = 0.0

    def monotonic(self) -> float:
        """Return the time, s."""
        now_s, found = time.monotonic(), waits()
        self._kept_s += sum(waited - self._last.get(name, 0) for name, waited in found.items()) / 1e9
        self._last = found
        return now_s - self._kept_s


@contextmanager
def within(limit_s: float) -> Iterator[None]:
    """Raise AssertionError if the block takes longer."""
    clock = OwnClock()
    began_s = clock.monotonic()
    yield
    if (took_s := clock.monotonic() - began_s) >= limit_s:
        raise AssertionError(f"took {took_s:.1f} s; the limit is {limit_s:g} s")


# Small plans for tests that stream them.


def plan_of(lines: Sequence[bytes], approach_blocks: int = 0) -> Plan:
    """Return a minimal plan of these lines for a robot link, without timed points."""
    text = b"\n".join(lines)
    none, points = np.zeros(0, dtype=np.int64), np.zeros((0, 3))
    program = Program(
        text=text,
        sha256=hashlib.sha256(text).hexdigest(),
        name="test.rnc",
        dialect="test",
        encoding="feed",
        line=none,
        block=none,
        start_mm=points,
        end_mm=points,
        axis=points,
        time_s=np.zeros(0),
        lines=len(lines),
        max_feed_mm_min=60.0,
    )
    return Plan(
        program=program,
        approach_blocks=approach_blocks,
        contact_blocks=len(lines),
        expected_time_s=np.zeros(0),
        predicted_removal_nm=np.zeros((1, 1)),
        segments=tuple(Segment(seq, line) for seq, line in enumerate(lines)),
    )
