"""Whether the tool touched, block by block, with which force and at which speed: what is known, and nothing else.

Samples are on the daemon's clock, blocks on the robot's, and told only when they have ended. So a block is taken to lie
between the word before the one that told of it and that word; what decides on contact allows the robot's word to be as
late as its link may be silent.
"""

from __future__ import annotations

import asyncio
import math
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from statistics import median
from typing import Any, Literal

from polishd.config.cell import CellConfig
from polishd.daemon.cell.cell import Cell
from polishd.daemon.cell.time_limits import ActionTimeLimit, TimeLimits, late_s
from polishd.daemon.journal.records import BlockRecord
from polishd.model.devices import ExecutedBlock, ForceSample, SensedForce, SpeedSample
from polishd.model.errors import ForcesApart, SafetyStop
from polishd.model.program import Plan, Program
from polishd.pipeline.recipe import Recipe
from polishd.pipeline.steps import envelope_of, in_part_frame
from polishd.process.removal.excess import ExcessMap
from polishd.process.removal.measured_tif import SpotFigures, measured_figures, spot_figures
from polishd.process.robot.motion import delivered_time_s

LUMP_S = 0.02
"""Blocks that are told within so much of each other are one word of the robot's."""

Samples = deque[tuple[float, float]]
"""(time, value), in time order."""


@dataclass(slots=True)
class _Lump:
    """Blocks of one word."""

    before_s: float
    """When the word before it came."""
    told_s: float
    blocks: list[ExecutedBlock] = field(default_factory=list)
    sampled: bool = False
    """A force sample has come since."""


class ContactRecord:
    """One contact: told of samples, blocks and orders as they come, it writes a record for each block.

    A block waits for the second force sample after it: the first may have been read before it ended, and lain on the
    wire while this process did not run; the second was asked for later. It touched where all samples around it were in
    contact; it did not where the tool was known to be up before it; else nobody knows. All times are of the daemon's
    monotonic clock.
    """

    def __init__(self, write: Callable[[Sequence[BlockRecord]], None], late_s: float) -> None:
        """``late_s``: the longest after its end that the robot tells of a block."""
        self._write = write
        self._late_s = late_s
        self._begun_s = math.inf
        """When the robot was told to run."""
        self._lifts_s = math.inf
        """When the robot was told to take the tool off the part, by a motion of its own."""
        self._lumps: list[_Lump] = []
        self._word = _Lump(0.0, -math.inf)
        """The robot's last one."""
        self._judged: list[BlockRecord] = []
        """Not written yet."""
        self._force: Samples = deque()
        self._rpm: Samples = deque()
        self._sensed: Samples = deque()
        self._pressing_s = math.inf
        """Since when all samples have been in contact."""
        self.left = False
        """Contact is being left, or was: force and tool are ordered off."""
        self.off_s = math.inf
        """From when on the tool is known to be off the part."""
        self.last_seq = -1
        """The last block that was told."""
        self.known = asyncio.Event()
        """No block waits to be judged."""
        self.known.set()

    @property
    def ran(self) -> bool:
        """The robot was told to run blocks in contact."""
        return self._begun_s < math.inf

    @property
    def told_s(self) -> float:
        """When the robot told of a block last, or was told to run."""
        return max(self._word.told_s, self._begun_s)

    @property
    def up(self) -> bool:
        """What runs after the last block that was told is not touched: the tool is off."""
        return self.off_s <= max(self.told_s - self._late_s, self._begun_s)

    @property
    def taken_off(self) -> bool:
        """The robot was told to take the tool off the part while it may have been on it."""
        return self._lifts_s < self.off_s

    def begin(self, at_s: float) -> None:
        """The robot stands, with the tool on its landing point, and is about to be told to run."""
        self._begun_s, self._word = at_s, _Lump(at_s, -math.inf)

    def force(self, sample: ForceSample) -> None:
        """A reading of the actuator: what ended before it was asked for is judged."""
        if self.left:
            return
        self._force.append((sample.at_s, sample.force_n))
        self._pressing_s = min(self._pressing_s, sample.at_s) if sample.in_contact else math.inf
        judged = [lump for lump in self._lumps if lump.sampled]
        self._lumps = self._lumps[len(judged) :]
        for lump in self._lumps:
            lump.sampled = True
        if judged:
            self._write(self._records_of(judged))
        if not self._lumps:
            self.known.set()
        needed_s = self._lumps[0].before_s if self._lumps else self.told_s
        for samples in (self._force, self._rpm, self._sensed):
            _forget(samples, needed_s)

    def speed(self, sample: SpeedSample) -> None:
        """A reading of the spindle."""
        self._rpm.append((sample.at_s, sample.rpm))

    def sensed(self, reading: SensedForce) -> None:
        """A reading of the independent force sensor."""
        self._sensed.append((reading.at_s, reading.force_n))

    def told(self, block: ExecutedBlock, at_s: float) -> None:
        """The robot tells that it has executed a block."""
        self.last_seq = block.seq
        if at_s > self._word.told_s + LUMP_S:
            self._word = _Lump(self.told_s, at_s)
        if self.left:
            lump = _Lump(self._word.before_s, self._word.told_s, [block])
            self._judged += _records(lump, False if self.off_s <= self._earliest_s(lump) else None)
            self.flush()
            return
        if self._word.sampled or not self._lumps or self._lumps[-1] is not self._word:
            # one of which a sample has told meanwhile goes on as another: its blocks wait for two, too
            self._word = _Lump(self._word.before_s, self._word.told_s)
            self._lumps.append(self._word)
        self._word.blocks.append(block)
        self.known.clear()

    def leave(self) -> None:
        """Force and tool are about to be ordered off: of what still waits, nobody knows.

        An actuator may have lost its power right after its last sample. Nothing is written yet: whatever becomes of
        the journal, the tool is lifted.
        """
        if not self.left:
            self.left, self._pressing_s = True, math.inf
            self._judged = self._records_of(self._lumps)
            self._lumps = []

    def lifts(self, at_s: float) -> None:
        """The robot is about to be told to take the tool off the part: it moves, also where it stood."""
        self._lifts_s = min(self._lifts_s, at_s)

    def flush(self) -> None:
        """Write what is judged."""
        if self._judged:
            records, self._judged = self._judged, []
            self._write(records)

    def off(self, at_s: float) -> None:
        """The tool is off the part from then on: it was confirmed, or its actuator has let go by itself by then."""
        self.off_s = min(self.off_s, at_s)

    def _records_of(self, lumps: Sequence[_Lump]) -> list[BlockRecord]:
        """What is known of those blocks."""
        records: list[BlockRecord] = []
        for lump in lumps:
            touched = self._pressing_s <= self._earliest_s(lump)
            heard = (self._force, self._rpm, self._sensed)
            means = (_mean(samples, lump.before_s, lump.told_s) for samples in heard)
            records += _records(lump, touched or None, *means)
        return records

    def _earliest_s(self, lump: _Lump) -> float:
        """None of its blocks began before."""
        return max(lump.before_s - self._late_s, self._begun_s)


def _records(
    lump: _Lump,
    touched: bool | None,
    force_n: float | None = None,
    rpm: float | None = None,
    sensor_force_n: float | None = None,
) -> list[BlockRecord]:
    return [BlockRecord(block, touched, force_n, rpm, lump.told_s, sensor_force_n) for block in lump.blocks]


def _mean(samples: Samples, from_s: float, to_s: float) -> float | None:
    """Of the samples in between, and of the next one on either side; None where there is none."""
    first = max((k for k, (at_s, _) in enumerate(samples) if at_s <= from_s), default=0)
    last = next((k for k, (at_s, _) in enumerate(samples) if at_s >= to_s), len(samples) - 1)
    values = [samples[k][1] for k in range(first, last + 1)]
    return sum(values) / len(values) if values else None


def _forget(samples: Samples, before_s: float) -> None:
    """Of those before keep the last one."""
    while len(samples) > 1 and samples[1][0] <= before_s:
        samples.popleft()


# Two words on one force: the actuator's and an independent sensor's, against each other and the set point.

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

        One may read a force alone for ``one_sided_s``.

        The sensor may be off the set point by ``set_band``, relative, and farther for ``set_alarm_delay_s``; it tells
        ``delay_s`` late. No device may read more than ``most_n``, not once, which the config key ``most_key`` changes.
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
        self._heard_s: dict[Who, float] = {}
        self._words: dict[Who, float] = {}
        self._reached: set[Who] = set()
        """Who has been at the set point."""
        self._left_s: dict[Who, float] = {}
        """Since when a device is off the set point by more than half of ``max_difference_n``: one of two always is."""
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
        elif at_s - self._good_s > self._set_alarm_delay_s:
            raise ForcesApart(
                f"force: by the force sensor {force_n:.2f} N is outside {self._set_n:g} N +- {self._set_band:.0%} for "
                f"more than {self._set_alarm_delay_s:g} s; "
                f"the actuator says {self._words.get(ACTUATOR, math.nan):.2f} N"
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
        if not (low_n <= min(self._max_difference_n / 2, self._set_n / 4) and high_n > self._max_difference_n):
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
        if abs(force_n - self._set_n) <= self._max_difference_n / 2:
            self._reached.add(who)
            self._left_s.pop(who, None)
        else:
            self._left_s.setdefault(who, at_s)
        if len(self._words) < 2:
            return
        self._one_sided(at_s)
        apart_n = abs(self._words[ACTUATOR] - self._words[SENSOR])
        if apart_n <= self._max_difference_n or math.isnan(self._together_s):
            self._together_s = at_s
        elif at_s - self._together_s > self._alarm_delay_s:
            raise ForcesApart(
                f"the forces disagree: the actuator says {self._words[ACTUATOR]:.2f} N, the force sensor "
                f"{self._words[SENSOR]:.2f} N, the set point is {self._set_n:g} N; {apart_n:.2f} N apart, at most "
                f"{self._max_difference_n:g} N (force_sensor.max_difference_n), for more than "
                f"{self._alarm_delay_s:g} s; {self._first()}"
            )

    def _first(self) -> str:
        left = {who: at_s for who, at_s in self._left_s.items() if who in self._reached}
        if not left:
            return "neither has kept to the set point"
        return f"the {min(left, key=lambda who: left[who])} left the set point first"


def verdict(actuator_n: float, sensor_n: float, max_difference_n: float) -> str:
    """What both read with the tool off the part, where the force is 0, and which of them that makes suspected."""
    off = {ACTUATOR: abs(actuator_n) > max_difference_n / 2, SENSOR: abs(sensor_n) > max_difference_n / 2}
    read = f"with the tool up the actuator reads {actuator_n:.2f} N, the sensor {sensor_n:.2f} N"
    wrong = [who for who in off if off[who]]
    if len(wrong) == 1:
        return f"{read}: suspected is the {wrong[0]}"
    return f"{read}: which of them is wrong that does not tell; try both with a weight"


# What it costs that a robot tells late: the pit where it stands, and the blur of when a block ended.

NO_TOLERANCE_NM = 10.0
"""Taken for the tolerance where no line of it is in nm."""
TENTH = 0.1
"""Share of what is planned at a place that may be removed beyond the plan by default."""


@dataclass(frozen=True, slots=True)
class StallRemoval:
    """Removal by a robot that stands in contact and goes on reporting that it runs."""

    notice_s: float
    """Longest from the standstill until contact is left: a block's expected time, the report's age, two looks."""
    release_s: float
    """Longest from then until the force is off."""
    rate_nm_s: float
    """Removal rate at the peak of the spot."""

    @property
    def removal_nm(self) -> float:
        """Depth of the pit, at most."""
        return self.rate_nm_s * (self.notice_s + self.release_s)

    def facts(self) -> dict[str, float]:
        """JSON-ready."""
        return {**asdict(self), "removal_nm": self.removal_nm}

    def row(self) -> dict[str, Any]:
        """Row of the time-limit table."""
        what = f"robot that stands is noticed; with force off after {self.notice_s + self.release_s:.2f} s "
        return ActionTimeLimit("", f"{what}it removes {self.removal_nm:.0f} nm at most", round(self.notice_s, 3)).row()

    def warning(self, tolerance_nm: float | None) -> str:
        """Return the warning of a pit deeper than half of the tolerance; empty where it is not."""
        if tolerance_nm is None or self.removal_nm <= tolerance_nm / 2:
            return ""
        return (
            f"A robot that stands in contact removes up to {self.removal_nm:.0f} nm before the force is off, more than "
            f"half of the tolerance of {tolerance_nm:g} nm: it is noticed after {self.notice_s:.2f} s, the force is "
            f"off {self.release_s:g} s later, at {self.rate_nm_s:.0f} nm/s. Use shorter blocks, less force, a "
            "controller that reports faster or an actuator that releases faster."
        )


def stall_removal(
    limits: TimeLimits, recipe: Recipe, program: Program, no_progress_s: float | None = None
) -> StallRemoval:
    """Return the bound for the program at its own times; ``no_progress_s`` in the place of the derived one.

    Of a dwell the time at the point itself is no standstill: the tool is to stand there.
    """
    expected_s = delivered_time_s(program, program.time_s, envelope_of(recipe, program))
    moving_s = expected_s - program.time_s if program.encoding == "dwell" else expected_s
    block_s = float(moving_s.max(initial=0.0))
    extra_s = limits.no_progress_s if no_progress_s is None else no_progress_s
    return StallRemoval(block_s + late_s(block_s) + extra_s, limits.actuator.release_s, peak_nm_s(recipe))


def tolerance_nm(recipe: Recipe) -> float | None:
    """Return the tightest limit in nm of the tolerance, or None where no line is in nm."""
    return min((line.limit for line in recipe.lines if line.unit == "nm"), default=None)


def require_stall_depth(config: CellConfig, cell: Cell, recipe: Recipe) -> str:
    """Depth of that; empty where the robot reports at once. ConfigError beyond ``limits.max_stall_removal_nm``."""
    robot, actuator = cell.limits.robot, cell.limits.actuator
    if not robot.unseen_stop_s:
        return ""
    stands_s = robot.unseen_stop_s + actuator.release_s
    rate_nm_s = peak_nm_s(recipe)
    said = (
        f"{rate_nm_s * stands_s:.1f} nm at most: {1e3 * robot.unseen_stop_s:.0f} ms until it is told, "
        f"{1e3 * actuator.release_s:.0f} ms until the force is off, at {rate_nm_s:.0f} nm/s"
    )
    if rate_nm_s * stands_s > config.limits.max_stall_removal_nm:
        raise config.error(
            "limits.max_stall_removal_nm",
            f"a feed hold at the controller would dig {said}; more than {config.limits.max_stall_removal_nm:g} nm. "
            "Have the "
            "controller report faster, state what the actuator truly takes (actuator.release_s), or wire its signal "
            "'in motion' to the actuator (in_motion_wired in its profile)",
        )
    return said


def timing_uncertainty_s(cell: Cell, recipe: Recipe) -> str:
    """How well it is known when a block ended, in time and in removal; empty where the robot tells it exactly."""
    end_s = cell.limits.robot.block_end_s
    return f"{1e3 * end_s:.0f} ms rms, {peak_nm_s(recipe) * end_s:.1f} nm; it does not add up" if end_s else ""


def peak_nm_s(recipe: Recipe) -> float:
    """Return the removal rate of a standing tool at the peak of its spot, nm/s."""
    return _spot(recipe).peak_nm_s


def _spot(recipe: Recipe) -> SpotFigures:
    tif, process = recipe.tif, recipe.process
    return spot_figures(process) if tif is None else measured_figures(tif, process)


def excess_map(recipe: Recipe, plan: Plan, most_nm: float | None) -> ExcessMap:
    """Return the limits of removal beyond that plan on the part: ``most_nm``, or by tolerance and plan."""
    share = TENTH if most_nm is None else 0.0
    return ExcessMap(
        in_part_frame(recipe, plan.program),
        plan.expected_time_s,
        _spot(recipe),
        floor_nm=(tolerance_nm(recipe) or NO_TOLERANCE_NM) / 2 if most_nm is None else most_nm,
        share=share,
        on_part=recipe.outline.contains,
    )
