"""The threads beside an event loop: one that hangs, as on a share that is away, does not keep a process that has ended.

``asyncio.run`` and the interpreter's end would wait for it for ever.
"""

from __future__ import annotations

import asyncio
import os
import sys
import threading
import time
from collections.abc import Coroutine
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

T = TypeVar("T")

END_S = 5.0
"""Time for a working thread to finish."""
NAME = "beside the loop"


class LoopThreads(ThreadPoolExecutor):
    """Threads of ``asyncio.to_thread``. Shutdown waits ``END_S`` for them and abandons the others."""

    def __init__(self) -> None:
        """Start all threads now, and none later.

        Without memory a new thread may end before it reports its start. The thread that starts it, which would be the
        loop in contact, then waits for ever.
        """
        super().__init__(thread_name_prefix=NAME)
        begun = threading.Barrier(self._max_workers)
        for _ in range(self._max_workers):
            self.submit(begun.wait)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """See ThreadPoolExecutor."""
        super().shutdown(wait=False, cancel_futures=cancel_futures)
        until_s = time.monotonic() + END_S
        for thread in _alive() if wait else ():
            thread.join(max(until_s - time.monotonic(), 0.0))


def run_loop(main: Coroutine[Any, Any, T]) -> T:
    """``asyncio.run``, whose end no thread holds up for longer than ``END_S``."""
    with asyncio.Runner() as runner:
        runner.get_loop().set_default_executor(LoopThreads())
        return runner.run(main)


def exit_if_hung(code: int) -> None:
    """End the process at once where a thread of such a loop hangs: all is written, and nothing waits for it."""
    if not _alive():
        return
    sys.stderr.write("polishd: a thread hangs, and is left: see which share or device does not answer\n")
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)


def _alive() -> list[threading.Thread]:
    return [thread for thread in threading.enumerate() if thread.name.startswith(NAME)]
