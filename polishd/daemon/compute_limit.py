"""When the compute worker's time for a call is over: CPU seconds of the worker, and a wall-clock backstop."""

from __future__ import annotations

import asyncio
import os
import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path

from polishd.recipe.limit import CpuLimit

LOOK_S = 0.1
"""Time between two looks at what the worker has used."""


def process_cpu_s(pid: int) -> float:
    """CPU seconds that all threads of a process have used; 0 where it is gone, or where there is no /proc."""
    try:
        stat = Path(f"/proc/{pid}/stat").read_text()
    except OSError:
        return 0.0
    # after the name, which may hold anything, user and system time are the 12th and 13th field
    fields = stat.rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


class WorkerTimeLimit:
    """Sees when a process has used its CPU seconds, counted from now, or when the backstop is over.

    A process that a busy machine starves, or that somebody stops, keeps its CPU seconds; one that sleeps uses none.
    """

    def __init__(self, pid: int, limit: CpuLimit, backstop: Callable[[float], float]) -> None:
        self._pid, self._limit = pid, limit
        self._backstop_s = backstop(limit.within_s)
        self._wall, self._cpu = time.monotonic(), process_cpu_s(pid)
        self._next_look: asyncio.TimerHandle | None = None

    @asynccontextmanager
    async def kept(self) -> AsyncIterator[None]:
        """What is inside ends with a TimeoutError when the time is over."""
        async with asyncio.timeout(None) as scope:
            self._look(scope)
            try:
                yield
            finally:
                if self._next_look is not None:
                    self._next_look.cancel()

    def __str__(self) -> str:
        """What was used, what was allowed, and what gives more."""
        used = f"used {self._cpu_s:.1f} s of CPU time in {self._wall_s:.1f} s"
        allowed = f"at most {self._limit.within_s:g} s in {self._backstop_s:g} s are allowed"
        more = f"; {self._limit.key} gives it more" if self._limit.key else ""
        return f"{used}, {allowed}{more}"

    @property
    def _cpu_s(self) -> float:
        return max(process_cpu_s(self._pid) - self._cpu, 0.0)

    @property
    def _wall_s(self) -> float:
        return time.monotonic() - self._wall

    def _look(self, scope: asyncio.Timeout) -> None:
        loop = asyncio.get_running_loop()
        if self._over():
            scope.reschedule(loop.time())
        else:
            self._next_look = loop.call_later(LOOK_S, self._look, scope)

    def _over(self) -> bool:
        return self._cpu_s >= self._limit.within_s or self._wall_s >= self._backstop_s
