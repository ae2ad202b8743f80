"""The engine of studies: cases go to an executor in tasks, and each result is yielded as soon as it exists."""

from __future__ import annotations

import math
import os
import uuid
from collections import deque
from collections.abc import Callable, Collection, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, CancelledError, Future, ThreadPoolExecutor, wait
from dataclasses import dataclass, replace
from pathlib import Path
from types import TracebackType
from typing import Any, Protocol, Self

from polishd.model.errors import ConfigError
from polishd.studies.cases import Case, versions
from polishd.studies.workers import CaseResult, StudyWorkerPool, Task
from polishd.util.extras import require_extra

# Executors of tasks: processes of this machine, or a Dask cluster. Both run a task with the same child process.

ANSWER_S = 60.0
"""Time in which a scheduler must answer."""

LOST = "the cluster was lost. Start the study again; it continues where it was"


class Executor(Protocol):
    """The interface of an executor."""

    @property
    def slots(self) -> int:
        """Tasks that run at once."""

    @property
    def lack(self) -> str:
        """Return the reason of the wait and a remedy; empty where a worker runs."""

    def submit(self, task: Task) -> Future[list[CaseResult]]:
        """Run a task. Its future raises ConfigError where the task is refused, and another error where it was lost."""

    def __enter__(self) -> Self:
        """Enter the context."""

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End all that it started."""


class LocalPool:
    """Processes of this machine: each thread waits for one process."""

    def __init__(self, workers: int | None = None) -> None:
        """``workers`` None: one for each core that this process may use."""
        self.slots = workers or len(os.sched_getaffinity(0))
        self.lack = ""  # they are started on demand
        self._children = StudyWorkerPool()
        self._threads = ThreadPoolExecutor(self.slots, thread_name_prefix="study")

    def submit(self, task: Task) -> Future[list[CaseResult]]:
        """Run it in the next free process."""
        return self._threads.submit(self._children.run, task)

    def __enter__(self) -> Self:
        """Enter the context."""
        return self

    def __exit__(self, *_: object) -> None:
        """Kill the processes."""
        self._threads.shutdown(wait=False, cancel_futures=True)
        self._children.kill()
        self._threads.shutdown()
        self._children.close()


class DaskCluster:
    """Workers of a Dask scheduler. Each of their threads has a child process, as in the local pool."""

    def __init__(self, address: str) -> None:
        """Connect; workers may come later. ConfigError where Dask is not installed, or no scheduler answers."""
        require_extra("--scheduler", "dask")
        from distributed import Client

        connect: Any = Client
        try:
            self._client = connect(address, timeout=ANSWER_S)
        except (OSError, TimeoutError, ValueError) as error:
            raise ConfigError(
                f"--scheduler {address}: no scheduler answers: {error}. "
                "Start one with `dask scheduler`, or correct the address"
            ) from error
        self._address = address
        self._executor = self._client.get_executor(pure=False)

    @property
    def slots(self) -> int:
        """Threads of all connected workers."""
        try:
            return sum(self._client.nthreads().values())
        except (OSError, TimeoutError) as error:  # the scheduler is gone, and Dask would call again without effect
            raise ConfigError(LOST) from error

    @property
    def lack(self) -> str:
        """Return a message if it has no worker: submitted tasks wait at the scheduler."""
        if self.slots:
            return ""
        return f"no worker at {self._address}: start one with `dask worker {self._address} --nthreads 1`"

    def submit(self, task: Task) -> Future[list[CaseResult]]:
        """Run it on any worker; after a loss Dask gives the task to another."""
        future: Future[list[CaseResult]] = self._executor.submit(run_there, task)
        return future

    def __enter__(self) -> Self:
        """Enter the context."""
        return self

    def __exit__(self, *_: object) -> None:
        """Withdraw waiting tasks and disconnect; the cluster continues."""
        self._executor.shutdown(wait=False)
        self._client.close()


_there = StudyWorkerPool()


def run_there(task: Task) -> list[CaseResult]:
    """Compute the cases of a task on a worker of a cluster. ConfigError where they are refused."""
    return _there.run(task)


TASK_S = 1.0
"""Approximate work of a task: in a shorter one the link would take most of the time."""
MOST_CASES = 500
TRIES = 2
WITHIN_S = 600.0
"""Default time limit of a case, wall time."""
LOOK_S = 5.0
"""After so long without a result, check for workers."""


@dataclass(frozen=True, slots=True)
class FinishedCase:
    """A case, and the result of its last try."""

    case: Case
    answer: CaseResult
    tries: int


def _silent(_message: str) -> None:
    """Discard the message."""


def work(
    study: Path,
    cases: Sequence[Case],
    executor: Executor,
    within_s: float = WITHIN_S,
    report_wait: Callable[[str], None] = _silent,
) -> Iterator[FinishedCase]:
    """Yield each result as its case ends, in any order.

    A case that fails, hangs or kills its worker is retried once, alone. Without a worker, ``report_wait`` gets one
    message, and one more when a worker has come.
    ConfigError where a worker refuses all cases: other versions, other files.
    """
    whole = Task(str(study), uuid.uuid4().hex, versions(), within_s, ())
    fresh, again = deque(cases), deque[Case]()
    running: dict[Future[list[CaseResult]], tuple[Case, ...]] = {}
    tried: dict[int, int] = {}
    pace, lack = _Pace(), _Lack(executor, report_wait)
    while fresh or again or running:
        while (fresh or again) and len(running) < max(executor.slots, 1):  # one more would wait behind a long one
            some = (again.popleft(),) if again else tuple(fresh.popleft() for _ in range(min(pace.cases, len(fresh))))
            running[executor.submit(replace(whole, cases=some))] = some
        ended = wait(running, timeout=LOOK_S, return_when=FIRST_COMPLETED).done
        lack.look(ended)
        for future in ended:
            for case, answer in zip(some := running.pop(future), _answers(future, some), strict=True):
                tried[case.number] = tried.get(case.number, 0) + 1
                if answer.error and tried[case.number] < TRIES:
                    again.append(case)
                    continue
                pace.add(answer)
                yield FinishedCase(case, answer, tried[case.number])


def _answers(future: Future[list[CaseResult]], cases: Sequence[Case]) -> list[CaseResult]:
    """Return the result of each case; where the whole task was lost, the reason."""
    try:
        return future.result()
    except ConfigError:
        raise
    except CancelledError as error:
        raise ConfigError(LOST) from error
    except Exception as error:  # noqa: BLE001  a cluster loses tasks with many exception types
        return [CaseResult(case.number, error=f"its task was lost: {type(error).__name__}: {error}") for case in cases]


class _Lack:
    """Report once that no worker is there, and once that one has come."""

    def __init__(self, executor: Executor, report_wait: Callable[[str], None]) -> None:
        self._executor, self._report_wait, self._reported = executor, report_wait, False

    def look(self, ended: Collection[object]) -> None:
        """Check after each wait, only if no case has ended for a while or the lack was reported before."""
        lack = "" if ended else self._executor.lack
        if bool(lack) != self._reported:
            self._reported = not self._reported
            self._report_wait(f"{lack}; the study waits" if lack else "a worker is there; the study continues")


class _Pace:
    """Return the number of cases in a task, from the times of those that have ended."""

    def __init__(self) -> None:
        self._spent_s, self._ended = 0.0, 0

    def add(self, answer: CaseResult) -> None:
        self._spent_s, self._ended = self._spent_s + answer.wall_s, self._ended + 1

    @property
    def cases(self) -> int:
        if not self._ended:
            return 1
        return min(math.ceil(TASK_S * self._ended / max(self._spent_s, 1e-6)), MOST_CASES)
