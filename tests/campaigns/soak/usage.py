"""Resources of processes from /proc: CPU seconds of all; memory, descriptors and threads of those that run."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

TICK_S = 1.0 / os.sysconf("SC_CLK_TCK")
PAGE_MB = os.sysconf("SC_PAGE_SIZE") / 1e6


@dataclass(frozen=True, slots=True)
class Held:
    """Memory, file descriptors and threads of one process."""

    rss_mb: float
    descriptors: int
    threads: int


@dataclass(slots=True)
class Meter:
    """CPU seconds by group; a process that has ended counts with its last reading."""

    _used_s: dict[tuple[str, int, str], float] = field(default_factory=dict)
    """CPU seconds by group, process id and start time."""
    _more_s: Counter[str] = field(default_factory=Counter)
    _waited_s: dict[tuple[str, int], float] = field(default_factory=dict)
    """Waiting time for a processor by process id, at the last reading."""
    late_s: float = 0.0
    """Longest wait of any process except workers between two readings, since the caller set this to 0."""

    def look(self, groups: Mapping[str, Iterable[int]]) -> None:
        """Read the processes of each group."""
        for group, pids in groups.items():
            for pid in pids:
                if (found := _stat(pid)) is None:
                    continue
                self._used_s[group, pid, found[19]] = TICK_S * (int(found[11]) + int(found[12]))
                waited_s = _waited_s(pid)
                before_s = self._waited_s.get((group, pid), waited_s)
                self._waited_s[group, pid] = waited_s
                if group != "worker":
                    self.late_s = max(self.late_s, waited_s - before_s)

    def add(self, group: str, seconds: float) -> None:
        """Add CPU seconds that were measured elsewhere."""
        self._more_s[group] += seconds

    def total_s(self) -> Counter[str]:
        """Return the CPU seconds by group since the beginning."""
        total = self._more_s.copy()
        for (group, *_), seconds in self._used_s.items():
            total[group] += seconds
        return total


def held(pid: int) -> Held | None:
    """Return the resources of a process; None where it does not run."""
    found = _stat(pid)
    if found is None:
        return None
    try:
        return Held(PAGE_MB * int(found[21]), len(os.listdir(f"/proc/{pid}/fd")), int(found[17]))  # noqa: PTH208
    except OSError:
        return None


def children(pid: int) -> list[int]:
    """Return the process ids of the children of all threads of a process."""
    found: list[int] = []
    for task in Path(f"/proc/{pid}/task").glob("*/children"):
        try:
            found += map(int, task.read_text().split())
        except OSError:
            continue  # it ended meanwhile
    return found


def _waited_s(pid: int) -> float:
    """Return the seconds for which the first thread, which serves the wires, was ready but had no processor."""
    try:
        return int(Path(f"/proc/{pid}/task/{pid}/schedstat").read_text().split()[1]) / 1e9
    except OSError:
        return 0.0


def _stat(pid: int) -> list[str] | None:
    """Return the fields of /proc/PID/stat from the third on: proc(5) numbers them from 1, this list from 3."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return None
