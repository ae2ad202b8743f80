"""Background task of a device between ``open()`` and ``close()``; its failure is raised in every waiting call."""

from __future__ import annotations

import asyncio
import heapq
import itertools
import time
from collections.abc import Awaitable, Callable, Coroutine
from dataclasses import dataclass, field
from functools import partial
from typing import Any, TypeVar

from polishd.model.errors import LinkError, PolishdError

T = TypeVar("T")
Ready = Callable[[], None]


def settle(future: asyncio.Future[None]) -> None:
    """Set the result of a future unless it is done."""
    if not future.done():
        future.set_result(None)


class Background:
    """Owner of a task from ``start`` to ``stop``. If it fails, ``check``, ``until`` and ``result`` raise its error."""

    def __init__(self, name: str) -> None:
        self.name = name
        """For messages."""
        self._task: asyncio.Task[None] | None = None
        self._news: asyncio.Future[None] | None = None

    @property
    def alive(self) -> bool:
        """Started, not stopped, not failed."""
        return self._task is not None and not self._task.done()

    async def start(self, main: Callable[[Ready], Coroutine[Any, Any, None]], within_s: float) -> None:
        """Run ``main(ready)`` until ``stop``; return once it has called ready, raise its error if it fails before."""
        if self._task is not None:
            raise LinkError(f"{self.name}: is open already")
        ready: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._task = asyncio.create_task(_flat(main(partial(settle, ready))), name=self.name)
        try:
            await asyncio.wait({ready, self._task}, timeout=within_s, return_when=asyncio.FIRST_COMPLETED)
            if self._task.done():
                await asyncio.shield(self._task)
            if not ready.done():
                raise LinkError(f"{self.name}: {self._unanswered(within_s)}")
        except BaseException:
            await self.stop()
            raise

    async def stop(self) -> None:
        """End the task and wait for its end; idempotent."""
        task, self._task = self._task, None
        if task is not None:
            task.cancel()
            await asyncio.wait({task})
            if not task.cancelled():
                task.exception()  # raised in every waiting call, or irrelevant now

    def check(self) -> None:
        """Raise the error of the task; LinkError if it does not run."""
        if not self.alive:
            raise self._failure()

    def fire(self) -> None:
        """Wake all waiting calls, which check their conditions again. Unlike an event it keeps no state."""
        if self._news is not None:
            settle(self._news)

    def news(self) -> asyncio.Future[None]:
        """Return a future that ends at the next ``fire``. It is shared: do not cancel it."""
        if self._news is None or self._news.done():
            self._news = asyncio.get_running_loop().create_future()
        return self._news

    async def until(self, condition: Callable[[], bool], within_s: float | None = None) -> bool:
        """Wait for the condition, checked after each ``fire``; False on timeout."""
        deadline = None if within_s is None else time.monotonic() + within_s
        while not condition():
            self.check()
            left = None if deadline is None else deadline - time.monotonic()
            if left is not None and left <= 0:
                return False
            await self._first(self.news(), left)
        return True

    async def result(self, future: asyncio.Future[T], within_s: float | None = None) -> T:
        """Return the future's result; LinkError on timeout."""
        await self._first(future, within_s)
        if future.done():
            return future.result()
        self.check()
        raise LinkError(f"{self.name}: {self._unanswered(within_s or 0.0)}")

    def _unanswered(self, within_s: float) -> str:
        """Describe the timeout; a link that knows more adds the likely cause."""
        return f"no answer within {within_s:g} s"

    async def _first(self, future: asyncio.Future[T], within_s: float | None) -> None:
        if self._task is None:
            raise self._failure()
        either: set[asyncio.Future[Any]] = {future, self._task}
        await asyncio.wait(either, timeout=within_s, return_when=asyncio.FIRST_COMPLETED)

    def _failure(self) -> BaseException:
        if self._task is None or self._task.cancelled():
            return LinkError(f"{self.name}: is not open")
        error = self._task.exception()
        if error is None:
            return LinkError(f"{self.name}: has ended")
        # A new error for each waiting call: a raised error collects tracebacks.
        if not isinstance(error, PolishdError):
            return error
        anew = type(error)(*error.args)
        anew.__cause__ = error.__cause__
        return anew


async def _flat(main: Coroutine[Any, Any, None]) -> None:
    """Run main; raise the first error instead of a TaskGroup's exception group."""
    try:
        await main
    except BaseExceptionGroup as group:
        first: BaseException = group
        while isinstance(first, BaseExceptionGroup):
            first = first.exceptions[0]
        raise first from first.__cause__  # not from the group


async def cancellable(answer: Awaitable[T]) -> T:
    """Await a library call that uses ``asyncio.wait_for``, without losing a cancellation.

    In Python 3.11 ``wait_for`` loses a cancellation that arrives with the answer (CPython gh-86296).
    """
    task = asyncio.current_task()
    before = 0 if task is None else task.cancelling()
    result = await answer
    if task is not None and task.cancelling() > before:
        raise asyncio.CancelledError
    return result


async def open_blocking(make: Callable[[], T], undo: Callable[[T], object], within_s: float, what: str) -> T:
    """Run a blocking open in a thread. A result after the timeout or a cancellation is undone."""
    future = asyncio.get_running_loop().run_in_executor(None, make)

    def undo_late(late: asyncio.Future[T]) -> None:
        if not late.cancelled() and late.exception() is None:
            undo(late.result())

    try:
        await asyncio.wait({future}, timeout=within_s)
    except asyncio.CancelledError:
        future.add_done_callback(undo_late)
        raise
    if not future.done():
        future.add_done_callback(undo_late)
        raise LinkError(f"{what}: did not open within {within_s:g} s")
    return future.result()


# Periodic loop.


class PeriodicTimer:
    """Timer of a periodic loop. A round that takes longer does not shorten later rounds."""

    def __init__(self, period_s: float) -> None:
        self._period_s = period_s
        self._due_s = time.monotonic()

    async def next(self) -> None:
        """Wait until the next round is due."""
        self._due_s = max(self._due_s + self._period_s, time.monotonic())
        await asyncio.sleep(self._due_s - time.monotonic())


# One request at a time on a link; urgent requests overtake waiting ones.


@dataclass(order=True)
class _Job:
    """A request that waits for its turn."""

    rank: tuple[int, int]
    work: Callable[[], Awaitable[Any]] = field(compare=False)
    answer: asyncio.Future[Any] = field(compare=False)


class RequestQueue:
    """Queue that runs requests one after the other in its own task.

    If a caller is cancelled while its request is on the link, the queue waits for the answer and drops it, so that it
    is never taken for the next request's. An urgent request waits for at most one other.
    """

    def __init__(self, name: str) -> None:
        self._background = Background(name)
        self._jobs: list[_Job] = []
        self._count = itertools.count()

    @property
    def running(self) -> bool:
        """Whether requests are served."""
        return self._background.alive

    async def start(self) -> None:
        """Start to serve requests."""
        await self._background.start(self._serve, within_s=1.0)

    async def stop(self) -> None:
        """Cancel the request on the link; all callers get LinkError. Idempotent."""
        await self._background.stop()
        self._jobs.clear()

    async def ask(self, work: Callable[[], Awaitable[T]], *, urgent: bool = False) -> T:
        """Run ``work`` in its turn; return its result or raise its error."""
        self._background.check()
        answer: asyncio.Future[T] = asyncio.get_running_loop().create_future()
        heapq.heappush(self._jobs, _Job((0 if urgent else 1, next(self._count)), work, answer))
        self._background.fire()
        try:
            return await self._background.result(answer)
        finally:
            answer.cancel()

    async def _serve(self, ready: Ready) -> None:
        ready()
        while True:
            while not self._jobs:
                await self._background.news()
            job = heapq.heappop(self._jobs)
            if not job.answer.done():
                await _serve_one(job)


async def _serve_one(job: _Job) -> None:
    try:
        result = await job.work()
    except PolishdError as error:
        if not job.answer.done():
            job.answer.set_exception(error)
    else:
        if not job.answer.done():
            job.answer.set_result(result)
