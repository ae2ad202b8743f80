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
from dataclasses import dataclass, field

from polishd.daemon.journal_records import BlockRecord
from polishd.model.devices import ExecutedBlock, ForceSample, SensedForce, SpeedSample

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
