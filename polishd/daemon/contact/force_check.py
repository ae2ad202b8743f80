"""Force readings of the actuator and of an independent sensor, checked against each other, the set point and limits."""

from __future__ import annotations

import math
from collections import deque
from statistics import median
from typing import Literal

from polishd.model.errors import ForcesApart, SafetyStop

ForceSource = Literal["actuator", "force sensor"]
ACTUATOR: ForceSource = "actuator"
SENSOR: ForceSource = "force sensor"
ONE_SIDED_S = 0.2
"""Longest time for which one of both may read a force and the other none."""
READING_S = 0.1
"""Time of two readings of a force sensor: it reports a force no later than its delay plus this."""
MOST_AHEAD = 2.0
"""A rise is extrapolated for at most this many times the interval in which it was measured."""


class ForceCeiling:
    """Check of the readings of one device against the largest permitted force, with one reading of foresight."""

    def __init__(self, who: str, set_n: float, *, band: float, most_n: float, key: str) -> None:
        """A rise counts only above the relative ``band`` of the set point, because a landing rises as fast.

        If the tool lands between two readings, a rise counts above the middle of band and limit: it may overshoot.
        """
        self._who = who
        self._set_n = set_n
        self._regular_n = set_n * (1.0 + band)
        self._most_n = most_n
        self._key = key
        self._last: tuple[float, float] | None = None
        """Time and force."""
        self._intervals = deque[float](maxlen=5)

    def check(self, at_s: float, force_n: float, others: str = "") -> None:
        """Raise SafetyStop if the reading is above the limit or the next one would be; ``others`` goes into it."""
        if abs(force_n) > self._most_n:
            raise SafetyStop(
                f"the {self._who} reads {force_n:.2f} N; at most {self._most_n:g} N may act ({self._key}), the set "
                f"point is {self._set_n:g} N{others}. Check the actuator, and the part for an obstacle"
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
                f"would pass {self._most_n:g} N ({self._key}), the set point is {self._set_n:g} N{others}. Check the "
                "actuator, and the part for an obstacle"
            )


class ForceCheck:
    """Comparison of all force readings of one contact. All times are of the daemon's monotonic clock."""

    def __init__(
        self,
        set_n: float,
        max_difference_n: float,
        alarm_delay_s: float,
        *,
        set_band: float,
        set_alarm_delay_s: float,
        most_n: float = math.inf,
        most_key: str = "process.force_max_n",
        delay_s: float = 0.0,
    ) -> None:
        """Both may be ``max_difference_n`` apart, and farther for ``alarm_delay_s``.

        One device alone may read a force for ``one_sided_s``. The sensor may be off the set point by ``set_band``
        (relative), and farther for ``set_alarm_delay_s``; its readings are ``delay_s`` late. A single reading above
        ``most_n`` is a fault; the config key ``most_key`` changes that limit.
        """
        self._set_n = set_n
        self._max_difference_n = max_difference_n
        self._alarm_delay_s = alarm_delay_s
        self._set_band = set_band
        self._set_alarm_delay_s = set_alarm_delay_s
        self._most_n = most_n
        self._most_key = most_key
        self._ceilings: dict[str, ForceCeiling] = {}
        self.one_sided_s = max(ONE_SIDED_S, delay_s + READING_S)
        self._one_sided_since_s = math.nan
        self._received_s: dict[ForceSource, float] = {}
        self._readings: dict[ForceSource, float] = {}
        self._reached: set[ForceSource] = set()
        """Devices that have reached the set point."""
        self._left_s: dict[ForceSource, float] = {}
        """When a device left the set point by more than half of ``max_difference_n``."""
        self._together_s = math.nan
        self._good_s = math.nan

    @property
    def sensor_fits(self) -> bool:
        """Whether the latest reading of the sensor is within its band of the set point."""
        return abs(self._readings.get(SENSOR, math.nan) - self._set_n) <= self._set_band * self._set_n

    def actuator(self, at_s: float, force_n: float) -> None:
        """Add a reading of the actuator; raise ForcesApart if both have disagreed for too long."""
        self._add(ACTUATOR, at_s, force_n)

    def sensor(self, at_s: float, force_n: float, *, landed: bool) -> None:
        """Add a reading of the sensor, which may be too low until the tool has ``landed``.

        Raise ForcesApart if both have disagreed, or the sensor has been off the set point, for too long.
        """
        self._add(SENSOR, at_s, force_n)
        if self.sensor_fits or (not landed and force_n < self._set_n) or math.isnan(self._good_s):
            self._good_s = at_s
        elif at_s - self._good_s > self._set_alarm_delay_s:
            raise ForcesApart(
                f"force: by the force sensor {force_n:.2f} N is outside {self._set_n:g} N +- {self._set_band:.0%} for "
                f"more than {self._set_alarm_delay_s:g} s; "
                f"the actuator reads {self._readings.get(ACTUATOR, math.nan):.2f} N"
            )

    def monitor(self, name: str, at_s: float, force_n: float) -> None:
        """Add a reading of a monitor that measures the force as well."""
        self._below_ceiling(f"signal {name}", at_s, force_n)

    def _below_ceiling(self, who: str, at_s: float, force_n: float) -> None:
        if who not in self._ceilings:
            band = self._set_band
            self._ceilings[who] = ForceCeiling(who, self._set_n, band=band, most_n=self._most_n, key=self._most_key)
        others = "".join(
            f"; the {other} reads {read_n:.2f} N" for other, read_n in self._readings.items() if other != who
        )
        self._ceilings[who].check(at_s, force_n, others)

    def _one_sided(self, at_s: float) -> None:
        """Raise ForcesApart if one reads a force and the other none for too long, and both have sent readings since."""
        low_n, high_n = sorted(abs(read_n) for read_n in self._readings.values())
        if not (low_n <= min(self._max_difference_n / 2, self._set_n / 4) and high_n > self._max_difference_n):
            self._one_sided_since_s = math.nan
        elif math.isnan(self._one_sided_since_s):
            self._one_sided_since_s = at_s
        elif at_s - self._one_sided_since_s > self.one_sided_s and min(self._received_s.values()) > (
            self._one_sided_since_s
        ):
            feels, other = sorted(self._readings, key=lambda who: -abs(self._readings[who]))
            raise ForcesApart(
                f"the {feels} reads {self._readings[feels]:.2f} N and the {other} none ({self._readings[other]:.2f} N) "
                f"for more than {self.one_sided_s:g} s; the set point is {self._set_n:g} N"
            )

    def _add(self, who: ForceSource, at_s: float, force_n: float) -> None:
        self._below_ceiling(who, at_s, force_n)
        self._readings[who], self._received_s[who] = force_n, at_s
        if abs(force_n - self._set_n) <= self._max_difference_n / 2:
            self._reached.add(who)
            self._left_s.pop(who, None)
        else:
            self._left_s.setdefault(who, at_s)
        if len(self._readings) < 2:
            return
        self._one_sided(at_s)
        apart_n = abs(self._readings[ACTUATOR] - self._readings[SENSOR])
        if apart_n <= self._max_difference_n or math.isnan(self._together_s):
            self._together_s = at_s
        elif at_s - self._together_s > self._alarm_delay_s:
            raise ForcesApart(
                f"the forces disagree: the actuator reads {self._readings[ACTUATOR]:.2f} N, the force sensor "
                f"{self._readings[SENSOR]:.2f} N, the set point is {self._set_n:g} N; {apart_n:.2f} N apart, at most "
                f"{self._max_difference_n:g} N (force_sensor.max_difference_n), for more than "
                f"{self._alarm_delay_s:g} s; {self._first()}"
            )

    def _first(self) -> str:
        left = {who: at_s for who, at_s in self._left_s.items() if who in self._reached}
        if not left:
            return "neither stayed at the set point"
        return f"the {min(left, key=lambda who: left[who])} left the set point first"


def verdict(actuator_n: float, sensor_n: float, max_difference_n: float) -> str:
    """Return both readings with the tool off the part, where the force is 0, and the device that is probably wrong."""
    off = {ACTUATOR: abs(actuator_n) > max_difference_n / 2, SENSOR: abs(sensor_n) > max_difference_n / 2}
    read = f"with the tool up the actuator reads {actuator_n:.2f} N, the sensor {sensor_n:.2f} N"
    wrong = [who for who in off if off[who]]
    if len(wrong) == 1:
        return f"{read}: the {wrong[0]} is probably wrong"
    return f"{read}: this does not show which of them is wrong. Check both with a weight"
