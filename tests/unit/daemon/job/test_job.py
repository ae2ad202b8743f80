"""A job: its records, its use of executed times, and its state after a restart."""

from __future__ import annotations

import inspect
import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from polishd.daemon.job.job import PROGRESS_BLOCKS, Job, StoredArrays, _process, cycle_entries
from polishd.daemon.journal.journal import Journal
from polishd.daemon.journal.records import BlockRecord
from polishd.daemon.runtime.installed import installed_at_start
from polishd.model.devices import ExecutedBlock, RobotProgress
from polishd.model.errors import ComputeError, HostFault, PlanRefused
from polishd.model.estimates import Finding
from polishd.model.program import Plan
from polishd.model.surface import SurfaceMap
from polishd.model.tolerance import ToleranceLine
from polishd.pipeline import steps
from polishd.pipeline.decisions import Accept, AnotherPass, Diverge
from polishd.pipeline.dwell_step import require_certificate
from polishd.pipeline.records import FIGURES, PASS_FIGURES, MeasureResult, ProgramTurn
from polishd.plugins.rnc_robot.dialect import dialect
from polishd.plugins.rnc_robot.formats import format_of
from polishd.process.identification.findings import DIVERGED_RATIO
from tests.rs274 import RS274
from tests.unit.daemon.small_job import (
    CERTIFICATE,
    as_map,
    at_rate,
    open_journal,
    small_job,
    small_map,
    small_program,
    small_recipe,
)

ROBOT = RobotProgress("held", "", 0, 0, 0.0, "boot-1")


@pytest.fixture
def journal(tmp_path: Path) -> Iterator[Journal]:
    with open_journal(tmp_path) as found:
        yield found


@pytest.fixture
def job(tmp_path: Path, journal: Journal) -> Job:
    return small_job(tmp_path, journal)


def scaled(surface: SurfaceMap, factor: float) -> SurfaceMap:
    return as_map(surface.height_nm * factor)


async def measure(job: Job, cycle: int, rms_nm: float) -> MeasureResult:
    return await job.measured(cycle, scaled(small_map(), rms_nm / 20.0))


async def planned(job: Job, cycle: int, surface: MeasureResult) -> Plan:
    return await job.plan(cycle, surface, await job.solve(cycle, surface))


async def run(
    job: Job,
    cycle: int,
    plan: Plan,
    *,
    late_s: float = 0.0,
    end: bool = True,
    blocks: int = 10**6,
    force_n: float | None = 12.0,
    sensed_n: float | None = None,
) -> None:
    """The pass, as expected and this much later a block."""
    await job.begin_pass(cycle, plan, ROBOT, 9.5)
    at_s = 100.0
    for seq, time_s in list(zip(plan.program.block, plan.expected_time_s, strict=True))[:blocks]:
        block = ExecutedBlock(int(seq), at_s, at_s + float(time_s) + late_s)
        job.executed(cycle, [BlockRecord(block, True, force_n, 1000.0, None, sensed_n)])
        at_s += float(time_s) + late_s
    if end:
        await job.end_pass(cycle)


async def whole_cycle(
    job: Job,
    cycle: int,
    surface: SurfaceMap,
    rate: float = 1.0,
    force_n: float | None = 12.0,
    sensed_n: float | None = None,
) -> SurfaceMap:
    """Measure, estimate, plan and run; return the surface afterwards on the map's grid."""
    measured = await job.measured(cycle, surface)
    await job.learn(cycle, measured)
    plan = await planned(job, cycle, measured)
    await run(job, cycle, plan, force_n=force_n, sensed_n=sensed_n)
    answer = steps.effect_of(small_recipe(), small_program(), surface.grid, at_rate(rate))
    return as_map(surface.height_nm - answer.effect.removal_nm(plan.expected_time_s))


def test_a_job_is_given_what_it_needs_and_begins_with_nothing_else(job: Job) -> None:
    assert set(inspect.signature(Job).parameters) == {
        "tools", "journal", "folder", "compute", "publish", "check_plan", "max_cycles", "stream_ahead_s"
    }  # fmt: skip
    assert (job.findings, job._initial_notes, job._surfaces, job._planned) == ((), (), {}, {})
    assert (job._stored, job._masks, job._lay, job._blocks, job.handled) == (StoredArrays(), None, None, 0, set())


# what a summary says of each measurement

STATS = dict.fromkeys(FIGURES, 1.0)
PLANNED = dict.fromkeys(PASS_FIGURES, 2.0)


@pytest.mark.parametrize("how", ["", "done", "interrupted"])
def test_an_entry_says_how_the_pass_after_its_map_ended(journal: Journal, how: str) -> None:
    journal.record_map(0, "aa", "x", {**STATS, "notes": ["dust"]})
    turn = {"number": 0, "name": "raster"}
    journal.begin_pass(0, "prog", "boot", 3, facts={**PLANNED, "tool": "wide", "program": turn})
    if how:
        journal.end_pass(0, how)
    journal.record_map(1, "bb", "y", STATS)
    (first, second) = cycle_entries(journal, several_tools=True)
    assert (first["how"], first["tool"], first["program"]) == (how or "begun", "wide", "raster")
    assert (second["how"], second["tool"], second["program"]) == (None, None, None)
    assert (first["notes"], second["notes"]) == (["dust"], [])
    assert "tool" not in cycle_entries(journal, several_tools=False)[0]


@pytest.mark.parametrize(("torn", "earlier"), [((), [1.0, 2.0, 3.0]), ((0,), [2.0, 3.0]), ((0, 1), [3.0]), ((2,), [])])
def test_a_surface_is_compared_with_those_since_the_last_interrupted_pass(
    job: Job, journal: Journal, monkeypatch: pytest.MonkeyPatch, torn: tuple[int, ...], earlier: list[float]
) -> None:
    asked: list[tuple[Any, ...]] = []
    monkeypatch.setattr("polishd.daemon.job.job.decide", lambda *values: asked.append(values))
    for cycle in range(3):
        journal.record_map(cycle, f"{cycle}", "x", {"rms_nm": cycle + 1.0, "band_rms_nm": None})
        journal.begin_pass(cycle, "prog", "boot", 3)
        journal.end_pass(cycle, "interrupted" if cycle in torn else "done")
    journal.record_map(3, "3", "x", {"rms_nm": 9.0, "band_rms_nm": None})
    surface: Any = object()
    job.decide(3, surface)
    ((recipe, *rest),) = asked
    assert recipe is job.recipe
    assert rest == [earlier, surface, (), job.max_cycles + len(torn) - 3]


def test_a_process_is_known_by_what_defines_it() -> None:
    own = {"process.rpm": 1000.0, "process.force_max_n": 18.0, "part.id": "P"}
    assert _process(own) == _process({**own, "process.force_max_n": 20.0, "part.id": "Q"})
    assert _process(own) != _process({**own, "process.rpm": 900.0})
    assert _process(None) == _process({})


# what a cycle leaves


async def test_a_measurement_is_journalled_kept_and_reported(job: Job, journal: Journal, tmp_path: Path) -> None:
    raw = tmp_path / "scan.dat"
    raw.write_bytes(b"raw")
    surface = replace(small_map(), path=raw)
    measured = await job.measured(0, surface)
    assert journal.last_map_id == surface.sha256
    assert journal.history[0].stats["rms_nm"] == measured.stats.rms_nm
    folder = tmp_path / "run" / "cycle-00"
    assert (folder / "map.dat").read_bytes() == b"raw"
    with np.load(folder / "surface.npz") as kept:
        assert np.array_equal(np.isfinite(kept["height_nm"]), measured.solve_mask)
    (event,) = job.published  # type: ignore[attr-defined]
    assert (event.name, event.cycle, event.data["rms_nm"]) == ("map_measured", 0, measured.stats.rms_nm)


async def test_each_step_is_reported_in_its_cycle(job: Job, journal: Journal) -> None:
    surface = await whole_cycle(job, 0, small_map())
    first, blocks = list(job.published), small_program().n  # type: ignore[attr-defined]
    progressed = [event for event in first if event.name == "pass_progressed"]
    assert [event.name for event in first if event not in progressed] == [
        "map_measured", "dwell_solved", "pass_started", "pass_ended"
    ]  # fmt: skip
    assert {event.cycle for event in first} == {0}
    (started,) = [event for event in first if event.name == "pass_started"]
    assert (started.data["program"], started.data["tool"]) == ("", "")
    ends = [int(small_program().block[k]) + 1 for k in range(PROGRESS_BLOCKS - 1, blocks, PROGRESS_BLOCKS)]
    assert [event.data["block"] for event in progressed] == ends
    assert journal.passes[0].reach_s == 9.5
    await whole_cycle(job, 1, surface)
    second = job.published[len(first) :]  # type: ignore[attr-defined]
    assert [event.name for event in second if event.name != "pass_progressed"][:2] == [
        "map_measured", "estimates_updated"
    ]  # fmt: skip
    assert {event.cycle for event in second} == {1}


async def test_a_plan_that_waits_says_which_it_is(job: Job) -> None:
    plan = await planned(job, 0, await job.measured(0, small_map()))
    asked = job.approval_request(0, plan)
    assert (asked.cycle, asked.program, asked.program_sha256) == (0, "", plan.program.sha256)
    assert (asked.dwell_s, asked.plan) == (plan.total_s, job._stored.plan)
    job._planned[0] = replace(job._planned[0], program=ProgramTurn(2, "crossed.rnc"))
    assert job.approval_request(0, plan).program == "crossed.rnc"
    assert job.names() == {"job": "small", "part": "P-1"}


async def test_a_pass_that_hardly_improves_is_reported_in_its_cycle(job: Job, monkeypatch: pytest.MonkeyPatch) -> None:
    await planned(job, 0, await job.measured(0, small_map()))
    job._planned[4] = job._planned[0]
    finding = Finding("stall", "it would remove too little", "job")
    monkeypatch.setattr("polishd.daemon.job.job.small_gain_finding", lambda *_: finding)
    assert job.pass_not_worthwhile(4)
    reported = job.published[-1]  # type: ignore[attr-defined]
    assert (reported.name, reported.cycle, reported.what) == ("finding_reported", 4, finding.what)


async def test_a_pass_says_with_which_tool_it_starts(job: Job, monkeypatch: pytest.MonkeyPatch) -> None:
    plan = await planned(job, 0, await job.measured(0, small_map()))
    monkeypatch.setattr(Job, "tool", "wide")
    await job.begin_pass(0, plan, ROBOT, 9.5)
    (started,) = [one for one in job.published if one.name == "pass_started"]  # type: ignore[attr-defined]
    assert started.data["tool"] == "wide"


async def test_a_map_without_a_file_is_journalled_without_a_path(job: Job, journal: Journal, tmp_path: Path) -> None:
    await job.measured(0, small_map())
    await job.measured(0, replace(small_map(seed=1), path=tmp_path / "a.dat"))
    assert [path for (path,) in journal.store.read("SELECT path FROM map")] == ["", str(tmp_path / "a.dat")]


async def test_masks_are_those_of_the_first_map(job: Job) -> None:
    first = await job.measured(0, small_map())
    holed = small_map(seed=1)
    holed.height_nm[24:27, 24:27] = np.nan
    second = await job.measured(1, holed)
    assert np.array_equal(second.solve_mask, first.solve_mask)


async def test_a_plan_leaves_program_dwell_and_certificate(job: Job, tmp_path: Path) -> None:
    plan = await planned(job, 0, await job.measured(0, small_map()))
    folder = tmp_path / "run" / "cycle-00"
    assert (folder / "program.rnc").read_bytes() == plan.program.text
    header, *rows = (folder / "dwell.csv").read_text().splitlines()
    assert header.split(",") == ["point", "line", "x_mm", "y_mm", "dwell_s", "asked_s", "expected_s"]
    assert len(rows) == plan.program.n
    assert json.loads((folder / "certificate.json").read_text())["solver"] == "newton_cg"


async def test_a_pass_is_journalled_before_it_moves(job: Job, journal: Journal) -> None:
    plan = await planned(job, 0, await job.measured(0, small_map()))
    await job.begin_pass(0, plan, ROBOT, 9.5)
    unfinished = journal.unfinished()
    assert unfinished is not None
    assert (unfinished.program_sha256, unfinished.boot_id) == (plan.program.sha256, "boot-1")
    (record,) = journal.passes
    assert (record.contact_from, record.contact_to) == (plan.approach_blocks, plan.contact_blocks)
    believed = {"rate", "block_overhead_s", "unexplained", "ripple", "removal", "plan_figures"}
    assert set(record.facts) == {"certificate", "predicted_rms_nm", "dwell_s", "forecast", *believed}


async def test_a_pass_that_ended_is_kept_for_people(job: Job, journal: Journal, tmp_path: Path) -> None:
    plan = await planned(job, 0, await job.measured(0, small_map()))
    await run(job, 0, plan)
    assert journal.passes[0].how == "done"
    rows = (tmp_path / "run/cycle-00/executed.csv").read_text().splitlines()
    assert rows[0] == "seq,start_s,end_s,contact,force_n,rpm,sensor_force_n"
    assert rows[1].endswith(",1,12,1000,nan")
    assert len(rows) - 1 == plan.program.n
    names = [event.name for event in job.published]  # type: ignore[attr-defined]
    progress = plan.program.n // PROGRESS_BLOCKS
    assert progress > 2
    assert names == ["map_measured", "dwell_solved", "pass_started", *["pass_progressed"] * progress, "pass_ended"]
    assert job.published[-1].data["executed_s"] == pytest.approx(plan.total_s)  # type: ignore[attr-defined]


# what was executed


async def test_executed_time_lies_at_the_points_that_had_it(job: Job) -> None:
    plan = await planned(job, 0, await job.measured(0, small_map()))
    await run(job, 0, plan, late_s=0.01)
    assert job.executed_s(0) == pytest.approx(plan.expected_time_s + 0.01)


async def test_new_times_that_bring_new_lines_are_counted_by_the_lines_that_ran(
    tmp_path: Path, journal: Journal
) -> None:
    """VAL3 states a speed on a separate line: the plan has more lines than the program that it was made of."""
    form, path = format_of(dialect("val3")), small_program()
    points, axis = np.vstack([path.start_mm[:1], path.end_mm]), np.vstack([path.axis[:1], path.axis])
    assert form.make is not None
    program = form.read(form.make(points, axis, 600.0, "small"), "small")
    recipe = small_recipe(format=form)
    job = small_job(tmp_path, journal, recipe=recipe, program=program)
    plan = await planned(job, 0, await job.measured(0, small_map()))
    assert plan.program.block[-1] > program.block[-1]
    await run(job, 0, plan)
    assert job.executed_s(0) == pytest.approx(plan.expected_time_s)
    again = small_job(tmp_path / "again", journal, recipe=recipe, program=program)
    assert again.executed_s(0) == pytest.approx(plan.expected_time_s), "and after a restart"


async def test_blocks_that_were_not_run_have_no_time(job: Job) -> None:
    plan = await planned(job, 0, await job.measured(0, small_map()))
    await run(job, 0, plan, end=False, blocks=100)
    found = job.executed_s(0)
    assert found[:100] == pytest.approx(plan.expected_time_s[:100])
    assert not found[100:].any()
    assert not job.executed_s(1).any(), "a pass that never was"


async def test_time_out_of_contact_does_not_count(job: Job, journal: Journal) -> None:
    plan = await planned(job, 0, await job.measured(0, small_map()))
    await job.begin_pass(0, plan, ROBOT, 9.5)
    journal.record_executed(0, [BlockRecord(ExecutedBlock(int(plan.program.block[0]), 0.0, 5.0), False)])
    journal.flush()
    assert not job.executed_s(0).any()


async def test_the_move_to_a_dwell_counts_for_its_point(tmp_path: Path, journal: Journal) -> None:
    text = b"G21 G90 G94\nG0 X0 Y0\nG1 X1 F600\nG4 P1\n(a comment)\nG1 X2\nG4 P2\nM2\n"
    program = RS274.read(text, "dwell.rnc")
    job = small_job(tmp_path, journal, program=program)
    journal.begin_pass(0, "sha", "boot", 8, contact=(3, 7))
    for seq, start_s, end_s in [(2, 0, 9), (3, 10, 11.5), (5, 11.5, 11.75), (6, 11.75, 14)]:
        journal.record_executed(0, [BlockRecord(ExecutedBlock(seq, start_s, end_s), seq >= 3)])
    assert job.executed_s(0) == pytest.approx([1.5, 2.5])


# when it ends


@pytest.mark.parametrize(("rms_nm", "accepted"), [(0.4, True), (0.7, False)])
async def test_accepts(job: Job, rms_nm: float, accepted: bool) -> None:
    assert isinstance(job.decide(0, await measure(job, 0, rms_nm)), Accept) is accepted


async def test_the_tolerance_may_be_for_a_band(tmp_path: Path, journal: Journal) -> None:
    job = small_job(tmp_path, journal, recipe=small_recipe(tolerance_period_mm=18.0, tolerance_nm=15.0))
    measured = await job.measured(0, small_map())
    assert measured.stats.band_rms_nm is not None
    assert measured.stats.band_rms_nm < 15.0 < measured.stats.rms_nm
    assert job.decide(0, measured) == Accept()


async def test_a_part_is_accepted_when_all_lines_hold(tmp_path: Path, journal: Journal) -> None:
    lines = (ToleranceLine("rms", 15.0, above_mm=18.0), ToleranceLine("pv", 60.0))
    job = small_job(tmp_path, journal, recipe=small_recipe(tolerance_nm=None, tolerance=lines))
    measured = await job.measured(0, small_map())
    assert [one.holds for one in measured.judged] == [True, False]
    assert job.decide(0, measured) == AnotherPass()
    (entry,) = job.summary()["cycles"]
    assert [(one["what"], one["holds"]) for one in entry["judged"]] == [
        ("RMS of periods above 18 mm", True),
        ("PV", False),
    ]
    assert job.decide(1, await job.measured(1, small_map(4.0))) == Accept()


async def test_what_was_judged_is_what_a_restart_knows(tmp_path: Path, journal: Journal) -> None:
    first = await small_job(tmp_path, journal).measured(0, small_map())
    again = small_job(tmp_path, journal)._measured(journal.history[0])
    assert again.judged == first.judged != ()


async def test_diverges_against_the_best_so_far(job: Job) -> None:
    assert job.decide(0, await measure(job, 0, 20.0)) == AnotherPass(), "the first has nothing to be worse than"
    assert job.decide(1, await measure(job, 1, 10.0)) == AnotherPass()
    assert job.decide(2, await measure(job, 2, 10.0 * DIVERGED_RATIO * 0.99)) == AnotherPass()
    assert job.decide(3, await measure(job, 3, 10.0 * DIVERGED_RATIO * 1.01)) == Diverge()


async def test_an_interrupted_pass_is_not_a_divergence(job: Job, journal: Journal) -> None:
    await measure(job, 0, 10.0)
    journal.begin_pass(0, "sha", "boot", 10)
    journal.end_pass(0, "interrupted")
    assert job.decide(1, await measure(job, 1, 30.0)) == AnotherPass(), "it left a step"
    assert job.decide(2, await measure(job, 2, 60.0)) == Diverge(), "but from there on it counts"


@pytest.mark.parametrize("how", ["done", "interrupted"])
async def test_only_whole_passes_use_up_cycles(job: Job, journal: Journal, how: str) -> None:
    journal.begin_pass(0, "sha", "boot", 10)
    journal.end_pass(0, how)
    assert job.last_cycle == 3 + (how == "interrupted")


# the entries


async def test_one_entry_a_measurement(job: Job) -> None:
    plan = await planned(job, 0, await job.measured(0, small_map()))
    await run(job, 0, plan)
    await measure(job, 1, 2.0)
    first, last = job.cycles()
    assert first["rms_nm"] > last["rms_nm"]
    assert first["dwell_s"] == pytest.approx(plan.total_s)
    assert first["executed_s"] == pytest.approx(plan.total_s)
    assert first["rate"] == 1.0
    assert [last[key] for key in ("predicted_rms_nm", "dwell_s", "rate", "executed_s")] == [None] * 4
    summary = job.summary()
    assert (summary["part_id"], summary["tolerance_nm"], len(summary["cycles"])) == ("P-1", 0.5, 2)
    json.dumps(summary)


# learning


async def test_the_first_cycle_learns_nothing(job: Job) -> None:
    await job.learn(0, await job.measured(0, small_map()))
    assert [event.name for event in job.published] == ["map_measured"]  # type: ignore[attr-defined]


@pytest.mark.full
async def test_the_rate_is_learned_and_used(job: Job, journal: Journal, tmp_path: Path) -> None:
    surface = await whole_cycle(job, 0, small_map(), rate=0.8)
    await whole_cycle(job, 1, surface, rate=0.8)
    assert journal.passes[0].facts["rate"] == 1.0
    assert journal.passes[1].facts["rate"] == pytest.approx(0.8, rel=0.05)
    learned = json.loads((tmp_path / "run/cycle-01/learned.json").read_text())
    assert learned["beliefs"]["rate"] == journal.passes[1].facts["rate"]


@pytest.mark.full
@pytest.mark.parametrize(("force_n", "sensed_n", "rate"), [(9.6, None, 1.0), (None, None, 0.8), (12.0, 9.6, 1.0)])
async def test_what_a_wrong_force_removed_is_no_wrong_rate(
    job: Job, force_n: float | None, sensed_n: float | None, rate: float
) -> None:
    """The tool pressed with 80 % and removed as much less: the known force leaves the rate unchanged."""
    surface = await whole_cycle(job, 0, small_map(), rate=0.8, force_n=force_n, sensed_n=sensed_n)
    await job.learn(1, await job.measured(1, surface))
    event = job.published[-1]  # type: ignore[attr-defined]
    assert event.name == "estimates_updated"
    assert event.data["rate"] == pytest.approx(rate, rel=0.02)


async def test_an_interrupted_pass_is_kept_for_people_with_what_is_unknown(
    job: Job, journal: Journal, tmp_path: Path
) -> None:
    plan = await planned(job, 0, await job.measured(0, small_map()))
    await run(job, 0, plan, end=False, blocks=5)
    journal.record_executed(0, [BlockRecord(ExecutedBlock(plan.approach_blocks + 5, 300.0, 301.0), None)])
    last = plan.approach_blocks + 5
    journal.mark_uncertain(0, last + 1, last + 3)
    await job.cut_off(0)
    _, *rows = (tmp_path / "run/cycle-00/executed.csv").read_text().splitlines()
    assert [row.split(",")[3] for row in rows] == ["1"] * 5 + ["nan"] * 3
    assert rows[-2:] == [f"{last + k},nan,nan,nan,nan,nan,nan" for k in (1, 2)]
    assert job.cycles()[0]["uncertain"] == [[last, last + 2]]


async def test_nothing_is_learned_from_a_pass_that_was_torn_off(job: Job, journal: Journal) -> None:
    plan = await planned(job, 0, await job.measured(0, small_map()))
    await run(job, 0, plan, end=False, blocks=50)
    journal.end_pass(0, "interrupted")
    await job.learn(1, await measure(job, 1, 30.0))
    assert "learned" not in [event.name for event in job.published]  # type: ignore[attr-defined]


async def test_a_cycle_that_is_measured_again_learns_from_the_pass_not_from_itself(job: Job) -> None:
    """Held while it solved, after learning: resume measures that cycle again."""
    surface = await whole_cycle(job, 0, small_map(), rate=0.8)
    for _ in range(2):
        await job.learn(1, await job.measured(1, surface))
    last = job.published[-1]  # type: ignore[attr-defined]
    assert last.name == "estimates_updated"
    assert last.data["rate"] == pytest.approx(0.8, rel=0.05)


# after a restart


@pytest.mark.full
async def test_restored_after_a_restart(job: Job, tmp_path: Path) -> None:
    surface = await whole_cycle(job, 0, small_map(), rate=0.8)
    again = await whole_cycle(job, 1, surface, rate=0.8)
    with open_journal(tmp_path) as journal:
        other = small_job(tmp_path, journal)
        await other.load()
        assert other.cycles() == job.cycles()
        assert np.array_equal(other.executed_s(1), job.executed_s(1))
        await other.learn(2, await other.measured(2, again))
        event = other.published[-1]  # type: ignore[attr-defined]
        assert event.name == "estimates_updated"
        assert event.data["rate"] == pytest.approx(0.8, rel=0.1), "what the first run had learned"


async def test_restored_amid_a_cycle_that_had_been_measured(job: Job, tmp_path: Path) -> None:
    surface = await whole_cycle(job, 0, small_map(), rate=0.8)
    await job.learn(1, await job.measured(1, surface))
    with open_journal(tmp_path) as journal:
        other = small_job(tmp_path, journal)
        await other.load()
        await other.learn(1, await other.measured(1, surface))
        assert other.published[-1].data["rate"] == pytest.approx(0.8, rel=0.05)  # type: ignore[attr-defined]


async def test_restored_before_any_pass_keeps_the_masks(job: Job, tmp_path: Path) -> None:
    first = await job.measured(0, small_map())
    with open_journal(tmp_path) as journal:
        other = small_job(tmp_path, journal)
        await other.load()
        holed = small_map()
        holed.height_nm[24:27, 24:27] = np.nan
        assert np.array_equal((await other.measured(0, holed)).solve_mask, first.solve_mask)


# what is refused


async def test_every_violation_is_reported(tmp_path: Path, journal: Journal) -> None:
    job = small_job(tmp_path, journal, check_plan=lambda plan, envelope: ["too fast", "too far"])
    plan = await planned(job, 0, await job.measured(0, small_map()))
    with pytest.raises(PlanRefused, match="nothing moved:\n  too fast\n  too far"):
        await job.refuse_unsafe(plan)


async def test_no_pass_with_software_that_changed(
    tmp_path: Path, journal: Journal, monkeypatch: pytest.MonkeyPatch
) -> None:
    job = small_job(tmp_path, journal)
    plan = await planned(job, 0, await job.measured(0, small_map()))
    now = {**installed_at_start(), "polishd": "9.9"}
    monkeypatch.setattr("polishd.daemon.job.job.installed_now", lambda: now)
    with pytest.raises(HostFault, match=r"polishd \(.* now 9\.9\).*Restart the daemon"):
        await job.refuse_unsafe(plan)


async def test_a_landing_on_the_part_is_refused(tmp_path: Path, journal: Journal) -> None:
    job = small_job(tmp_path, journal)
    plan = await planned(job, 0, await job.measured(0, small_map()))
    await job.refuse_unsafe(plan)
    job.tools.now = replace(job.tools.now, recipe=small_recipe(aperture_mm=60.0))
    with pytest.raises(PlanRefused, match=r"contact starts at .*\n.*contact ends at"):
        await job.refuse_unsafe(plan)


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        ({"kkt_residual": 2e-4}, "KKT residual 2.00e-04 is above 1.00e-04"),
        ({"kkt_residual": float("nan")}, "KKT residual nan"),
        ({"bound_violation_s": 1e-6}, "a bound is violated by 1.00e-06 s"),
        ({"bound_violation_s": float("nan")}, "a bound is violated"),
        ({"cross_check": "qp", "cross_check_gap": 2e-3}, "qp found an objective that is 2.00e-03 lower"),
        ({"cross_check": "qp", "cross_check_gap": float("nan")}, "qp found"),
    ],
)
def test_a_dwell_without_a_certificate_is_not_used(wrong: dict[str, float], says: str) -> None:
    with pytest.raises(ComputeError, match=says) as refused:
        require_certificate(replace(CERTIFICATE, **wrong), small_recipe())
    assert "nothing was sent" in str(refused.value)


@pytest.mark.parametrize("fine", [{}, {"kkt_residual": 1e-4}, {"cross_check": "qp", "cross_check_gap": -0.5}])
def test_a_valid_certificate(fine: dict[str, float]) -> None:
    require_certificate(replace(CERTIFICATE, **fine), small_recipe())


def test_all_that_is_wrong_is_reported() -> None:
    bad = replace(CERTIFICATE, kkt_residual=1.0, bound_violation_s=1.0)
    with pytest.raises(ComputeError, match=r"KKT residual .*; a bound is violated"):
        require_certificate(bad, small_recipe())


async def test_what_was_found_in_a_pass_stands_in_its_entry(job: Job, journal: Journal) -> None:
    plan = await planned(job, 0, await job.measured(0, small_map()))
    await run(job, 0, plan)
    await measure(job, 1, 2.0)
    journal.add_facts(0, {"findings": [{"kind": "wear", "what": "the rate fell", "stops": "cell"}]})
    assert [entry["found"] for entry in job.cycles()] == [["the rate fell"], []]
