"""One request at a time on a wire that answers one at a time; urgent ones overtake those that wait."""

from __future__ import annotations

import asyncio
import heapq
import itertools
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from typing import Any, TypeVar

from polishd.drivers.transport.background import Background, Ready
from polishd.model.errors import PolishdError

T = TypeVar("T")


@dataclass(order=True)
class _Job:
    """A request that waits for its turn."""

    rank: tuple[int, int]
    work: Callable[[], Awaitable[Any]] = field(compare=False)
    answer: asyncio.Future[Any] = field(compare=False)


class RequestQueue:
    """Runs requests one after the other in a task of its own.

    A caller that is cancelled while its request is on the wire leaves it there to be answered: the answer is dropped
    and never taken for the next one's. An urgent request waits for one other at most.
    """

    def __init__(self, name: str) -> None:
        self._background = Background(name)
        self._jobs: list[_Job] = []
        self._count = itertools.count()

    @property
    def running(self) -> bool:
        """Requests are served."""
        return self._background.alive

    async def start(self) -> None:
        """Begin to serve."""
        await self._background.start(self._serve, within_s=1.0)

    async def stop(self) -> None:
        """Cut off the request on the wire; all callers get LinkError. Idempotent."""
        await self._background.stop()
        self._jobs.clear()

    async def ask(self, work: Callable[[], Awaitable[T]], *, urgent: bool = False) -> T:
        """Run ``work`` when it is its turn; its result or its error."""
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
