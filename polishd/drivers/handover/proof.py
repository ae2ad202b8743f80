"""Whether the line that a controller shows is the one that it executes: shown by dwells of known times. Sans-IO.

A controller that reads ahead shows a dwell's line for as long as reading takes it; one that runs another file shows it
for another time, since the times are drawn anew for each file.
"""

from __future__ import annotations

import random
from collections.abc import Sequence

REPORTS = (6.0, 12.0)
"""A dwell lasts so many reports: long enough to be seen, whatever the reports miss."""
MORE_S = 1.0
"""Wall seconds that a controller may take beyond a dwell."""
_CHANCE = random.SystemRandom()


def dwells_s(report_s: float, count: int = 2) -> list[float]:
    """Times for the dwells of one file, s."""
    return [round(report_s * _CHANCE.uniform(*REPORTS), 3) for _ in range(count)]


class LineCheck:
    """Follows the dwells of one file: told of each line with its time, it says what is wrong once they are over."""

    def __init__(self, lines: Sequence[int], seconds: Sequence[float], more_s: float) -> None:
        """``lines``: rising lines of the file; ``more_s``: by how much a dwell may be longer, controller's time."""
        self._left = list(zip(lines, seconds, strict=False))
        self._more_s = more_s
        self._before_s: float | None = None
        """When the last look was."""
        self._first: tuple[float, float] | None = None
        """(before, at): between them the dwell under way was first shown."""

    @property
    def over(self) -> bool:
        """Nothing is left to be proved."""
        return not self._left

    def look(self, line: int, time_s: float) -> str:
        """What the controller shows now; returns what is wrong with it, or nothing."""
        wrong = ""
        while self._left and not wrong and line >= self._left[0][0]:
            dwell, seconds = self._left[0]
            if self._first is None:
                self._first = (time_s if self._before_s is None else self._before_s, time_s)
            if line == dwell:
                break
            wrong = self._judge(dwell, seconds, time_s)
            del self._left[0]
            self._first = None
        self._before_s = time_s
        return wrong

    def _judge(self, dwell: int, seconds: float, now_s: float) -> str:
        if self._first is None or self._before_s is None:
            return ""
        longest_s, least_s = now_s - self._first[0], self._before_s - self._first[1]
        if longest_s >= seconds * 0.99 and least_s <= seconds + self._more_s:
            return ""
        return (
            f"the line that it shows is not the block that it executes: a dwell of {seconds:.3f} s, line {dwell} of "
            f"the file, was shown for {max(least_s, 0.0):.3f} to {longest_s:.3f} s"
        )
