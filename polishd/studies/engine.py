"""The engine of studies: cases go to an executor in tasks, and what comes of each is handed on as it comes."""

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

# Where tasks run: processes of this machine, or a Dask cluster. Both work a task with the same child process.

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


TASK_S = 1.0
"""Work of a task, about: of less, the wire would be most of it."""
MOST_CASES = 500
TRIES = 2
WITHIN_S = 600.0
"""Wall time of a case, unless told."""
LOOK_S = 5.0
"""After so long without an answer it is asked whether anybody works."""


@dataclass(frozen=True, slots=True)
class FinishedCase:
    """A case, and what came of it at its last try."""

    case: Case
    answer: CaseResult
    tries: int


def _silent(words: str) -> None:
    """Nobody waits at a terminal."""


def work(
    study: Path,
    cases: Sequence[Case],
    executor: Executor,
    within_s: float = WITHIN_S,
    tell: Callable[[str], None] = _silent,
) -> Iterator[FinishedCase]:
    """Each as it ends, in any order. One that fails, hangs or kills its worker is tried once more, and by itself.

    Where nobody is there to work, ``tell`` is told once, and once more when somebody has come.
    ConfigError where a worker refuses them all: other versions, other files.
    """
    whole = Task(str(study), uuid.uuid4().hex, versions(), within_s, ())
    fresh, again = deque(cases), deque[Case]()
    running: dict[Future[list[CaseResult]], tuple[Case, ...]] = {}
    tried: dict[int, int] = {}
    pace, lack = _Pace(), _Lack(executor, tell)
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
    """Of each case; where the whole task was lost, why."""
    try:
        return future.result()
    except ConfigError:
        raise
    except CancelledError as error:
        raise ConfigError(LOST) from error
    except Exception as error:  # noqa: BLE001  a cluster loses tasks in ways of its own
        return [CaseResult(case.number, error=f"its task was lost: {type(error).__name__}: {error}") for case in cases]


class _Lack:
    """Says once that there is nobody to work, and once that there is again."""

    def __init__(self, executor: Executor, tell: Callable[[str], None]) -> None:
        self._executor, self._tell, self._told = executor, tell, False

    def look(self, ended: Collection[object]) -> None:
        """After each wait. Asked only when nothing has ended for a while, or that was told before."""
        lack = "" if ended else self._executor.lack
        if bool(lack) != self._told:
            self._told = not self._told
            self._tell(f"{lack}; it is waited for" if lack else "a worker is there; the study goes on")


class _Pace:
    """How many cases are a task's work, by those that have ended."""

    def __init__(self) -> None:
        self._spent_s, self._ended = 0.0, 0

    def add(self, answer: CaseResult) -> None:
        self._spent_s, self._ended = self._spent_s + answer.wall_s, self._ended + 1

    @property
    def cases(self) -> int:
        if not self._ended:
            return 1
        return min(math.ceil(TASK_S * self._ended / max(self._spent_s, 1e-6)), MOST_CASES)
