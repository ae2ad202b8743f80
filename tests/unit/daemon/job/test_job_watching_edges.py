"""Indicators of passes: of which pass, of which process, and how far back."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from polishd.daemon.job.job import FAR_BACK, watch
from polishd.daemon.journal.journal import Journal
from polishd.model.estimates import FindingLimits
from tests.unit.daemon.job.test_job_watching import TERMS, passed, shown


def facts(folder: Path, job: str, *rates: float, how: str = "done", **terms: Any) -> list[dict[str, Any]]:
    """Record the passes of that job, and end it."""
    with Journal.open(folder, job=job, part_id="P", terms={**TERMS, **terms}) as journal:
        for cycle, rate in enumerate(rates):
            journal.record_map(cycle, f"{job}{cycle}", "x", {})
            journal.begin_pass(cycle, "sha", "boot", 3)
            watch(journal, cycle, shown(rate), FindingLimits())
            journal.end_pass(cycle, how)
        journal._store.write(("UPDATE job SET outcome = 'in_tolerance' WHERE id = ?", (journal._job,)))
        return [dict(one.facts) for one in journal.passes]


def passes(folder: Path, job: str, *rates: float, **terms: Any) -> list[int]:
    """How many passes each of them has been followed by then."""
    return [one["series"]["passes"] for one in facts(folder, job, *rates, **terms)]


def test_each_pass_keeps_what_it_showed_itself(tmp_path: Path) -> None:
    first, second = facts(tmp_path, "a", 1.0, 0.99)
    assert (first["shown"]["rate"]["value"], second["shown"]["rate"]["value"]) == (1.0, 0.99)
    assert first["findings"] == second["findings"] == []


def test_passes_are_followed_over_jobs_of_one_process(tmp_path: Path) -> None:
    assert passes(tmp_path, "a", 1.0, 1.0) == [1, 2]
    assert passes(tmp_path, "b", 1.0) == [3]


@pytest.mark.parametrize("key", ["process.rpm", "compliance.gain", "kinematics.model", "roles.robot"])
def test_another_process_is_followed_by_itself(tmp_path: Path, key: str) -> None:
    assert passes(tmp_path, "a", 1.0) == [1]
    assert passes(tmp_path, "b", 1.0, **{key: "other"}) == [1]
    assert passes(tmp_path, "c", 1.0, **{key: "other"}) == [2]


@pytest.mark.parametrize("key", ["part.edge_mm", "robot.address", "processes", "job.id"])
def test_what_makes_no_process_changes_none(tmp_path: Path, key: str) -> None:
    assert passes(tmp_path, "a", 1.0) == [1]
    assert passes(tmp_path, "b", 1.0, **{key: "other"}) == [2]


def test_the_order_of_keys_makes_no_process(tmp_path: Path) -> None:
    assert passes(tmp_path, "a", 1.0, **{"process.a": 1, "process.b": 2}) == [1]
    assert passes(tmp_path, "b", 1.0, **{"process.b": 2, "process.a": 1}) == [2]


def test_passes_that_were_not_watched_are_passed_over_so_far_back_and_no_farther(tmp_path: Path) -> None:
    assert passes(tmp_path, "a", 1.0) == [1]
    for number, expected in ((FAR_BACK - 1, 2), (FAR_BACK, 1)):
        with Journal.open(tmp_path, job=f"unwatched {number}", part_id="P", terms=TERMS) as journal:
            for cycle in range(number):
                journal.begin_pass(cycle, "sha", "boot", 3)
                journal.end_pass(cycle, "done")
            journal._store.write(("UPDATE job SET outcome = 'in_tolerance' WHERE id = ?", (journal._job,)))
        assert passes(tmp_path, f"b {number}", 1.0) == [expected]


def test_a_job_without_a_recorded_process_is_followed_too(tmp_path: Path) -> None:
    for job in "ab":
        with Journal.open(tmp_path, job=job, part_id="P") as journal:
            journal._known.terms = None
            journal.begin_pass(0, "sha", "boot", 3)
            watch(journal, 0, shown(), FindingLimits())
            journal.end_pass(0, "done")
            journal._store.write(("UPDATE job SET outcome = 'in_tolerance' WHERE id = ?", (journal._job,)))
            found = journal.passes[0].facts["series"]["passes"]
    assert found == 2


def test_what_was_reported_stays_reported_beside_what_is_new(tmp_path: Path) -> None:
    assert passed(tmp_path, "a", 1.0, 1.0, 1.0, 0.6, ends=False) == ["drift"]
    with Journal.open(tmp_path, job="a", part_id="P", terms=TERMS) as journal:
        journal.add_facts(3, {"findings": [{"kind": "wear", "stops": "", "text": "reported"}]})
        again = watch(journal, 3, shown(0.6), FindingLimits())
        assert [one.kind for one in again] == ["drift"]
        assert [one["kind"] for one in journal.passes[-1].facts["findings"]] == ["wear", "drift"]


def test_a_stall_stops_its_job_and_the_tool_is_followed_on(tmp_path: Path) -> None:
    with Journal.open(tmp_path, job="a", part_id="P", terms=TERMS) as journal:
        for cycle in range(3):
            journal.begin_pass(cycle, "sha", "boot", 3)
            found = watch(journal, cycle, shown(after_nm=9.0), FindingLimits())
            journal.end_pass(cycle, "done")
        assert [one.kind for one in found] == ["stall"]
        assert [one.facts["series"]["passes"] for one in journal.passes] == [1, 2, 3]


def test_a_pass_that_is_watched_twice_is_one_pass(tmp_path: Path) -> None:
    """The cell was held, and measured anew: that is no second one without success."""
    with Journal.open(tmp_path, job="a", part_id="P", terms=TERMS) as journal:
        for cycle in range(2):  # the first of them was cut off, and showed nothing
            journal.begin_pass(cycle, "sha", "boot", 3)
            journal.end_pass(cycle, "done" if cycle else "interrupted")
        for _ in range(2):
            assert watch(journal, 1, shown(after_nm=9.0), FindingLimits()) == ()
