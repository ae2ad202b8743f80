"""Numerical work in one worker process with a time limit, so that it never blocks the event loop.

Both ends of a call are in this file: ``Compute`` in the daemon, ``start_worker`` in the worker. Calls and results are
pickles, because both ends are this program.
"""

from __future__ import annotations

import asyncio
import importlib
import os
import pickle
import traceback
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from types import TracebackType
from typing import Any, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from polishd.daemon.runtime.installed import installed_at_start, installed_now, require_same
from polishd.daemon.runtime.process import compute_last
from polishd.model.errors import ComputeError, HostFault, PolishdError, WorkerError
from polishd.pipeline.recipe import CpuLimit
from polishd.process.dwell.problem import backstop_s
from polishd.util.array_stream import Message
from polishd.util.worker_main import AnswerFunction
from polishd.util.worker_process import WorkerLimit, WorkerProcess

TARGET = "polishd.daemon.runtime.compute:start_worker"
EARLY = ("polishd.hookspecs", "scipy.fft", "scipy.ndimage", "scipy.sparse", "scipy.spatial")
"""Imported before the worker is ready, so that no call's limit includes them."""
SMALL_BYTES = 1 << 12
"""Arrays up to this size are inside the pickle."""

T = TypeVar("T")
Pickled = dict[str, NDArray[np.uint8]]


class Compute:
    """``await compute(function, *arguments, within_s=30)``: module-level functions and picklable arguments.

    One call runs at a time; others wait in order. The worker starts at the first call or ``start``. It states the
    versions of its installed software: HostFault where they are not the daemon's.
    """

    def __init__(self, threads: int | None = None, backstop: Callable[[float], float] = backstop_s) -> None:
        self._threads = threads or (1 if (os.cpu_count() or 1) <= 2 else 2)
        self._backstop = backstop
        self._installed = installed_at_start()
        self._turn = asyncio.Lock()
        # Not asyncio's threads: files on a share that does not answer may block all of them.
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="compute")
        self._worker: WorkerProcess | None = None
        self._ready = False
        self._closed = False

    @property
    def pid(self) -> int | None:
        """Process id of the worker, or None while there is none."""
        return None if self._worker is None else self._worker.pid

    async def start(self) -> None:
        """Start the worker and wait until it is ready. Idempotent."""
        async with self._turn:
            await self._started()

    async def __call__(self, function: Callable[..., T], *arguments: Any, within_s: CpuLimit | float = 600.0) -> T:
        """Run the function in the worker, and return its result.

        The limit is CPU seconds of all threads of the worker, and the ``backstop``'s wall seconds for them. The worker
        is killed at the limit, and when the caller is cancelled. The next call has another one.

        Raises:
            PolishdError: as the function raises it.
            ComputeError: the function raises another exception (a note has its traceback), the limit is exceeded, or
                the worker ends.
        """
        cpu = within_s if isinstance(within_s, CpuLimit) else CpuLimit(within_s)
        limit = WorkerLimit(wall_s=self._backstop(cpu.within_s), cpu_s=cpu.within_s, key=cpu.key)
        name = getattr(function, "__qualname__", repr(function))
        async with self._turn:
            worker = await self._started()
            try:
                call = pack((function, arguments))
            except Exception as error:
                raise ComputeError(f"{name} cannot be sent to the worker: {error}") from error
            try:
                kind, value = await self._in_thread(worker, partial(_exchange, worker, call, limit))
            except WorkerError as error:
                if not self._closed:
                    self._worker = self._new_worker()  # so that the next call does not wait for its start
                raise ComputeError(f"{name}: {error}") from error
        if kind == "error":
            raise value
        return value  # type: ignore[no-any-return]

    async def close(self) -> None:
        """End the worker, also during a call. Idempotent."""
        self._closed = True
        if self._worker is not None:
            self._worker.kill()
            async with self._turn:
                await self._in_thread(self._worker, self._worker.end)
                self._worker = None
        self._thread.shutdown(wait=False)

    async def __aenter__(self) -> Self:
        """Itself; the worker starts when it is needed."""
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        """Close."""
        await self.close()

    async def _started(self) -> WorkerProcess:
        """Return a worker that is ready."""
        if self._closed:
            raise ComputeError("the compute worker is closed")
        if self._worker is None or not self._worker.alive:
            if self._worker is not None:
                self._worker.end()
            self._worker = self._new_worker()
        worker = self._worker
        if not self._ready:
            try:
                stated = await self._in_thread(worker, worker.start)
            except WorkerError:
                require_same(self._installed, await asyncio.to_thread(installed_now))  # names the distribution
                raise
            try:
                require_same(self._installed, stated["installed"])
            except HostFault:
                worker.end()
                self._worker = None
                raise
            self._ready = True
        return worker

    def _new_worker(self) -> WorkerProcess:
        self._ready = False
        return WorkerProcess(TARGET, "the compute worker", threads=self._threads, has_log=True)

    async def _in_thread(self, worker: WorkerProcess, work: Callable[[], T]) -> T:
        """Return the result of work that waits for the worker. The worker is killed where the caller is cancelled."""
        running = asyncio.get_running_loop().run_in_executor(self._thread, work)
        try:
            return await asyncio.shield(running)
        except asyncio.CancelledError:
            worker.kill()
            await asyncio.wait({running})
            raise


def pack(value: object) -> Pickled:
    """Return the pickle of a value, and its large arrays, which are not copied."""
    arrays: list[memoryview] = []

    def is_small(buffer: pickle.PickleBuffer) -> bool:
        content = buffer.raw()
        if content.nbytes > SMALL_BYTES:
            arrays.append(content)
        return content.nbytes <= SMALL_BYTES

    main = pickle.dumps(value, protocol=5, buffer_callback=is_small)
    pieces: list[bytes | memoryview] = [main, *arrays]
    return {str(number): np.frombuffer(piece, np.uint8) for number, piece in enumerate(pieces)}


def unpack(pieces: Mapping[str, NDArray[Any]]) -> Any:
    """Return the value of such pieces; its arrays are writable."""
    main, *buffers = pieces.values()
    # The other end is this program, on a pipe that no other process has.
    return pickle.loads(main.data, buffers=buffers)  # noqa: S301


def _exchange(worker: WorkerProcess, call: Pickled, limit: WorkerLimit) -> tuple[str, Any]:
    kind, value = unpack(worker.request({}, call, limit)[1])
    return kind, value


def start_worker() -> tuple[dict[str, Any], AnswerFunction]:
    """Prepare this process to be the worker."""
    compute_last()
    for name in EARLY:
        importlib.import_module(name)
    return {"installed": installed_now()}, _answer


def _answer(_: Mapping[str, Any], call: Mapping[str, NDArray[Any]]) -> Message:
    """Return ``("result", value)`` or ``("error", exception)``, pickled."""
    name = "a call"
    try:
        function, arguments = unpack(call)
        name = getattr(function, "__qualname__", repr(function))
        answer = "result", function(*arguments)
    except PolishdError as error:
        answer = "error", _portable(error)
    except Exception as error:  # noqa: BLE001 - the caller gets any exception
        failure = ComputeError(f"{name} failed: {type(error).__name__}: {error}")
        failure.add_note(traceback.format_exc())
        answer = "error", failure
    try:
        return {}, pack(answer)
    except Exception as error:  # noqa: BLE001 - a result that cannot be pickled is the call's error
        return {}, pack(("error", ComputeError(f"the result cannot be sent back: {error}")))


def _portable(error: PolishdError) -> PolishdError:
    """Return the error itself where it survives pickling, else a ComputeError with its text."""
    try:
        unpack(pack(error))
    except Exception:  # noqa: BLE001 - a plugin's exception class may raise anything here
        return ComputeError(f"{type(error).__name__}: {error}")
    return error
