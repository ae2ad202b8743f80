"""Hearing a device for as long as contact lasts, and no longer than it may take: nothing that it does holds up others.

In contact each sample is judged as it comes, and silence is counted.
"""

from __future__ import annotations

import asyncio
import contextlib
import inspect
import logging
import time
from collections.abc import AsyncIterator, Callable, Coroutine, Iterator
from functools import cached_property
from inspect import Parameter
from typing import Any, TypeVar

from polishd.daemon.runtime.memory import is_out_of_memory, named
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


# What a device lacks of its port, told from the port's Protocol before anything is opened.

MISSING = object()


def missing_members(device: object, port: type) -> list[str]:
    """Each member of the port that the device has not, or has as something else; nothing of it is called."""
    asked = members(port)
    missing = [name for name in asked if _found(device, name) is MISSING]
    found = [f"it has no {', '.join(map(repr, missing))}"] if missing else []
    return found + [why for name in asked if name not in missing and (why := _wrong(device, name, asked[name]))]


def members(port: type) -> dict[str, Any]:
    """What a Protocol asks, by name: functions, properties, and the annotations of plain attributes."""
    found: dict[str, Any] = {}
    for kind in port.__mro__:
        if getattr(kind, "_is_protocol", False):
            asked = {**inspect.get_annotations(kind), **vars(kind)}
            found = {name: member for name, member in asked.items() if not name.startswith("_")} | found
    return found


def _found(device: object, name: str) -> Any:
    """The member: a property itself, for its getter may ask a device that is not open; else as the device gives it."""
    static = inspect.getattr_static(device, name, MISSING)
    return static if isinstance(static, property | cached_property) else getattr(device, name, MISSING)


def _wrong(device: object, name: str, asked: Any) -> str | None:
    has = _found(device, name)
    if not inspect.isfunction(asked):
        return f"its {name!r} is a method; the port asks for a property" if inspect.isroutine(has) else None
    if not callable(has):
        return f"its {name!r} is no method: {type(has).__name__}"
    return _wrong_kind(name, inspect.unwrap(has), asked) or _wrong_arguments(name, has, asked)


def _wrong_kind(name: str, method: Callable[..., Any], asked: Callable[..., Any]) -> str | None:
    """A port's ``def`` that gives an iterator is kept by an async generator, or by a ``def`` that gives one."""
    if inspect.iscoroutinefunction(asked):
        return (
            None if inspect.iscoroutinefunction(method) else f"its {name!r} is no coroutine function: write async def"
        )
    if inspect.iscoroutinefunction(method) or inspect.isgeneratorfunction(method):
        return f"its {name!r} is no async generator: write async def, with yield in it"
    return None


def _wrong_arguments(name: str, method: Callable[..., Any], asked: Callable[..., Any]) -> str | None:
    """The calls that the port allows must bind."""
    signature = inspect.signature(method)
    for positional, keywords in _calls(list(inspect.signature(asked).parameters.values())[1:]):
        try:
            signature.bind(*positional, **keywords)
        except TypeError as error:
            call = ", ".join([*positional, *(f"{key}=..." for key in keywords)])
            return f"its {name!r} cannot be called as {name}({call}): {error}"
    return None


def _calls(parameters: list[Parameter]) -> Iterator[tuple[list[str], dict[str, str]]]:
    names = [one.name for one in parameters]
    yield [one.name for one in parameters if one.default is Parameter.empty], {}
    yield names, {}
    yield [], dict.fromkeys(names, "")
