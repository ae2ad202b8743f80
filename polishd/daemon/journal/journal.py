"""Journal of a cell: durable intent, effect, durable outcome. The daemon knows only what the journal records."""

from __future__ import annotations

import asyncio
import json
import logging
import time
from collections.abc import AsyncIterator, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, asynccontextmanager
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType, TracebackType
from typing import Any, NoReturn, Self

import numpy as np

from polishd.daemon.journal.records import (
    BlockCounts,
    BlockRecord,
    JobMemory,
    JournalBlocks,
    MapRecord,
    PassRecord,
    empty_job_memory,
    joined,
    read_job,
    read_tally,
    read_unreported_blocks,
)
from polishd.daemon.journal.store import ArrayStore, Connect, Row, Store, connect
from polishd.model.errors import PolishdError, WrongSeat
from polishd.model.events import Event
from polishd.model.states import CyclePhase, Outcome
from polishd.util.serialization import plain

# Records of a job: from memory, but those that grow with the job are read from the file.

NOTHING = BlockCounts()

_EXECUTED = (
    "SELECT seq, start_s, end_s, touched, recovered, force_n, rpm, told_s, sensor_force_n FROM segment "
    "WHERE job = ? AND cycle = ? ORDER BY seq"
)


class JournalView:
    """Records of one job."""

    def __init__(self, store: Store, job: int, known: JobMemory) -> None:
        self._store = store
        self._job = self.number = job
        """Number of the job's row; ``NO_JOB`` between jobs."""
        self._known = known

    @property
    def unsaved_s(self) -> float:
        """Time that the oldest record that is not durable has waited for the disk, s."""
        return self._store.unsaved_s

    @property
    def begun(self) -> bool:
        """Whether this job has measured: from then on its terms are fixed."""
        return bool(self._known.maps or self._known.passes)

    @property
    def terms(self) -> Mapping[str, Any] | None:
        """Values with which this job began; None where an early polishd did not record them."""
        return self._known.terms

    @property
    def run_dir(self) -> str:
        """Its run folder; empty before there is one."""
        return self._known.run_dir

    def remaining(self, cycles: int) -> Iterator[int]:
        """Yield the remaining ones of so many cycles. The first one follows the last pass that has begun."""
        yield from range(max(self._known.passes, default=-1) + 1, cycles)

    @property
    def last_map_id(self) -> str | None:
        """sha256 of the last map of any job of this cell."""
        return self._known.last_map_id

    @property
    def history(self) -> tuple[MapRecord, ...]:
        """Maps of this job, the last one of each cycle."""
        return tuple(self._known.maps.values())

    @property
    def passes(self) -> tuple[PassRecord, ...]:
        """Passes of this job that have begun."""
        return tuple(self._known.passes.values())

    @property
    def phase_now(self) -> tuple[int | None, str | None]:
        """Cycle and phase that began last, in this run of the daemon or an earlier one."""
        return self._known.phase or (None, None)

    def tally(self, cycle: int) -> BlockCounts:
        """Return the recorded blocks of that cycle's pass."""
        return self._known.tallies.get(cycle, NOTHING)

    @property
    def done(self) -> int:
        """Number of recorded blocks of all passes of this job."""
        return sum(tally.done for tally in self._known.tallies.values())

    def contact_s(self, cycle: int) -> float:
        """Return the process time of the blocks of that cycle's pass that are known to be in contact."""
        return self.tally(cycle).contact_s

    def uncertain(self, cycle: int) -> tuple[tuple[int, int], ...]:
        """Return the blocks of that cycle's pass with unknown contact: ranges, ends excluded."""
        record = self._known.passes.get(cycle)
        tail = () if record is None or record.uncertain is None else (record.uncertain,)
        return joined([*self._known.unknown.get(cycle, ()), *tail])

    def executed(self, cycle: int) -> JournalBlocks:
        """Return the executed blocks of that cycle's pass. It reads the file: call it in a thread."""
        found = self._store.read_columns(_EXECUTED, (self._job, cycle), 9)
        seq, start_s, end_s, touched, recovered, *rest = found
        return JournalBlocks(seq.astype(np.int64), start_s, end_s, touched, recovered.astype(bool), *rest)

    def phase_times_s(self) -> dict[str, float]:
        """Return the total wall time of each phase of this job, in the order of a cycle."""
        sql = "SELECT phase, sum(ended - started) FROM phase WHERE job = ? AND ended IS NOT NULL GROUP BY phase"
        found = dict(self._store.read(sql, (self._job,)))
        return {phase.value: found[phase.value] for phase in CyclePhase if phase.value in found}

    def errors(self) -> list[tuple[float, str, Mapping[str, Any]]]:
        """Return the errors that held or ended this job's daemon, in time order: Unix time, event's name, its data.

        Between jobs, return only those of this run.
        """
        sql = (
            "SELECT at, name, data FROM event WHERE job = ? AND id > ? AND name IN ('cell_held', 'daemon_failed') "
            "ORDER BY id"
        )
        found = self._store.read(sql, (self._job, self._known.events_before))
        return [(at, name, json.loads(data)) for at, name, data in found]

    def held_last(self) -> str:
        """Return why the cell was held, or its queue stopped, when its last daemon ended; empty where neither was."""
        sql = (
            "SELECT data FROM event WHERE (name = 'state_changed' AND json_extract(data, '$.state') NOT IN "
            "('starting', 'finished')) OR (name = 'queue_job_ended' AND json_extract(data, '$.stops') != '') "
            "ORDER BY id DESC LIMIT 1"
        )
        for (text,) in self._store.read(sql):
            data = json.loads(text)
            if "stops" in data:  # without an operator the daemon ends here and does not hold
                return f"the queue stopped: {data['stops']}; {data['job']} was {data['verdict']}: {data['reason']}"
            return str(data["reason"]) if data["state"] == "held" else ""
        return ""

    def unfinished(self) -> PassRecord | None:
        """Return the pass that has begun and not ended, or None."""
        return next((record for record in self.passes if record.ended_s is None), None)

    def cut_off(self) -> int | None:
        """Return the phase row of the last pass or touch-off where it was interrupted: the robot may stand in it.

        None where it was complete. A wrong seat is complete when the robot has left the part.
        """
        sql = "SELECT id, outcome, error FROM phase WHERE phase IN (?, ?) ORDER BY id DESC LIMIT 1"
        for number, outcome, error in self._store.read(sql, (CyclePhase.RUN.value, CyclePhase.TOUCH_OFF.value)):
            if outcome != "done" and not (error or "").startswith(f"{WrongSeat.__name__}:"):
                return int(number)
        return None

    def passes_before(self, cycle: int, most: int) -> list[Mapping[str, Any]]:
        """Return the facts of the last complete passes of any job of this cell before that cycle, the latest first."""
        sql = (
            "SELECT facts FROM pass WHERE how = 'done' AND (job < ? OR (job = ? AND cycle < ?)) "
            "ORDER BY job DESC, cycle DESC LIMIT ?"
        )
        return [json.loads(facts) for (facts,) in self._store.read(sql, (self._job, self._job, cycle, most))]


log = logging.getLogger(__name__)

JOURNAL_NAME, ARRAYS_NAME = "journal.sqlite", "store"
NO_JOB = 0
"""Job number of events between jobs."""

_INTENT = (
    "INSERT INTO pass (job, cycle, program_sha256, boot_id, blocks, contact_from, contact_to, facts, started, plan, "
    "start, reach_s) VALUES (?,?,?,?,?,?,?,?,?,?,?,?)"
)
_SEGMENT = "INSERT OR IGNORE INTO segment VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)"


class Journal(JournalView, AbstractContextManager["Journal", None]):
    """Records of one job, for reading and writing.

    An error of the disk raises SafetyStop, then and in each later method that uses the disk: polishing stops.
    """

    def __init__(self, store: Store, arrays: ArrayStore, job: int, known: JobMemory, *, resumed: bool) -> None:
        super().__init__(store, job, known)
        self.store = store
        """Its file, shared with the queue."""
        self.arrays = arrays
        """Large arrays that its rows name."""
        self.resumed = resumed
        """An earlier run of the daemon began this job."""

    @classmethod
    def open(
        cls,
        state_dir: Path,
        *,
        job: str,
        part_id: str,
        terms: Mapping[str, Any] = MappingProxyType({}),
        connect: Connect = connect,
    ) -> Self:
        """Open the journal of a state folder, and continue its unfinished job of that name, or begin a new one.

        ``terms``: values with which the job begins (``resume_checks``), recorded before the first measurement. An
        unfinished job of another name ends. ConfigError where the file cannot be used.
        """
        cell = cls.of_cell(state_dir, connect)
        try:
            return cell.of_job(job, part_id, terms)
        except BaseException:
            cell.close()
            raise

    @classmethod
    def of_cell(cls, state_dir: Path, connect: Connect = connect) -> Self:
        """Open the journal of a state folder between jobs, with the events of that time. ConfigError as of ``open``."""
        store, arrays = Store.open(state_dir / JOURNAL_NAME, connect), ArrayStore(state_dir / ARRAYS_NAME)
        return cls(store, arrays, NO_JOB, empty_job_memory(store), resumed=False)

    def of_job(self, job: str, part_id: str, terms: Mapping[str, Any], *also: Row) -> Self:
        """Return the journal with its unfinished job of that name, or a new one, whose row is written with ``also``."""
        number, resumed = _taken_up(self._store, self.arrays, job, part_id, also)
        journal = type(self)(self._store, self.arrays, number, read_job(self._store, number), resumed=resumed)
        if not journal.begun:
            journal._take(part_id, terms)
        return journal

    # Writing. All but record_executed and record_event are durable when they return.

    @asynccontextmanager
    async def phase(self, cycle: int, phase: CyclePhase) -> AsyncIterator[None]:
        """Record start, end and error of a phase. Rows that were buffered in it are durable at its end."""
        sql, now = "INSERT INTO phase (job, cycle, phase, started) VALUES (?, ?, ?, ?)", time.time()
        self._store.write((sql, (self._job, cycle, phase.value, now)))
        ((number,),) = self._store.read("SELECT max(id) FROM phase")
        self._known.phase = (cycle, phase.value)
        try:
            yield
        except BaseException as error:
            outcome = "cancelled" if isinstance(error, (asyncio.CancelledError, GeneratorExit)) else "failed"
            try:
                self._end_phase(number, outcome, f"{type(error).__name__}: {error}")
            except PolishdError as lost:
                error.add_note(str(lost))  # the error of the phase comes first
            raise
        self._end_phase(number, "done", None)

    def record_run_dir(self, path: Path) -> None:
        """Record the run folder of this job."""
        self._store.write(("UPDATE job SET run_dir = ? WHERE id = ?", (str(path), self._job)))
        self._known.run_dir = str(path)

    def record_map(self, cycle: int, sha256: str, path: Path | str, stats: Mapping[str, Any], arrays: str = "") -> None:
        """Record a map of that cycle; ``arrays`` names the arrays computed from it."""
        text, now = json.dumps(dict(stats), default=plain), time.time()
        sql = "INSERT INTO map (job, cycle, sha256, path, stats, taken, arrays) VALUES (?,?,?,?,?,?,?)"
        self._store.write((sql, (self._job, cycle, sha256, str(path), text, now, arrays)))
        self._known.maps[cycle] = MapRecord(cycle, sha256, str(path), json.loads(text), now, arrays)
        self._known.last_map_id = sha256

    def begin_pass(
        self,
        cycle: int,
        program_sha256: str,
        boot_id: str,
        blocks: int,
        *,
        contact: tuple[int, int] | None = None,
        facts: Mapping[str, Any] | None = None,
        plan: str = "",
        start: str = "",
        reach_s: float | None = None,
    ) -> None:
        """Record the intent to run a program, durable before the robot starts. A cycle has one pass only.

        ``contact``: range of sequence numbers with the tool on the part (end excluded; default: all). ``facts``: for
        the summary. ``plan`` and ``start`` name arrays that a later cycle needs. ``reach_s``: longest time that the
        tool can stay on the part after the last recorded block.
        """
        if cycle in self._known.passes:
            raise PolishdError(f"journal: cycle {cycle} has a pass already; the daemon runs no pass twice")
        first, end = contact or (0, blocks)
        text, now = json.dumps(dict(facts or {}), default=plain), time.time()
        begun = (cycle, program_sha256, boot_id, blocks, first, end)
        self._store.write((_INTENT, (self._job, *begun, text, now, plan, start, reach_s)))
        known = PassRecord(*begun, json.loads(text), now, plan=plan, start=start, reach_s=reach_s)
        self._known.passes[cycle] = known

    def record_executed(self, cycle: int, records: Sequence[BlockRecord]) -> None:
        """Record executed blocks (buffered: durable within 0.25 s). A recorded block is not changed."""
        for record in records:
            self._store.buffer(self._segment(cycle, record, recovered=False))
        self._known.add(cycle, records)

    def require_in_time(self) -> None:
        """SafetyStop where an executed block has waited too long for its commit: the tool leaves contact."""
        self._store.require_in_time()

    def flush(self) -> None:
        """Commit all buffered rows now."""
        self._store.write()

    def add_facts(self, cycle: int, facts: Mapping[str, Any]) -> None:
        """Add facts to that cycle's pass after its end."""
        record = self._known.passes[cycle]
        whole = {**record.facts, **facts}
        text = json.dumps(whole, default=plain)
        self._store.write(("UPDATE pass SET facts = ? WHERE job = ? AND cycle = ?", (text, self._job, cycle)))
        self._known.passes[cycle] = replace(record, facts=json.loads(text))

    def end_pass(self, cycle: int, how: str) -> None:
        """Record the end of a pass: ``done``, ``stopped: ...`` or ``interrupted``."""
        now = time.time()
        sql = "UPDATE pass SET ended = ?, how = ? WHERE job = ? AND cycle = ? AND ended IS NULL"
        self._store.write((sql, (now, how, self._job, cycle)))
        record = self._known.passes[cycle]
        if record.ended_s is None:
            self._known.passes[cycle] = replace(record, ended_s=now, how=how)

    def reconcile(self, cycle: int, records: Iterable[BlockRecord]) -> None:
        """Add executed blocks that the robot reports and the journal does not have."""
        self._store.write(*(self._segment(cycle, record, recovered=True) for record in records))
        self._known.tallies[cycle] = read_tally(self._store, self._job, cycle)
        self._known.unknown[cycle] = read_unreported_blocks(self._store, self._job, cycle)

    def mark_uncertain(self, cycle: int, first: int, end: int) -> None:
        """Record the blocks after the last record that the tool may have touched (end excluded)."""
        sql = "UPDATE pass SET uncertain_from = ?, uncertain_to = ? WHERE job = ? AND cycle = ?"
        self._store.write((sql, (first, end, self._job, cycle)))
        self._known.passes[cycle] = replace(self._known.passes[cycle], uncertain=(first, end))

    def record_event(self, event: Event) -> None:
        """Record an event (buffered)."""
        values = (self._job, time.time(), event.cycle, event.name, json.dumps(dict(event.data), default=plain))
        self._store.buffer(("INSERT INTO event (job, at, cycle, name, data) VALUES (?,?,?,?,?)", values))

    def record_outcome(self, outcome: Outcome) -> None:
        """Record the end of the job; the next Journal of this state folder begins a new one."""
        self._store.write(over_row(self._job, outcome.value))

    def copy_to(self, path: Path) -> None:
        """Write a copy of this job for the run folder."""
        self._store.copy_to(path, self._job)

    async def lost(self) -> NoReturn:
        """Wait until the journal is lost, then raise SafetyStop. For a monitor in contact."""
        await self._store.lost()

    def close(self) -> None:
        """Commit all rows and close; idempotent."""
        self._store.close()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        """Close."""
        self.close()

    def _take(self, part_id: str, terms: Mapping[str, Any]) -> None:
        sql = "UPDATE job SET part_id = ?, terms = ? WHERE id = ?"
        self._store.write((sql, (part_id, json.dumps(dict(terms)), self._job)))
        self._known.terms = json.loads(json.dumps(dict(terms)))

    def _end_phase(self, number: int, outcome: str, error: str | None) -> None:
        sql = "UPDATE phase SET ended = ?, outcome = ?, error = ? WHERE id = ?"
        self._store.write((sql, (time.time(), outcome, error, number)))

    def _segment(self, cycle: int, record: BlockRecord, *, recovered: bool) -> Row:
        block = record.block
        known = (record.touched, recovered, record.force_n, record.rpm, record.told_s, record.sensor_force_n)
        return _SEGMENT, (self._job, cycle, block.seq, block.start_s, block.end_s, *known)


def over_row(job: int, outcome: str, detail: str = "") -> Row:
    """Return the row that ends a job, to write together with other ends."""
    return "UPDATE job SET ended = ?, outcome = ?, detail = ? WHERE id = ?", (time.time(), outcome, detail, job)


def _taken_up(store: Store, arrays: ArrayStore, job: str, part_id: str, also: Sequence[Row]) -> tuple[int, bool]:
    """Return the number of the unfinished job of that name, or of a new one; and whether it is the unfinished one."""
    rows = store.read("SELECT id, name FROM job WHERE outcome IS NULL ORDER BY id DESC LIMIT 1")
    if rows and rows[0][1] == job:
        return int(rows[0][0]), True
    number = _begin(store, job, part_id, also)
    _drop_plans(store, arrays)
    return number, False


def _begin(store: Store, job: str, part_id: str, also: Sequence[Row]) -> int:
    """Add a row. An unfinished job ends, with a warning in the log."""
    for (name,) in store.read("SELECT name FROM job WHERE outcome IS NULL"):
        log.warning("the unfinished job %r ends: the job %r replaces it", name, job)
    sql = "UPDATE job SET ended = ?, outcome = 'stopped', detail = ? WHERE outcome IS NULL"
    new = "INSERT INTO job (name, part_id, terms, started) VALUES (?, ?, 'null', ?)"
    store.write((sql, (time.time(), f"{job} replaced it")), (new, (job, part_id, time.time())), *also)
    return int(store.read("SELECT max(id) FROM job")[0][0])


def _drop_plans(store: Store, arrays: ArrayStore) -> None:
    """Remove the plans of jobs that are over. Their maps stay for the history."""
    over = "plan != '' AND job IN (SELECT id FROM job WHERE outcome IS NOT NULL)"
    for names in store.read(f"SELECT plan, start FROM pass WHERE {over}"):  # noqa: S608 - no value is in it
        arrays.remove(*names)
    store.write((f"UPDATE pass SET plan = '', start = '' WHERE {over}", ()))  # noqa: S608
