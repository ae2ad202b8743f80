"""What the journal gives back: maps, passes, and the blocks that were executed."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from polishd.model.devices import ExecutedBlock
from polishd.model.program import IntArray
from polishd.model.surface import BoolArray, FloatArray


@dataclass(frozen=True, slots=True)
class MapRecord:
    """A map that was taken: the last one of its cycle."""

    cycle: int
    sha256: str
    path: str
    stats: Mapping[str, Any]
    taken_s: float
    """Unix time."""
    arrays: str = ""
    """Name in the array store of what was made of it."""


@dataclass(frozen=True, slots=True)
class PassRecord:
    """A pass: written before the robot starts, ended when it is known how."""

    cycle: int
    program_sha256: str
    boot_id: str
    blocks: int
    contact_from: int
    contact_to: int
    facts: Mapping[str, Any]
    started_s: float
    ended_s: float | None = None
    how: str | None = None
    plan: str = ""
    """Names in the array store: the plan, and what the next solve can start from."""
    start: str = ""
    reach_s: float | None = None
    """Longest that the tool can stay on the part after the last block that is recorded, s; None: nobody said."""
    uncertain: tuple[int, int] | None = None
    """Blocks after the last record that it may have touched: sequence numbers, end excluded; None: not judged yet."""


@dataclass(frozen=True, slots=True)
class BlockRecord:
    """A block that was executed, and what is known of the tool meanwhile."""

    block: ExecutedBlock
    touched: bool | None
    """The tool was on the part for all of it, or for none of it; None: nobody knows."""
    force_n: float | None = None
    """Mean force by the actuator's word; None: not known."""
    rpm: float | None = None
    told_s: float | None = None
    """When the robot told of it, on the monotonic clock of the daemon that ran the pass."""
    sensor_force_n: float | None = None
    """Mean force by the independent sensor's word; None: not known, or the cell has none."""


@dataclass(frozen=True, slots=True)
class BlockCounts:
    """How much of one pass is recorded as executed."""

    done: int = 0
    """Blocks."""
    last_seq: int = -1
    """The last of them; -1 for none."""
    contact_s: float = 0.0
    """Process time of those in contact, as far as that is known."""


@dataclass(frozen=True, slots=True)
class JournalBlocks:
    """Blocks of one pass that were executed, by sequence number; (n,) each."""

    seq: IntArray
    start_s: FloatArray
    end_s: FloatArray
    """Times are the robot's process clock."""
    touched: FloatArray
    """1: the tool was on the part, 0: off it, NaN: not known."""
    recovered: BoolArray
    """Recorded after an interruption, on the robot's word."""
    force_n: FloatArray
    """Mean over the block by the actuator's word, as the daemon's samples had it; NaN where that is not known.

    So with ``rpm``, and with ``sensor_force_n``, which is the independent sensor's.
    """
    rpm: FloatArray
    told_s: FloatArray
    """When the robot told of it, on the monotonic clock of the daemon that ran the pass; NaN where recovered."""
    sensor_force_n: FloatArray

    @property
    def acting_n(self) -> FloatArray:
        """(n,) the force that acted, N: by the independent sensor where that told it, else by the actuator."""
        return np.where(np.isnan(self.sensor_force_n), self.force_n, self.sensor_force_n)

    @property
    def duration_s(self) -> FloatArray:
        """(n,) process time of each block."""
        return self.end_s - self.start_s

    @property
    def contact(self) -> BoolArray:
        """(n,) the tool is known to have been on the part."""
        return np.asarray(self.touched == 1, dtype=np.bool_)

    @property
    def possible(self) -> BoolArray:
        """(n,) the tool is not known to have been off the part."""
        return np.asarray(self.touched != 0, dtype=np.bool_)


def joined(ranges: Iterable[tuple[int, int]]) -> tuple[tuple[int, int], ...]:
    """Ranges of sequence numbers, ends excluded, in order; those that meet are one."""
    found: list[tuple[int, int]] = []
    for first, end in ranges:
        if found and first <= found[-1][1]:
            found[-1] = found[-1][0], max(end, found[-1][1])
        elif first < end:
            found.append((first, end))
    return tuple(found)
