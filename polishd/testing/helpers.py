"""Waiting for what a machine does, and for calls that go on beside others."""

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


# Time limits that a busy machine does not break: what it keeps from this process does not count.

SOON_S = 240.0
"""For what ends at once on an idle machine: only what hangs takes longer on a busy one."""


def waits() -> dict[str, int]:
    """Nanoseconds that each thread of this process could have run and did not get a processor; only Linux tells."""
    found = {}
    for task in Path("/proc/self/task").glob("*"):
        try:
            found[task.name] = int((task / "schedstat").read_text().split()[1])
        except (OSError, IndexError):
            continue  # a thread that ended meanwhile
    return found


class OwnClock:
    """``time.monotonic`` of a machine that would be this process's own."""

    def __init__(self) -> None:
        self._last = waits()
        self._kept_s = 0.0

    def monotonic(self) -> float:
        """Seconds."""
        now_s, found = time.monotonic(), waits()
        self._kept_s += sum(waited - self._last.get(name, 0) for name, waited in found.items()) / 1e9
        self._last = found
        return now_s - self._kept_s


@contextmanager
def within(limit_s: float) -> Iterator[None]:
    """What takes longer is wrong."""
    clock = OwnClock()
    began_s = clock.monotonic()
    yield
    if (took_s := clock.monotonic() - began_s) >= limit_s:
        raise AssertionError(f"it took {took_s:.1f} s; {limit_s:g} s are allowed")


# Small plans for tests that stream them.


def plan_of(lines: Sequence[bytes], approach_blocks: int = 0) -> Plan:
    """A plan of these lines without timed points: what a robot link needs, and nothing more."""
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
