"""Reads of the journal's file: why a cell was held, times of phases, executed blocks."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from polishd.daemon.journal.journal import Journal
from polishd.daemon.journal.records import BlockCounts, BlockRecord, joined
from polishd.daemon.runtime.events import safety_of
from polishd.model.devices import ExecutedBlock
from polishd.model.events import CellHeld, DaemonFailed, QueueJobEnded
from polishd.model.states import CyclePhase, Outcome
from tests.unit.daemon.small_job import open_journal


@pytest.fixture
def journal(tmp_path: Path) -> Iterator[Journal]:
    with open_journal(tmp_path) as found:
        yield found


def state(name: str, reason: str = "") -> object:
    return safety_of(name, reason, ())


def ended(stops: str) -> QueueJobEnded:
    return QueueJobEnded(
        job="a", part_id="P", verdict="rejected", reason="the job has used all its passes", stops=stops, run_dir=""
    )


@pytest.mark.parametrize(
    ("events", "why"),
    [
        ([state("polishing")], ""),
        ([state("held", "LinkError: gone")], "LinkError: gone"),
        ([state("held", "gone"), state("polishing")], ""),
        ([state("held", "gone"), state("finished", "stopped"), state("starting")], "gone"),  # it comes up held again
        ([state("polishing"), state("held", "one"), state("held", "two")], "two"),
        ([state("idle"), ended(""), state("finished")], ""),
        ([ended("worn")], "the queue stopped: worn; a was rejected: the job has used all its passes"),
        ([state("held", "x"), state("idle"), ended("worn"), state("finished")], "the queue stopped: worn"),
        ([ended("worn"), state("idle")], ""),
        ([state("held", "x"), CellHeld(error="y", kind="z")], "x"),
    ],
)
def test_why_the_cell_was_held_when_its_last_daemon_ended(journal: Journal, events: list[object], why: str) -> None:
    for event in events:
        journal.record_event(event)  # type: ignore[arg-type]
    said = journal.held_last()
    assert said.startswith(why)
    assert bool(said) is bool(why)


def test_an_earlier_jobs_hold_counts_too(tmp_path: Path, journal: Journal) -> None:
    journal.record_event(state("held", "gone"))  # type: ignore[arg-type]
    journal.record_outcome(Outcome.STALLED)
    with Journal.of_cell(tmp_path) as cell:
        assert cell.held_last() == "gone"


def test_errors_are_of_this_job_and_between_jobs_of_this_run(tmp_path: Path, journal: Journal) -> None:
    journal.record_event(CellHeld(error="hot", kind="DeviceFault"))
    journal.record_event(state("held", "no error"))  # type: ignore[arg-type]
    journal.record_event(DaemonFailed(error="gone", kind="LinkError"))
    assert [(name, data["error"]) for _, name, data in journal.errors()] == [
        ("cell_held", "hot"),
        ("daemon_failed", "gone"),
    ]
    journal.record_outcome(Outcome.STALLED)
    for error in ("first", "second"):
        with Journal.of_cell(tmp_path) as cell:
            assert cell.errors() == []
            cell.record_event(CellHeld(error=error, kind="x"))
            assert [data["error"] for _, _, data in cell.errors()] == [error]
    assert len(journal.errors()) == 2


async def test_what_each_phase_took_is_of_this_job_and_of_what_ended(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ticks = itertools.count(100)
    monkeypatch.setattr("polishd.daemon.journal.journal.time.time", lambda: float(next(ticks)))
    with Journal.open(tmp_path, job="one", part_id="P") as journal:
        async with journal.phase(0, CyclePhase.RUN):
            pass
        journal.record_outcome(Outcome.STALLED)
    with Journal.open(tmp_path, job="two", part_id="P") as journal:
        for _ in range(2):
            async with journal.phase(0, CyclePhase.SOLVE):
                pass
        async with journal.phase(0, CyclePhase.MEASURE):
            assert journal.phase_times_s() == {"solve": 2.0}
        assert list(journal.phase_times_s().items()) == [("measure", 1.0), ("solve", 2.0)], "in the order of a cycle"


def test_executed_blocks_are_of_one_pass_in_their_order(tmp_path: Path) -> None:
    for job in ("one", "two"):
        with Journal.open(tmp_path, job=job, part_id="P") as journal:
            for cycle in (0, 1):
                journal.begin_pass(cycle, "prog", "boot", 9)
                for seq in (3, 1, 2) if cycle else (7, 5):
                    block = ExecutedBlock(seq, seq + 0.25, seq + 1.0)
                    journal.record_executed(cycle, [BlockRecord(block, None if seq == 2 else seq != 3, 1.5, 2.5, 9.0)])
            journal.reconcile(1, [BlockRecord(ExecutedBlock(4, 4.0, 5.0), True)])
            found = journal.executed(1)
            assert found.seq.tolist() == [1, 2, 3, 4]
            assert found.start_s.tolist() == [1.25, 2.25, 3.25, 4.0]
            assert found.duration_s.tolist() == [0.75, 0.75, 0.75, 1.0]
            assert found.contact.tolist() == [True, False, False, True]
            assert found.possible.tolist() == [True, True, False, True]
            assert found.recovered.tolist() == [False, False, False, True]
            assert (found.force_n[0], found.rpm[0], found.told_s[0]) == (1.5, 2.5, 9.0)
            assert np.isnan(found.told_s[3])
            assert journal.executed(0).seq.tolist() == [5, 7]
            assert journal.executed(5).seq.size == 0
            assert journal.tally(1) == BlockCounts(4, 4, 1.75)
            assert journal.uncertain(1) == ((2, 3),)
            assert journal.uncertain(0) == journal.uncertain(5) == ()
            assert journal.tally(5) == BlockCounts(0, -1, 0.0)
            assert journal.contact_s(1) == 1.75


@pytest.mark.parametrize(
    ("ranges", "found"),
    [
        ([], ()),
        ([(1, 1)], ()),
        ([(1, 2), (2, 3)], ((1, 3),)),
        ([(1, 2), (3, 4)], ((1, 2), (3, 4))),
        ([(1, 9), (2, 3), (9, 9), (9, 10)], ((1, 10),)),
        ([(1, 2), (5, 5), (7, 8)], ((1, 2), (7, 8))),
        ([(3, 2)], ()),
    ],
)
def test_ranges_that_meet_are_one(ranges: list[tuple[int, int]], found: tuple[tuple[int, int], ...]) -> None:
    assert joined(ranges) == found
