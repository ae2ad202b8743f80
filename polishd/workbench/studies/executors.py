"""Where tasks run: processes of this machine, or a Dask cluster. Both work a task with the same child process."""

from __future__ import annotations

import os
from concurrent.futures import Future, ThreadPoolExecutor
from types import TracebackType
from typing import Any, Protocol, Self

from polishd.model.errors import ConfigError
from polishd.workbench.studies.children import CaseResult, StudyWorkerPool, Task

ANSWER_S = 60.0
"""In which a scheduler answers."""

LOST = "the cluster was lost; begin the study again, and it goes on where it was"


class Executor(Protocol):
    """What the engine wants of one."""

    @property
    def slots(self) -> int:
        """Tasks that run at once."""

    @property
    def lack(self) -> str:
        """In words, for whom is waited and what to do; empty where somebody works."""

    def submit(self, task: Task) -> Future[list[CaseResult]]:
        """Run it somewhere. Its future raises ConfigError where it is refused, anything else where it was lost."""

    def __enter__(self) -> Self:
        """Itself."""

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End all that it started."""


class LocalPool:
    """Processes of this machine: a thread each, which waits for its own."""

    def __init__(self, workers: int | None = None) -> None:
        """``workers`` None: one a core that this process may use."""
        self.slots = workers or len(os.sched_getaffinity(0))
        self.lack = ""  # they are started as they are wanted
        self._children = StudyWorkerPool()
        self._threads = ThreadPoolExecutor(self.slots, thread_name_prefix="study")

    def submit(self, task: Task) -> Future[list[CaseResult]]:
        """To the next process that is free."""
        return self._threads.submit(self._children.run, task)

    def __enter__(self) -> Self:
        """Itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Kill the processes."""
        self._threads.shutdown(wait=False, cancel_futures=True)
        self._children.kill()
        self._threads.shutdown()
        self._children.close()


class DaskCluster:
    """Workers of a Dask scheduler, of which each thread has a child process, as here."""

    def __init__(self, address: str) -> None:
        """Connect; workers may come later. ConfigError where Dask is not installed, or nobody answers."""
        try:
            from distributed import Client
        except ImportError as error:
            raise ConfigError(
                "--scheduler: distributed is not installed; install polishd[dask], or leave it out and compute here"
            ) from error
        connect: Any = Client
        try:
            self._client = connect(address, timeout=ANSWER_S)
        except (OSError, TimeoutError, ValueError) as error:
            raise ConfigError(
                f"--scheduler {address}: no scheduler answers: {error}; start one with `dask scheduler`, or mend that"
            ) from error
        self._address = address
        self._executor = self._client.get_executor(pure=False)

    @property
    def slots(self) -> int:
        """Threads of all workers that are there now."""
        try:
            return sum(self._client.nthreads().values())
        except (OSError, TimeoutError) as error:  # the scheduler is gone, and Dask calls again in vain
            raise ConfigError(LOST) from error

    @property
    def lack(self) -> str:
        """That it has no worker, if so: what was given to it waits at the scheduler."""
        if self.slots:
            return ""
        return f"no worker at {self._address}: start one with `dask worker {self._address} --nthreads 1`"

    def submit(self, task: Task) -> Future[list[CaseResult]]:
        """To some worker; where it is lost, Dask gives the task to another."""
        future: Future[list[CaseResult]] = self._executor.submit(run_there, task)
        return future

    def __enter__(self) -> Self:
        """Itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Take back what waits, and hang up; the cluster goes on."""
        self._executor.shutdown(wait=False)
        self._client.close()


_there = StudyWorkerPool()


def run_there(task: Task) -> list[CaseResult]:
    """The cases of a task on a worker of a cluster. ConfigError where they are refused."""
    return _there.run(task)
