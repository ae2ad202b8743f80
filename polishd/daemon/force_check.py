"""Two words on one force: the actuator's and an independent sensor's, against each other and the set point.

An actuator regulates by what it measures itself: should that drift, it stays at its set point, and what acts does not.
Only a second measurement shows it. Which of both is wrong two numbers cannot say; where both must read 0 they do.
"""

from __future__ import annotations

import math
from collections import deque
from statistics import median
from typing import Literal

from polishd.model.errors import ForcesApart, SafetyStop

Who = Literal["actuator", "force sensor"]
ACTUATOR: Who = "actuator"
SENSOR: Who = "force sensor"
ONE_SIDED_S = 0.2
"""So long one of both may read a force and the other none."""
READING_S = 0.1
"""Two readings of a force sensor: so much later than its delay it has told of a force."""
MOST_AHEAD = 2.0
"""A rise is followed for at most so many times the interval in which it was seen."""


class ForceCeiling:
    """The largest force that one device may read, by its last two readings."""

    def __init__(self, who: str, set_n: float, *, band: float, most_n: float, key: str) -> None:
        """A rise counts only above the relative ``band`` of the set point: a landing is as steep, and ends there.

        Of a tool that lands between two readings it counts above the middle of band and limit: it may overshoot.
        """
        self._who = who
        self._set_n = set_n
        self._regular_n = set_n * (1.0 + band)
        self._most_n = most_n
        self._key = key
        self._last: tuple[float, float] | None = None
        """(time, force)."""
        self._intervals = deque[float](maxlen=5)

    def hear(self, at_s: float, force_n: float, others: str = "") -> None:
        """A reading, and what the other devices read. SafetyStop above the limit, or where the next would be."""
        if abs(force_n) > self._most_n:
            raise SafetyStop(
                f"the {self._who} reads {force_n:.2f} N; at most {self._most_n:g} N may act ({self._key}), the set "
                f"point is {self._set_n:g} N{others}. Look at the actuator, and at what the tool may have met"
            )
        before, self._last = self._last, (at_s, force_n)
        if before is None or not at_s > before[0]:
            return
        interval_s, rise_n = at_s - before[0], force_n - before[1]
        self._intervals.append(interval_s)
        next_n = force_n + rise_n * min(median(self._intervals) / interval_s, MOST_AHEAD)
        lands = before[1] < self._set_n / 2
        counts_n = (self._regular_n + self._most_n) / 2 if lands else self._regular_n
        if force_n > counts_n and rise_n > 0.0 and next_n > self._most_n:
            raise SafetyStop(
                f"the {self._who} reads {force_n:.2f} N and rises by {rise_n / interval_s:.0f} N/s: its next reading "
                f"would pass {self._most_n:g} N ({self._key}), the set point is {self._set_n:g} N{others}. Look at the "
                "actuator, and at what the tool may have met"
            )


class ForceCheck:
    """One contact, told of both words as they come. All times are of the daemon's monotonic clock."""

    def __init__(
        self,
        set_n: float,
        band_n: float,
        grace_s: float,
        *,
        set_band: float,
        set_grace_s: float,
        most_n: float = math.inf,
        most_key: str = "process.force_max_n",
        delay_s: float = 0.0,
    ) -> None:
        """Both may be ``band_n`` apart, and farther for ``grace_s``; one may read a force alone for ``one_sided_s``.

        The sensor may be off the set point by ``set_band``, relative, and farther for ``set_grace_s``; it tells
        ``delay_s`` late. No device may read more than ``most_n``, not once, which the config key ``most_key`` changes.
        """
        self._set_n = set_n
        self._band_n = band_n
        self._grace_s = grace_s
        self._set_band = set_band
        self._set_grace_s = set_grace_s
        self._most_n = most_n
        self._most_key = most_key
        self._ceilings: dict[str, ForceCeiling] = {}
        self.one_sided_s = max(ONE_SIDED_S, delay_s + READING_S)
        self._one_sided_since_s = math.nan
        self._heard_s: dict[Who, float] = {}
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

    def monitor(self, name: str, at_s: float, force_n: float) -> None:
        """The word of a monitor that measures the force, too."""
        self._below_ceiling(f"signal {name}", at_s, force_n)

    def _below_ceiling(self, who: str, at_s: float, force_n: float) -> None:
        if who not in self._ceilings:
            band = self._set_band
            self._ceilings[who] = ForceCeiling(who, self._set_n, band=band, most_n=self._most_n, key=self._most_key)
        others = "".join(f"; the {other} reads {read_n:.2f} N" for other, read_n in self._words.items() if other != who)
        self._ceilings[who].hear(at_s, force_n, others)

    def _one_sided(self, at_s: float) -> None:
        """ForcesApart where one reads a force and the other none for too long, and both have been heard meanwhile."""
        low_n, high_n = sorted(abs(read_n) for read_n in self._words.values())
        if not (low_n <= min(self._band_n / 2, self._set_n / 4) and high_n > self._band_n):
            self._one_sided_since_s = math.nan
        elif math.isnan(self._one_sided_since_s):
            self._one_sided_since_s = at_s
        elif at_s - self._one_sided_since_s > self.one_sided_s and min(self._heard_s.values()) > (
            self._one_sided_since_s
        ):
            feels, other = sorted(self._words, key=lambda who: -abs(self._words[who]))
            raise ForcesApart(
                f"the {feels} reads {self._words[feels]:.2f} N and the {other} none ({self._words[other]:.2f} N) for "
                f"more than {self.one_sided_s:g} s; the set point is {self._set_n:g} N"
            )

    def _hear(self, who: Who, at_s: float, force_n: float) -> None:
        self._below_ceiling(who, at_s, force_n)
        self._words[who], self._heard_s[who] = force_n, at_s
        if abs(force_n - self._set_n) <= self._band_n / 2:
            self._reached.add(who)
            self._left_s.pop(who, None)
        else:
            self._left_s.setdefault(who, at_s)
        if len(self._words) < 2:
            return
        self._one_sided(at_s)
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
