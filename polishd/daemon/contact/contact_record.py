"""Record of one contact: for each block whether the tool touched, with the mean force and speed.

Samples have times of the daemon's clock, blocks of the robot's clock, and the robot reports a block only after its end.
So a block lies between the report that contains it and the report before. The decision on contact allows each report to
be as late as the robot's link may be silent.
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

REPORT_S = 0.02
"""Blocks that arrive within this time of each other belong to one report of the robot."""

Samples = deque[tuple[float, float]]
"""(time, value), in time order."""


@dataclass(slots=True)
class _Report:
    """Blocks of one report of the robot."""

    before_s: float
    """When the report before it arrived."""
    reported_s: float
    blocks: list[ExecutedBlock] = field(default_factory=list)
    sampled: bool = False
    """A force sample has arrived since."""


class ContactRecord:
    """Samples, blocks and commands of one contact; writes a record for each block.

    A block waits for the second force sample after it. The first sample may have been read before the block ended and
    delivered late; the second was requested later. The tool touched in a block if all samples around the block were in
    contact, did not touch if the tool was known to be up before the block; otherwise it is unknown. All times are of
    the daemon's monotonic clock.
    """

    def __init__(self, write: Callable[[Sequence[BlockRecord]], None], late_s: float) -> None:
        """``late_s``: longest time from the end of a block until the robot reports it."""
        self._write = write
        self._late_s = late_s
        self._begun_s = math.inf
        """When the robot was commanded to run."""
        self._lifts_s = math.inf
        """When the robot was commanded to lift the tool off the part."""
        self._waiting: list[_Report] = []
        self._latest = _Report(0.0, -math.inf)
        """The latest report of the robot."""
        self._judged: list[BlockRecord] = []
        """Records that are not written yet."""
        self._force: Samples = deque()
        self._rpm: Samples = deque()
        self._sensed: Samples = deque()
        self._pressing_s = math.inf
        """Time since which all samples have been in contact."""
        self.left = False
        """Contact is being left or was left: the daemon has commanded force off and retract."""
        self.off_s = math.inf
        """Time from which the tool is known to be off the part."""
        self.last_seq = -1
        """The last block that the robot reported."""
        self.known = asyncio.Event()
        """Set while no block waits for its decision on contact."""
        self.known.set()

    @property
    def ran(self) -> bool:
        """Whether the robot was commanded to run blocks in contact."""
        return self._begun_s < math.inf

    @property
    def reported_s(self) -> float:
        """Time of the latest report of the robot, or of the command to run."""
        return max(self._latest.reported_s, self._begun_s)

    @property
    def up(self) -> bool:
        """Whether the tool is off the part in all blocks after the last reported one."""
        return self.off_s <= max(self.reported_s - self._late_s, self._begun_s)

    @property
    def taken_off(self) -> bool:
        """Whether the robot was commanded to lift the tool while it may have been on the part."""
        return self._lifts_s < self.off_s

    def begin(self, at_s: float) -> None:
        """Note that the robot, with the tool on its landing point, is about to be commanded to run."""
        self._begun_s, self._latest = at_s, _Report(at_s, -math.inf)

    def force(self, sample: ForceSample) -> None:
        """Add a reading of the actuator; decide on the blocks that ended before it was requested."""
        if self.left:
            return
        self._force.append((sample.at_s, sample.force_n))
        self._pressing_s = min(self._pressing_s, sample.at_s) if sample.in_contact else math.inf
        judged = [report for report in self._waiting if report.sampled]
        self._waiting = self._waiting[len(judged) :]
        for report in self._waiting:
            report.sampled = True
        if judged:
            self._write(self._records_of(judged))
        if not self._waiting:
            self.known.set()
        needed_s = self._waiting[0].before_s if self._waiting else self.reported_s
        for samples in (self._force, self._rpm, self._sensed):
            _forget(samples, needed_s)

    def speed(self, sample: SpeedSample) -> None:
        """Add a reading of the spindle."""
        self._rpm.append((sample.at_s, sample.rpm))

    def sensed(self, reading: SensedForce) -> None:
        """Add a reading of the independent force sensor."""
        self._sensed.append((reading.at_s, reading.force_n))

    def add_block(self, block: ExecutedBlock, at_s: float) -> None:
        """Add a block that the robot reports as executed."""
        self.last_seq = block.seq
        if at_s > self._latest.reported_s + REPORT_S:
            self._latest = _Report(self.reported_s, at_s)
        if self.left:
            report = _Report(self._latest.before_s, self._latest.reported_s, [block])
            self._judged += _records(report, False if self.off_s <= self._earliest_s(report) else None)
            self.flush()
            return
        if self._latest.sampled or not self._waiting or self._waiting[-1] is not self._latest:
            # a sample has arrived since the report began: its later blocks need two more samples as well
            self._latest = _Report(self._latest.before_s, self._latest.reported_s)
            self._waiting.append(self._latest)
        self._latest.blocks.append(block)
        self.known.clear()

    def leave(self) -> None:
        """Note that the daemon is about to command force off and retract; contact in waiting blocks stays unknown.

        An actuator may have lost its power right after its last sample. Nothing is written yet, so that a fault of the
        journal does not delay the lift.
        """
        if not self.left:
            self.left, self._pressing_s = True, math.inf
            self._judged = self._records_of(self._waiting)
            self._waiting = []

    def lifts(self, at_s: float) -> None:
        """Note that the daemon is about to command the robot to lift the tool: a robot that stood moves then."""
        self._lifts_s = min(self._lifts_s, at_s)

    def flush(self) -> None:
        """Write the records of all decided blocks."""
        if self._judged:
            records, self._judged = self._judged, []
            self._write(records)

    def off(self, at_s: float) -> None:
        """Note that the tool is off the part from then on: confirmed, or lifted by the actuator's watchdog."""
        self.off_s = min(self.off_s, at_s)

    def _records_of(self, reports: Sequence[_Report]) -> list[BlockRecord]:
        records: list[BlockRecord] = []
        for report in reports:
            touched = self._pressing_s <= self._earliest_s(report)
            received = (self._force, self._rpm, self._sensed)
            means = (_mean(samples, report.before_s, report.reported_s) for samples in received)
            records += _records(report, touched or None, *means)
        return records

    def _earliest_s(self, report: _Report) -> float:
        """Return the earliest time at which one of its blocks can have begun."""
        return max(report.before_s - self._late_s, self._begun_s)


def _records(
    report: _Report,
    touched: bool | None,
    force_n: float | None = None,
    rpm: float | None = None,
    sensor_force_n: float | None = None,
) -> list[BlockRecord]:
    return [BlockRecord(block, touched, force_n, rpm, report.reported_s, sensor_force_n) for block in report.blocks]


def _mean(samples: Samples, from_s: float, to_s: float) -> float | None:
    """Return the mean of the samples in between and of the next one on either side; None without samples."""
    first = max((k for k, (at_s, _) in enumerate(samples) if at_s <= from_s), default=0)
    last = next((k for k, (at_s, _) in enumerate(samples) if at_s >= to_s), len(samples) - 1)
    values = [samples[k][1] for k in range(first, last + 1)]
    return sum(values) / len(values) if values else None


def _forget(samples: Samples, before_s: float) -> None:
    """Drop the samples before that time, except the last of them."""
    while len(samples) > 1 and samples[1][0] <= before_s:
        samples.popleft()


# Force readings of the actuator and of an independent sensor, checked against each other and the set point.

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


# Cost of late reports of the robot: depth of the pit where it stands, and uncertainty of the end of a block.

NO_TOLERANCE_NM = 10.0
"""Tolerance to assume where no line of the tolerance is in nm."""
TENTH = 0.1
"""Default limit of excess removal, as a share of the removal planned at the point."""


@dataclass(frozen=True, slots=True)
class StallRemoval:
    """Removal by a robot that stands in contact while it reports that it runs."""

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
        what = f"standstill of the robot detected; force off after {self.notice_s + self.release_s:.2f} s, "
        return ActionTimeLimit("", f"{what}removal {self.removal_nm:.0f} nm at most", round(self.notice_s, 3)).row()

    def warning(self, tolerance_nm: float | None) -> str:
        """Return the warning of a pit deeper than half of the tolerance; empty if it is not deeper."""
        if tolerance_nm is None or self.removal_nm <= tolerance_nm / 2:
            return ""
        return (
            f"A robot that stands in contact removes up to {self.removal_nm:.0f} nm before the force is off, more than "
            f"half of the tolerance of {tolerance_nm:g} nm: detection takes {self.notice_s:.2f} s, force off "
            f"{self.release_s:g} s more, at {self.rate_nm_s:.0f} nm/s. Use shorter blocks, less force, a "
            "controller that reports faster or an actuator that releases faster."
        )


def stall_removal(
    limits: TimeLimits, recipe: Recipe, program: Program, no_progress_s: float | None = None
) -> StallRemoval:
    """Return the bound for the program with its own times; ``no_progress_s`` replaces the derived one.

    The dwell time at a point does not count as standstill: the tool has to stand there.
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
    """Return the depth of the pit in words; empty if the robot reports at once.

    ConfigError beyond ``limits.max_stall_removal_nm``.
    """
    robot, actuator = cell.limits.robot, cell.limits.actuator
    if not robot.unseen_stop_s:
        return ""
    stands_s = robot.unseen_stop_s + actuator.release_s
    rate_nm_s = peak_nm_s(recipe)
    depth = (
        f"{rate_nm_s * stands_s:.1f} nm at most: {1e3 * robot.unseen_stop_s:.0f} ms until the robot reports it, "
        f"{1e3 * actuator.release_s:.0f} ms until the force is off, at {rate_nm_s:.0f} nm/s"
    )
    if rate_nm_s * stands_s > config.limits.max_stall_removal_nm:
        raise config.error(
            "limits.max_stall_removal_nm",
            f"a feed hold at the controller would dig {depth}; the limit is {config.limits.max_stall_removal_nm:g} nm. "
            "Make the controller report faster, set actuator.release_s to the measured time, or connect the "
            "controller's signal 'in motion' to the actuator (in_motion_wired in its profile)",
        )
    return depth


def timing_uncertainty_s(cell: Cell, recipe: Recipe) -> str:
    """Return the uncertainty of the end of a block, in time and removal; empty if the robot reports it exactly."""
    end_s = cell.limits.robot.block_end_s
    return f"{1e3 * end_s:.0f} ms rms, {peak_nm_s(recipe) * end_s:.1f} nm; it does not add up" if end_s else ""


def peak_nm_s(recipe: Recipe) -> float:
    """Return the removal rate of a standing tool at the peak of its spot, nm/s."""
    return _spot(recipe).peak_nm_s


def _spot(recipe: Recipe) -> SpotFigures:
    tif, process = recipe.tif, recipe.process
    return spot_figures(process) if tif is None else measured_figures(tif, process)


def excess_map(recipe: Recipe, plan: Plan, most_nm: float | None) -> ExcessMap:
    """Return the limits of excess removal for that plan: ``most_nm``, or from tolerance and plan."""
    share = TENTH if most_nm is None else 0.0
    return ExcessMap(
        in_part_frame(recipe, plan.program),
        plan.expected_time_s,
        _spot(recipe),
        floor_nm=(tolerance_nm(recipe) or NO_TOLERANCE_NM) / 2 if most_nm is None else most_nm,
        share=share,
        on_part=recipe.outline.contains,
    )
