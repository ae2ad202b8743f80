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
from dataclasses import dataclass, field

from polishd.daemon.journal.records import BlockRecord
from polishd.model.devices import ExecutedBlock, ForceSample, SensedForce, SpeedSample

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
