"""Speed of the tool from the poses that the controller reports, against the speed that its instructions command.

It is independent of the speed override that the controller reports. Only pairs of poses count that prove slow motion:
both lie well inside one straight move, where the tool has its full speed even with a low acceleration, and the time
between them is the shortest that the times of request and answer allow.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

LEAST_ACCEL_MM_S2 = 200.0
"""Acceleration that each controller has at least."""
FULL = 0.7
"""A pose counts where the tool has at least this fraction of its commanded speed."""
ASIDE_MM = 0.1
"""Largest distance of a pose from the straight line between both ends of its move."""
MOST_TURN_DEG_S = 20.0
"""Moves that turn the tool faster may be limited by the turn, and do not count."""
SLOW = 0.8
"""Fraction of the commanded speed below which motion is slow."""
SLOW_PAIRS = 4
"""Consecutive pairs of poses that show slow motion before it is reported."""
Xyz = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class StraightMove:
    """A linear move, as commanded."""

    begin_mm: Xyz
    end_mm: Xyz
    speed_mm_s: float

    def full_share(self, at_mm: Xyz) -> float:
        """Return the least fraction of the commanded speed that the tool has at a position; 0 off the line."""
        length_mm = math.dist(self.begin_mm, self.end_mm)
        way = [end - begin for begin, end in zip(self.begin_mm, self.end_mm, strict=True)]
        offset = [at - begin for begin, at in zip(self.begin_mm, at_mm, strict=True)]
        along_mm = sum(a * b for a, b in zip(way, offset, strict=True)) / length_mm if length_mm else 0.0
        aside_mm = math.sqrt(max(sum(part**2 for part in offset) - along_mm**2, 0.0))
        inside_mm = min(along_mm, length_mm - along_mm)
        if aside_mm > ASIDE_MM or inside_mm <= 0.0:
            return 0.0
        return min(math.sqrt(2.0 * LEAST_ACCEL_MM_S2 * inside_mm) / self.speed_mm_s, 1.0)


@dataclass(frozen=True, slots=True)
class _Sample:
    instruction: int
    position_mm: Xyz
    asked_s: float
    answered_s: float


class MotionSpeed:
    """Watch of one program's speed."""

    def __init__(self) -> None:
        """Nothing is measured yet."""
        self._last: _Sample | None = None
        self._slow: list[float] = []

    @property
    def share(self) -> float | None:
        """Fraction of the commanded speed at which the tool moves, at most; None where it is not known to be slow."""
        return max(self._slow[-SLOW_PAIRS:]) if len(self._slow) >= SLOW_PAIRS else None

    def interrupt(self) -> None:
        """Motion stops or starts: no pair of poses goes across."""
        self._last = None

    def add(self, instruction: int, move: StraightMove | None, position_mm: Xyz, asked_s: float, at_s: float) -> None:
        """Add a pose while an instruction is executed; ``move`` is None where it is not a straight move.

        ``asked_s`` and ``at_s`` are the times of the request and of its answer.
        """
        before, self._last = self._last, _Sample(instruction, position_mm, asked_s, at_s)
        if move is None or before is None or before.instruction != instruction:
            return
        least = min(move.full_share(before.position_mm), move.full_share(position_mm))
        shortest_s = asked_s - before.answered_s
        if least < FULL or shortest_s <= 0.0:
            return
        share = math.dist(before.position_mm, position_mm) / shortest_s / (least * move.speed_mm_s)
        if share < SLOW:
            self._slow = [*self._slow, share][-SLOW_PAIRS:]
        else:
            self._slow.clear()
