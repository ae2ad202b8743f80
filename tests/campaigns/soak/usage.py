"""What processes use, from /proc: CPU seconds of all that ever ran, and what those that run hold now."""

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
    """What one process holds."""

    rss_mb: float
    descriptors: int
    threads: int


@dataclass(slots=True)
class Meter:
    """CPU seconds by group; a process that has ended keeps what it had used when it was looked at last."""

    _used_s: dict[tuple[str, int, str], float] = field(default_factory=dict)
    """By group, process id and start time."""
    _more_s: Counter[str] = field(default_factory=Counter)
    _waited_s: dict[tuple[str, int], float] = field(default_factory=dict)
    """For a processor, by process id, when it was looked at last."""
    late_s: float = 0.0
    """Longest that any process was kept waiting between two looks, since somebody set this to 0; workers aside."""

    def look(self, groups: Mapping[str, Iterable[int]]) -> None:
        """At the processes of each group, as they are now."""
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
        """What somebody else has measured."""
        self._more_s[group] += seconds

    def total_s(self) -> Counter[str]:
        """By group, since the beginning."""
        total = self._more_s.copy()
        for (group, *_), seconds in self._used_s.items():
            total[group] += seconds
        return total


def held(pid: int) -> Held | None:
    """None where it does not run."""
    found = _stat(pid)
    if found is None:
        return None
    try:
        return Held(PAGE_MB * int(found[21]), len(os.listdir(f"/proc/{pid}/fd")), int(found[17]))  # noqa: PTH208
    except OSError:
        return None


def children(pid: int) -> list[int]:
    """Those of all its threads."""
    found: list[int] = []
    for task in Path(f"/proc/{pid}/task").glob("*/children"):
        try:
            found += map(int, task.read_text().split())
        except OSError:
            continue  # it ended meanwhile
    return found


def _waited_s(pid: int) -> float:
    """Seconds that its first thread, which serves the wires, could have run and did not get a processor."""
    try:
        return int(Path(f"/proc/{pid}/task/{pid}/schedstat").read_text().split()[1]) / 1e9
    except OSError:
        return 0.0


def _stat(pid: int) -> list[str] | None:
    """The fields of /proc/PID/stat from the third on: proc(5) numbers them from 1, this list from 3."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return None
