"""The engine of studies: cases go to an executor in tasks, and each result is yielded as soon as it exists.

One worker process for each thread that runs tasks, here or on a cluster, computes the cases. Both ends are in this
file: ``StudyWorkerPool`` here, ``start_worker`` in the worker. A case that hangs or kills its worker affects no other.
"""

from __future__ import annotations

import math
import os
import threading
import time
import traceback
import uuid
from collections import deque
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, CancelledError, Future, ThreadPoolExecutor, wait
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from types import TracebackType
from typing import Any, Protocol, Self

from polishd.model.errors import ComputeError, ConfigError, PolishdError, WorkerError
from polishd.plugins.rnc_robot.gcode import jit
from polishd.studies.case_runner import CaseRunner
from polishd.studies.cases import Case, versions
from polishd.util.array_stream import Message
from polishd.util.extras import require_extra
from polishd.util.worker_main import AnswerFunction
from polishd.util.worker_process import WorkerLimit, WorkerProcess

TARGET = "polishd.studies.engine:start_worker"
ENVIRONMENT = {"PYTHONHASHSEED": "0"}
"""With one thread each: as many workers as cores, and sums in one order, on any computer."""


@dataclass(frozen=True, slots=True)
class Task:
    """Some cases of a study, as they are sent to where they run."""

    study: str
    run: str
    """Another for each run of the study: files are read again."""
    versions: Mapping[str, str]
    within_s: float
    """Wall time of a case, after which its worker is killed."""
    cases: tuple[Case, ...]


@dataclass(frozen=True, slots=True)
class CaseResult:
    """The rows of a case, or why there are none."""

    number: int
    rows: tuple[dict[str, Any], ...] = ()
    error: str = ""
    wall_s: float = 0.0
    cpu_s: float = 0.0


class StudyWorkerPool:
    """The worker of each thread that runs tasks."""

    def __init__(self) -> None:
        self._mine = threading.local()
        self._all: set[WorkerProcess] = set()
        self._lock = threading.Lock()
        self._closed = False

    def run(self, task: Task) -> list[CaseResult]:
        """Run all cases of a task, in order, in this thread's worker. ConfigError where the worker refuses them."""
        return [_run_case(self._worker(task.versions), task, case) for case in task.cases]

    def kill(self) -> None:
        """Kill all workers, and start no more. The tasks that run end at once."""
        with self._lock:
            self._closed = True
            for worker in self._all:
                worker.kill()

    def close(self) -> None:
        """Release all workers: after ``kill``, when no thread runs a task."""
        while self._all:
            self._all.pop().end()

    def _worker(self, versions: Mapping[str, str]) -> WorkerProcess:
        last: WorkerProcess | None = getattr(self._mine, "worker", None)
        if last is not None and last.alive:
            return last
        with self._lock:
            if self._closed:
                raise ConfigError("the study was ended. Start it again; it continues where it was.")
            if last is not None:
                self._all.discard(last)
                last.end()
            worker = WorkerProcess(TARGET, "the study worker", threads=1, environment=ENVIRONMENT)
            self._all.add(worker)  # before its start is awaited, so that it can be killed meanwhile
        self._mine.worker = worker
        try:
            stated = worker.start()["versions"]
        except WorkerError as error:
            raise ConfigError(str(error)) from error
        other = {name: (stated.get(name), wanted) for name, wanted in versions.items()}
        wrong = [f"{name} {here or 'missing'} for {wanted}" for name, (here, wanted) in other.items() if here != wanted]
        if wrong:
            worker.end()
            raise ConfigError(f"a worker has other versions: {', '.join(wrong)}; install the same on all machines")
        return worker


def _run_case(worker: WorkerProcess, task: Task, case: Case) -> CaseResult:
    """Return the result of one case, also where it ends its worker. ConfigError where the worker refuses it."""
    began_s = time.monotonic()
    request = {"study": task.study, "run": task.run, "case": asdict(case)}
    try:
        answer, _ = worker.request(request, limit=WorkerLimit(wall_s=task.within_s))
    except WorkerError as error:
        return CaseResult(case.number, error=str(error), wall_s=time.monotonic() - began_s)
    except ComputeError as error:
        raise ConfigError(str(error)) from error
    return CaseResult(case.number, tuple(answer["rows"]), answer["failed"], answer["wall_s"], answer["cpu_s"])


def start_worker() -> tuple[dict[str, Any], AnswerFunction]:
    """Prepare this process to compute cases."""
    jit.compile_always()
    return {"versions": dict(versions())}, _StudyCases().answer


class _StudyCases:
    """The worker's end: the study of the last request, with the data that it keeps from case to case."""

    def __init__(self) -> None:
        self._runner: CaseRunner | None = None
        self._run = ""

    def answer(self, request: Mapping[str, Any], _: Mapping[str, Any]) -> Message:
        """Return the rows of a case, or why it failed. ConfigError where files or versions have changed."""
        if self._runner is None or self._run != request["run"]:
            if self._runner is not None:
                self._runner.close()
            self._runner, self._run = CaseRunner(Path(request["study"])), request["run"]
        case = Case(**request["case"])
        self._runner.require_same(case)
        wall_s, cpu_s = time.monotonic(), time.process_time()
        rows: list[dict[str, Any]] = []
        failed = ""
        try:
            rows = self._runner.rows(case)
        except PolishdError as error:
            failed = f"{type(error).__name__}: {error}"
        except Exception as error:  # noqa: BLE001  any exception is the case's result
            failed = "".join(traceback.format_exception_only(error)).strip()
            traceback.print_exc()
        used = {"wall_s": time.monotonic() - wall_s, "cpu_s": time.process_time() - cpu_s}
        return {"rows": rows, "failed": failed, **used}, {}


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
