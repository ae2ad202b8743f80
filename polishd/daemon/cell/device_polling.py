"""Reading a device with time limits, so that a device that hangs does not delay the others.

In contact each sample is checked on arrival, and silence is counted.
"""

from __future__ import annotations

import asyncio
import contextlib
import inspect
import logging
import time
from collections.abc import AsyncIterator, Callable, Coroutine, Iterator, Mapping
from functools import cached_property
from inspect import Parameter
from typing import Any, TypeVar

from polishd.daemon.runtime.memory import is_out_of_memory, named
from polishd.model.errors import LinkError, PolishdError, SafetyStop

T = TypeVar("T")

log = logging.getLogger(__name__)

LET_GO_S = 1.0
"""Longest time for cancelled work to clean up."""
LOOK_S = 0.05
"""Step in which silence is counted, so that a daemon that was stalled reads first."""


async def with_deadline(seconds: float, work: Coroutine[Any, Any, T]) -> T:
    """Return the result of the work; raise its error, or TimeoutError after that time.

    The work is cancelled then, and abandoned if it does not end within ``LET_GO_S``.
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
                log.error("%s does not end after it was cancelled and is abandoned", work)


async def read_samples(samples: AsyncIterator[T], judge: Callable[[T], None], name: str, silence_s: float) -> None:
    """Call ``judge`` with each sample until it raises; LinkError after ``silence_s`` without one, or at their end.

    Silence is counted in small steps, so that time in which this process did not run is not silence of the device.
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


@contextlib.asynccontextmanager
async def running_beside(work: Mapping[str, Coroutine[Any, Any, None]]) -> AsyncIterator[None]:
    """Run coroutines, by the names of their tasks, inside this block, and cancel them at its end.

    An error of one of them ends the block; the root cause is raised.
    """
    try:
        async with asyncio.TaskGroup() as group:
            tasks = [group.create_task(one, name=name) for name, one in work.items()]
            try:
                yield
            finally:
                for task in tasks:
                    task.cancel()
    except BaseExceptionGroup as errors:
        raise root_cause(errors) from errors


def root_cause(errors: BaseExceptionGroup[BaseException]) -> BaseException:
    """Return the most informative error of a group: polishd's errors first, then others, then cancellation.

    A lack of memory comes before all of them, because the others follow from it.
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


# Check of a device against the Protocol of its port, before anything is opened.

MISSING = object()


def missing_members(device: object, port: type) -> list[str]:
    """Return a message for each member of the port that the device lacks or has in another form; calls nothing."""
    required = members(port)
    missing = [name for name in required if _found(device, name) is MISSING]
    found = [f"it has no {', '.join(map(repr, missing))}"] if missing else []
    return found + [why for name in required if name not in missing and (why := _wrong(device, name, required[name]))]


def members(port: type) -> dict[str, Any]:
    """Return the members of a Protocol by name: functions, properties, and annotations of plain attributes."""
    found: dict[str, Any] = {}
    for kind in port.__mro__:
        if getattr(kind, "_is_protocol", False):
            own = {**inspect.get_annotations(kind), **vars(kind)}
            found = {name: member for name, member in own.items() if not name.startswith("_")} | found
    return found


def _found(device: object, name: str) -> Any:
    """Return the member; for a property the property itself, because its getter may access a closed device."""
    static = inspect.getattr_static(device, name, MISSING)
    return static if isinstance(static, property | cached_property) else getattr(device, name, MISSING)


def _wrong(device: object, name: str, required: Any) -> str | None:
    has = _found(device, name)
    if not inspect.isfunction(required):
        return f"its {name!r} is a method; the port requires a property" if inspect.isroutine(has) else None
    if not callable(has):
        return f"its {name!r} is not a method but {type(has).__name__}"
    return _wrong_kind(name, inspect.unwrap(has), required) or _wrong_arguments(name, has, required)


def _wrong_kind(name: str, method: Callable[..., Any], required: Callable[..., Any]) -> str | None:
    """Compare the kinds; an async generator or a ``def`` that returns one fulfills a ``def`` for an iterator."""
    if inspect.iscoroutinefunction(required):
        return None if inspect.iscoroutinefunction(method) else f"its {name!r} is not a coroutine: write async def"
    if inspect.iscoroutinefunction(method) or inspect.isgeneratorfunction(method):
        return f"its {name!r} is not an async generator: write async def with yield"
    return None


def _wrong_arguments(name: str, method: Callable[..., Any], required: Callable[..., Any]) -> str | None:
    """Bind the calls that the port allows to the method's signature."""
    signature = inspect.signature(method)
    for positional, keywords in _calls(list(inspect.signature(required).parameters.values())[1:]):
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
