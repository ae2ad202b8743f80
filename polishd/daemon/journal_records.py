"""What the journal gives back: maps, passes, and the blocks that were executed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

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


@dataclass(frozen=True, slots=True)
class Tally:
    """How much of one pass is recorded as executed."""

    done: int = 0
    """Blocks."""
    last_seq: int = -1
    """The last of them; -1 for none."""
    contact_s: float = 0.0
    """Process time of those in contact."""


@dataclass(frozen=True, slots=True)
class ExecutedBlocks:
    """Blocks of one pass that were executed, by sequence number; (n,) each."""

    seq: IntArray
    start_s: FloatArray
    end_s: FloatArray
    """Times are the robot's process clock."""
    contact: BoolArray
    """The tool was on the part, as far as the record knows."""
    recovered: BoolArray
    """Recorded after an interruption, on the robot's word: the force at that time is not known."""

    @property
    def duration_s(self) -> FloatArray:
        """(n,) process time of each block."""
        return self.end_s - self.start_s
