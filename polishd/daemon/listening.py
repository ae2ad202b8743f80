"""Hearing a device for as long as contact lasts, and no longer than it may take: nothing that it does holds up others.

In contact each sample is judged as it comes, and silence is counted.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import time
from collections.abc import AsyncIterator, Callable, Coroutine
from typing import Any, TypeVar

from polishd.daemon.memory import is_out_of_memory, named
from polishd.model.errors import LinkError, PolishdError, SafetyStop

T = TypeVar("T")

log = logging.getLogger(__name__)

LET_GO_S = 1.0
"""What is cancelled may tidy up for so long."""
LOOK_S = 0.05
"""Between two looks at a silence: it is counted in steps, so that a daemon that was stalled hears first."""


async def with_deadline(seconds: float, work: Coroutine[Any, Any, T]) -> T:
    """What the work returns or raises; TimeoutError where that takes longer.

    It is cancelled then, and left behind where it does not end over that: whoever waits is never held up for more than
    ``LET_GO_S`` beyond.
    """
    task = asyncio.ensure_future(work)
    try:
        async with asyncio.timeout(seconds):
            return await asyncio.shield(task)
    finally:
        if not task.done():
            task.cancel()
            await asyncio.wait({task}, timeout=LET_GO_S)
            if not task.done():
                log.error("%s does not end though it was cancelled, and is left behind", work)


async def read_samples(samples: AsyncIterator[T], judge: Callable[[T], None], name: str, silence_s: float) -> None:
    """Have each sample judged as it comes, until that raises; LinkError after that much silence, or at their end.

    Time in which this process itself did not run is no silence of the device: it is counted in small steps.
    """
    news = asyncio.Event()

    async def listen() -> None:
        async for sample in samples:
            news.set()
            judge(sample)
        raise LinkError(f"{name}: its samples ended while in contact")

    async def count_silence() -> None:
        silent_s = 0.0
        while silent_s < silence_s:
            looked_s = time.monotonic()
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(min(LOOK_S, silence_s)):
                    await news.wait()
            silent_s = 0.0 if news.is_set() else silent_s + min(time.monotonic() - looked_s, 2 * LOOK_S)
            news.clear()
        raise LinkError(f"{name}: no sample for {silence_s:g} s while in contact")

    try:
        async with asyncio.TaskGroup() as group:
            group.create_task(listen(), name=f"listen to {name}")
            group.create_task(count_silence(), name=f"count silence of {name}")
    except BaseExceptionGroup as errors:
        raise root_cause(errors) from errors


def root_cause(errors: BaseExceptionGroup[BaseException]) -> BaseException:
    """The one error of a group that says what to do: ours before others, others before cancellation.

    Before all of them that memory is out, in words: the others follow from it.
    """
    memory, _ = errors.split(lambda one: not isinstance(one, BaseExceptionGroup) and is_out_of_memory(one))
    if memory is not None and isinstance(first := _first(memory), Exception):
        return named(first)
    for kind in (SafetyStop, PolishdError, Exception):
        if (found := errors.subgroup(kind)) is not None:
            return _first(found)
    return _first(errors)


def _first(error: BaseException) -> BaseException:
    return _first(error.exceptions[0]) if isinstance(error, BaseExceptionGroup) else error
