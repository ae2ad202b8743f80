"""Whether a tool that is pressed touches, by where it is: an axis with a motor has no force sensor. Pure."""

from __future__ import annotations

from collections import deque

WINDOW_S = 0.08
"""Speeds are means over at least so long."""
LANDED_MM_S = 1.0
"""A tool that has landed while the robot stands is slower than that, whatever is told of how fast it travels."""


class ContactDetector:
    """Fed with positions (mm out of the tool's rest) while the tool is pressed outwards.

    In the air the tool travels out, as fast as the drive lets it; on the part it goes with the part. So it touches
    where it is off its rest, short of its end, and travels slower than ``travel_mm_s``, either way.
    """

    def __init__(self, *, rest_mm: float, end_mm: float, travel_mm_s: float) -> None:
        self._rest_mm = rest_mm
        self._end_mm = end_mm
        self._travel_mm_s = travel_mm_s
        self.landed = False
        """As of the last reading, for a robot that stands: it touches, and stands, too."""
        self._positions: deque[tuple[float, float]] = deque()

    def reset(self) -> None:
        """Not pressed: what was seen before says nothing."""
        self._positions.clear()
        self.landed = False

    def feed(self, at_s: float, position_mm: float) -> bool:
        """A reading; whether the tool touches. It takes ``WINDOW_S`` until the first yes."""
        seen = self._positions
        seen.append((at_s, position_mm))
        while len(seen) > 2 and seen[1][0] <= at_s - WINDOW_S:
            seen.popleft()
        began_s, from_mm = seen[0]
        self.landed = False
        if at_s - began_s < WINDOW_S or not self._rest_mm < position_mm < self._end_mm:
            return False
        speed_mm_s = abs(position_mm - from_mm) / (at_s - began_s)
        self.landed = speed_mm_s < min(self._travel_mm_s, LANDED_MM_S)
        return speed_mm_s < self._travel_mm_s
