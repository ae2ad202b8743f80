"""Speed of the tool from the poses that the controller reports, against the speed that its instructions command.

It is independent of the speed override that the controller reports. A span is the way between two poses well inside
one straight move. The time that it took is compared with the longest that it takes at full speed with low acceleration.
It is the difference of the controller's time tags, if the times of the requests and answers confirm it; otherwise the
shortest that those allow. So a slow span is proven to be slow.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

LEAST_ACCEL_MM_S2 = 200.0
"""Acceleration that each controller has at least."""
FULL = 0.4
"""A pose counts where the tool has at least this fraction of its commanded speed."""
ASIDE_MM = 0.1
"""Largest distance of a pose from the straight line between both ends of its move."""
MOST_TURN_DEG_S = 20.0
"""Moves that turn the tool faster may be limited by the turn, and do not count."""
SPAN_S = 0.25
"""A longer move is several spans of this time."""
SLOW = 0.8
"""Fraction of the commanded speed below which motion is slow."""
SLOW_SPANS = 3
"""Consecutive slow spans before slow motion is reported."""
Xyz = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class StraightMove:
    """A linear move, as commanded."""

    begin_mm: Xyz
    end_mm: Xyz
    speed_mm_s: float

    @property
    def length_mm(self) -> float:
        """Length of the way."""
        return math.dist(self.begin_mm, self.end_mm)

    def along_mm(self, at_mm: Xyz) -> float | None:
        """Return the way to a position; None off the line, and where the tool may be slow."""
        way = [end - begin for begin, end in zip(self.begin_mm, self.end_mm, strict=True)]
        offset = [at - begin for begin, at in zip(self.begin_mm, at_mm, strict=True)]
        along_mm = sum(a * b for a, b in zip(way, offset, strict=True)) / self.length_mm
        aside_mm = math.sqrt(max(sum(part**2 for part in offset) - along_mm**2, 0.0))
        inside_mm = min(along_mm, self.length_mm - along_mm)
        least_mm = (FULL * self.speed_mm_s) ** 2 / (2.0 * LEAST_ACCEL_MM_S2)
        return along_mm if aside_mm <= ASIDE_MM and inside_mm >= least_mm else None

    def longest_s(self, along_mm: float) -> float:
        """Return the longest time from the begin to that way at full speed, from rest to rest."""
        accel, length_mm = LEAST_ACCEL_MM_S2, self.length_mm
        speed_mm_s = min(self.speed_mm_s, math.sqrt(accel * length_mm))
        ramp_mm = speed_mm_s**2 / (2.0 * accel)
        if along_mm > length_mm / 2.0:
            return length_mm / speed_mm_s + speed_mm_s / accel - self.longest_s(length_mm - along_mm)
        if along_mm < ramp_mm:
            return math.sqrt(2.0 * along_mm / accel)
        return speed_mm_s / accel + (along_mm - ramp_mm) / speed_mm_s


@dataclass(frozen=True, slots=True)
class PoseTimes:
    """Times of one pose."""

    asked_s: float
    """Time of the request."""
    answered_s: float
    """Time of the answer."""
    tag_ms: int | None = None
    """Time tag of the controller."""

    def least_s_until(self, later: PoseTimes) -> float:
        """Return the least time between two poses."""
        shortest_s, longest_s = later.asked_s - self.answered_s, later.answered_s - self.asked_s
        if self.tag_ms is None or later.tag_ms is None:
            return shortest_s
        tagged_s = (later.tag_ms - self.tag_ms) / 1000.0
        return tagged_s if shortest_s <= tagged_s <= longest_s else shortest_s


@dataclass(frozen=True, slots=True)
class _Sample:
    instruction: int
    along_mm: float
    times: PoseTimes


class MotionSpeed:
    """Watch of one program's speed."""

    def __init__(self) -> None:
        """Nothing is measured yet."""
        self._first: _Sample | None = None
        self._share: float | None = None
        """Of the present span, so far."""
        self._slow: list[float] = []
        self._starts = True
        self._ignored: int | None = None
        """The instruction in which motion started: the tool may have begun in its middle."""

    @property
    def share(self) -> float | None:
        """Fraction of the commanded speed at which the tool moves, at most; None where it is not known to be slow."""
        return max(self._slow) if len(self._slow) >= SLOW_SPANS else None

    def interrupt(self) -> None:
        """Motion stops or starts: no span goes across."""
        self._first, self._share, self._starts = None, None, True

    def add(self, instruction: int, move: StraightMove | None, position_mm: Xyz, times: PoseTimes) -> None:
        """Add a pose while an instruction is executed; ``move`` is None where it is not a straight move."""
        if self._starts:
            self._starts, self._ignored = False, instruction
        if self._first is not None and instruction != self._first.instruction:
            self._end()
        along_mm = None if move is None or instruction == self._ignored else move.along_mm(position_mm)
        if move is None or along_mm is None:
            return
        first = self._first
        if first is None:
            self._first = _Sample(instruction, along_mm, times)
            return
        least_s = first.times.least_s_until(times)
        if least_s > 0.0:
            self._share = (move.longest_s(along_mm) - move.longest_s(first.along_mm)) / least_s
        if least_s >= SPAN_S:
            self._end()
            self._first = _Sample(instruction, along_mm, times)

    def _end(self) -> None:
        """End the span."""
        share, self._first, self._share = self._share, None, None
        if share is not None and share < SLOW:
            self._slow = [*self._slow, share][-SLOW_SPANS:]
        elif share is not None:
            self._slow.clear()
