"""The true force behind the actuator's: a damped coil on a springy contact, with a part that comes and goes.

A coil that exerts F moves the bonnet through its damping b: ``b x' = F - N``. The contact is a spring,
``N = k (x - h)`` with h how far the part has withdrawn from the robot, so ``N' = (F - N) / tau - k h'`` with
``tau = b / k``: N lags behind F when the tool lands, and where the part comes at a speed v it is ``k tau v`` too large.

A guide with dry friction sticks first: the part's way goes into the contact's spring, ``N' = -k h'``, until it has made
up the friction f, and slides from there. So N is f too small where the part goes and f too large where it comes.

The actuator measures what its coil exerts, as those without a sensor in the tool do: it sees none of this.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from polishd.model.surface import FloatArray

TOGETHER_S = 1e-3
"""Process time between contacts beyond which the tool has lifted and lands anew."""


@dataclass(slots=True)
class ForceDynamics:
    """The force between tool and part as it goes on from contact to contact."""

    lag_s: float
    """tau, process time."""
    friction_n: float = 0.0
    """f."""
    _force_n: float = 0.0
    """Of the contact and of the friction, together."""
    _held_n: float = 0.0
    """By the friction, positive where it takes from the contact."""
    _gap_mm: float = 0.0
    _middle_s: float = 0.0
    _until_s: float = -math.inf

    def lift(self) -> None:
        """The tool leaves the part: the next contact is a landing."""
        self._until_s = -math.inf

    def truly(
        self, force_n: FloatArray, *, begin_s: FloatArray, lasts_s: FloatArray, gap_mm: FloatArray, stiff: FloatArray
    ) -> FloatArray:
        """(n,) mean forces of contacts in which the coil exerts ``force_n``; 0 at least.

        ``begin_s``, ``lasts_s`` process time; ``gap_mm`` from the part out along the tool to where the robot holds it,
        in the middle of each; ``stiff`` the contact's stiffness, N/mm.
        """
        means = np.empty(len(force_n))
        columns = (force_n, begin_s, lasts_s, gap_mm, stiff)
        for row, (coil, begin, lasts, gap, k) in enumerate(zip(*(c.tolist() for c in columns), strict=True)):
            middle = begin + lasts / 2.0
            pushed = 0.0
            if begin - self._until_s > TOGETHER_S:
                self._force_n, self._held_n = 0.0, self.friction_n  # it comes out, and is held back
            elif middle > self._middle_s:
                before, way_n = self._held_n, k * (gap - self._gap_mm)
                self._held_n = min(max(before + way_n, -self.friction_n), self.friction_n)
                pushed = self.lag_s * (self._held_n - before - way_n) / (middle - self._middle_s)
            settled = max(coil + pushed, self._held_n)  # nothing pulls
            ratio = lasts / self.lag_s if self.lag_s else math.inf
            behind = (self._force_n - settled) * -math.expm1(-ratio)
            mean = settled + (behind / ratio if ratio > 0.0 else self._force_n - settled)
            means[row] = max(mean - self._held_n, 0.0)
            self._force_n -= behind
            self._gap_mm, self._middle_s, self._until_s = gap, middle, begin + lasts
        return means
