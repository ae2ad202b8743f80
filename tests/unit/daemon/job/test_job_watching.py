"""Indicators of passes in their rows: over cycles, jobs, restarts and a change of the process."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from polishd.daemon.job.job import watch
from polishd.daemon.journal.journal import Journal
from polishd.model.estimates import Estimate, Finding, FindingLimits, PassIndicators

TERMS: Mapping[str, Any] = {"process.force_n": 12.0, "job.id": "x"}


def shown(rate: float = 1.0, *, after_nm: float = 1.0) -> PassIndicators:
    return PassIndicators(10.0, 1.0, after_nm, 1.0, 600.0, Estimate(rate, 0.01), Estimate(0.0, 0.02), None)


def passed(folder: Path, job: str, *rates: float, terms: Mapping[str, Any] = TERMS, ends: bool = True) -> list[str]:
    """A job with these passes; the kinds that were found, in order."""
    found: list[Finding] = []
    with Journal.open(folder, job=job, part_id="P", terms=terms) as journal:
        first = len(journal.passes)
        for cycle, rate in enumerate(rates, first):
            journal.record_map(cycle, f"{job}{cycle}", "x", {})
            journal.begin_pass(cycle, "sha", "boot", 3)
            journal.end_pass(cycle, "done")
            found += watch(journal, cycle, shown(rate), FindingLimits())
        if ends:
            journal._store.write(("UPDATE job SET outcome = 'in_tolerance' WHERE id = ?", (journal._job,)))
    return [one.kind for one in found]


def test_a_rate_that_drifts_over_parts_is_found(tmp_path: Path) -> None:
    assert [passed(tmp_path, f"part-{k}", rate) for k, rate in enumerate((1.0, 1.0, 1.0, 0.9, 0.8, 0.7))] == [
        *[[]] * 5,
        ["drift"],
    ]


def test_what_follows_is_held_against_what_the_tool_is_then(tmp_path: Path) -> None:
    assert passed(tmp_path, "a", 1.0, 1.0, 1.0, 0.7) == ["drift"]
    assert passed(tmp_path, "b", 0.7, 0.7, 0.7, 0.7) == [], "a person has seen to it, and went on with that tool"
    assert passed(tmp_path, "c", 1.0) == ["drift"]


def test_another_process_begins_anew(tmp_path: Path) -> None:
    assert passed(tmp_path, "a", 1.0, 1.0, 1.0) == []
    assert passed(tmp_path, "b", 0.6, terms={**TERMS, "process.force_n": 10.0}) == []
    assert passed(tmp_path, "c", 0.6, terms={**TERMS, "process.force_n": 10.0, "part.edge_mm": 5.0}) == []


def test_a_job_that_goes_on_after_a_restart_is_watched_on(tmp_path: Path) -> None:
    assert passed(tmp_path, "a", 1.0, 1.0, ends=False) == []
    assert passed(tmp_path, "a", 1.0, 0.6) == ["drift"]


def test_what_was_reported_of_a_pass_does_not_hold_the_cell_again(tmp_path: Path) -> None:
    assert passed(tmp_path, "a", 1.0, 1.0, 1.0, 0.6, ends=False) == ["drift"]
    with Journal.open(tmp_path, job="a", part_id="P", terms=TERMS) as journal:
        assert watch(journal, 3, shown(0.6), FindingLimits()) == ()
        facts = journal.passes[-1].facts
        assert [one["kind"] for one in facts["findings"]] == ["drift"]
        assert facts["series"]["passes"] == 0


def test_a_stall_is_of_one_job(tmp_path: Path) -> None:
    with Journal.open(tmp_path, job="a", part_id="P", terms=TERMS) as journal:
        for cycle in range(2):
            journal.begin_pass(cycle, "sha", "boot", 3)
            journal.end_pass(cycle, "done")
        assert watch(journal, 0, shown(after_nm=9.0), FindingLimits()) == ()
        (found,) = watch(journal, 1, shown(after_nm=9.0), FindingLimits())
    assert (found.kind, found.stops) == ("stall", "job")
