"""Two words on one force: the actuator's and an independent sensor's, against each other and the set point.

An actuator regulates by what it measures itself: should that drift, it stays at its set point, and what acts does not.
Only a second measurement shows it. Which of both is wrong two numbers cannot say; where both must read 0 they do.
"""

from __future__ import annotations

import math
from typing import Literal

from polishd.model.errors import ForcesApart

Who = Literal["actuator", "force sensor"]
ACTUATOR: Who = "actuator"
SENSOR: Who = "force sensor"


class ForceCheck:
    """One contact, told of both words as they come. All times are of the daemon's monotonic clock."""

    def __init__(self, set_n: float, band_n: float, grace_s: float, *, set_band: float, set_grace_s: float) -> None:
        """Both may be ``band_n`` apart, and farther for ``grace_s``.

        The sensor may be off the set point by ``set_band``, relative, and farther for ``set_grace_s``.
        """
        self._set_n = set_n
        self._band_n = band_n
        self._grace_s = grace_s
        self._set_band = set_band
        self._set_grace_s = set_grace_s
        self._words: dict[Who, float] = {}
        self._reached: set[Who] = set()
        """Who has been at the set point."""
        self._left_s: dict[Who, float] = {}
        """Since when who is off it by more than half of ``band_n``: of two that are farther apart one always is."""
        self._together_s = math.nan
        self._good_s = math.nan

    @property
    def sensor_fits(self) -> bool:
        """The sensor's last word is within its band of the set point."""
        return abs(self._words.get(SENSOR, math.nan) - self._set_n) <= self._set_band * self._set_n

    def actuator(self, at_s: float, force_n: float) -> None:
        """The actuator's word. ForcesApart where both have been apart for too long."""
        self._hear(ACTUATOR, at_s, force_n)

    def sensor(self, at_s: float, force_n: float, *, landed: bool) -> None:
        """The sensor's word, which may be too low until the tool has ``landed``. ForcesApart also where it is off."""
        self._hear(SENSOR, at_s, force_n)
        if self.sensor_fits or (not landed and force_n < self._set_n) or math.isnan(self._good_s):
            self._good_s = at_s
        elif at_s - self._good_s > self._set_grace_s:
            raise ForcesApart(
                f"force: by the force sensor {force_n:.2f} N is outside {self._set_n:g} N +- {self._set_band:.0%} for "
                f"more than {self._set_grace_s:g} s; the actuator says {self._words.get(ACTUATOR, math.nan):.2f} N"
            )

    def _hear(self, who: Who, at_s: float, force_n: float) -> None:
        self._words[who] = force_n
        if abs(force_n - self._set_n) <= self._band_n / 2:
            self._reached.add(who)
            self._left_s.pop(who, None)
        else:
            self._left_s.setdefault(who, at_s)
        if len(self._words) < 2:
            return
        apart_n = abs(self._words[ACTUATOR] - self._words[SENSOR])
        if apart_n <= self._band_n or math.isnan(self._together_s):
            self._together_s = at_s
        elif at_s - self._together_s > self._grace_s:
            raise ForcesApart(
                f"the forces disagree: the actuator says {self._words[ACTUATOR]:.2f} N, the force sensor "
                f"{self._words[SENSOR]:.2f} N, the set point is {self._set_n:g} N; {apart_n:.2f} N apart, at most "
                f"{self._band_n:g} N (force_sensor.band_n), for more than {self._grace_s:g} s; {self._first()}"
            )

    def _first(self) -> str:
        left = {who: at_s for who, at_s in self._left_s.items() if who in self._reached}
        if not left:
            return "neither has kept to the set point"
        return f"the {min(left, key=lambda who: left[who])} left the set point first"


def verdict(actuator_n: float, sensor_n: float, band_n: float) -> str:
    """What both read with the tool off the part, where the force is 0, and which of them that makes suspected."""
    off = {ACTUATOR: abs(actuator_n) > band_n / 2, SENSOR: abs(sensor_n) > band_n / 2}
    read = f"with the tool up the actuator reads {actuator_n:.2f} N, the sensor {sensor_n:.2f} N"
    wrong = [who for who in off if off[who]]
    if len(wrong) == 1:
        return f"{read}: suspected is the {wrong[0]}"
    return f"{read}: which of them is wrong that does not tell; try both with a weight"
