"""Time limits that a busy machine does not break: what it keeps from this process does not count.

A limit that only ends what hangs is ``SOON_S``. Where being prompt is the point, ``within`` and ``OwnClock`` take off
the time that threads of this process could run and others did (``/proc/self/task/*/schedstat``).
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

SOON_S = 240.0
"""For what ends at once on an idle machine: only what hangs takes longer on a busy one."""


def waits() -> dict[str, int]:
    """Nanoseconds that each thread of this process could have run and did not get a processor; only Linux tells."""
    found = {}
    for task in Path("/proc/self/task").glob("*"):
        try:
            found[task.name] = int((task / "schedstat").read_text().split()[1])
        except (OSError, IndexError):
            continue  # a thread that ended meanwhile
    return found


class OwnClock:
    """``time.monotonic`` of a machine that would be this process's own."""

    def __init__(self) -> None:
        self._last = waits()
        self._kept_s = 0.0

    def monotonic(self) -> float:
        """Seconds."""
        now_s, found = time.monotonic(), waits()
        self._kept_s += sum(waited - self._last.get(name, 0) for name, waited in found.items()) / 1e9
        self._last = found
        return now_s - self._kept_s


@contextmanager
def within(limit_s: float) -> Iterator[None]:
    """What takes longer is wrong."""
    clock = OwnClock()
    began_s = clock.monotonic()
    yield
    if (took_s := clock.monotonic() - began_s) >= limit_s:
        raise AssertionError(f"it took {took_s:.1f} s; {limit_s:g} s are allowed")
