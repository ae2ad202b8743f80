"""Out of memory: found in the causes of an error, reported with a message, and handled with a reserve."""

from __future__ import annotations

import resource
import sqlite3
from pathlib import Path
from typing import Any

import pytest

from polishd.daemon.cell.device_polling import root_cause
from polishd.daemon.journal.store import Store
from polishd.daemon.runtime import memory
from polishd.model.errors import HostFault, LinkError, SafetyStop
from polishd.util.threads import LoopThreads


def caused() -> LinkError:
    error = LinkError("tcp://h:1: MemoryError")
    error.__cause__ = MemoryError()
    return error


@pytest.mark.parametrize("error", [MemoryError(), RuntimeError("can't start new thread"), caused()])
def test_missing_memory_is_reported_before_what_follows_from_it(error: Exception) -> None:
    memory.RESERVE.take()
    fault = root_cause(ExceptionGroup("", [SafetyStop("late"), ExceptionGroup("", [LinkError("gone"), error])]))
    assert isinstance(fault, HostFault)
    assert "run out of memory" in str(fault)
    assert fault.__cause__ is error
    assert memory.RESERVE.kept_bytes == 0


def test_other_errors_stay_what_they_are() -> None:
    error = RuntimeError("a bug")
    assert memory.named(error) is error
    stop = SafetyStop("a limit")
    assert root_cause(ExceptionGroup("", [error, stop])) is stop


def test_the_reserve_is_taken_once() -> None:
    reserve = memory.Reserve()
    reserve.take()
    reserve.take()
    assert reserve.kept_bytes == memory.RESERVE_BYTES


def test_what_is_left_is_below_the_nearer_limit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    status = tmp_path / "status"
    status.write_text("Name:\tx\nVmSize:\t 100000 kB\nVmData:\t 50000 kB\n")
    limits = {resource.RLIMIT_AS: 300_000_000, resource.RLIMIT_DATA: 100_000_000}
    monkeypatch.setattr(memory.resource, "getrlimit", lambda number: (limits[number], -1))
    assert memory.process_memory_mb(status) == (pytest.approx(48.8), "LimitDATA, ulimit -d")
    limits |= dict.fromkeys(limits, resource.RLIM_INFINITY)
    assert memory.process_memory_mb(status) is None


def test_a_journal_without_memory_is_lost_and_says_so(tmp_path: Path) -> None:
    """SQLite raises MemoryError then: rows that were to be written are not silently gone."""

    class Connection(sqlite3.Connection):
        out = False

        def execute(self, sql: str, *values: Any) -> sqlite3.Cursor:
            if self.out and sql.startswith("INSERT"):
                raise MemoryError
            return super().execute(sql, *values)

    kept: list[Connection] = []

    def connect(*arguments: Any, **named: Any) -> sqlite3.Connection:
        kept.append(sqlite3.connect(*arguments, **named, factory=Connection))
        return kept[-1]

    store = Store.open(tmp_path / "journal.sqlite", connect)
    kept[-1].out = True
    said = r"journal lost: .*the daemon has run out of memory; .* Increase its memory limit"
    with pytest.raises(SafetyStop, match=said):
        store.write(("INSERT INTO nothing VALUES (1)", ()))
    assert not kept[-1].in_transaction
    with pytest.raises(SafetyStop, match=said):
        store.buffer(("INSERT INTO nothing VALUES (1)", ()))
    store.close()


def test_threads_beside_the_loop_begin_at_once() -> None:
    threads = LoopThreads()
    before = len(threads._threads)
    assert before == threads._max_workers
    for future in [threads.submit(int) for _ in range(3 * before)]:
        future.result()
    assert len(threads._threads) == before
    threads.shutdown()
