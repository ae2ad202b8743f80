"""Time limit of a solve: CPU seconds, which a busy machine does not use up, and a wall-clock backstop."""

from __future__ import annotations

import time

SLOWEST = 10.0
"""Wall seconds for each CPU second that a busy machine may take."""
IDLE_S = 60.0
"""And so many more for what uses no CPU: a licence server that is asked, memory that was swapped out."""


def backstop_s(within_s: float) -> float:
    """Wall seconds after which a limit of so many CPU seconds is over, whatever was computed."""
    return SLOWEST * within_s + IDLE_S


class TimeLimit:
    """CPU seconds of the thread that makes it and asks it, counted from then on; `backstop_s` stands behind them.

    Of the thread and not of the process: how many threads BLAS lets spin beside it depends on the computer.
    """

    def __init__(self, within_s: float) -> None:
        self._within_s = within_s
        self._cpu, self._wall = time.thread_time(), time.monotonic()

    @property
    def cpu_s(self) -> float:
        """CPU seconds used."""
        return time.thread_time() - self._cpu

    @property
    def wall_s(self) -> float:
        """Wall seconds gone by."""
        return time.monotonic() - self._wall

    @property
    def left_s(self) -> float:
        """CPU seconds left; 0 when the limit is over."""
        return 0.0 if self.expired() else self._within_s - self.cpu_s

    def expired(self) -> bool:
        """Return whether the limit is over."""
        return self.cpu_s >= self._within_s or self.wall_s >= backstop_s(self._within_s)

    def __str__(self) -> str:
        """Return the used times as text."""
        return f"{self.cpu_s:.1f} s of CPU time and {self.wall_s:.1f} s of wall time"
