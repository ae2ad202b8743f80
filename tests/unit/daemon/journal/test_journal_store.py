"""File of the journal: buffered rows, durable rows, their waiting time, and the permanent error after a loss."""

from __future__ import annotations

import asyncio
import errno
import sqlite3
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from polishd.daemon.journal import store as journal_store
from polishd.daemon.journal.store import COMMIT_ROWS, COMMIT_S, LATE_S, Row, Store
from polishd.model.errors import ConfigError, SafetyStop


def event(number: int) -> Row:
    return "INSERT INTO event (job, at, name, data) VALUES (0, ?, 'x', '{}')", (float(number),)


BROKEN: Row = ("INSERT INTO nowhere VALUES (?)", (1,))
EVENTS = "SELECT at FROM event ORDER BY at"


class Clock:
    """Clock of the store."""

    now_s = 10.0

    def monotonic(self) -> float:
        return self.now_s


class Disk:
    """Transactions of a store: each waits until it may go on."""

    def __init__(self, store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
        self.begun, self.go_on = threading.Semaphore(0), threading.Semaphore(0)
        self._plain = store._transaction
        monkeypatch.setattr(store, "_transaction", self.transaction)

    def transaction(self, rows: list[Row]) -> None:
        self.begun.release()
        assert self.go_on.acquire(timeout=60)
        self._plain(rows)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "journal.sqlite"


@pytest.fixture
def store(path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Store]:
    """Store whose thread commits nothing."""
    monkeypatch.setattr(journal_store, "COMMIT_S", 1e6)
    found = Store.open(path)
    yield found
    try:
        found.close()
    except SafetyStop:
        assert found._failure is not None


def durable(path: Path) -> list[float]:
    connection = sqlite3.connect(f"file:{path}?mode=ro", uri=True)
    try:
        return [at for (at,) in connection.execute(EVENTS)]
    finally:
        connection.close()


def test_what_is_buffered_is_read_and_durable_then(store: Store, path: Path) -> None:
    store.buffer(event(1))
    assert durable(path) == []
    assert store.read(EVENTS) == [(1.0,)]
    assert durable(path) == [1.0]
    store.buffer(event(2))
    at, job = store.read_columns("SELECT at, job FROM event ORDER BY at", (), 2)
    assert (at.tolist(), job.tolist()) == ([1.0, 2.0], [0.0, 0.0])
    assert durable(path) == [1.0, 2.0]


def test_rows_are_written_in_the_order_in_which_they_were_given(store: Store) -> None:
    store.buffer(event(1))
    store.buffer(("UPDATE event SET at = at + 10 WHERE at = ?", (1.0,)))
    store.write(("UPDATE event SET at = at + 100 WHERE at = ?", (11.0,)), event(2))
    assert store.read(EVENTS) == [(2.0,), (111.0,)]


def test_columns_of_many_pieces_are_whole_and_empty_ones_are_as_many(store: Store) -> None:
    store.write(*map(event, range(2 * COMMIT_ROWS + 1)))
    (found,) = store.read_columns(EVENTS, (), 1)
    assert found.tolist() == list(range(2 * COMMIT_ROWS + 1))
    none = store.read_columns("SELECT at, job, id FROM event WHERE at < ?", (0.0,), 3)
    assert [column.shape for column in none] == [(0,)] * 3


def test_what_is_closed_is_durable(store: Store, path: Path) -> None:
    store.buffer(event(1))
    store.close()
    assert durable(path) == [1.0]
    assert store.unsaved_s == 0.0
    assert not store._thread.is_alive()


def test_a_process_that_ends_without_closing_ends(store: Store) -> None:
    assert store._thread.daemon, "else it would wait for the thread for ever"
    assert store._thread.is_alive()


def test_what_is_read_needs_no_lock_of_the_file(store: Store, path: Path) -> None:
    """Another program that copies the file may lock it for any time."""
    other = sqlite3.connect(path, isolation_level=None)
    other.execute("BEGIN IMMEDIATE")
    assert store.read(EVENTS) == []
    other.close()


def test_a_copy_makes_the_folders_that_it_needs(store: Store, tmp_path: Path) -> None:
    store.copy_to(tmp_path / "run" / "of" / "copy.sqlite", 1)
    assert (tmp_path / "run" / "of" / "copy.sqlite").is_file()


def test_a_copy_that_sqlite_refuses_is_reported_and_loses_nothing(
    store: Store, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuses(*_: object) -> None:
        raise sqlite3.OperationalError("database or disk is full")

    monkeypatch.setattr(journal_store, "copy_job", refuses)
    with pytest.raises(SafetyStop, match="the copy failed: database or disk is full"):
        store.copy_to(tmp_path / "copy.sqlite", 1)
    store.write(event(1))
    assert store.read(EVENTS) == [(1.0,)]


# how long rows have waited


def test_the_oldest_row_counts_while_it_waits_and_while_it_is_written(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock, disk = Clock(), Disk(store, monkeypatch)
    monkeypatch.setattr(journal_store, "time", clock)
    assert store.unsaved_s == 0.0
    store.buffer(event(1))
    clock.now_s = 11.0
    store.buffer(event(2))
    assert store.unsaved_s == 1.0
    writing = threading.Thread(target=store.write)
    writing.start()
    assert disk.begun.acquire(timeout=60)
    clock.now_s = 12.0
    assert store.unsaved_s == 2.0, "the disk has them, and has not kept them yet"
    store.buffer(event(3))
    clock.now_s = 13.0
    assert store.unsaved_s == 3.0
    disk.go_on.release()
    writing.join()
    assert store.unsaved_s == 1.0, "only the last one waits"
    disk.go_on.release(9)
    store.write()
    assert store.unsaved_s == 0.0


def test_just_so_late_is_in_time_and_later_is_not(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    clock = Clock()
    monkeypatch.setattr(journal_store, "time", clock)
    store.buffer(event(1))
    clock.now_s += LATE_S
    store.require_in_time()
    clock.now_s += 0.5
    with pytest.raises(SafetyStop, match=r"journal.sqlite: a commit takes 2\.5 s, the limit is 2 s"):
        store.require_in_time()
    store.write()
    store.require_in_time()


# a loss


def lose(store: Store) -> None:
    with pytest.raises(SafetyStop, match=r"journal lost: .*no such table: nowhere"):
        store.write(BROKEN)


def test_a_loss_is_reported_by_everything_from_then_on(store: Store, tmp_path: Path) -> None:
    store.write(event(1))
    lose(store)
    for use in (
        store.write,
        store.require_in_time,
        lambda: store.write(event(2)),
        lambda: store.buffer(event(2)),
        lambda: store.read(EVENTS),
        lambda: store.read_columns(EVENTS, (), 1),
        lambda: store.copy_to(tmp_path / "copy", 1),
        lambda: asyncio.run(store.lost()),
    ):
        with pytest.raises(
            SafetyStop, match=r"journal lost: .*journal.sqlite: no such table: nowhere \(SQLITE_ERROR\)"
        ):
            use()
    assert store.unsaved_s == 0.0, "nothing waits for it any more"
    assert not (tmp_path / "copy").exists()


def test_what_waited_when_it_was_lost_is_reported_by_the_loss_alone(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = Clock()
    monkeypatch.setattr(journal_store, "time", clock)
    store.buffer(event(1))
    clock.now_s += 60.0
    assert store.unsaved_s == 60.0
    lose(store)
    assert store.unsaved_s == 0.0


@pytest.mark.parametrize("table", [False, True])
def test_a_question_that_the_file_does_not_answer_is_a_loss(store: Store, table: bool) -> None:
    with pytest.raises(SafetyStop, match="journal lost"):
        store.read_columns("SELECT a FROM nowhere", (), 1) if table else store.read("SELECT a FROM nowhere")
    with pytest.raises(SafetyStop, match="journal lost"):
        store.write()


def test_nothing_of_a_transaction_that_fails_is_kept_and_nothing_stays_locked(store: Store, path: Path) -> None:
    with pytest.raises(SafetyStop):
        store.write(event(1), BROKEN)
    assert durable(path) == []
    store.close()


async def test_all_who_wait_for_a_loss_hear_of_one_in_the_thread(store: Store) -> None:
    waiting = [asyncio.ensure_future(store.lost()) for _ in range(2)]
    gone = asyncio.ensure_future(store.lost())
    await asyncio.sleep(0)
    gone.cancel()
    await asyncio.gather(gone, return_exceptions=True)
    store.buffer(BROKEN)
    for k in range(COMMIT_ROWS - 1):
        store.buffer(event(k))
    for one in waiting:
        with pytest.raises(SafetyStop, match="no such table: nowhere"):
            await one
    store._thread.join()
    assert store._waiters == [], "a cancelled waiter is removed"


def test_a_loss_at_the_end_is_reported_and_the_file_is_closed_all_the_same(store: Store) -> None:
    store.buffer(BROKEN)
    with pytest.raises(SafetyStop, match="no such table"):
        store.close()
    with pytest.raises(sqlite3.ProgrammingError, match="closed"):
        store._connection.execute("SELECT 1")
    store.close()


@pytest.mark.parametrize("error", [OSError(errno.EIO, "I/O error"), sqlite3.OperationalError("disk I/O error")])
def test_a_store_that_cannot_begin_its_commit_record_is_not_opened(
    path: Path, monkeypatch: pytest.MonkeyPatch, error: Exception
) -> None:
    opened: list[sqlite3.Connection] = []

    def connect(*arguments: Any, **named: Any) -> sqlite3.Connection:
        opened.append(sqlite3.connect(*arguments, **named))
        return opened[-1]

    def fails(*_: object) -> None:
        raise error

    monkeypatch.setattr(journal_store.CommitRecord, "write", fails)
    with pytest.raises(ConfigError, match=r"journal\.sqlite: the journal cannot be used: .*error\. Leave the file"):
        Store.open(path, connect)
    with pytest.raises(sqlite3.ProgrammingError, match="closed"):
        opened[-1].execute("SELECT 1")


def test_a_thread_without_memory_is_a_loss(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    def fails() -> None:
        raise MemoryError

    monkeypatch.setattr(store, "write", fails)
    for k in range(COMMIT_ROWS):
        store.buffer(event(k))
    store._thread.join()
    with pytest.raises(SafetyStop, match="the daemon has run out of memory"):
        store.require_in_time()


def test_a_full_buffer_is_committed_at_once(store: Store, path: Path) -> None:
    """By the thread, which waits for more rows after the first one."""
    store.buffer(event(0))
    until_s = time.monotonic() + 10.0
    while not store._pending._waiters and time.monotonic() < until_s:  # type: ignore[attr-defined]
        time.sleep(0.001)
    for number in range(1, COMMIT_ROWS):
        store.buffer(event(number))
    while len(durable(path)) < COMMIT_ROWS and time.monotonic() < until_s:
        time.sleep(0.001)
    assert len(durable(path)) == COMMIT_ROWS


def test_each_commit_is_named_beside_the_journal(store: Store, path: Path) -> None:
    record = journal_store.CommitRecord(path)
    before = record.read()
    assert before is not None
    for number in range(1, 4):
        store.write(event(number))
        assert record.read() == (before[0], before[1] + number)
    ((count,),) = store.read("SELECT count FROM commits")
    assert record.read() == (before[0], count)


def test_a_closed_store_leaves_no_file_open(store: Store, path: Path) -> None:
    store.close()
    still = [one.readlink() for one in Path("/proc/self/fd").iterdir() if one.is_symlink()]
    assert not [one for one in still if one.is_relative_to(path.parent)]


def test_the_longest_wait_for_a_commit_is_far_from_too_late() -> None:
    assert COMMIT_S <= LATE_S / 8


class Reserve:
    """Memory that is kept for the way out."""

    released = 0

    def release(self) -> None:
        self.released += 1


def test_a_loss_for_want_of_memory_frees_the_reserve(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    reserve = Reserve()
    monkeypatch.setattr(journal_store, "RESERVE", reserve)
    store._fail(MemoryError())
    assert reserve.released == 1


def test_an_error_without_a_name_of_sqlite_is_said_alone(store: Store) -> None:
    store._fail(sqlite3.Error("no cursor"))
    with pytest.raises(SafetyStop, match=r"journal\.sqlite: no cursor; the daemon does not polish"):
        store.require_in_time()
