"""Jobs for the plant, as read from a journal."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path

import pytest

from polishd.daemon.journal.journal import JOURNAL_NAME
from polishd.daemon.journal.store import connect
from polishd.model.errors import ConfigError
from polishd.opcua.jobs import MOST_ENDED, OpcUaResultValue, read_work
from tests.unit.opcua.journals import write_journal


def test_jobs_stand_in_the_order_in_which_they_were_and_will_be_worked(tmp_path: Path) -> None:
    write_journal(tmp_path)
    assert [(one.name, one.state) for one in read_work(tmp_path)] == [
        ("lens", "Ended"), ("mirror", "Ended"), ("flat", "Aborted"), ("wedge", "Running"), ("prism", "AllowedToStart")
    ]  # fmt: skip
    assert [one.id for one in read_work(tmp_path)][:2] == ["lens.1", "mirror.2"]


def test_a_part_has_the_figures_of_its_last_map(tmp_path: Path) -> None:
    write_journal(tmp_path)
    lens, mirror, flat, *_ = read_work(tmp_path)
    assert lens.figures == (
        OpcUaResultValue("Passes", 1), OpcUaResultValue("RMS", 1.5, "nm"), OpcUaResultValue("PV", 7.5, "nm"),
        OpcUaResultValue("RMS, counted", 1.5, "nm"), OpcUaResultValue("RMS, limit", 2.0, "nm"),
    )  # fmt: skip
    assert (lens.holds, mirror.holds, flat.holds) == (True, False, None)
    assert flat.figures == (OpcUaResultValue("Passes", 0),)


def test_a_job_without_an_end_that_another_came_after_was_given_up(tmp_path: Path) -> None:
    write_journal(tmp_path)
    _write(tmp_path, "INSERT INTO job (id, name, part_id, terms, started) VALUES (5, 'new', 'A-6', 'null', 700.0)")
    known = {one.name: one for one in read_work(tmp_path)}
    assert (known["wedge"].end, known["wedge"].state, known["new"].state) == ("given up", "Aborted", "Running")


def test_of_many_jobs_the_latest_are_reported(tmp_path: Path) -> None:
    write_journal(tmp_path)
    for number in range(100, 150):
        _write(tmp_path, "INSERT INTO job (id, name, part_id, terms, started, ended, outcome) "
               f"VALUES ({number}, 'n{number}', 'B', 'null', 700.0, 800.0, 'stalled')")  # fmt: skip
    names = [one.name for one in read_work(tmp_path)]
    assert (len(names), names[-2:]) == (MOST_ENDED + 2, ["n149", "prism"])


def test_without_a_journal_there_are_no_jobs_and_one_that_cannot_be_read_is_refused(tmp_path: Path) -> None:
    assert read_work(tmp_path) == ()
    (tmp_path / JOURNAL_NAME).write_bytes(b"no database at all" * 100)
    with pytest.raises(ConfigError, match="cannot be read"):
        read_work(tmp_path)


def _write(state_dir: Path, sql: str) -> None:
    with closing(connect(state_dir / JOURNAL_NAME)) as journal:
        journal.execute(sql)
