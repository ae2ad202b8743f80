"""The journal: acknowledged rows survive any crash, and a lost journal stops the job.

Journals that cannot be opened, written or copied: no partial file, and no open connection.
"""

from __future__ import annotations

import asyncio
import json
import sqlite3
import threading
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from polishd.daemon.journal import store
from polishd.daemon.journal.checksums import check_journal
from polishd.daemon.journal.history import read_only
from polishd.daemon.journal.journal import ARRAYS_NAME, JOURNAL_NAME, NO_JOB, Journal
from polishd.daemon.journal.records import BlockRecord
from polishd.daemon.journal.store import OF_A_JOB, Store
from polishd.model import events
from polishd.model.devices import ExecutedBlock
from polishd.model.errors import ConfigError, JournalDamage, LinkError, PolishdError, SafetyStop
from polishd.model.events import CellHeld, PlanWritten
from polishd.model.states import CyclePhase, Outcome
from polishd.plugin_loader import RENAMED
from tests.unit.daemon.small_job import recorded_phases


def opened(state_dir: Path, job: str = "job", part_id: str = "P1") -> Journal:
    return Journal.open(state_dir, job=job, part_id=part_id)


def block(seq: int) -> ExecutedBlock:
    return ExecutedBlock(seq, seq * 0.1, seq * 0.1 + 0.05)


def touched(seq: int, *what: float) -> list[BlockRecord]:
    return [BlockRecord(block(seq), True, *what)]


@pytest.fixture
def journal(tmp_path: Path) -> Iterator[Journal]:
    with opened(tmp_path) as found:
        yield found


def rows(state_dir: Path, sql: str) -> list[tuple[object, ...]]:
    """What another reader of the file sees: committed rows only."""
    connection = sqlite3.connect(f"file:{state_dir / 'journal.sqlite'}?mode=ro", uri=True)
    try:
        return connection.execute(sql).fetchall()
    finally:
        connection.close()


def wait_until(condition: object) -> None:
    """Poll; pytest's timeout is the limit."""
    assert callable(condition)
    pause = threading.Event()
    while not condition():
        pause.wait(0.005)


def test_new_journal_is_empty(journal: Journal) -> None:
    assert not journal.resumed
    assert list(journal.remaining(5)) == [0, 1, 2, 3, 4]
    assert journal.last_map_id is None
    assert (journal.history, journal.passes, journal.phase_now) == ((), (), (None, None))
    assert journal.unfinished() is None
    assert journal.executed(0).seq.shape == (0,)


def test_full_sync_in_wal_mode(tmp_path: Path, journal: Journal) -> None:
    connection = journal._store._connection
    assert connection.execute("PRAGMA journal_mode").fetchone() == ("wal",)
    assert connection.execute("PRAGMA synchronous").fetchone() == (2,)


async def test_job_goes_on_where_it_was(tmp_path: Path) -> None:
    with opened(tmp_path) as journal:
        async with journal.phase(0, CyclePhase.MEASURE):
            journal.record_map(0, "aa", "maps/0.dat", {"rms_nm": 18.0})
        journal.begin_pass(0, "prog0", "boot", 10, facts={"predicted_rms_nm": 5.0})
        for seq in range(10):
            journal.record_executed(0, touched(seq))
        journal.end_pass(0, "done")
        journal.record_map(1, "bb", "maps/1.dat", {"rms_nm": 5.5})
    with opened(tmp_path) as journal:
        assert journal.resumed
        assert journal.last_map_id == "bb"
        assert list(journal.remaining(5)) == [1, 2, 3, 4]  # a map without a pass is taken again
        assert [(m.cycle, m.sha256, m.stats["rms_nm"]) for m in journal.history] == [(0, "aa", 18.0), (1, "bb", 5.5)]
        assert journal.passes[0].facts == {"predicted_rms_nm": 5.0}
        assert journal.passes[0].how == "done"
        assert journal.executed(0).seq.size == 10
        assert journal.phase_now == (0, "measure")
        assert recorded_phases(journal) == [(0, "measure", "done", None)]
        assert journal.unfinished() is None


def test_maps_taken_again_replace_earlier_ones_of_the_cycle(journal: Journal) -> None:
    for sha in ("aa", "bb", "cc"):
        journal.record_map(0, sha, "x", {"rms_nm": 1.0})
    assert [record.sha256 for record in journal.history] == ["cc"]


def test_finished_job_is_followed_by_a_new_one_that_knows_the_last_map(tmp_path: Path) -> None:
    with opened(tmp_path) as journal:
        journal.record_map(0, "aa", "x", {})
        journal.record_outcome(Outcome.IN_TOLERANCE)
    assert rows(tmp_path, "SELECT outcome FROM job") == [("in_tolerance",)]
    with opened(tmp_path) as journal:
        assert not journal.resumed
        assert journal.history == ()
        assert journal.last_map_id == "aa"


def test_another_job_takes_the_place_of_one_that_was_not_finished(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with opened(tmp_path) as journal:
        journal.begin_pass(0, "prog", "boot", 3)
    with opened(tmp_path, "other") as journal:
        assert not journal.resumed
        assert journal.unfinished() is None
        assert list(journal.remaining(2)) == [0, 1]
    assert rows(tmp_path, "SELECT outcome, detail FROM job WHERE id = 1") == [("stopped", "other replaced it")]
    assert "the unfinished job 'job' ends: the job 'other' replaces it" in caplog.text


def test_a_job_keeps_what_it_was_begun_with_once_it_has_measured(tmp_path: Path) -> None:
    for edge_mm in (3.0, 4.0):  # nothing is measured yet: what is named now holds
        with Journal.open(tmp_path, job="job", part_id="P1", terms={"part.edge_mm": edge_mm}) as journal:
            assert journal.terms == {"part.edge_mm": edge_mm}
    with opened(tmp_path) as journal:
        pass
    with Journal.open(tmp_path, job="job", part_id="P1", terms={"part.edge_mm": 5.0}) as journal:
        journal.record_map(0, "aa", "x", {})
    with Journal.open(tmp_path, job="job", part_id="P1", terms={"part.edge_mm": 6.0}) as journal:
        assert journal.resumed
        assert journal.terms == {"part.edge_mm": 5.0}


async def test_what_each_phase_took_in_all(journal: Journal, monkeypatch: pytest.MonkeyPatch) -> None:
    """In the order of a cycle, over all cycles and attempts; a phase without an end does not count."""
    times = iter([100.0, 104.0, 110.0, 111.0, 120.0, 123.5, 130.0])
    monkeypatch.setattr("polishd.daemon.journal.journal.time.time", lambda: next(times))
    for cycle, phase in ((0, CyclePhase.RUN), (1, CyclePhase.MEASURE), (1, CyclePhase.RUN)):
        async with journal.phase(cycle, phase):
            pass
    running = journal.phase(2, CyclePhase.SOLVE)
    await running.__aenter__()
    monkeypatch.undo()
    assert list(journal.phase_times_s().items()) == [("measure", 1.0), ("run", 7.5)]
    await running.__aexit__(None, None, None)


async def test_phases_tell_how_they_ended(journal: Journal) -> None:
    async with journal.phase(0, CyclePhase.MEASURE):
        assert recorded_phases(journal) == [(0, "measure", None, None)]
    with pytest.raises(LinkError, match="gone"):
        async with journal.phase(0, CyclePhase.SOLVE):
            raise LinkError("gone")
    with pytest.raises(asyncio.CancelledError):
        async with journal.phase(0, CyclePhase.RUN):
            raise asyncio.CancelledError
    assert recorded_phases(journal) == [
        (0, "measure", "done", None),
        (0, "solve", "failed", "LinkError: gone"),
        (0, "run", "cancelled", "CancelledError: "),
    ]
    assert journal._store.read("SELECT count(*) FROM phase WHERE ended >= started") == [(3,)]


async def test_what_is_buffered_in_a_phase_is_durable_at_its_end(tmp_path: Path, journal: Journal) -> None:
    journal.begin_pass(0, "prog", "boot", 3)

    async def interrupted() -> None:
        async with journal.phase(0, CyclePhase.RUN):
            journal.record_executed(0, touched(0))
            raise LinkError("gone")

    with pytest.raises(LinkError):
        await interrupted()
    assert rows(tmp_path, "SELECT seq FROM segment") == [(0,)]


def test_intent_is_durable_before_start(tmp_path: Path, journal: Journal) -> None:
    journal.begin_pass(0, "prog", "boot-7", 20)
    assert rows(tmp_path, "SELECT program_sha256, boot_id, blocks, ended FROM pass") == [("prog", "boot-7", 20, None)]


def test_a_cycle_has_one_pass(journal: Journal) -> None:
    journal.begin_pass(0, "prog", "boot", 3)
    journal.end_pass(0, "stopped")
    with pytest.raises(PolishdError, match="cycle 0 has a pass already"):
        journal.begin_pass(0, "prog", "boot", 3)


def test_executed_blocks_come_back_as_arrays(journal: Journal) -> None:
    journal.begin_pass(2, "prog", "boot", 6, contact=(1, 5))
    journal.record_executed(
        2, [BlockRecord(block(0), False), *touched(1, 12.1, 998.0, 7.5, 11.8), *touched(2), *touched(4)]
    )
    journal.record_executed(2, [BlockRecord(block(5), None)])
    again = BlockRecord(ExecutedBlock(2, 99.0, 100.0), True)
    journal.record_executed(2, [again])  # reported again after a reconnect: the first record stays
    found = journal.executed(2)
    np.testing.assert_array_equal(found.seq, [0, 1, 2, 4, 5])
    assert found.seq.dtype == np.int64
    np.testing.assert_array_equal(found.touched, [0, 1, 1, 1, np.nan])
    np.testing.assert_array_equal(found.contact, [False, True, True, True, False])
    np.testing.assert_array_equal(found.possible, [False, True, True, True, True])
    assert (found.force_n[1], found.rpm[1], found.told_s[1]) == (12.1, 998.0, 7.5)
    assert np.isnan([found.force_n[2], found.rpm[2], found.told_s[2]]).all()
    np.testing.assert_array_equal(found.sensor_force_n, [np.nan, 11.8, np.nan, np.nan, np.nan])
    np.testing.assert_array_equal(found.acting_n, [np.nan, 11.8, np.nan, np.nan, np.nan])
    assert journal.uncertain(2) == ((5, 6),)
    assert journal.contact_s(2) == pytest.approx(0.15), "as far as it is known"
    np.testing.assert_allclose(found.start_s, found.seq * 0.1)
    np.testing.assert_allclose(found.duration_s, 0.05)
    assert not found.recovered.any()


def test_group_commit_by_time(tmp_path: Path, journal: Journal) -> None:
    journal.begin_pass(0, "prog", "boot", 3)
    journal.record_executed(0, touched(0))
    wait_until(lambda: rows(tmp_path, "SELECT count(*) FROM segment") == [(1,)])


def test_group_commit_by_number(tmp_path: Path, journal: Journal, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(store, "COMMIT_S", 1e6)
    journal.begin_pass(0, "prog", "boot", 1000)
    for seq in range(store.COMMIT_ROWS - 1):
        journal.record_executed(0, touched(seq))
    assert rows(tmp_path, "SELECT count(*) FROM segment") == [(0,)]
    journal.record_executed(0, touched(999))
    wait_until(lambda: rows(tmp_path, "SELECT count(*) FROM segment") == [(store.COMMIT_ROWS,)])


def test_a_stalled_disk_does_not_stall_the_recording(
    tmp_path: Path, journal: Journal, monkeypatch: pytest.MonkeyPatch
) -> None:
    """record_executed is called from the event loop in contact: it never waits for a commit."""
    journal.begin_pass(0, "prog", "boot", 5000)
    stalled, release = threading.Event(), threading.Event()
    commit = journal._store._transaction

    def slow(rows: list[store.Row]) -> None:
        stalled.set()
        assert release.wait(30)
        commit(rows)

    monkeypatch.setattr(journal._store, "_transaction", slow)
    journal.record_executed(0, touched(0))
    assert stalled.wait(30)
    for seq in range(1, 2000):
        journal.record_executed(0, touched(seq))  # would never return if it waited
    release.set()
    assert journal.executed(0).seq.size == 2000


def test_a_disk_that_does_not_keep_up_is_reported(journal: Journal, monkeypatch: pytest.MonkeyPatch) -> None:
    """What may go unrecorded in contact has an end: contact is left over it, and the rows are written all the same."""
    journal.begin_pass(0, "prog", "boot", 9)
    stalled, release = threading.Event(), threading.Event()
    commit = journal._store._transaction

    def slow(rows: list[store.Row]) -> None:
        stalled.set()
        assert release.wait(30)
        commit(rows)

    journal.require_in_time()
    monkeypatch.setattr(journal._store, "_transaction", slow)
    monkeypatch.setattr(store, "LATE_S", 0.0)
    journal.record_executed(0, touched(0))
    assert stalled.wait(30)
    with pytest.raises(SafetyStop, match=r"a commit takes 0\.\d s, the limit is 0 s"):
        journal.require_in_time()
    journal.record_executed(0, touched(1))
    release.set()
    assert journal.executed(0).seq.tolist() == [0, 1]
    journal.require_in_time()


def test_interrupted_pass_is_reported_and_reconciled(tmp_path: Path) -> None:
    with opened(tmp_path) as journal:
        journal.begin_pass(0, "prog", "boot", 10, contact=(2, 9), reach_s=9.5)
        for seq in range(4):
            journal.record_executed(0, touched(seq))
    with opened(tmp_path) as journal:
        found = journal.unfinished()
        assert found is not None
        assert (found.cycle, found.program_sha256, found.boot_id, found.blocks) == (0, "prog", "boot", 10)
        assert (journal.tally(0).done, journal.tally(0).last_seq) == (4, 3)
        assert list(journal.remaining(3)) == [1, 2]  # never the same pass again
        journal.reconcile(0, [BlockRecord(block(seq), None) for seq in range(6)])
        assert (journal.tally(0).done, journal.tally(0).last_seq) == (6, 5)
        journal.reconcile(0, [])
        assert journal.tally(0).done == 6
        executed = journal.executed(0)
        np.testing.assert_array_equal(executed.recovered, [False] * 4 + [True] * 2)
        np.testing.assert_array_equal(executed.touched, [1, 1, 1, 1, np.nan, np.nan])
        assert journal.uncertain(0) == ((4, 6),)
        journal.mark_uncertain(0, 6, 8)
        assert journal.uncertain(0) == ((4, 8),)
        journal.end_pass(0, "interrupted")
        assert journal.unfinished() is None
    with opened(tmp_path) as journal:
        assert journal.uncertain(0) == ((4, 8),)
        assert (journal.passes[0].reach_s, journal.passes[0].uncertain) == (9.5, (6, 8))


def test_ending_a_pass_twice_keeps_the_first_word(journal: Journal) -> None:
    journal.begin_pass(0, "prog", "boot", 1)
    journal.end_pass(0, "done")
    journal.end_pass(0, "stopped")
    assert journal.passes[0].how == "done"


def test_events_are_kept(tmp_path: Path) -> None:
    with opened(tmp_path) as journal:
        journal.record_event(PlanWritten(cycle=1, run_dir=Path("x")))  # type: ignore[arg-type]
    assert rows(tmp_path, "SELECT cycle, name, data FROM event") == [(1, "plan_written", '{"run_dir": "x"}')]


def test_copy_is_whole_and_stands_alone(tmp_path: Path, journal: Journal) -> None:
    journal.begin_pass(0, "prog", "boot", 5)
    journal.record_executed(0, touched(0))
    target = tmp_path / "run" / "journal.sqlite"
    target.parent.mkdir()
    for _ in range(2):
        journal.copy_to(target)
    assert list(target.parent.iterdir()) == [target]
    assert rows(target.parent, "SELECT seq FROM segment") == [(0,)]


def test_a_copy_holds_its_own_job_alone(tmp_path: Path) -> None:
    target = tmp_path / "run" / "journal.sqlite"
    for name in ("one", "two"):
        with opened(tmp_path, name) as journal:
            journal.record_map(0, name, "x", {})
            journal.begin_pass(0, "prog", "boot", 5)
            journal.record_executed(0, touched(0))
            journal.copy_to(target)
            journal.record_outcome(Outcome.IN_TOLERANCE)
    assert rows(target.parent, "SELECT name FROM job") == [("two",)]
    assert rows(target.parent, "SELECT sha256 FROM map") == [("two",)]
    assert rows(target.parent, "SELECT job, seq FROM segment") == [(2, 0)]


def test_of_a_job_that_is_over_the_maps_stay_and_the_plans_go(tmp_path: Path) -> None:
    with opened(tmp_path) as journal:
        surface, plan, start = (journal.arrays.put({"a": np.arange(n)}) for n in (3, 4, 5))
        journal.record_map(0, "aa", "x", {}, surface)
        journal.begin_pass(0, "prog", "boot", 5, plan=plan, start=start)
    with opened(tmp_path) as journal:
        assert journal.arrays.content(plan), "it goes on"
        journal.record_outcome(Outcome.IN_TOLERANCE)
    with opened(tmp_path, "next") as journal:
        assert [path.stem for path in journal.arrays.folder.iterdir()] == [surface]
    assert rows(tmp_path, "SELECT plan, start FROM pass") == [("", "")]


def test_between_jobs_it_knows_of_none_and_keeps_what_happens(tmp_path: Path) -> None:
    with opened(tmp_path, "one") as journal:
        journal.record_map(0, "aa", "x", {})
        journal.record_outcome(Outcome.IN_TOLERANCE)
    with Journal.of_cell(tmp_path) as cell:
        assert (cell.history, cell.passes, cell.unfinished(), cell.last_map_id) == ((), (), None, "aa")
        cell.record_event(PlanWritten(run_dir=""))
        assert cell.of_job("two", "P2", {}).last_map_id == "aa"
    assert rows(tmp_path, "SELECT job FROM event") == [(NO_JOB,)]


def test_close_is_idempotent(tmp_path: Path) -> None:
    journal = opened(tmp_path)
    journal.close()
    journal.close()


def test_numbers_of_numpy_stay_numbers(journal: Journal) -> None:
    journal.record_map(0, "aa", "x", {"samples": np.int64(3), "rms_nm": np.float64(2.5)})
    assert journal.history[0].stats == {"samples": 3, "rms_nm": 2.5}


# a journal of format 1

FORMAT_1 = """
CREATE TABLE job (
    id INTEGER PRIMARY KEY, name TEXT NOT NULL, part_id TEXT NOT NULL, config_sha256 TEXT NOT NULL,
    started REAL NOT NULL, ended REAL, outcome TEXT, detail TEXT);
CREATE TABLE map (
    id INTEGER PRIMARY KEY, job INTEGER NOT NULL REFERENCES job, cycle INTEGER NOT NULL, sha256 TEXT NOT NULL,
    path TEXT NOT NULL, stats TEXT NOT NULL, taken REAL NOT NULL);
CREATE TABLE phase (
    id INTEGER PRIMARY KEY, job INTEGER NOT NULL REFERENCES job, cycle INTEGER NOT NULL, phase TEXT NOT NULL,
    started REAL NOT NULL, ended REAL, outcome TEXT, error TEXT);
CREATE TABLE pass (
    job INTEGER NOT NULL REFERENCES job, cycle INTEGER NOT NULL, program_sha256 TEXT NOT NULL,
    boot_id TEXT NOT NULL, blocks INTEGER NOT NULL, contact_from INTEGER NOT NULL, contact_to INTEGER NOT NULL,
    facts TEXT NOT NULL, started REAL NOT NULL, ended REAL, how TEXT, PRIMARY KEY (job, cycle));
CREATE TABLE segment (
    job INTEGER NOT NULL, cycle INTEGER NOT NULL, seq INTEGER NOT NULL, start_s REAL NOT NULL, end_s REAL NOT NULL,
    in_contact INTEGER NOT NULL, recovered INTEGER NOT NULL, PRIMARY KEY (job, cycle, seq)) WITHOUT ROWID;
CREATE TABLE event (
    id INTEGER PRIMARY KEY, job INTEGER NOT NULL, at REAL NOT NULL, cycle INTEGER, name TEXT NOT NULL,
    data TEXT NOT NULL);
INSERT INTO job VALUES (1, 'first', 'P1', 'ab12', 1.0, 2.0, 'in_tolerance', ''), (2, 'job', 'P1', 'cd34', 3.0, NULL, NULL, NULL);
INSERT INTO map VALUES (1, 1, 0, 'aa', 'x', '{}', 1.5), (2, 2, 0, 'bb', 'y', '{"rms_nm": 4.0}', 3.5);
INSERT INTO phase VALUES (1, 2, 0, 'measure', 3.0, 3.6, 'done', NULL);
INSERT INTO pass VALUES (2, 0, 'prog', 'boot', 5, 1, 4, '{"rate": 0.9}', 4.0, NULL, NULL);
INSERT INTO segment VALUES (2, 0, 1, 10.0, 10.5, 1, 0), (2, 0, 2, 10.5, 11.5, 1, 0);
INSERT INTO event VALUES (1, 2, 4.0, 0, 'pass_started', '{}');
PRAGMA user_version = 1;
"""  # noqa: E501


# additions of format 2, and a pass whose last blocks the robot reported after an interruption
FORMAT_2 = f"""
{FORMAT_1} {store.FROM_1}
UPDATE job SET terms = '{{}}' WHERE id = 2;
INSERT INTO segment VALUES (2, 0, 0, 9.5, 10.0, 0, 0), (2, 0, 3, 11.5, 12.0, 1, 1), (2, 0, 4, 12.0, 12.5, 0, 1);
PRAGMA user_version = 2;
"""


# what the polishd of format 3 had beside that: force and speed of each block, and no sensor's
FORMAT_3 = f"""
{FORMAT_2} {store.FROM_2} {store.QUEUE}
INSERT INTO segment VALUES (2, 0, 5, 12.5, 13.0, 1, 0, 11.9, 998.0, 7.5);
PRAGMA user_version = 3;
"""


def made(state_dir: Path, script: str) -> Path:
    connection = sqlite3.connect(state_dir / "journal.sqlite")
    connection.executescript(f"PRAGMA journal_mode=WAL; {script}")
    connection.close()
    return state_dir


@pytest.fixture
def of_format_1(tmp_path: Path) -> Path:
    return made(tmp_path, FORMAT_1)


@pytest.fixture
def of_format_2(tmp_path: Path) -> Path:
    return made(tmp_path, FORMAT_2)


def test_a_journal_of_format_2_is_read_on(of_format_2: Path) -> None:
    """Format 2 derived the contact of recovered blocks from their position in the program; it was unknown."""
    for _ in range(2):
        with opened(of_format_2) as journal:
            assert journal.resumed
            assert journal.terms == {}
            blocks = journal.executed(0)
            np.testing.assert_array_equal(blocks.touched, [0, 1, 1, np.nan, 0])
            np.testing.assert_array_equal(blocks.recovered, [False, False, False, True, True])
            assert np.isnan([blocks.force_n, blocks.rpm, blocks.told_s]).all()
            assert (journal.uncertain(0), journal.contact_s(0)) == (((3, 4),), 1.5)
            assert (journal.passes[0].reach_s, journal.passes[0].uncertain) == (None, None)
    assert rows(of_format_2, "PRAGMA user_version") == [(7,)]
    kept = sqlite3.connect(of_format_2 / "journal.v2.sqlite")
    assert kept.execute("SELECT total(in_contact) FROM segment").fetchone() == (3.0,)
    kept.close()


def test_a_journal_of_format_3_is_read_on(tmp_path: Path) -> None:
    """Its cells had no force sensor: the acting force is the actuator's."""
    for _ in range(2):
        with opened(made(tmp_path, FORMAT_3) if not list(tmp_path.iterdir()) else tmp_path) as journal:
            assert journal.resumed
            blocks = journal.executed(0)
            assert blocks.seq.tolist() == [0, 1, 2, 3, 4, 5]
            assert (blocks.force_n[5], blocks.rpm[5], blocks.told_s[5]) == (11.9, 998.0, 7.5)
            assert np.isnan(blocks.sensor_force_n).all()
            assert blocks.acting_n[5] == 11.9
    assert rows(tmp_path, "PRAGMA user_version") == [(7,)]
    assert (tmp_path / "journal.v3.sqlite").exists()


def test_a_journal_of_format_1_is_read_on(of_format_1: Path) -> None:
    for _ in range(2):
        with opened(of_format_1) as journal:
            assert journal.resumed
            assert journal.terms is None, "it did not say: same_job refuses to go on with it"
            assert journal.last_map_id == "bb"
            assert [record.stats for record in journal.history] == [{"rms_nm": 4.0}]
            assert [record.facts for record in journal.passes] == [{"rate": 0.9}]
            assert journal.phase_now[1] == "measure"
            assert (journal.contact_s(0), journal.executed(0).seq.tolist()) == (1.5, [1, 2])
            assert [record.blocks for record in journal.passes] == [5]
            assert journal.unfinished() == journal.passes[0]
            assert journal.tally(0).done == 2
    assert rows(of_format_1, "PRAGMA user_version") == [(7,)]


def test_a_journal_of_format_1_is_kept_as_it_was(of_format_1: Path) -> None:
    opened(of_format_1).close()
    kept = sqlite3.connect(of_format_1 / "journal.v1.sqlite")
    assert kept.execute("PRAGMA user_version").fetchall() == [(1,)]
    assert kept.execute("SELECT config_sha256 FROM job").fetchall() == [("ab12",), ("cd34",)]
    kept.close()


@pytest.mark.parametrize("script", [FORMAT_1, FORMAT_2, FORMAT_3], ids=["1", "2", "3"])
def test_a_journal_brought_up_to_date_has_the_tables_of_a_new_one(tmp_path: Path, script: str) -> None:
    opened(made(tmp_path, script)).close()
    (tmp_path / "new").mkdir()
    opened(tmp_path / "new").close()

    def columns(state_dir: Path) -> dict[str, set[tuple[object, ...]]]:
        return {
            table: {column[1:] for column in rows(state_dir, f"PRAGMA table_info({table})")}
            for table in ("job", *OF_A_JOB)
        }

    assert columns(tmp_path) == columns(tmp_path / "new")


def test_a_migration_that_fails_changes_nothing(of_format_1: Path) -> None:
    (of_format_1 / "journal.v1.sqlite").mkdir()  # the copy cannot be kept
    with pytest.raises(ConfigError, match="the journal cannot be used: "):
        opened(of_format_1)
    assert rows(of_format_1, "PRAGMA user_version") == [(1,)]


def test_a_new_job_follows_one_that_was_under_way_in_format_1(of_format_1: Path) -> None:
    with opened(of_format_1, "next") as journal:
        assert not journal.resumed
        assert journal.last_map_id == "bb"
        journal.record_map(0, "cc", "x", {})
        journal.begin_pass(0, "prog", "boot", 3, plan="p", start="s")
    with opened(of_format_1, "next") as journal:
        assert (journal.passes[0].plan, journal.passes[0].start) == ("p", "s")


FORMAT_6 = (
    "UPDATE event SET name = 'held' WHERE name = 'cell_held'",
    "INSERT INTO event (job, at, cycle, name, data) VALUES (1, 5.0, 0, 'touched_off', '{\"most_off_mm\": 0.3}')",
    "INSERT INTO event (job, at, cycle, name, data) VALUES (1, 6.0, 0, 'signal_wrong', '{\"leads_to\": \"hold\"}')",
    "PRAGMA user_version = 6",
)
TERMS_6 = {
    "between.clean.person": "wipe", "between.settle.maps": 5, "part.rim": "free", "process.learns": "rate",
    "memory.tool": "bonnet 7", "process.rpm": 1000.0, "robot.type": "handover",
}  # fmt: skip


def of_format_6(state_dir: Path) -> None:
    """A journal with the names of before release 1.0."""
    with opened(state_dir) as journal:
        journal.record_map(0, "cc", "x", {})
        journal.record_event(CellHeld(error="hot", kind="DeviceFault"))
    with closing(store.connect(state_dir / "journal.sqlite")) as file:
        file.execute("UPDATE job SET terms = ?", (json.dumps(TERMS_6),))
        for statement in FORMAT_6:
            file.execute(statement)


def test_a_journal_of_format_6_gets_the_names_of_release_1(tmp_path: Path) -> None:
    of_format_6(tmp_path)
    with opened(tmp_path) as journal:
        assert journal.resumed
        assert journal.terms == {
            "part_handling.clean.operator": "wipe", "part_handling.settle.max_maps": 5, "part.free_edge": True,
            "process.estimates": "rate", "estimates.tool": "bonnet 7", "process.rpm": 1000.0, "robot.type": "plc_robot",
        }  # fmt: skip
    events = rows(tmp_path, "SELECT name, data FROM event ORDER BY id")
    assert [name for name, _ in events] == ["cell_held", "part_touched_off", "signal_out_of_range"]
    assert [json.loads(str(data)) for _, data in events[1:]] == [{"max_offset_mm": 0.3}, {"action": "hold"}]
    assert rows(tmp_path, "PRAGMA user_version") == [(7,)]
    assert check_journal(tmp_path / "journal.sqlite", {7: store._definitions()}).damage is None
    assert (tmp_path / "journal.v6.sqlite").exists()


def test_a_journal_of_format_6_that_is_only_read_shows_the_names_of_release_1(tmp_path: Path) -> None:
    of_format_6(tmp_path)
    with read_only(tmp_path) as journal:
        names = [name for (name,) in journal.execute("SELECT name FROM event ORDER BY id")]
    assert names == ["cell_held", "part_touched_off", "signal_out_of_range"]
    assert rows(tmp_path, "PRAGMA user_version") == [(6,)], "nothing is written"


EVENTS_6 = (
    "rate_offered", "job_begun", "part_wanted", "job_ended", "queue_ended", "opened", "state", "ordered",
    "acknowledged", "contact_broken", "held", "failed", "measured", "repeated", "gate_stopped", "learned",
    "signal_wrong", "found", "solved", "touched_off", "plan_waits", "approved", "pass_begun", "progress",
    "job_finished",
)  # fmt: skip


def test_each_event_of_format_6_gets_the_name_of_a_present_one(tmp_path: Path) -> None:
    of_format_6(tmp_path)
    with closing(store.connect(tmp_path / "journal.sqlite")) as file:
        file.execute("DELETE FROM event")
        for number, name in enumerate(EVENTS_6):
            sql = "INSERT INTO event (job, at, cycle, name, data) VALUES (1, ?, 0, ?, '{}')"
            file.execute(sql, (float(number), name))
    with opened(tmp_path):
        pass
    names = [str(name) for (name,) in rows(tmp_path, "SELECT name FROM event WHERE at < 100 ORDER BY at")]
    assert len(set(names)) == len(EVENTS_6)
    present = {getattr(one, "name", "") for one in vars(events).values() if isinstance(one, type)}
    assert set(names) <= present


def test_verdicts_plugins_and_terms_of_format_6_get_the_names_of_release_1(tmp_path: Path) -> None:
    of_format_6(tmp_path)
    old, new = next((old, new) for old, new in RENAMED.items() if old != new)
    terms = {"process.rpm": 1.0, "plugins.load": [old, new, "mine"], "memory.tool": "bonnet 7"}
    with closing(store.connect(tmp_path / "journal.sqlite")) as file:
        file.execute("UPDATE job SET outcome = 'put aside', terms = ?", (json.dumps(terms),))
        sql = (
            "INSERT INTO queue (place, name, part_id, path, content, files, added, verdict) "
            "VALUES (1, 'a', 'P', '', '', '{}', 0.0, 'put aside')"
        )
        file.execute(sql)
    expected = {"estimates.tool": "bonnet 7", "plugins.load": [new, "mine"], "process.rpm": 1.0}
    with read_only(tmp_path) as journal:
        assert journal.execute("SELECT outcome, terms FROM job").fetchone() == (
            "set aside", json.dumps(expected, sort_keys=True)
        )  # fmt: skip
        assert journal.execute("SELECT verdict FROM queue").fetchone() == ("set aside",)
    with opened(tmp_path):
        pass
    ((outcome, kept),) = rows(tmp_path, "SELECT outcome, terms FROM job WHERE id = 1")
    assert (outcome, kept) == ("set aside", json.dumps(expected, sort_keys=True))


@pytest.mark.parametrize(
    ("table", "column"), [("job", "terms"), ("map", "stats"), ("pass", "facts"), ("event", "data")]
)
def test_a_row_without_a_checksum_that_is_not_json_is_damage_with_its_place(
    of_format_2: Path, table: str, column: str
) -> None:
    with closing(sqlite3.connect(of_format_2 / "journal.sqlite")) as file:
        file.execute(f"UPDATE {table} SET {column} = '{{' WHERE rowid = (SELECT max(rowid) FROM {table})")
        file.commit()
    with pytest.raises(JournalDamage, match=rf"{column} of the row rowid = \d of {table} is not JSON"):
        opened(of_format_2)


def test_indexes_have_the_names_by_which_later_formats_drop_them(tmp_path: Path, journal: Journal) -> None:
    names = {name for (name,) in rows(tmp_path, "SELECT name FROM sqlite_schema WHERE type = 'index' AND sql != ''")}
    assert names == {"queue_of_name", "queue_to_do", "map_of_job", "phase_of_job", "event_of_job"}


def test_what_is_not_said_of_a_map_or_a_pass_is_empty(tmp_path: Path) -> None:
    with opened(tmp_path) as journal:
        assert not journal.begun
        journal.begin_pass(0, "prog", "boot", 3, facts={"count": np.int64(3), "path": [np.float64(0.5)]})
        assert journal.begun, "a pass without a map"
        journal.record_map(0, "cc", "x", {})
        journal.begin_pass(1, "prog", "boot", 3, contact=(1, 2), plan="p", start="s")
        first, second = journal.passes
        assert (first.contact_from, first.contact_to, first.plan, first.start) == (0, 3, "", "")
        assert first.facts == {"count": 3, "path": [0.5]}
        assert (second.contact_from, second.contact_to, second.plan, second.start) == (1, 2, "p", "s")
        assert journal.history[0].arrays == ""
        journal.record_outcome(Outcome.IN_TOLERANCE)
    assert rows(tmp_path, "SELECT detail FROM job") == [("",)]
    with Journal.of_cell(tmp_path) as journal:
        assert not journal.resumed
    assert (tmp_path / "store").name == ARRAYS_NAME


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


def test_a_copy_that_cannot_be_written_is_reported_and_the_journal_goes_on(tmp_path: Path) -> None:
    (tmp_path / "run").write_text("no folder")
    with Journal.open(tmp_path, job="job", part_id="P1") as journal:
        with pytest.raises(SafetyStop, match=r"run/journal.sqlite: the copy failed: "):
            journal.copy_to(tmp_path / "run" / "journal.sqlite")
        journal.begin_pass(0, "prog", "boot", 5)
    assert sorted(path.name for path in tmp_path.iterdir() if "partial" in path.name) == []
