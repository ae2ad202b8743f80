"""The journal's file is created, converted and copied; an unusable one is closed and unchanged."""

from __future__ import annotations

import errno
import os
import re
import sqlite3
from pathlib import Path
from typing import Any

import pytest

from polishd.daemon.journal import store
from polishd.daemon.journal.checksums import Damage
from polishd.daemon.journal.store import SCHEMA_VERSION, connect, copy_job, copy_whole, old_copy, open_file
from polishd.model.errors import ConfigError, JournalDamage


class Opened:
    """A ``Connect`` that records its ``connection``."""

    def __init__(self) -> None:
        self.connection: sqlite3.Connection | None = None

    def __call__(self, path: Path) -> sqlite3.Connection:
        self.connection = connect(path)
        return self.connection

    def closed(self) -> bool:
        assert self.connection is not None
        try:
            self.connection.execute("SELECT 1")
        except sqlite3.ProgrammingError:
            return True
        return False


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "journal.sqlite"


@pytest.fixture
def steps(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """What is made durable, and when a file gets its name."""
    found: list[str] = []
    sync, replace = os.fsync, Path.replace

    def fsync(handle: int) -> None:
        found.append(f"sync {Path(f'/proc/self/fd/{handle}').readlink().name}")
        sync(handle)

    def replaces(self: Path, target: Path) -> Path:
        found.append(f"name {Path(target).name}")
        return replace(self, target)

    monkeypatch.setattr(os, "fsync", fsync)
    monkeypatch.setattr(Path, "replace", replaces)
    return found


def a_job(connection: sqlite3.Connection, name: str) -> int:
    sql = "INSERT INTO job (name, part_id, terms, started) VALUES (?, 'P', 'null', 1.0)"
    number = connection.execute(sql, (name,)).lastrowid
    assert number is not None
    connection.execute("INSERT INTO event (job, at, name, data) VALUES (?, 1.0, ?, '{}')", (number, name))
    return number


def test_a_new_file_is_durable_with_its_name_and_commits_are(path: Path, steps: list[str]) -> None:
    connection = open_file(path)
    assert steps == [f"sync {path.parent.name}"]
    said = [
        connection.execute(f"PRAGMA {name}").fetchone()[0] for name in ("journal_mode", "synchronous", "foreign_keys")
    ]
    assert said == ["wal", 2, 1]
    assert connection.execute("PRAGMA user_version").fetchone() == (SCHEMA_VERSION,)
    assert connection.execute("PRAGMA busy_timeout").fetchone() == (5000,)
    assert not connection.in_transaction
    connection.close()
    steps.clear()
    open_file(path).close()
    assert steps == [], "nothing is made anew"


def test_no_row_names_a_job_that_is_not_there(path: Path) -> None:
    connection = open_file(path)
    with pytest.raises(sqlite3.IntegrityError, match="FOREIGN KEY"):
        connection.execute("INSERT INTO map (job, cycle, sha256, path, stats, taken) VALUES (7, 0, '', '', '', 0.0)")
    connection.close()


def test_a_file_of_another_format_is_closed_and_stays(path: Path) -> None:
    connection = connect(path)
    connection.execute("PRAGMA user_version=99")
    connection.close()
    before, opened = path.read_bytes(), Opened()
    with pytest.raises(
        ConfigError, match=re.escape(f"{path}: the journal has format 99, this polishd writes format {SCHEMA_VERSION}")
    ):
        open_file(path, opened)
    assert opened.closed()
    connection = connect(path)
    assert connection.execute("PRAGMA user_version").fetchone() == (99,)
    connection.close()
    assert len(before) == path.stat().st_size


def test_what_is_no_journal_may_go(path: Path) -> None:
    path.write_bytes(b"no database, and long enough to be asked for its header " * 20)
    opened = Opened()
    with pytest.raises(JournalDamage, match=r"the journal cannot be used: .*\. Move the file to another folder"):
        open_file(path, opened)
    assert opened.closed()


@pytest.mark.parametrize(
    "error", [OSError(errno.EIO, "Input/output error"), sqlite3.OperationalError("disk I/O error")]
)
def test_what_the_disk_refuses_stays_where_it_is(path: Path, monkeypatch: pytest.MonkeyPatch, error: Exception) -> None:
    def fails(_: Path) -> None:
        raise error

    monkeypatch.setattr(store, "sync_folder", fails)
    opened = Opened()
    with pytest.raises(
        ConfigError, match=r"the journal cannot be used: .*\. Leave the file in place, and repair the disk"
    ) as refused:
        open_file(path, opened)
    assert not isinstance(refused.value, JournalDamage)
    assert opened.closed()


def test_a_folder_that_is_not_there_is_reported(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"the journal cannot be opened: .*\. Check cell.state_dir"):
        open_file(tmp_path / "no" / "journal.sqlite")


@pytest.mark.parametrize("whole", [False, True])
def test_a_copy_is_durable_before_it_has_its_name_and_its_name_after(path: Path, steps: list[str], whole: bool) -> None:
    connection = open_file(path)
    number = a_job(connection, "a")
    target = path.parent / "copy.sqlite"
    (path.parent / ".copy.sqlite.partial").write_bytes(b"left by a crash, and longer than a page " * 999)
    for _ in range(2):
        steps.clear()
        copy_whole(connection, target) if whole else copy_job(connection, target, number)
        own = [step for step in steps if "wal" not in step]
        assert own == ["sync .copy.sqlite.partial", "name copy.sqlite", f"sync {path.parent.name}"]
    assert not connection.in_transaction
    connection.close()
    assert [one.name for one in path.parent.iterdir() if "copy" in one.name] == ["copy.sqlite"], "it stands alone"
    assert target.read_bytes()[18:20] == b"\x01\x01", "who reads it makes no files beside it"
    copied = sqlite3.connect(f"file:{target}?mode=ro&immutable=1", uri=True)
    assert copied.execute("SELECT name FROM job").fetchall() == [("a",)]
    assert copied.execute("PRAGMA user_version").fetchone() == (SCHEMA_VERSION,)
    copied.close()


def test_a_copy_of_a_job_holds_its_rows_and_no_others(path: Path) -> None:
    connection = open_file(path)
    numbers = [a_job(connection, name) for name in "abc"]
    copy_job(connection, path.parent / "copy.sqlite", numbers[1])
    copied = sqlite3.connect(path.parent / "copy.sqlite")
    assert copied.execute("SELECT id, name FROM job").fetchall() == [(numbers[1], "b")]
    assert copied.execute("SELECT job, name FROM event").fetchall() == [(numbers[1], "b")]
    copied.close()
    connection.close()


def test_a_copy_that_fails_leaves_no_file_of_its_own_in_the_connection(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    connection = open_file(path)
    number = a_job(connection, "a")
    monkeypatch.setattr(store, "OF_A_JOB", ("nowhere",))
    with pytest.raises(sqlite3.Error):
        copy_job(connection, path.parent / "copy.sqlite", number)
    monkeypatch.undo()
    assert not (path.parent / "copy.sqlite").exists()
    copy_job(connection, path.parent / "copy.sqlite", number)
    names: list[Any] = connection.execute("PRAGMA database_list").fetchall()
    assert [name for _, name, _ in names] == ["main"]
    connection.close()


def test_where_an_earlier_format_is_kept() -> None:
    assert old_copy(Path("/state/journal.sqlite"), 2) == Path("/state/journal.v2.sqlite")


def test_the_tables_of_this_format_are_found_without_a_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    store._definitions.cache_clear()
    assert "event" in store._definitions()
    assert list(tmp_path.iterdir()) == []


def test_only_a_whole_file_that_is_there_is_checked(
    path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level("INFO")
    checked: list[Path] = []

    def fails(found: Path, _: object) -> None:
        checked.append(found)
        raise OSError(errno.EIO, "Input/output error")

    monkeypatch.setattr(store, "check_journal", fails)
    store.require_sound(path)
    open_file(path).close()
    path.with_name(f"{path.name}-journal").touch()
    store.require_sound(path)
    assert (checked, caplog.messages) == ([], []), "it is rolled back when it is opened"
    path.with_name(f"{path.name}-journal").unlink()
    store.require_sound(path)
    assert checked == [path]
    assert "the journal cannot be checked before it opens: [Errno 5] Input/output error" in caplog.text


def test_a_row_is_advised_to_be_deleted_only_where_it_is_known(path: Path) -> None:
    assert "DELETE FROM event WHERE rowid = 7" in store._remedy(path, Damage("x", "event", "rowid = 7"))
    assert "DELETE" not in store._remedy(path, Damage("x", "event", ""))
    assert "DELETE" not in store._remedy(path, Damage("x", "pass", "rowid = 7")), "passes depend on it"
