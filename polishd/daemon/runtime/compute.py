"""Numerical work in one worker process, killed when its time is over, so that the event loop never waits for it."""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
import sys
import time
from asyncio.subprocess import PIPE, Process
from collections.abc import AsyncIterator, Callable, Coroutine
from contextlib import asynccontextmanager
from pathlib import Path
from types import TracebackType
from typing import Any, Self, TypeVar

from polishd.daemon.runtime.compute_worker import LENGTH, pack, unpack
from polishd.daemon.runtime.installed import installed_at_start, installed_now, require_same
from polishd.model.errors import ComputeError, HostFault
from polishd.pipeline.recipe import CpuLimit
from polishd.process.dwell.time_limit import backstop_s
from polishd.util.secret_files import environment_without_secrets

# When the compute worker's time for a call is over: CPU seconds of the worker, and a wall-clock backstop.

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


T = TypeVar("T")

START_S = 30.0
"""CPU seconds in which a worker says that it is ready."""
_THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS")


class Compute:
    """``await compute(function, *arguments, within_s=30)``: module-level functions and picklable arguments.

    One call runs at a time, others wait their turn. The worker starts at the first call or ``start``, and proves that
    it has the daemon's versions: else HostFault.
    """

    def __init__(self, threads: int | None = None, backstop: Callable[[float], float] = backstop_s) -> None:
        self._threads = threads or (1 if (os.cpu_count() or 1) <= 2 else 2)
        self._backstop = backstop
        self._installed = installed_at_start()
        self._turn = asyncio.Lock()
        self._process: Process | None = None
        self._ready = False
        self._closed = False

    @property
    def pid(self) -> int | None:
        """Process id of the worker, or None while there is none."""
        return None if self._process is None else self._process.pid

    async def start(self) -> None:
        """Start the worker and wait until it is ready; idempotent."""
        async with self._turn:
            await self._warm()

    async def __call__(self, function: Callable[..., T], *arguments: Any, within_s: CpuLimit | float = 600.0) -> T:
        """Run it in the worker. PolishdErrors come back as themselves, others as ComputeError with a note.

        ComputeError also when the worker has used so many CPU seconds (all its threads, since the ready worker has the
        call), or the ``backstop``'s wall seconds for them, or where it dies. The worker is killed then, and when the
        caller is cancelled; the next call has a new one.
        """
        limit = within_s if isinstance(within_s, CpuLimit) else CpuLimit(within_s)
        async with self._turn:
            process = await self._warm()
            name = getattr(function, "__qualname__", repr(function))
            try:
                message = pack((function, arguments))
            except Exception as error:
                raise ComputeError(f"{name} cannot be sent to the worker: {error}") from error
            work = _exchange(process, message)
            late, dead = f"{name} was ended", f"{name}: the worker died"
            kind, value = await self._kept(process, limit, work, late=late, dead=dead)
        if kind == "error":
            raise value
        return value  # type: ignore[no-any-return]

    async def close(self) -> None:
        """End the worker, also amid a call; idempotent."""
        self._closed = True
        await self._drop()

    async def __aenter__(self) -> Self:
        """Nothing yet: the worker starts when it is needed."""
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        """Close."""
        await self.close()

    async def _warm(self) -> Process:
        process = self._process
        if process is None or process.returncode is not None:
            process = await self._spawn()
        if not self._ready:
            late, dead = "the worker was not ready in time", "the worker did not start"
            try:
                _, now = await self._kept(
                    process, CpuLimit(START_S), _receive(process), late=late, dead=dead, hint="; see stderr"
                )
            except ComputeError:
                require_same(self._installed, await asyncio.to_thread(installed_now))  # names what is gone
                raise
            try:
                require_same(self._installed, now)
            except HostFault:
                await self._drop()
                raise
            self._ready = True
        return process

    async def _kept(
        self, process: Process, limit: CpuLimit, work: Coroutine[Any, Any, T], *, late: str, dead: str, hint: str = ""
    ) -> T:
        """What the worker answers in time; else it is killed, and a ComputeError begins with ``late`` or ``dead``."""
        watch = WorkerTimeLimit(process.pid, limit, self._backstop)
        try:
            async with watch.kept():
                return await work
        except TimeoutError:
            used = str(watch)
            await self._drop()
            if self._ready:  # the next call need not wait for it
                await self._spawn()
            raise ComputeError(f"{late}: it {used}") from None
        except (OSError, EOFError) as error:
            raise ComputeError(f"{dead} ({await self._drop()}){hint}") from error
        except BaseException:
            await self._drop()
            raise

    async def _spawn(self) -> Process:
        self._refuse_closed()
        folders = [folder or str(Path.cwd()) for folder in sys.path]
        environment = {
            **environment_without_secrets(),
            **dict.fromkeys(_THREAD_VARIABLES, str(self._threads)),
            "PYTHONPATH": os.pathsep.join(folders),
        }
        command = (sys.executable, "-P", "-m", "polishd.daemon.runtime.compute_worker")
        self._ready = False
        self._process = await asyncio.create_subprocess_exec(*command, stdin=PIPE, stdout=PIPE, env=environment)
        if self._closed:  # while it started
            await self._drop()
            self._refuse_closed()
        return self._process

    def _refuse_closed(self) -> None:
        if self._closed:
            raise ComputeError("the compute worker is closed")

    async def _drop(self) -> str:
        """Kill the worker and wait for its end; says how it ended."""
        process, self._process = self._process, None
        if process is None:
            return "it was closed"
        if process.returncode is None:
            # Not process.kill(): it may reap the process itself, and asyncio then never learns the exit code.
            with contextlib.suppress(ProcessLookupError):
                os.kill(process.pid, signal.SIGKILL)
        if process.stdin is not None:
            process.stdin.close()
        code = await process.wait()
        return f"exit code {code}" if code >= 0 else f"signal {-code}; out of memory?"


async def _exchange(process: Process, message: list[bytes | memoryview]) -> tuple[str, Any]:
    if process.stdin is None:
        raise EOFError
    process.stdin.writelines(message)
    await process.stdin.drain()
    return await _receive(process)


async def _receive(process: Process) -> tuple[str, Any]:
    stream = process.stdout
    if stream is None:
        raise EOFError
    (count,) = LENGTH.unpack(await stream.readexactly(LENGTH.size))
    pieces = []
    for _ in range(count):
        (length,) = LENGTH.unpack(await stream.readexactly(LENGTH.size))
        pieces.append(await stream.readexactly(length))
    kind, value = unpack(pieces)
    return kind, value
