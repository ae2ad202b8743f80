"""Who computes first: the loop that is in contact with the part, and our own solving behind it. See docs/host.md."""

from __future__ import annotations

import ctypes
import logging
import os
import resource
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

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
