"""Process of the daemon: priorities (the contact loop before the solver, docs/how-to/host.md), supervisor, and log."""

from __future__ import annotations

import asyncio
import ctypes
import json
import logging
import logging.handlers
import os
import queue
import resource
import socket
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from polishd.model.events import Event, StateChanged
from polishd.model.text import printable
from polishd.util.serialization import plain

log = logging.getLogger(__name__)

LOOP_NICE = -10
BEHIND = 5
"""Nice levels of the solver after a loop without raised priority. With more, other programs starve the solver."""
# linux/mman.h; ONFAULT: lock pages at their first use, not all reserved ones
_MCL_CURRENT, _MCL_FUTURE, _MCL_ONFAULT = 1, 2, 4
_CAP_IPC_LOCK = 14


@dataclass(frozen=True, slots=True)
class PriorityResult:
    """Priority and memory lock that this computer grants to the contact loop."""

    first: bool
    """It runs before everything of normal priority."""
    locked: bool
    """Its memory cannot be swapped out."""
    cores: int

    def __str__(self) -> str:
        """Text for ``polishd check`` and the log."""
        first = f"contact loop at nice {LOOP_NICE}" if self.first else f"nice {LOOP_NICE} is not allowed: no priority"
        locked = "memory locked" if self.locked else "memory may be swapped out"
        spare = "one core kept free of computing" if self.cores > 2 else "no core to keep free"
        missing = "" if self.first and self.locked else " (docs/how-to/host.md)"
        return f"{first}, {locked}, {self.cores} cores: {spare}{missing}"


@contextmanager
def loop_first() -> Iterator[PriorityResult]:
    """Raise the priority of the calling thread and lock memory inside this block, as far as this computer allows.

    Threads and processes that it starts do not inherit the priority.
    """
    if sys.platform != "linux":
        yield PriorityResult(first=False, locked=False, cores=os.cpu_count() or 1)
        return
    nice, policy = os.getpriority(os.PRIO_PROCESS, 0), os.sched_getscheduler(0)
    granted = PriorityResult(_raised(nice, policy), _locked(), len(os.sched_getaffinity(0)))
    log.info("host: %s", granted)
    try:
        yield granted
    finally:
        os.setpriority(os.PRIO_PROCESS, 0, nice)
        with suppress(OSError):  # the other policy does no harm
            os.sched_setscheduler(0, policy, os.sched_getparam(0))
        if granted.locked:
            ctypes.CDLL(None).munlockall()


def host() -> str:
    """Return the text on what this computer grants to a run. It tries and restores the settings."""
    with loop_first() as granted:
        return str(granted)


def compute_last() -> None:
    """Lower this process, the compute worker, below the contact loop, and keep it off the loop's core.

    Normal priority is low enough where the loop is raised.
    """
    if sys.platform == "linux":
        behind = os.getpriority(os.PRIO_PROCESS, os.getppid()) + BEHIND  # of the main thread, which is the loop's
        os.setpriority(os.PRIO_PROCESS, 0, max(os.getpriority(os.PRIO_PROCESS, 0), behind, 0))
        with suppress(OSError):
            os.sched_setaffinity(0, cores_to_compute(os.sched_getaffinity(0)))


def cores_to_compute(allowed: set[int]) -> set[int]:
    """Return all cores but the first, where there are more than two."""
    return allowed - {min(allowed)} if len(allowed) > 2 else allowed


def _raised(nice: int, policy: int) -> bool:
    """Raise the priority of the calling thread only."""
    try:
        os.sched_setscheduler(0, policy | os.SCHED_RESET_ON_FORK, os.sched_getparam(0))
        os.setpriority(os.PRIO_PROCESS, 0, min(nice, LOOP_NICE))
    except OSError:
        return False
    return True


def _locked() -> bool:
    """Lock the process's memory, where that has no limit: beyond a limit, allocations would fail."""
    unlimited = resource.getrlimit(resource.RLIMIT_MEMLOCK)[0] == resource.RLIM_INFINITY
    flags = _MCL_CURRENT | _MCL_FUTURE | _MCL_ONFAULT
    return (unlimited or _may_lock()) and ctypes.CDLL(None).mlockall(flags) == 0


def _may_lock() -> bool:
    """Return whether the process has CAP_IPC_LOCK, so that no limit applies."""
    status = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text().splitlines())
    return bool(int(status["CapEff"], 16) >> _CAP_IPC_LOCK & 1)


# Reports to the supervisor of the process: sd_notify of systemd, over ``NOTIFY_SOCKET``.


SOCKET, WATCHDOG_US, WATCHDOG_PID = "NOTIFY_SOCKET", "WATCHDOG_USEC", "WATCHDOG_PID"


class SystemdNotifier:
    """Reports of a process with that number of cells; ``environment`` is from systemd."""

    def __init__(self, cells: int = 1, environment: Mapping[str, str] = os.environ) -> None:
        self._cells = cells
        self._address = environment.get(SOCKET, "")
        self.watchdog_s = _watchdog_s(environment)
        """Time without a report after which systemd kills the process; 0 without a watchdog."""
        self._states: dict[str, str] = {}

    def stopping(self) -> None:
        """Report that the end begins."""
        self._send("STOPPING=1")

    def status_sink(self, cell: str) -> Callable[[Event], None]:
        """Return a sink for that cell's bus, which reports its state and the reason."""

        def report(event: Event) -> None:
            if isinstance(event, StateChanged):
                self.status(cell, f"{cell}: {event.state}{f': {event.reason}' if event.reason else ''}")

        return report

    def status(self, cell: str, text: str) -> None:
        """Report a line on a cell. The process is ready when each cell has a line: all answer, or have ended."""
        waited_for = len(self._states) < self._cells
        self._states[cell] = " ".join(text.split())
        ready = ["READY=1"] if waited_for and len(self._states) == self._cells else []
        self._send("\n".join([*ready, "STATUS=" + "; ".join(self._states.values())]))

    async def feed(self, lives: Callable[[float], bool]) -> None:
        """Feed the watchdog while ``lives`` is true: each row older than so many seconds is durable.

        A blocked event loop does not feed it either.
        """
        while self.watchdog_s:
            if lives(self.watchdog_s / 2):
                self._send("WATCHDOG=1")
            else:
                log.error("a journal is not written in time: the daemon does not feed the service's watchdog")
            await asyncio.sleep(self.watchdog_s / 4)

    def _send(self, text: str) -> None:
        if not self._address:
            return
        address = "\0" + self._address[1:] if self._address.startswith("@") else self._address
        try:
            with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as supervisor:
                supervisor.setblocking(False)
                supervisor.sendto(text.encode(), address)
        except OSError as error:
            log.warning("%s cannot be sent to the supervisor of this process: %s", text, error)


def _watchdog_s(environment: Mapping[str, str]) -> float:
    """Return systemd's watchdog time; 0 where it is for another process, or no number."""
    if environment.get(WATCHDOG_PID, str(os.getpid())) != str(os.getpid()):
        return 0.0
    text = environment.get(WATCHDOG_US, "")
    return int(text) / 1e6 if text.isdecimal() else 0.0


# Structured log of a cell in its state folder: one JSON object a line, times in UTC.

LOG_NAME = "polishd.log"
_MAX_BYTES = 10_000_000
_KEPT = 5
_cell: ContextVar[Path | None] = ContextVar("cell", default=None)
"""State folder of the cell of this context."""


class JsonLines(logging.Formatter):
    """``{"at", "level", "logger", "message"}``, with ``event`` of an event and ``error`` of an exception."""

    def format(self, record: logging.LogRecord) -> str:
        """One line."""
        line: dict[str, object] = {
            "at": datetime.fromtimestamp(record.created, UTC).isoformat(timespec="milliseconds"),
            "level": record.levelname.lower(),
            "logger": record.name,
            "message": record.getMessage(),
        }
        if hasattr(record, "event"):
            line["event"] = record.event
        if record.exc_info:
            line["error"] = self.formatException(record.exc_info)
        return printable(json.dumps(line, default=plain))


@contextmanager
def logging_to(state_dir: Path) -> Iterator[None]:
    """Write the log of a cell to ``state_dir/polishd.log`` (rotated) inside this block.

    It has the records of this context: of the tasks and threads that begin in the block. Records without a cell go to
    the log of each cell. A thread writes, so that the contact loop does not wait for the disk.
    """
    file = logging.handlers.RotatingFileHandler(
        state_dir / LOG_NAME, maxBytes=_MAX_BYTES, backupCount=_KEPT, encoding="utf-8"
    )
    lines: queue.SimpleQueue[logging.LogRecord] = queue.SimpleQueue()
    handler = logging.handlers.QueueHandler(lines)
    handler.setFormatter(JsonLines())  # here, with the present values: the queue gets the line
    handler.addFilter(lambda _: _cell.get() in {None, state_dir})
    _cell.set(state_dir)
    writer = logging.handlers.QueueListener(lines, file)
    writer.start()
    logger = logging.getLogger("polishd")
    logger.addHandler(handler)
    logger.setLevel(logging.INFO)
    try:
        yield
    finally:
        logger.removeHandler(handler)
        if not logger.handlers:  # else another cell logs
            logger.setLevel(logging.NOTSET)
        writer.stop()
        file.close()
