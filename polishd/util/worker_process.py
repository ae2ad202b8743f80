"""Worker processes that can be killed: requests and answers, limits of time and memory, and how a worker ended."""

from __future__ import annotations

import io
import math
import os
import resource
import select
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any, BinaryIO, NoReturn, Self, cast

from polishd.model.errors import ComputeError, FrameError, WorkerError
from polishd.util import array_stream
from polishd.util.array_stream import Arrays, Message
from polishd.util.files import environment_without_secrets

LOOK_S = 0.1
"""Time between two looks at what a worker has used."""
STDERR_BYTES = 1 << 12
"""Of what a worker printed last, so much is kept."""
_THREAD_VARIABLES = (
    "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS", "NUMBA_NUM_THREADS",
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class WorkerLimit:
    """Limits of one request."""

    wall_s: float = math.inf
    cpu_s: float = math.inf
    """Of all threads of the worker. A process that a busy machine starves does not use it up."""
    memory_bytes: int | None = None
    """Address space beyond what the worker has before the request."""
    key: str = ""
    """The config key that increases the limit."""


START_LIMIT = WorkerLimit(wall_s=360.0, cpu_s=60.0)
"""Until a worker is ready: a file server may be slow."""
NO_LIMIT = WorkerLimit()


def process_cpu_s(pid: int) -> float:
    """Return the CPU seconds that all threads of a process have used; 0 where it is gone or there is no /proc."""
    try:
        stat = Path(f"/proc/{pid}/stat").read_text()
    except OSError:
        return 0.0
    # user and system time are the 12th and 13th field after the name, which may contain any character
    fields = stat.rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


class WorkerProcess:
    """A process that answers one request after another; it is killed when a request exceeds its limit.

    One thread at a time makes requests. ``kill`` may be called from any thread: the request then ends with WorkerError.
    The worker also ends when the program that started it ends. It inherits no secrets.
    """

    def __init__(
        self,
        target: str,
        name: str,
        *,
        threads: int | None = None,
        environment: Mapping[str, str] = MappingProxyType({}),
        has_log: bool = False,
    ) -> None:
        """Start it, without waiting for it. WorkerError.

        Args:
            target: ``module:function``, see ``worker_main``.
            name: what messages call it.
            threads: of numerical libraries; None: as in this program.
            environment: variables beside those that Python and its libraries need.
            has_log: whether what it prints also goes to this program's stderr.
        """
        self.name = name
        self._has_log = has_log
        self._was_killed = False
        self._printed = b""
        self._ready: dict[str, Any] | None = None
        lifeline, self._lifeline = os.pipe()
        threading = {} if threads is None else dict.fromkeys(_THREAD_VARIABLES, str(threads))
        path = {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
        try:
            self._process = subprocess.Popen(
                # -P: the working folder stays off its path
                [sys.executable, "-P", "-m", "polishd.util.worker_main", target, str(lifeline)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                bufsize=0,
                pass_fds=(lifeline,),
                process_group=0,  # Ctrl-C is for this program, and what the worker starts is killed with it
                env=environment_without_secrets({**path, **threading, **environment}),
            )
        except OSError as error:
            os.close(self._lifeline)
            raise WorkerError(f"{name} cannot be started: {error.strerror}") from error
        finally:
            os.close(lifeline)
        self._pipes = [
            cast(io.FileIO, one) for one in (self._process.stdin, self._process.stdout, self._process.stderr)
        ]
        self._requests, out, self._stderr = [pipe.fileno() for pipe in self._pipes]
        for pipe in (self._requests, self._stderr):
            os.set_blocking(pipe, False)
        self._answer_pipe = _AnswerPipe(out, self._wait_for)
        self._answers = io.BufferedReader(self._answer_pipe, 1 << 16)
        self._has_stderr = True
        self._watch = _Watch(self.pid, START_LIMIT)

    @property
    def pid(self) -> int:
        """Its process id."""
        return self._process.pid

    @property
    def alive(self) -> bool:
        """Whether it can take another request."""
        if self._process.returncode is not None:
            return False
        return os.waitid(os.P_PID, self.pid, os.WEXITED | os.WNOHANG | os.WNOWAIT) is None

    def start(self) -> dict[str, Any]:
        """Wait until it is ready, and return what it states then. WorkerError."""
        if self._ready is None:
            message, _ = self._exchange((), START_LIMIT, "did not start: ")
            if not isinstance(message.get("ready"), dict):
                self._fail("did not start: it sent no statement")
            self._ready = message["ready"]
        return self._ready

    def request(
        self, message: Mapping[str, Any], arrays: Arrays | None = None, limit: WorkerLimit = NO_LIMIT
    ) -> Message:
        """Return the answer.

        Raises:
            FrameError: the request is too large; it was not sent.
            ComputeError: the worker refuses the request, for the reason in the message, and can take another.
            WorkerError: the worker exceeded the limit, ended, or broke the protocol. It has ended.
        """
        self.start()
        answer = self._exchange(array_stream.encode(message, arrays), limit)
        if "error" in answer[0]:
            raise ComputeError(str(answer[0]["error"]))
        return answer

    def kill(self) -> None:
        """Kill it and what it started, without waiting."""
        self._was_killed = True
        self._kill_group()

    def end(self) -> str:
        """Kill it, wait for its end, and describe how it ended. Idempotent."""
        self._kill_group()
        code = self._process.wait()
        if self._lifeline >= 0:
            while self._has_stderr and self._read_stderr():
                pass
            for pipe in self._pipes:
                pipe.close()
            os.close(self._lifeline)
            self._lifeline = -1
        how = f"was ended by {signal.Signals(-code).name}" if code < 0 else f"ended with exit code {code}"
        if code == -signal.SIGKILL:
            how += " (by polishd)" if self._was_killed else " (is the computer out of memory?)"
        last = self.stderr_tail.splitlines()[-1:]
        return f"{how}: {last[0]}" if last else how

    @property
    def stderr_tail(self) -> str:
        """What it printed last."""
        return self._printed.decode(errors="replace").strip()

    def __enter__(self) -> Self:
        """Itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """End it."""
        self.end()

    def _kill_group(self) -> None:
        if self._process.returncode is None:
            with suppress(ProcessLookupError):
                os.killpg(self.pid, signal.SIGKILL)

    def _exchange(self, pieces: Iterable[bytes | memoryview], limit: WorkerLimit, prefix: str = "") -> Message:
        try:
            if limit.memory_bytes is not None:
                _limit_memory(self.pid, limit.memory_bytes)
            self._watch = _Watch(self.pid, limit)
            for piece in pieces:
                self._write(memoryview(piece))
            answer = array_stream.read(cast(BinaryIO, self._answers))
        except TimeoutError as error:
            self._fail(f"{prefix}exceeded its limit: {error}")
        except OSError:
            answer = None  # it has ended, and no longer reads
        except FrameError as error:
            if not self._answer_pipe.has_ended:
                self._fail(f"{prefix}broke the protocol: {error}")
            answer = None  # it ended in the middle of its answer
        except BaseException:
            self.end()  # its answer would be taken for that of the next request
            raise
        if answer is None:
            self._fail(f"{prefix}{self.end()}")
        return answer

    def _fail(self, why: str) -> NoReturn:
        self.end()
        error = WorkerError(f"{self.name} {why}")
        if self.stderr_tail:
            error.add_note(self.stderr_tail)
        raise error

    def _write(self, piece: memoryview) -> None:
        while piece:
            self._wait_for(self._requests, select.POLLOUT)
            piece = piece[os.write(self._requests, piece) :]

    def _wait_for(self, pipe: int, event: int) -> None:
        """Wait until one of its pipes is ready, and keep what it prints meanwhile. TimeoutError at the limit."""
        poll = select.poll()
        poll.register(pipe, event)
        if self._has_stderr:
            poll.register(self._stderr, select.POLLIN)
        while True:
            self._watch.check()
            ready = dict(poll.poll(LOOK_S * 1000))
            if self._stderr in ready and not self._read_stderr() and not self._has_stderr:
                poll.unregister(self._stderr)
            if pipe in ready:
                return

    def _read_stderr(self) -> bool:
        """Read what it printed; return whether there was anything."""
        try:
            printed = os.read(self._stderr, 1 << 16)
        except BlockingIOError:
            return False
        self._has_stderr = bool(printed)
        self._printed = (self._printed + printed)[-STDERR_BYTES:]
        if self._has_log:
            with suppress(OSError):
                os.write(2, printed)
        return self._has_stderr


class _AnswerPipe(io.RawIOBase):
    """The answers of a worker, read within its limits."""

    def __init__(self, pipe: int, wait_for: Callable[[int, int], None]) -> None:
        self._pipe, self._wait_for = pipe, wait_for
        self.has_ended = False

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: Any) -> int:
        self._wait_for(self._pipe, select.POLLIN)
        count = os.readv(self._pipe, [buffer])
        self.has_ended = not count
        return count


class _Watch:
    """What a request has used of its limit, counted from the time this is made."""

    def __init__(self, pid: int, limit: WorkerLimit) -> None:
        self._pid, self._limit = pid, limit
        self._cpu_s, self._wall_s = process_cpu_s(pid), time.monotonic()
        self._next_look_s = self._wall_s

    def check(self) -> None:
        """TimeoutError, with what was used, where the limit is exceeded. Looks every LOOK_S only."""
        now_s = time.monotonic()
        if now_s < self._next_look_s:
            return
        self._next_look_s = now_s + LOOK_S
        limit = self._limit
        cpu_s, wall_s = max(process_cpu_s(self._pid) - self._cpu_s, 0.0), now_s - self._wall_s
        if cpu_s >= limit.cpu_s or wall_s >= limit.wall_s:
            cpu = f"{cpu_s:.1f} s of CPU time (limit {limit.cpu_s:g} s)" if limit.cpu_s < math.inf else ""
            wall = f"{wall_s:.1f} s (limit {limit.wall_s:g} s)" if limit.wall_s < math.inf else ""
            more = f". Increase {limit.key}." if limit.key else ""
            raise TimeoutError(f"{' in '.join(filter(None, (cpu, wall)))}{more}")


def _limit_memory(pid: int, more: int) -> None:
    """Limit the address space of a process to so many bytes more than it has."""
    has = int(Path(f"/proc/{pid}/statm").read_text().split()[0]) * resource.getpagesize()
    hard = resource.prlimit(pid, resource.RLIMIT_AS)[1]
    most = has + more if hard == resource.RLIM_INFINITY else min(has + more, hard)
    resource.prlimit(pid, resource.RLIMIT_AS, (most, hard))
