"""The process that is recorded: the real daemon, or the journal's own methods, on a connection that leaves marks.

A mark is a line in a separate file, so that it stands in its place among the recorded system calls: what a commit is
about to write, and that it has returned. ``python -m tests.campaigns.crash.recorded_process MARKS`` and one of these:
``daemon CELL.toml ...`` is ``polishd run``; ``script STATE_DIR`` is a job of a second, by the journal's own methods;
``open STATE_DIR`` opens and closes it.
"""

from __future__ import annotations

import asyncio
import functools
import json
import os
import sqlite3
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from polishd.daemon.journal.journal import Journal
from polishd.daemon.journal.records import BlockRecord
from polishd.daemon.runtime.exit_record import locked
from polishd.model.devices import ExecutedBlock
from polishd.model.states import CyclePhase, Outcome
from polishd.util import files
from polishd.util.serialization import plain

CHECKPOINT_PAGES = 24
"""So that pages wander into the database all the time, not once in 1,000."""
NORMAL, NO_STORE_SYNC = "normal", "no-store-sync"
"""Broken on purpose: commits that are not synced, arrays that are not."""
WEAK = "POLISHD_CRASH_WEAK"
BLOCKS = 60
GROUP = 7


class Marking(sqlite3.Connection):
    """Marks what it commits before it does, and that it is durable afterwards."""

    handle = -1
    """Of the marks' file."""
    weak = ""

    @classmethod
    def mark(cls, **what: Any) -> None:
        """One line, whole."""
        os.write(cls.handle, json.dumps(what, default=plain).encode() + b"\n")

    def execute(self, sql: str, values: Any = (), /) -> sqlite3.Cursor:
        """One statement."""
        word = sql.split(None, 1)[0].upper()
        if self.weak == NORMAL and "synchronous" in sql:
            sql = "PRAGMA synchronous=NORMAL"
        if word == "BEGIN":
            self.rows: list[Any] = []
        beside = sql.startswith("INSERT INTO copy.")  # of the run folder, which promises nothing
        if beside or word not in {"INSERT", "UPDATE", "DELETE", "COMMIT", "ALTER", "CREATE", "DROP"}:
            return super().execute(sql, values)
        inside = self.in_transaction
        if word != "COMMIT":
            self.rows = [*(self.rows if inside else []), [sql, list(values)]]
            if inside:
                return super().execute(sql, values)
        self.mark(commit=self.rows)
        cursor = super().execute(sql, values)
        self.mark(durable=True)
        return cursor

    def executescript(self, script: str, /) -> sqlite3.Cursor:
        """A separate transaction."""
        self.mark(commit=[[script, None]])
        cursor = super().executescript(script)
        self.mark(durable=True)
        return cursor


def marking(marks: Path) -> Any:
    """A ``Connect`` for the journal."""
    Marking.handle = os.open(marks, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
    Marking.weak = os.environ.get(WEAK, "")
    if Marking.weak == NO_STORE_SYNC:
        files.os = SimpleNamespace(**{**vars(os), "fsync": lambda _: None})  # type: ignore[attr-defined]

    def connect(path: Path) -> sqlite3.Connection:
        connection = sqlite3.connect(path, isolation_level=None, check_same_thread=False, timeout=5.0, factory=Marking)
        connection.execute(f"PRAGMA wal_autocheckpoint={CHECKPOINT_PAGES}")
        return connection

    return connect


def opened(journal: Any, connect: Any, state: Path, *, job: str, **terms: Any) -> Journal:
    """``Journal.open``, with a mark of whose it is."""
    Marking.mark(job=job)
    return journal(state, job=job, connect=connect, **terms)


async def script(state: Path, connect: Any) -> None:
    """Two jobs in the cycle's order, each in two runs: the first pass of each job is cut off."""
    for job in ("first", "second"):
        for last in (False, True):
            with locked(state), opened(Journal.open, connect, state, job=job, part_id="P1") as journal:
                _settle(journal)
                await _cycle(journal, job, whole=last)
                if last:
                    journal.record_outcome(Outcome.CYCLES_USED)


def _settle(journal: Journal) -> None:
    if (torn := journal.unfinished()) is not None:
        begin = journal.tally(torn.cycle).last_seq + 1
        journal.reconcile(torn.cycle, [_block(seq, None) for seq in range(begin, begin + GROUP)])
        journal.mark_uncertain(torn.cycle, begin + GROUP, begin + 2 * GROUP)
        journal.end_pass(torn.cycle, "interrupted")


async def _cycle(journal: Journal, job: str, *, whole: bool) -> None:
    cycle = next(journal.remaining(9))
    program = f"{job} {cycle}"
    random = np.random.default_rng(len(program))
    async with journal.phase(cycle, CyclePhase.MEASURE):
        arrays = journal.arrays.put({"height_nm": random.normal(size=(40, 40))})
        journal.record_map(cycle, f"map of {program}", "map.dat", {"rms_nm": 1.0}, arrays)
    plan, start = (journal.arrays.put({"x": random.normal(size=200)}) for _ in range(2))
    journal.begin_pass(cycle, program, "boot", BLOCKS, contact=(2, BLOCKS - 2), plan=plan, start=start)
    Marking.mark(moves=program)
    for seq in range(BLOCKS if whole else BLOCKS // 2):
        journal.record_executed(cycle, [_block(seq, 2 <= seq < BLOCKS - 2)])
        if seq % GROUP == 0:
            journal.flush()
    if whole:
        journal.end_pass(cycle, "done")


def _block(seq: int, touched: bool | None) -> BlockRecord:
    return BlockRecord(ExecutedBlock(seq, seq * 0.1, seq * 0.1 + 0.05), touched)


def main(marks: str, what: str, *arguments: str) -> int:
    """Run it; the exit code."""
    connect = marking(Path(marks))
    if what == "script":
        asyncio.run(script(Path(arguments[0]), connect))
        return 0
    if what == "open":
        opened(Journal.open, connect, Path(arguments[0]), job="job", part_id="P1").close()
        return 0
    of_job = Journal.of_job

    def marked(journal: Journal, job: str, *terms: Any) -> Journal:
        Marking.mark(job=job)
        return of_job(journal, job, *terms)

    Journal.of_cell = functools.partial(Journal.of_cell, connect=connect)  # type: ignore[method-assign]
    Journal.of_job = marked  # type: ignore[method-assign]
    from polishd.__main__ import main as polishd

    sys.argv = ["polishd", "run", *arguments]
    polishd()
    return 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
