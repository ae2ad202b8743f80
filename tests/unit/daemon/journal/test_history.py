"""History of a cell's parts from the journal's rows, read beside a writer."""

from __future__ import annotations

import sqlite3
from pathlib import Path

import pytest

from polishd.daemon.job.job import watch
from polishd.daemon.journal.history import read_history
from polishd.daemon.journal.journal import Journal
from polishd.model.errors import ConfigError
from polishd.model.estimates import Estimate, FindingLimits, PassIndicators
from polishd.model.events import CellHeld, DaemonFailed, EstimatesUpdated, FindingReported
from polishd.model.states import Outcome
from polishd.model.tolerance import LineResult

SHOWN = PassIndicators(10.0, 1.0, 1.5, 1.0, 600.0, Estimate(0.9, 0.02), None, None, (1.0, 1.6), 1.5)


def polished(folder: Path, job: str, *, rms_nm: float = 1.5, outcome: Outcome | None = Outcome.IN_TOLERANCE) -> None:
    """A job with one complete pass, and one with an interrupted pass."""
    with Journal.open(folder, job=job, part_id=f"{job}-part") as journal:
        for cycle, how in enumerate(("done", "interrupted")):
            judged = [LineResult("PV", 30.0 / (1 + cycle), 20.0, "nm").facts()]
            journal.record_map(cycle, f"{job}{cycle}", "x", {"rms_nm": 20.0 - 10 * cycle, "judged": judged})
            journal.begin_pass(cycle, "sha", "boot", 3, facts={"predicted_rms_nm": 1.0})
            journal.end_pass(cycle, how)
        watch(journal, 0, SHOWN, FindingLimits())
        journal.record_event(EstimatesUpdated(beliefs={}, notes=[]))
        journal.record_event(CellHeld(error="the wire is dead", kind="LinkError"))
        journal.record_event(DaemonFailed(error="the wire is dead", kind="LinkError"))
        journal.record_event(FindingReported(kind="wear", what="the rate fell", stops="cell"))
        journal.record_event(CellHeld(error="the rate fell", kind="ToolStop"))
        journal.record_map(2, f"{job}2", "x", {"rms_nm": rms_nm})
        if outcome is not None:
            journal.record_outcome(outcome)


def test_a_job_as_its_rows_have_it(tmp_path: Path) -> None:
    polished(tmp_path, "a")
    (job,) = read_history(tmp_path)
    assert (job.job, job.part_id, job.outcome) == ("a", "a-part", "in_tolerance")
    assert (job.passes, job.interrupted, job.contact_s) == (1, 1, 600.0)
    assert [one.rms_nm for one in job.measured] == [20.0, 10.0, 1.5]
    assert [one.rate for one in job.measured] == [None, 0.9, None]
    assert [one.predicted_nm for one in job.measured] == [None, 1.0, 1.0]
    assert [(fault.kind, fault.what) for fault in job.faults] == [
        ("LinkError", "the wire is dead"),
        ("wear", "the rate fell"),
    ]
    assert [one.as_forecast for one in job.measured] == [None, True, None]
    assert job.rate == 0.9
    assert job.worst is None, "the last map was of an earlier polishd"


def test_all_jobs_in_order_while_another_writes(tmp_path: Path) -> None:
    polished(tmp_path, "a")
    polished(tmp_path, "b", outcome=Outcome.STALLED)
    with Journal.open(tmp_path, job="c", part_id="P") as journal:
        journal.record_map(0, "c0", "x", {"rms_nm": 9.0})
        jobs = [(job.job, job.outcome) for job in read_history(tmp_path)]
        journal.record_map(1, "c1", "x", {"rms_nm": 8.0})
        assert [one.rms_nm for one in read_history(tmp_path)[-1].measured] == [9.0, 8.0]
    assert jobs == [("a", "in_tolerance"), ("b", "stalled"), ("c", "")]


def test_a_map_that_was_taken_again_counts_once(tmp_path: Path) -> None:
    with Journal.open(tmp_path, job="c", part_id="P") as journal:
        journal.record_map(0, "c0", "x", {"rms_nm": 9.0})
        journal.record_map(0, "c1", "x", {"rms_nm": 8.0})
    assert [one.rms_nm for one in read_history(tmp_path)[0].measured] == [8.0]


def test_reading_changes_nothing(tmp_path: Path) -> None:
    polished(tmp_path, "a")
    before = (tmp_path / "journal.sqlite").read_bytes()
    read_history(tmp_path)
    assert (tmp_path / "journal.sqlite").read_bytes() == before


def test_no_journal_and_one_that_is_none_are_one_line(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"journal\.sqlite: not found: this cell has begun no job yet"):
        read_history(tmp_path)
    (tmp_path / "journal.sqlite").write_bytes(b"no database at all, however long it may be" * 100)
    with pytest.raises(ConfigError, match="the history cannot be read: file is not a database"):
        read_history(tmp_path)
    (tmp_path / "journal.sqlite").unlink()
    sqlite3.connect(tmp_path / "journal.sqlite").close()
    with pytest.raises(ConfigError, match="no such table"):
        read_history(tmp_path)
