"""Records in memory equal those that a starting daemon reads from the file."""

from __future__ import annotations

from collections.abc import AsyncIterator, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from polishd.daemon.journal.journal import Journal
from polishd.daemon.journal.records import BlockRecord, read_unreported_blocks
from polishd.model.devices import ExecutedBlock
from polishd.model.errors import PolishdError, WrongSeat
from polishd.model.events import PlanWritten
from polishd.model.states import CyclePhase, Outcome
from tests.unit.daemon.small_job import recorded_phases


def opened(state_dir: Path, job: str = "job", **terms: Any) -> Journal:
    return Journal.open(state_dir, job=job, part_id="P1", terms=terms)


def block(seq: int, touched: bool | None) -> BlockRecord:
    return BlockRecord(ExecutedBlock(seq, seq * 1.0, seq + 0.5), touched, 12.0, 990.0, 70.0 + seq)


def known(journal: Journal) -> dict[str, Any]:
    """All records in memory."""
    cycles = range(4)
    return {
        "number": journal.number,
        "begun": journal.begun,
        "terms": journal.terms,
        "run_dir": journal.run_dir,
        "map": journal.last_map_id,
        "history": journal.history,
        "passes": journal.passes,
        "phase": journal.phase_now,
        "tallies": [journal.tally(cycle) for cycle in cycles],
        "contact_s": [journal.contact_s(cycle) for cycle in cycles],
        "uncertain": [journal.uncertain(cycle) for cycle in cycles],
        "remaining": list(journal.remaining(9)),
        "unfinished": journal.unfinished(),
    }


@pytest.fixture
def journal(tmp_path: Path) -> Iterator[Journal]:
    with opened(tmp_path, a=1) as found:
        yield found


def agrees(tmp_path: Path, journal: Journal) -> dict[str, Any]:
    """Require that both records are equal, and return them."""
    journal.flush()
    said = known(journal)
    with opened(tmp_path, a=1) as again:
        assert again.resumed
        assert known(again) == said
    return said


async def test_of_a_job_that_has_just_begun(tmp_path: Path, journal: Journal) -> None:
    assert not journal.resumed
    said = agrees(tmp_path, journal)
    assert (said["begun"], said["passes"], said["history"], said["map"]) == (False, (), (), None)
    assert (said["run_dir"], said["phase"], said["remaining"]) == ("", (None, None), list(range(9)))


async def test_of_each_thing_that_is_recorded(tmp_path: Path, journal: Journal) -> None:
    journal.record_run_dir(tmp_path / "run")
    assert agrees(tmp_path, journal)["run_dir"] == str(tmp_path / "run")
    async with journal.phase(0, CyclePhase.MEASURE):
        assert journal.phase_now == (0, "measure")
        journal.record_map(0, "aa", tmp_path / "a.dat", {"rms_nm": np.float64(2.5)}, "arrays")
    said = agrees(tmp_path, journal)
    (record,) = said["history"]
    assert (record.cycle, record.sha256, record.path, record.arrays) == (0, "aa", str(tmp_path / "a.dat"), "arrays")
    assert (record.stats, said["map"], said["begun"], said["phase"]) == ({"rms_nm": 2.5}, "aa", True, (0, "measure"))
    journal.begin_pass(0, "prog", "boot", 9, facts={"n": np.int64(3)}, plan="plan", start="start", reach_s=4.5)
    (begun,) = agrees(tmp_path, journal)["passes"]
    assert (begun.contact_from, begun.contact_to, begun.blocks) == (0, 9, 9), "the default is all blocks"
    assert (begun.facts, begun.plan, begun.start, begun.reach_s) == ({"n": 3}, "plan", "start", 4.5)
    assert (begun.ended_s, begun.how, begun.uncertain) == (None, None, None)
    journal.record_executed(0, [block(0, True), block(1, None), block(2, False)])
    journal.record_executed(0, [block(1, True), block(2, True)])  # reported again: the first record stays
    said = agrees(tmp_path, journal)
    assert (said["tallies"][0].done, said["tallies"][0].last_seq, said["contact_s"][0]) == (3, 2, 0.5)
    assert said["uncertain"][0] == ((1, 2),)
    assert said["unfinished"] == begun
    journal.reconcile(0, [block(3, None), block(4, False)])
    assert agrees(tmp_path, journal)["uncertain"][0] == ((1, 2), (3, 4))
    journal.mark_uncertain(0, 5, 7)
    assert agrees(tmp_path, journal)["uncertain"][0] == ((1, 2), (3, 4), (5, 7))
    journal.add_facts(0, {"rate": np.float32(0.5)})
    assert agrees(tmp_path, journal)["passes"][0].facts == {"n": 3, "rate": 0.5}
    async with journal.phase(0, CyclePhase.RUN):
        assert agrees(tmp_path, journal)["phase"] == (0, "run")
    journal.end_pass(0, "interrupted")
    said = agrees(tmp_path, journal)
    assert (said["passes"][0].how, said["unfinished"], said["remaining"][0]) == ("interrupted", None, 1)
    assert said["passes"][0].ended_s >= said["passes"][0].started_s
    assert said["passes"][0].uncertain == (5, 7)


async def test_of_several_cycles_each_has_its_own(tmp_path: Path, journal: Journal) -> None:
    for cycle in (0, 1):
        journal.record_map(cycle, f"map {cycle}, taken again", "x", {})
        journal.record_map(cycle, f"map {cycle}", "x", {})
        journal.begin_pass(cycle, f"prog {cycle}", "boot", 9, contact=(2, 8))
        journal.record_executed(cycle, [block(seq, None if cycle else True) for seq in range(2 + cycle)])
        journal.end_pass(cycle, "done")
    said = agrees(tmp_path, journal)
    assert [tally.done for tally in said["tallies"]] == [2, 3, 0, 0]
    assert said["uncertain"] == [(), ((0, 3),), (), ()]
    assert [(one.cycle, one.sha256) for one in said["history"]] == [(0, "map 0"), (1, "map 1")]
    assert (said["map"], [one.program_sha256 for one in said["passes"]]) == ("map 1", ["prog 0", "prog 1"])
    assert [(one.contact_from, one.contact_to) for one in said["passes"]] == [(2, 8)] * 2


async def test_a_job_knows_the_last_map_of_any_other_and_nothing_else_of_it(tmp_path: Path, journal: Journal) -> None:
    journal.record_run_dir(tmp_path)
    journal.record_map(0, "aa", "x", {})
    async with journal.phase(0, CyclePhase.RUN):
        journal.begin_pass(0, "prog", "boot", 9)
        journal.record_executed(0, [block(0, None)])
    journal.record_outcome(Outcome.CYCLES_USED)
    journal.flush()
    with opened(tmp_path, b=2) as other:
        said = known(other)
        assert other.number == journal.number + 1
        assert not other.resumed
    assert (said["map"], said["terms"], said["run_dir"], said["phase"]) == ("aa", {"b": 2}, "", (None, None))
    assert (said["history"], said["passes"], said["uncertain"], said["begun"]) == ((), (), [()] * 4, False)


def passes(journal: Journal) -> dict[tuple[int, int], tuple[Any, ...]]:
    """Return the columns of all passes that may change after the begin, by job and cycle."""
    sql = "SELECT job, cycle, how, facts, uncertain_from, uncertain_to, ended IS NULL, plan FROM pass"
    return {(job, cycle): tuple(rest) for job, cycle, *rest in journal.store.read(sql)}


def test_what_becomes_known_of_a_pass_changes_no_other_of_this_job_or_another(tmp_path: Path) -> None:
    def two_passes(journal: Journal) -> None:
        for cycle in range(3):
            journal.begin_pass(cycle, "prog", "boot", 9, plan="plan")

    with opened(tmp_path, "one") as journal:
        two_passes(journal)
    with opened(tmp_path, "two") as journal:
        two_passes(journal)
        assert journal.begun, "though it has no map"
        before = passes(journal)
        journal.add_facts(1, {"a": 1})
        journal.mark_uncertain(1, 3, 4)
        journal.end_pass(1, "done")
        after = passes(journal)
        assert after.pop((2, 1)) == ("done", '{"a": 1}', 3, 4, 0, "plan")
        assert before.pop((2, 1)) == (None, "{}", None, None, 1, "plan")
        assert after == before


async def test_a_run_folder_and_an_outcome_and_the_end_of_a_phase_are_of_their_own_row(tmp_path: Path) -> None:
    with opened(tmp_path, "one") as journal:
        journal.record_run_dir(tmp_path / "one")
        journal.record_outcome(Outcome.STALLED)
    with opened(tmp_path, "two") as journal:
        journal.record_run_dir(tmp_path / "two")
        async with journal.phase(0, CyclePhase.MEASURE):
            async with journal.phase(0, CyclePhase.SOLVE):
                pass
            assert recorded_phases(journal) == [(0, "measure", None, None), (0, "solve", "done", None)]
        journal.record_outcome(Outcome.DIVERGED)
        rows = journal.store.read("SELECT name, run_dir, outcome, detail, ended IS NULL FROM job ORDER BY id")
    assert rows == [("one", str(tmp_path / "one"), "stalled", "", 0), ("two", str(tmp_path / "two"), "diverged", "", 0)]


# phases


async def test_a_phase_that_is_not_gone_on_with_was_cancelled(journal: Journal) -> None:
    async def work() -> AsyncIterator[int]:
        async with journal.phase(1, CyclePhase.SOLVE):
            yield 1

    working = work()
    await anext(working)
    await working.aclose()  # type: ignore[attr-defined]
    assert recorded_phases(journal) == [(1, "solve", "cancelled", "GeneratorExit: ")]


async def test_what_ended_a_phase_is_reported_before_the_loss_of_the_journal(
    journal: Journal, monkeypatch: pytest.MonkeyPatch
) -> None:
    def lost(*_: object) -> None:
        raise PolishdError("journal lost")

    async def work() -> None:
        async with journal.phase(0, CyclePhase.RUN):
            monkeypatch.setattr(journal, "_end_phase", lost)
            raise WrongSeat("crooked")

    with pytest.raises(WrongSeat, match="crooked") as raised:
        await work()
    assert raised.value.__notes__ == ["journal lost"]


async def test_where_the_robot_stands_amid_a_pass_is_known_until_another_pass_was_whole(journal: Journal) -> None:
    async def run(phase: CyclePhase, error: BaseException | None = None) -> None:
        with pytest.raises(type(error)) if error else _nothing():
            async with journal.phase(0, phase):
                if error:
                    raise error

    assert journal.cut_off() is None
    await run(CyclePhase.RUN)
    assert journal.cut_off() is None
    await run(CyclePhase.TOUCH_OFF, PolishdError("the link"))
    assert journal.cut_off() == 2
    await run(CyclePhase.MEASURE)
    assert journal.cut_off() == 2, "the robot was not moved"
    await run(CyclePhase.TOUCH_OFF, WrongSeat("crooked"))
    assert journal.cut_off() is None, "the robot left it"
    await run(CyclePhase.RUN, PolishdError("WrongSeat"))
    assert journal.cut_off() == 5
    async with journal.phase(0, CyclePhase.RUN):
        assert journal.cut_off() == 6, "a daemon that is killed ends none"


def _nothing() -> Any:
    return pytest.MonkeyPatch.context()


# what was said


def test_the_reason_why_a_cell_is_held_is_that_of_its_last_state(tmp_path: Path, journal: Journal) -> None:
    assert journal.held_last() == ""
    journal.record_event(PlanWritten(run_dir="x"))
    assert journal.held_last() == ""


def test_what_passes_of_any_job_showed_is_found_latest_first(tmp_path: Path) -> None:
    for number in range(2):
        with opened(tmp_path, f"job {number}") as journal:
            for cycle, how in enumerate(("done", "interrupted", "done", "done")):
                journal.begin_pass(cycle, "prog", "boot", 1, facts={"name": f"{number}.{cycle}"})
                journal.end_pass(cycle, how)
            names = [facts["name"] for facts in journal.passes_before(3, 9)]
            assert names == ["1.2", "1.0", "0.3", "0.2", "0.0"][-2 - 3 * number :][: 2 + 3 * number]
            assert [facts["name"] for facts in journal.passes_before(3, 1)] == [f"{number}.2"]
            assert [facts["name"] for facts in journal.passes_before(0, 1)] == (["0.3"] if number else [])


def test_between_jobs_no_job_goes_on(tmp_path: Path) -> None:
    with Journal.of_cell(tmp_path) as cell:
        assert not cell.resumed
        assert cell.number == 0
        assert cell.errors() == []
        assert (cell.run_dir, cell.terms, cell.history, cell.passes, cell.phase_now) == ("", None, (), (), (None, None))
        assert not cell.begun
        assert not cell.of_job("a", "P1", {}).resumed
        assert cell.of_job("a", "P1", {}).resumed


def test_unnamed_records_are_empty_and_arrays_lie_beside_the_journal(tmp_path: Path, journal: Journal) -> None:
    journal.record_map(0, "aa", "x", {})
    journal.begin_pass(0, "prog", "boot", 9)
    assert (journal.history[0].arrays, journal.passes[0].plan, journal.passes[0].start) == ("", "", "")
    assert (journal.arrays.folder, journal.store.path) == (tmp_path / "store", tmp_path / "journal.sqlite")


def test_blocks_of_which_contact_is_unknown_are_ranges(tmp_path: Path, journal: Journal) -> None:
    journal.begin_pass(0, "sha", "boot", 20, contact=(0, 20))
    unknown = [(0, 2), (4, 5), (8, 11)]
    seqs = [seq for first, end in unknown for seq in range(first, end)]
    journal.record_executed(0, [block(seq, None if seq in seqs else True) for seq in range(12)])
    assert agrees(tmp_path, journal)["uncertain"][0] == tuple(unknown)
    assert journal._known.unknown[0] == unknown, "as few ranges as there are"
    assert list(read_unreported_blocks(journal._store, journal.number, 0)) == unknown
