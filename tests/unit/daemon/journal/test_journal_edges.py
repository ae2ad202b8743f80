"""Journals that cannot be opened, written or copied: no partial file, and no open connection."""

from __future__ import annotations

import sqlite3
import threading
from pathlib import Path

import pytest

from polishd.daemon.journal.journal import JOURNAL_NAME, Journal
from polishd.daemon.journal.store import Store
from polishd.model.errors import SafetyStop


def committers() -> list[threading.Thread]:
    return [thread for thread in threading.enumerate() if thread.name == "journal"]


def test_a_job_that_cannot_begin_leaves_the_journal_closed(tmp_path: Path) -> None:
    before = committers()
    with pytest.raises(TypeError):
        Journal.open(tmp_path, job="job", part_id="P1", terms={"no": object()})
    assert committers() == before
    with Journal.open(tmp_path, job="job", part_id="P1") as journal:
        assert not journal.begun


def test_of_rows_that_are_written_together_none_stays_where_one_is_refused(tmp_path: Path) -> None:
    store = Store.open(tmp_path / JOURNAL_NAME)
    good = ("INSERT INTO job (name, part_id, terms, started) VALUES (?,?,?,?)", ("a", "P", "null", 1.0))
    with pytest.raises(SafetyStop, match=r"journal lost: .*NOT NULL"):
        store.write(good, (good[0], ("b", None, "null", 1.0)))
    other = sqlite3.connect(tmp_path / JOURNAL_NAME, timeout=0.0, isolation_level=None)
    other.execute("BEGIN IMMEDIATE")  # no connection holds it any more
    assert other.execute("SELECT count(*) FROM job").fetchone() == (0,)
    other.close()
    with pytest.raises(SafetyStop, match="journal lost"):
        store.write()
    store.close()


def test_a_copy_that_cannot_be_written_is_told_and_the_journal_goes_on(tmp_path: Path) -> None:
    (tmp_path / "run").write_text("no folder")
    with Journal.open(tmp_path, job="job", part_id="P1") as journal:
        with pytest.raises(SafetyStop, match=r"run/journal.sqlite: the copy failed: "):
            journal.copy_to(tmp_path / "run" / "journal.sqlite")
        journal.begin_pass(0, "prog", "boot", 5)
    assert sorted(path.name for path in tmp_path.iterdir() if "partial" in path.name) == []
