"""Killable processes that work cases: one a thread of whoever runs tasks, here or on a worker of a cluster."""

from __future__ import annotations

import contextlib
import json
import os
import select
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import IO, Any, cast

from polishd.model.errors import ConfigError
from polishd.studies.cases import Case
from polishd.util.secret_files import environment_without_secrets

COMMAND = (sys.executable, "-m", "polishd.studies.worker_process")
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")
"""Of each: as many processes as cores, and sums in one order, wherever it runs."""
READY_S = 300.0
"""In which it has begun: a file server may be slow."""
SAID = 500
"""Of what it printed as it died, so many characters are told."""


@dataclass(frozen=True, slots=True)
class Task:
    """Some cases of a study, as they go over the wire."""

    study: str
    run: str
    """Another for each run of the study: files are read again."""
    versions: Mapping[str, str]
    within_s: float
    """Wall time of a case, after which its process is killed."""
    cases: tuple[Case, ...]


@dataclass(frozen=True, slots=True)
class CaseResult:
    """What came of a case: its rows, or why there are none."""

    number: int
    rows: tuple[dict[str, Any], ...] = ()
    error: str = ""
    wall_s: float = 0.0
    cpu_s: float = 0.0


class StudyWorker:
    """One process, which works one case after the other."""

    def __init__(self, versions: Mapping[str, str]) -> None:
        """Start it. ConfigError where it does not begin, or has other versions."""
        self._said = tempfile.TemporaryFile()  # noqa: SIM115  (closed with the process)
        self._process = subprocess.Popen(
            COMMAND,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._said,
            env=environment_without_secrets({**ONE_THREAD, "PYTHONHASHSEED": "0"}),
            start_new_session=True,  # its plant is killed with it, and Ctrl-C is its owner's
        )
        self._rest = b""
        told = self._line(time.monotonic() + READY_S)
        if told is None:
            words = self.end()
            raise ConfigError(f"a worker of the study does not start: {words}; try {' '.join(COMMAND[1:])}")
        other = {name: (told["ready"].get(name), wanted) for name, wanted in versions.items()}
        wrong = [f"{name} {here or 'missing'} for {wanted}" for name, (here, wanted) in other.items() if here != wanted]
        if wrong:
            self.end()
            raise ConfigError(f"a worker has other versions: {', '.join(wrong)}; install the same on all machines")

    def ask(self, task: Task, case: Case) -> CaseResult:
        """One case; whatever comes of it is an answer. After one with an error of the process, it is dead.

        Raises ConfigError where it refuses the task.
        """
        began = time.monotonic()
        request = json.dumps({"study": task.study, "run": task.run, "case": asdict(case)}) + "\n"
        with contextlib.suppress(BrokenPipeError):  # it is dead: there will be no answer
            cast(IO[bytes], self._process.stdin).write(request.encode())
            cast(IO[bytes], self._process.stdin).flush()
        told = self._line(began + task.within_s)
        wall_s = time.monotonic() - began
        if told is None:
            hung = wall_s >= task.within_s
            words = self.end()
            why = f"did not end within {task.within_s:g} s and was killed" if hung else f"killed its worker: {words}"
            return CaseResult(case.number, error=why, wall_s=wall_s)
        if "refused" in told:
            raise ConfigError(told["refused"])
        failed = told.get("failed", "")
        return CaseResult(case.number, tuple(told.get("rows", ())), failed, told["wall_s"], told["cpu_s"])

    @property
    def alive(self) -> bool:
        """Whether it takes another case."""
        return self._process.returncode is None and self._process.poll() is None

    def kill(self) -> None:
        """Kill it and what it started."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)

    def end(self) -> str:
        """The same, and take away what is left of it; in words how it ended, and what it said last."""
        closed = self._said.closed
        self.kill()
        code = self._process.wait()
        for pipe in (self._process.stdin, self._process.stdout):
            with contextlib.suppress(BrokenPipeError):
                cast(IO[bytes], pipe).close()
        if closed:
            return ""
        self._said.seek(0)
        last = self._said.read()[-SAID:].decode(errors="replace").strip().splitlines()
        self._said.close()
        how = f"signal {-code}" if code < 0 else f"exit code {code}"
        return f"{how}, {last[-1]}" if last else how

    def _line(self, until: float) -> dict[str, Any] | None:
        """Its next answer; None where it died, or says nothing until then."""
        out = cast(IO[bytes], self._process.stdout).fileno()
        while b"\n" not in self._rest:
            ready, _, _ = select.select([out], [], [], max(until - time.monotonic(), 0.0))
            piece = os.read(out, 1 << 16) if ready else b""
            if not piece:
                return None
            self._rest += piece
        line, _, self._rest = self._rest.partition(b"\n")
        answer: dict[str, Any] = json.loads(line)
        return answer


class StudyWorkerPool:
    """Of each thread that runs tasks, its child."""

    def __init__(self) -> None:
        self._mine = threading.local()
        self._all: set[StudyWorker] = set()
        self._lock = threading.Lock()
        self._closed = False

    def run(self, task: Task) -> list[CaseResult]:
        """All cases of a task, in order, in this thread's child. ConfigError where they are refused."""
        return [self._child(task.versions).ask(task, case) for case in task.cases]

    def kill(self) -> None:
        """Kill all of them, and make no more; a thread that waits for one is answered at once."""
        with self._lock:
            self._closed = True
            for child in self._all:
                child.kill()

    def close(self) -> None:
        """After ``kill``, and when no thread runs any more: take what is left of them away."""
        while self._all:
            self._all.pop().end()

    def _child(self, versions: Mapping[str, str]) -> StudyWorker:
        child: StudyWorker | None = getattr(self._mine, "child", None)
        if child is not None and child.alive:
            return child
        made = None if self._closed else StudyWorker(versions)
        with self._lock:
            if made is None or self._closed:
                if made is not None:
                    made.end()
                raise ConfigError("the study was ended; begin it again, and it goes on")
            if child is not None:
                self._all.discard(child)
            self._all.add(made)
        self._mine.child = made
        return made
