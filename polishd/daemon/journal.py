"""The journal of a cell: durable intent, effect, durable outcome. What it says is what the daemon knows."""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import AsyncIterator, Iterable, Iterator, Mapping
from contextlib import asynccontextmanager
from pathlib import Path
from types import TracebackType
from typing import Any, NoReturn, Self

import numpy as np

from polishd.daemon.journal_records import ExecutedBlocks, Interrupted, MapRecord, PassRecord, PhaseRecord
from polishd.daemon.journal_store import Row, Store
from polishd.daemon.plain import plain
from polishd.model.cycle import Event, Outcome, Phase
from polishd.model.devices import Executed
from polishd.model.errors import PolishdError

JOURNAL_NAME = "journal.sqlite"

_SEGMENT = "INSERT OR IGNORE INTO segment VALUES (?, ?, ?, ?, ?, ?, ?)"


class Journal:
    """One job's view of the journal: the unfinished job of that name and part goes on, else a new one begins.

    Any error of the disk raises SafetyStop, from then on from every method: polishing stops.
    """

    def __init__(self, state_dir: Path, *, job: str, part_id: str, config_sha256: str = "") -> None:
        self._store = Store(state_dir / JOURNAL_NAME)
        self.superseded: str | None = None
        """Name of an unfinished job that this one replaces (another job, or another part)."""
        rows = self._store.read("SELECT id, name, part_id FROM job WHERE outcome IS NULL ORDER BY id DESC LIMIT 1")
        self.resumed = bool(rows) and rows[0][1:] == (job, part_id)
        """This job was begun by an earlier run of the daemon."""
        if self.resumed:
            self._job = int(rows[0][0])
        else:
            self._job = self._begin(job, part_id, config_sha256, [row[1] for row in rows])
        self._contact: dict[int, tuple[int, int]] = {
            record.cycle: (record.contact_from, record.contact_to) for record in self.passes
        }

    # what is known

    def remaining(self, cycles: int) -> Iterator[int]:
        """Cycles yet to do of so many: each starts with a measurement, so one after a begun pass is a new one."""
        begun = [record.cycle for record in self.passes]
        yield from range(max(begun, default=-1) + 1, cycles)

    @property
    def last_map_id(self) -> str | None:
        """sha256 of the last map taken, by any job of this cell."""
        rows = self._store.read("SELECT sha256 FROM map ORDER BY id DESC LIMIT 1")
        return str(rows[0][0]) if rows else None

    @property
    def history(self) -> tuple[MapRecord, ...]:
        """The maps of this job, the last one of each cycle."""
        sql = (
            "SELECT cycle, sha256, path, stats, taken FROM map WHERE id IN "
            "(SELECT max(id) FROM map WHERE job = ? GROUP BY cycle) ORDER BY cycle"
        )
        return tuple(MapRecord(c, sha, path, json.loads(s), t) for c, sha, path, s, t in self._read(sql))

    @property
    def passes(self) -> tuple[PassRecord, ...]:
        """The passes begun by this job."""
        sql = (
            "SELECT cycle, program_sha256, boot_id, blocks, contact_from, contact_to, facts, started, ended, how "
            "FROM pass WHERE job = ? ORDER BY cycle"
        )
        return tuple(
            PassRecord(cycle, sha, boot, blocks, first, end, json.loads(facts), started, ended, how)
            for cycle, sha, boot, blocks, first, end, facts, started, ended, how in self._read(sql)
        )

    @property
    def phases(self) -> tuple[PhaseRecord, ...]:
        """The phases of this job, in time order."""
        sql = "SELECT cycle, phase, started, ended, outcome, error FROM phase WHERE job = ? ORDER BY id"
        return tuple(PhaseRecord(*row) for row in self._read(sql))

    def executed(self, cycle: int) -> ExecutedBlocks:
        """What the robot executed in that cycle's pass; empty where there was none."""
        sql = "SELECT seq, start_s, end_s, in_contact, recovered FROM segment WHERE job = ? AND cycle = ? ORDER BY seq"
        table = np.array(self._store.read(sql, (self._job, cycle)), dtype=np.float64).reshape(-1, 5)
        seq, start_s, end_s, contact, recovered = table.T.copy()
        return ExecutedBlocks(seq.astype(np.int64), start_s, end_s, contact.astype(bool), recovered.astype(bool))

    def unfinished(self) -> Interrupted | None:
        """The pass that was begun and never ended, or None."""
        for record in self.passes:
            if record.ended_s is None:
                seqs = self.executed(record.cycle).seq
                last = int(seqs[-1]) if seqs.size else -1
                return Interrupted(
                    cycle=record.cycle,
                    program_sha256=record.program_sha256,
                    boot_id=record.boot_id,
                    blocks=record.blocks,
                    done=int(seqs.size),
                    last_seq=last,
                    uncertain=tuple(range(last + 1, record.blocks)),
                    started_s=record.started_s,
                )
        return None

    def finished(self) -> Outcome | None:
        """How this job ended, or None while it has not."""
        rows = self._store.read("SELECT outcome FROM job WHERE id = ?", (self._job,))
        return None if rows[0][0] is None else Outcome(rows[0][0])

    # what is recorded; all but executed_segment and record_event are durable when they return

    @asynccontextmanager
    async def phase(self, cycle: int, phase: Phase) -> AsyncIterator[None]:
        """Record start, end and error of a phase; what was buffered in it is durable at its end."""
        number = self._insert_phase(cycle, phase)
        try:
            yield
        except BaseException as error:
            outcome = "cancelled" if isinstance(error, (asyncio.CancelledError, GeneratorExit)) else "failed"
            try:
                self._end_phase(number, outcome, f"{type(error).__name__}: {error}")
            except PolishdError as lost:
                error.add_note(str(lost))  # what ended the phase is told first
            raise
        self._end_phase(number, "done", None)

    def record_map(self, cycle: int, sha256: str, path: Path | str, stats: Mapping[str, Any]) -> None:
        """A map was taken for that cycle."""
        values = (self._job, cycle, sha256, str(path), json.dumps(dict(stats), default=plain), time.time())
        self._store.write(("INSERT INTO map (job, cycle, sha256, path, stats, taken) VALUES (?,?,?,?,?,?)", values))

    def begin_pass(
        self,
        cycle: int,
        program_sha256: str,
        boot_id: str,
        blocks: int,
        *,
        contact: tuple[int, int] | None = None,
        facts: Mapping[str, Any] | None = None,
    ) -> None:
        """The intent to run a program: durable before the robot is started. A cycle has one pass, ever.

        ``contact`` is the range of sequence numbers with the tool on the part (end excluded; default: all);
        ``facts`` is kept for the summary.
        """
        first, end = contact or (0, blocks)
        values = (
            self._job,
            cycle,
            program_sha256,
            boot_id,
            blocks,
            first,
            end,
            json.dumps(dict(facts or {}), default=plain),
        )
        if any(record.cycle == cycle for record in self.passes):
            raise PolishdError(f"journal: cycle {cycle} has had its pass; nothing is run twice")
        self._store.write(("INSERT INTO pass VALUES (?,?,?,?,?,?,?,?,?,NULL,NULL)", (*values, time.time())))
        self._contact[cycle] = (first, end)

    def executed_segment(self, cycle: int, block: Executed, contact: bool | None = None) -> None:
        """A block was executed (buffered: durable within 0.25 s). One that is recorded already changes nothing."""
        self._store.buffer(self._segment(cycle, block, contact, recovered=False))

    def flush(self) -> None:
        """Make all that is buffered durable now."""
        self._store.write()

    def end_pass(self, cycle: int, how: str) -> None:
        """The pass is over, and it is known how: ``done``, ``stopped: ...``, ``interrupted``."""
        sql = "UPDATE pass SET ended = ?, how = ? WHERE job = ? AND cycle = ? AND ended IS NULL"
        self._store.write((sql, (time.time(), how, self._job, cycle)))

    def reconcile(self, cycle: int, executed: Iterable[Executed]) -> int:
        """Add blocks that the robot says it executed and the journal does not know; says how many were new."""
        before = self.executed(cycle).seq.size
        self._store.write(*(self._segment(cycle, block, None, recovered=True) for block in executed))
        return int(self.executed(cycle).seq.size - before)

    def record_event(self, event: Event) -> None:
        """Keep an event (buffered)."""
        values = (self._job, time.time(), event.cycle, event.name, json.dumps(dict(event.data), default=plain))
        self._store.buffer(("INSERT INTO event (job, at, cycle, name, data) VALUES (?,?,?,?,?)", values))

    def record_outcome(self, outcome: Outcome, detail: str = "") -> None:
        """The job is over; the next Journal of this state folder begins a new one."""
        sql = "UPDATE job SET ended = ?, outcome = ?, detail = ? WHERE id = ?"
        self._store.write((sql, (time.time(), outcome.value, detail, self._job)))

    def copy_to(self, path: Path) -> None:
        """A whole copy for the run folder."""
        self._store.copy_to(path)

    async def lost(self) -> NoReturn:
        """Raise SafetyStop as soon as the journal is lost; until then wait. For a watcher in contact."""
        await self._store.lost()

    def close(self) -> None:
        """Make all durable and close; idempotent."""
        self._store.close()

    def __enter__(self) -> Self:
        """The journal is open already."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        """Close."""
        self.close()

    def _read(self, sql: str) -> list[tuple[Any, ...]]:
        return self._store.read(sql, (self._job,))

    def _begin(self, job: str, part_id: str, config_sha256: str, unfinished: list[str]) -> int:
        if unfinished:
            self.superseded = unfinished[0]
            sql = "UPDATE job SET ended = ?, outcome = 'stopped', detail = 'superseded' WHERE outcome IS NULL"
            self._store.write((sql, (time.time(),)))
        sql = "INSERT INTO job (name, part_id, config_sha256, started) VALUES (?, ?, ?, ?)"
        self._store.write((sql, (job, part_id, config_sha256, time.time())))
        return int(self._store.read("SELECT max(id) FROM job")[0][0])

    def _insert_phase(self, cycle: int, phase: Phase) -> int:
        sql = "INSERT INTO phase (job, cycle, phase, started) VALUES (?, ?, ?, ?)"
        self._store.write((sql, (self._job, cycle, phase.value, time.time())))
        return int(self._store.read("SELECT max(id) FROM phase")[0][0])

    def _end_phase(self, number: int, outcome: str, error: str | None) -> None:
        sql = "UPDATE phase SET ended = ?, outcome = ?, error = ? WHERE id = ?"
        self._store.write((sql, (time.time(), outcome, error, number)))

    def _segment(self, cycle: int, block: Executed, contact: bool | None, *, recovered: bool) -> Row:
        first, end = self._contact.get(cycle, (0, 0))
        touching = first <= block.seq < end if contact is None else contact
        return _SEGMENT, (self._job, cycle, block.seq, block.start_s, block.end_s, touching, recovered)
