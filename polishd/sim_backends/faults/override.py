"""Speed override of a simulated robot, as the faults of its script set it."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, field

from polishd.config.simulator import FaultSection


@dataclass(slots=True)
class SpeedOverride:
    """Fraction of the programmed speed at which the tool moves, and the fraction that the controller reports."""

    _acting: list[tuple[FaultSection, float]] = field(default_factory=list)
    """Faults that act, and the time (time.monotonic) of their begin."""

    def suffer(self, fault: FaultSection, on: bool) -> None:
        """Begin a fault, or end it: then the tool goes on at the programmed speed."""
        if on:
            self._acting.append((fault, time.monotonic()))
        else:
            self._acting = [(other, begun_s) for other, begun_s in self._acting if other is not fault]

    def actual(self, now_s: float) -> float:
        """Fraction at which the tool moves; 0: it stands."""
        return 0.0 if self.stands else self._product(now_s, [*self._acting])

    def reported(self, now_s: float) -> float:
        """Fraction that the controller reports: nothing of ``stand``, nor of an override with ``reported = false``."""
        return self._product(now_s, [(fault, begun_s) for fault, begun_s in self._acting if fault.reported])

    @property
    def stands(self) -> bool:
        """The tool stands, and the controller reports that it runs."""
        return any(fault.what == "stand" for fault, _ in self._acting)

    def _product(self, now_s: float, acting: list[tuple[FaultSection, float]]) -> float:
        return math.prod(_fraction(fault, now_s - begun_s) for fault, begun_s in acting)


def _fraction(fault: FaultSection, since_s: float) -> float:
    if fault.percent is None:
        return 1.0
    share = min(max(since_s / fault.ramp_s, 0.0), 1.0) if fault.ramp_s else 1.0
    return 1.0 + (fault.percent / 100.0 - 1.0) * share
