"""Records of the journal: maps, passes and executed blocks."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from polishd.daemon.journal.store import Store
from polishd.model.devices import ExecutedBlock
from polishd.model.program import IntArray
from polishd.model.surface import BoolArray, FloatArray


@dataclass(frozen=True, slots=True)
class MapRecord:
    """The last map of a cycle."""

    cycle: int
    sha256: str
    path: str
    stats: Mapping[str, Any]
    taken_s: float
    """Unix time."""
    arrays: str = ""
    """Name in the array store of the arrays computed from it."""


@dataclass(frozen=True, slots=True)
class PassRecord:
    """A pass: written before the robot starts, completed when its end is known."""

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
    """Names in the array store: of the plan, and of the start of the next solution."""
    start: str = ""
    reach_s: float | None = None
    """Longest time that the tool can stay on the part after the last recorded block, s; None: unknown."""
    uncertain: tuple[int, int] | None = None
    """Blocks after the last record that the tool may have touched: sequence numbers, end excluded; None: not known."""


@dataclass(frozen=True, slots=True)
class BlockRecord:
    """An executed block, with the state of the tool during it."""

    block: ExecutedBlock
    touched: bool | None
    """The tool was on the part for all of it, or for none of it; None: unknown."""
    force_n: float | None = None
    """Mean force from the actuator; None: unknown."""
    rpm: float | None = None
    told_s: float | None = None
    """Time of the robot's report, on the monotonic clock of the daemon that ran the pass."""
    sensor_force_n: float | None = None
    """Mean force from the independent sensor; None: unknown, or the cell has none."""


@dataclass(frozen=True, slots=True)
class BlockCounts:
    """Recorded blocks of one pass."""

    done: int = 0
    """Number of blocks."""
    last_seq: int = -1
    """Sequence number of the last one; -1 for none."""
    contact_s: float = 0.0
    """Process time of those that are known to be in contact."""


@dataclass(frozen=True, slots=True)
class JournalBlocks:
    """Executed blocks of one pass, by sequence number; (n,) each."""

    seq: IntArray
    start_s: FloatArray
    end_s: FloatArray
    """Times are on the robot's process clock."""
    touched: FloatArray
    """1: the tool was on the part, 0: off it, NaN: unknown."""
    recovered: BoolArray
    """Recorded after an interruption, from the robot's report."""
    force_n: FloatArray
    """Mean of the actuator's samples over the block; NaN where unknown.

    The same for ``rpm``, and for ``sensor_force_n`` of the independent sensor.
    """
    rpm: FloatArray
    told_s: FloatArray
    """Time of the robot's report, on the monotonic clock of the daemon that ran the pass; NaN where recovered."""
    sensor_force_n: FloatArray

    @property
    def acting_n(self) -> FloatArray:
        """(n,) the acting force, N: from the independent sensor where known, else from the actuator."""
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
    """Return ranges of sequence numbers, ends excluded, in order; adjacent ranges are joined."""
    found: list[tuple[int, int]] = []
    for first, end in ranges:
        if found and first <= found[-1][1]:
            found[-1] = found[-1][0], max(end, found[-1][1])
        elif first < end:
            found.append((first, end))
    return tuple(found)


# Rows of one job in memory, so that reading them never waits for the disk.


@dataclass(slots=True)
class JobMemory:
    """Rows of one job: read once, then updated with each write."""

    terms: Mapping[str, Any] | None
    """Values with which the job began (``resume_checks``); None: an early polishd did not record them."""
    run_dir: str
    last_map_id: str | None
    """Of any job."""
    maps: dict[int, MapRecord]
    """Last map of each cycle."""
    passes: dict[int, PassRecord]
    phase: tuple[int, str] | None
    """Cycle and phase that began last."""
    tallies: dict[int, BlockCounts]
    unknown: dict[int, list[tuple[int, int]]]
    """By cycle, executed blocks with unknown contact: ranges, ends excluded."""
    events_before: int = 0
    """Number of the last event of earlier runs between jobs, which have the same job number."""

    def add(self, cycle: int, records: Sequence[BlockRecord]) -> None:
        """Add executed blocks; blocks that are there already change nothing."""
        tally = self.tallies.get(cycle, BlockCounts())
        new = [record for record in records if record.block.seq > tally.last_seq]
        if new:
            contact_s = sum(record.block.end_s - record.block.start_s for record in new if record.touched)
            self.tallies[cycle] = BlockCounts(tally.done + len(new), new[-1].block.seq, tally.contact_s + contact_s)
        for record in new:  # appended at constant cost: the contact loop calls this
            if record.touched is None:
                _append(self.unknown.setdefault(cycle, []), record.block.seq)


def _append(ranges: list[tuple[int, int]], seq: int) -> None:
    """Append one sequence number after all ranges."""
    first = ranges.pop()[0] if ranges and ranges[-1][1] == seq else seq
    ranges.append((first, seq + 1))


def empty_job_memory(store: Store) -> JobMemory:
    """Return the memory between jobs."""
    ((before,),) = store.read("SELECT ifnull(max(id), 0) FROM event")
    return JobMemory(None, "", _last_map(store), {}, {}, None, {}, {}, before)


def read_job(store: Store, job: int) -> JobMemory:
    """Return the rows of a job."""
    ((terms, run_dir),) = store.read("SELECT terms, run_dir FROM job WHERE id = ?", (job,))
    maps = "SELECT cycle, sha256, path, stats, taken, arrays FROM map WHERE job = ? ORDER BY id"
    passes = (
        "SELECT cycle, program_sha256, boot_id, blocks, contact_from, contact_to, facts, started, ended, how, plan, "
        "start, reach_s, uncertain_from, uncertain_to FROM pass WHERE job = ? ORDER BY cycle"
    )
    phases = store.read("SELECT cycle, phase FROM phase WHERE job = ? ORDER BY id DESC LIMIT 1", (job,))
    begun = [_decoded(row, 6) for row in store.read(passes, (job,))]
    return JobMemory(
        terms=json.loads(terms),
        run_dir=run_dir,
        last_map_id=_last_map(store),
        maps={row[0]: MapRecord(*_decoded(row, 3)) for row in store.read(maps, (job,))},
        passes={row[0]: replace(PassRecord(*row[:-2]), uncertain=_range(*row[-2:])) for row in begun},
        phase=(phases[0][0], phases[0][1]) if phases else None,
        tallies={cycle: read_tally(store, job, cycle) for cycle, *_ in begun},
        unknown={cycle: read_unreported_blocks(store, job, cycle) for cycle, *_ in begun},
    )


def read_tally(store: Store, job: int, cycle: int) -> BlockCounts:
    """Return the recorded blocks of that pass in the file."""
    sql = (
        "SELECT count(*), ifnull(max(seq), -1), total((end_s - start_s) * touched) "
        "FROM segment WHERE job = ? AND cycle = ?"
    )
    ((done, last_seq, contact_s),) = store.read(sql, (job, cycle))
    return BlockCounts(done, last_seq, contact_s)


def read_unreported_blocks(store: Store, job: int, cycle: int) -> list[tuple[int, int]]:
    """Return the executed blocks of that pass with unknown contact in the file."""
    sql = "SELECT seq FROM segment WHERE job = ? AND cycle = ? AND touched IS NULL ORDER BY seq"
    seq = store.read_columns(sql, (job, cycle), 1)[0].astype(np.int64)
    starts = np.flatnonzero(np.diff(seq, prepend=-2) > 1)
    ends = np.append(starts[1:], seq.size) - 1
    return [(int(first), int(last) + 1) for first, last in zip(seq[starts], seq[ends], strict=True)] if seq.size else []


def _range(first: int | None, end: int | None) -> tuple[int, int] | None:
    return None if first is None or end is None else (first, end)


def _last_map(store: Store) -> str | None:
    found = store.read("SELECT sha256 FROM map ORDER BY id DESC LIMIT 1")
    return found[0][0] if found else None


def _decoded(row: tuple[Any, ...], column: int) -> tuple[Any, ...]:
    return (*row[:column], json.loads(row[column]), *row[column + 1 :])
