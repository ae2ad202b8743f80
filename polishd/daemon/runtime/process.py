"""Who computes first: the loop that is in contact with the part, and our own solving behind it. See docs/host.md."""

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
"""Nice levels that computing stands behind a loop that could not be raised. More, and other programs starve it."""
# linux/mman.h; ONFAULT: pages when they are first used, not all that was ever reserved
_MCL_CURRENT, _MCL_FUTURE, _MCL_ONFAULT = 1, 2, 4
_CAP_IPC_LOCK = 14


@dataclass(frozen=True, slots=True)
class PriorityResult:
    """What this computer lets the contact loop have."""

    first: bool
    """It runs before everything of usual priority."""
    locked: bool
    """Its memory cannot be swapped out."""
    cores: int

    def __str__(self) -> str:
        """For ``polishd check`` and the log."""
        first = f"contact loop at nice {LOOP_NICE}" if self.first else f"nice {LOOP_NICE} is not allowed: no priority"
        locked = "memory locked" if self.locked else "memory may be swapped out"
        spare = "one core kept free of computing" if self.cores > 2 else "no core to keep free"
        missing = "" if self.first and self.locked else " (docs/host.md)"
        return f"{first}, {locked}, {self.cores} cores: {spare}{missing}"


@contextmanager
def loop_first() -> Iterator[PriorityResult]:
    """The calling thread runs before others, in memory that stays, as far as this computer allows; until the end.

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
        with suppress(OSError):  # it harms nobody
            os.sched_setscheduler(0, policy, os.sched_getparam(0))
        if granted.locked:
            ctypes.CDLL(None).munlockall()


def host() -> str:
    """What a run would be granted here, in words: tried, and given back."""
    with loop_first() as granted:
        return str(granted)


def compute_last() -> None:
    """For the daemon's process that computes: behind the loop, and not on the core that is kept for it.

    Behind a raised loop usual priority is enough.
    """
    if sys.platform == "linux":
        behind = os.getpriority(os.PRIO_PROCESS, os.getppid()) + BEHIND  # of the main thread, which is the loop's
        os.setpriority(os.PRIO_PROCESS, 0, max(os.getpriority(os.PRIO_PROCESS, 0), behind, 0))
        with suppress(OSError):
            os.sched_setaffinity(0, cores_to_compute(os.sched_getaffinity(0)))


def cores_to_compute(allowed: set[int]) -> set[int]:
    """All but the first, where there are more than two."""
    return allowed - {min(allowed)} if len(allowed) > 2 else allowed


def _raised(nice: int, policy: int) -> bool:
    """Raise the calling thread, alone."""
    try:
        os.sched_setscheduler(0, policy | os.SCHED_RESET_ON_FORK, os.sched_getparam(0))
        os.setpriority(os.PRIO_PROCESS, 0, min(nice, LOOP_NICE))
    except OSError:
        return False
    return True


def _locked() -> bool:
    """Lock the process's memory, where there is no limit to it: with one, allocations beyond it would fail."""
    unlimited = resource.getrlimit(resource.RLIMIT_MEMLOCK)[0] == resource.RLIM_INFINITY
    flags = _MCL_CURRENT | _MCL_FUTURE | _MCL_ONFAULT
    return (unlimited or _may_lock()) and ctypes.CDLL(None).mlockall(flags) == 0


def _may_lock() -> bool:
    """Whether the capability CAP_IPC_LOCK is there, which no limit binds."""
    status = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text().splitlines())
    return bool(int(status["CapEff"], 16) >> _CAP_IPC_LOCK & 1)


# What the daemon tells whoever supervises its process: sd_notify of systemd, over ``NOTIFY_SOCKET``.


SOCKET, WATCHDOG_US, WATCHDOG_PID = "NOTIFY_SOCKET", "WATCHDOG_USEC", "WATCHDOG_PID"


class SystemdNotifier:
    """Of the process in which so many cells run; ``environment`` is what systemd set."""

    def __init__(self, cells: int = 1, environment: Mapping[str, str] = os.environ) -> None:
        self._cells = cells
        self._address = environment.get(SOCKET, "")
        self.watchdog_s = _watchdog_s(environment)
        """It kills the process that says nothing for so long; 0 where it does not."""
        self._states: dict[str, str] = {}

    def stopping(self) -> None:
        """The end was asked for."""
        self._tell("STOPPING=1")

    def hears(self, cell: str) -> Callable[[Event], None]:
        """A sink for that cell's bus: its state, with the reason, is what the supervisor shows."""

        def hear(event: Event) -> None:
            if isinstance(event, StateChanged):
                self.status(cell, f"{cell}: {event.state}{f': {event.reason}' if event.reason else ''}")

        return hear

    def status(self, cell: str, text: str) -> None:
        """One line on a cell; with the last one's first the process is ready: all answer, or have ended already."""
        waited_for = len(self._states) < self._cells
        self._states[cell] = " ".join(text.split())
        ready = ["READY=1"] if waited_for and len(self._states) == self._cells else []
        self._tell("\n".join([*ready, "STATUS=" + "; ".join(self._states.values())]))

    async def feed(self, lives: Callable[[float], bool]) -> None:
        """Feed the watchdog for as long as ``lives`` (all is written that is older than so many seconds) says so.

        Only a loop that turns comes here at all.
        """
        while self.watchdog_s:
            if lives(self.watchdog_s / 2):
                self._tell("WATCHDOG=1")
            else:
                log.error("a journal is not written any more: the watchdog of the service is not fed")
            await asyncio.sleep(self.watchdog_s / 4)

    def _tell(self, text: str) -> None:
        if not self._address:
            return
        address = "\0" + self._address[1:] if self._address.startswith("@") else self._address
        try:
            with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as told:
                told.setblocking(False)
                told.sendto(text.encode(), address)
        except OSError as error:
            log.warning("the supervisor of this process cannot be told %s: %s", text, error)


def _watchdog_s(environment: Mapping[str, str]) -> float:
    """0 where it is another process's, or no number."""
    if environment.get(WATCHDOG_PID, str(os.getpid())) != str(os.getpid()):
        return 0.0
    text = environment.get(WATCHDOG_US, "")
    return int(text) / 1e6 if text.isdecimal() else 0.0


# The structured log of a cell: one JSON object a line in its state folder, for machines; times are UTC.

LOG_NAME = "polishd.log"
_MAX_BYTES = 10_000_000
_KEPT = 5
_cell: ContextVar[Path | None] = ContextVar("cell", default=None)
"""The state folder of the cell at work."""


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
    """What polishd logs of a cell goes to ``state_dir/polishd.log`` (rotated) inside this block.

    Of a cell is what is logged in this context: by the tasks and threads that begin in the block. What belongs to no
    cell is in the log of each. A thread writes it: who logs in contact does not wait for the disk.
    """
    file = logging.handlers.RotatingFileHandler(
        state_dir / LOG_NAME, maxBytes=_MAX_BYTES, backupCount=_KEPT, encoding="utf-8"
    )
    lines: queue.SimpleQueue[logging.LogRecord] = queue.SimpleQueue()
    handler = logging.handlers.QueueHandler(lines)
    handler.setFormatter(JsonLines())  # here, as things are now; what is queued is the line
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
        if not logger.handlers:  # else another cell still logs
            logger.setLevel(logging.NOTSET)
        writer.stop()
        file.close()
