"""Worker processes that compute the cases of a study: one for each thread that runs tasks, here or on a cluster.

Both ends are in this file: ``StudyWorkerPool`` here, ``start_worker`` in the worker. A case that hangs or kills its
worker affects no other case.
"""

from __future__ import annotations

import threading
import time
import traceback
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from polishd.model.errors import ComputeError, ConfigError, PolishdError, WorkerError
from polishd.plugins.rnc_robot.gcode import jit
from polishd.studies.case_runner import CaseRunner
from polishd.studies.cases import Case, versions
from polishd.util.array_stream import Message
from polishd.util.worker_main import AnswerFunction
from polishd.util.worker_process import WorkerLimit, WorkerProcess

TARGET = "polishd.studies.workers:start_worker"
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
