"""The whole cycle on a cell in memory: what happens in which order, how it ends, and what stops it."""

from __future__ import annotations

import asyncio
import gc
import json
from collections.abc import AsyncIterator, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from polishd.hookspecs import DwellSolver
from polishd.model.devices import ActuatorTimes, ForceSample
from polishd.model.dwell import DwellSolution
from polishd.model.errors import (
    ComputeError,
    DeviceFault,
    LinkError,
    MapError,
    PlanRefused,
    RemovalCheckStop,
    SafetyStop,
    ToolStop,
)
from polishd.model.estimates import Finding
from polishd.model.events import FindingReported, PassStarted
from polishd.model.states import Outcome
from polishd.pipeline import steps
from polishd.process.dwell import newton_cg
from polishd.process.dwell.problem import DwellProblem
from tests.unit.daemon.contact.test_streaming_stream import time_passes
from tests.unit.daemon.small_job import (
    LIMITS,
    MOVES,
    Bench,
    as_map,
    open_journal,
    small_map,
    small_program,
    small_recipe,
)

SLOW = replace(LIMITS, excess_nm=1e6)
"""A robot may be as slow as it likes."""
SAFE = ["spindle.make_safe", "actuator.make_safe", "lifted", "robot.make_safe"]


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    with open_journal(tmp_path) as journal:
        yield Bench(tmp_path, journal)


def whole(cycle: int) -> list[str]:
    return [f"{cycle} {phase} done" for phase in ("measure", "learn", "solve", "plan", "run")]


# how it ends


async def test_a_part_is_polished_into_tolerance(bench: Bench) -> None:
    assert await bench.polish(bench.job(recipe=small_recipe(tolerance_nm=1.5))) is Outcome.IN_TOLERANCE
    history = bench.journal.history
    assert history[-1].stats["rms_nm"] <= 1.5 < 15 < history[0].stats["rms_nm"]
    runs = len(bench.journal.passes)
    assert bench.phases() == [line for cycle in range(runs) for line in whole(cycle)] + [
        f"{runs} measure done",
        f"{runs} learn done",
    ]
    assert bench.fake.metrology.afters == [None, *(record.sha256 for record in history[:-1])]


async def test_a_pass_in_time_order(bench: Bench) -> None:
    await bench.polish(bench.job(max_cycles=1))
    calls = bench.fake.of("metrology.next_map", "robot.prepare", "robot.resume", *MOVES[3:], "retract", "make_safe")
    first, last = int(small_program().block[0]), int(small_program().block[-1])
    assert calls == [
        "metrology.next_map",
        "robot.prepare",
        f"robot.resume {first}",
        "spindle.set_speed 1000",
        "actuator.set_force 12",
        f"robot.resume {last + 1}",
        "actuator.set_force 0",
        "actuator.retract",
        "spindle.set_speed 0",
        "robot.resume None",
        "metrology.next_map",
    ]


async def test_a_part_that_is_in_tolerance_is_not_touched(bench: Bench) -> None:
    assert await bench.polish(bench.job(recipe=small_recipe(tolerance_nm=50.0))) is Outcome.IN_TOLERANCE
    assert bench.fake.events == ["metrology.next_map"]
    assert bench.phases() == ["0 measure done", "0 learn done"]


async def test_no_figure_is_believed_of_a_map_that_the_gate_stops(bench: Bench) -> None:
    measure = bench.measure  # of an instrument whose maps are half as high: after a pass the part seems good enough
    bench.fake.metrology.measure = lambda: as_map(0.5 * measure().height_nm)
    seems_nm = 0.4 * steps.condition(small_recipe(), small_map(), None).stats.rms_nm
    with pytest.raises(RemovalCheckStop, match="times the predicted one"):
        await bench.polish(bench.job(recipe=small_recipe(tolerance_nm=seems_nm)))
    assert bench.journal.history[1].stats["rms_nm"] < seems_nm < bench.journal.history[0].stats["rms_nm"]


@pytest.mark.full
async def test_cycles_used_after_one_measurement_more_than_passes(bench: Bench) -> None:
    job = bench.job(recipe=small_recipe(tolerance_nm=1e-6), max_cycles=2)
    bench.rate = 0.9
    assert await bench.polish(job) is Outcome.CYCLES_USED
    assert [record.cycle for record in bench.journal.passes] == [0, 1]
    assert [record.cycle for record in bench.journal.history] == [0, 1, 2]
    assert bench.phases()[-1] == "2 learn done"


async def test_a_surface_that_gets_worse_ends_the_job(bench: Bench) -> None:
    measure, grid = bench.measure, small_map().grid
    scratches = [np.zeros(grid.shape), 30.0 * np.random.default_rng(5).standard_normal(grid.shape)]
    bench.fake.metrology.measure = lambda: as_map(measure().height_nm + scratches.pop(0))
    assert await bench.polish() is Outcome.DIVERGED
    assert bench.phases() == [*whole(0), "1 measure done", "1 learn done"]


async def test_another_tilt_in_each_map_ends_in_tolerance_all_the_same(bench: Bench) -> None:
    measure, x_mm = bench.measure, small_map().grid.x_mm
    tilts_nm = iter([4.0, -6.0, 10.0, -10.0])
    bench.fake.metrology.measure = lambda: as_map(measure().height_nm + next(tilts_nm) * x_mm / 20.0)
    assert await bench.polish(bench.job(recipe=small_recipe(tolerance_nm=1.5))) is Outcome.IN_TOLERANCE


async def test_a_pass_that_will_hardly_gain_is_not_made(bench: Bench) -> None:
    job = bench.job()
    job.tools.update_estimates(
        replace(job.tools.estimates, unexplained=9.0)
    )  # passes left nine times what they removed
    assert await bench.polish(job) is Outcome.STALLED
    assert not bench.journal.passes
    assert not bench.fake.of("robot.resume", "actuator.set_force")
    (found,) = [event for event in job.published if isinstance(event, FindingReported)]
    assert found.what.startswith("the next pass would leave ")
    assert found.what.endswith("it is not made. Take another tool, or tolerance, or a quieter map")
    assert (job.folder.cycle(0).path / "certificate.json").exists(), "for people, what was solved and not used"


async def test_a_pass_that_is_to_teach_is_made_whatever_the_map_says(bench: Bench) -> None:
    job = bench.job(recipe=small_recipe(tolerance_nm=50.0, objective="as_programmed"), max_cycles=1)
    assert await bench.polish(job) is Outcome.AS_PROGRAMMED, "although the part is in tolerance, and gets worse"
    (record,) = bench.journal.passes
    assert record.how == "done"
    assert "taught" in record.facts


async def test_what_a_pass_is_expected_to_leave_is_reported_and_kept(bench: Bench) -> None:
    job = bench.job(max_cycles=1)
    await bench.polish(job)
    (begun,) = [event for event in job.published if isinstance(event, PassStarted)]
    (record,) = bench.journal.passes
    assert begun.forecast == record.facts["forecast"]
    low, high = (record.facts["forecast"][key] for key in ("low_nm", "high_nm"))
    assert record.facts["shown"]["expected_nm"] == [low, high]
    assert 0.0 < low < high < record.facts["shown"]["before_nm"]
    entry, last = job.summary()["cycles"]
    assert (entry["expected_low_nm"], entry["expected_high_nm"]) == (low, high)
    assert last["expected_low_nm"] is None


# what is journalled


async def test_what_was_executed_is_journalled_not_what_was_asked(bench: Bench) -> None:
    job = bench.job(max_cycles=1, contact=SLOW)
    plain = bench.block_s
    bench.fake.robot.block_s = lambda block: plain(block) and plain(block) + 0.05
    await bench.polish(job)
    (record,) = bench.journal.passes
    blocks = bench.journal.executed(0)
    assert record.how == "done"
    assert list(blocks.seq) == list(range(record.contact_from, record.contact_to)), "each once, in order"
    assert blocks.contact.all()
    assert not blocks.recovered.any()
    assert job.executed_s(0).sum() > record.facts["dwell_s"] + 0.04 * small_program().n
    names = [event.name for event in job.published if event.name != "pass_progressed"]
    assert names == ["map_measured", "dwell_solved", "pass_started", "pass_ended", "map_measured", *names[5:]]


async def test_the_tool_stays_until_samples_cover_the_last_block(bench: Bench) -> None:
    """They come rarely here: all of the pass has run before the second one."""
    plain = bench.fake.actuator.samples

    async def rarely() -> AsyncIterator[ForceSample]:
        async for sample in plain():
            yield sample
            await asyncio.sleep(0.02)

    bench.fake.actuator.samples = rarely  # type: ignore[method-assign]
    await bench.polish(bench.job(max_cycles=1))
    assert bench.journal.executed(0).contact.all()


async def test_the_intent_is_durable_before_the_robot_moves(bench: Bench) -> None:
    known: list[int] = []
    bench.fake.robot.acts.before["resume"] = lambda: known.append(len(bench.journal.passes))
    await bench.polish(bench.job(max_cycles=1))
    assert known == [1, 1, 1]


@pytest.mark.full
async def test_the_rate_of_the_last_pass_is_used_in_the_next(bench: Bench) -> None:
    bench.rate = 0.8
    await bench.polish(bench.job(recipe=small_recipe(tolerance_nm=1e-6), max_cycles=2))
    assert bench.journal.passes[1].facts["rate"] == pytest.approx(0.8, rel=0.1)


# what is refused before anything moves


def bad_solver(**wrong: float) -> DwellSolver:
    def solve(problem: DwellProblem, within_s: float) -> DwellSolution:
        found = newton_cg.solve(problem, within_s)
        return replace(found, certificate=replace(found.certificate, **wrong))

    return DwellSolver("bad", solve)


async def test_a_dwell_without_a_certificate_moves_nothing(bench: Bench, tmp_path: Path) -> None:
    job = bench.job(recipe=small_recipe(solver=bad_solver(kkt_residual=0.5)))
    with pytest.raises(ComputeError, match="no valid certificate"):
        await bench.polish(job)
    assert bench.phases() == ["0 measure done", "0 learn done", "0 solve failed"]
    assert bench.moved() == []
    assert bench.journal.passes == ()
    assert (tmp_path / "run/cycle-00/certificate.json").exists(), "for people"


async def test_a_veto_moves_nothing(bench: Bench) -> None:
    with pytest.raises(PlanRefused, match="guard: too deep"):
        await bench.polish(bench.job(check_plan=lambda plan, envelope: ["guard: too deep"]))
    assert bench.phases()[-1] == "0 plan failed"
    assert bench.moved() == []
    assert bench.journal.passes == ()


async def test_a_map_that_is_refused_moves_nothing(bench: Bench) -> None:
    bench.fake.metrology.acts.fails["next_map"] = MapError("all holes")
    with pytest.raises(MapError):
        await bench.polish()
    assert bench.phases() == ["0 measure failed"]
    assert bench.moved() == []


async def test_an_implausible_rate_stops_before_the_next_pass(bench: Bench) -> None:
    bench.rate = 0.8
    with pytest.raises(RemovalCheckStop, match="max_rate_change"):
        await bench.polish(bench.job(recipe=small_recipe(max_rate_change=0.1)))
    assert bench.phases() == [*whole(0), "1 measure done", "1 learn failed"]


async def test_a_map_that_is_turned_over_stops_at_the_gate_and_leaves_what_it_compared(bench: Bench) -> None:
    measure = bench.measure
    bench.fake.metrology.measure = lambda: as_map(measure().height_nm[:, ::-1])
    job = bench.job()
    with pytest.raises(RemovalCheckStop, match=r"flipped left-right.*gate\.png"):
        await bench.polish(job)
    assert bench.phases() == [*whole(0), "1 measure done", "1 learn failed"]
    folder = bench.tmp_path / "run" / "cycle-01"
    (stopped,) = [event for event in job.published if event.name == "removal_check_failed"]
    assert stopped.data["cycle_dir"] == str(folder)
    verdict = json.loads((folder / "gate.json").read_text())
    assert verdict["stop"] == stopped.data["stop"]
    assert verdict["best"]["name"] == "flipped left-right"
    with np.load(folder / "gate.npz") as arrays:
        assert {"predicted_nm", "measured_nm", "explained_nm", "metric_mask", "pitch_mm"} <= set(arrays)
    assert not (folder / "learned.json").exists()


# what ends a pass


async def test_force_lost_in_contact(bench: Bench) -> None:
    """The tool leaves first; the journal says what was done; the pass has not ended."""
    lost = lambda s: replace(s, force_n=0.0) if bench.fake.robot.done > 100 else s  # noqa: E731
    bench.fake.actuator.reads = lost
    with pytest.raises(SafetyStop, match="force"):
        await bench.polish()
    assert bench.fake.events[-4:] == SAFE
    assert bench.phases()[-1] == "0 run failed"
    unfinished = bench.journal.unfinished()
    assert unfinished is not None
    assert bench.journal.tally(unfinished.cycle).last_seq == bench.fake.robot.done - 1


async def test_what_runs_while_the_tool_is_lifted_is_recorded_at_once(bench: Bench) -> None:
    """A lift takes 4 s here, and motion goes on: contact in those blocks is unknown."""
    left: list[int] = []
    bench.fake.robot.block_s = 0.5
    bench.fake.actuator.acts.before["make_safe"] = lambda: left.append(bench.fake.robot.done)
    bench.fake.actuator.reads = lambda s: replace(s, fault=4) if bench.fake.robot.done > 100 else s
    with pytest.raises(DeviceFault, match="fault bits"):
        await bench.polish(bench.job(contact=SLOW))
    blocks, done = bench.journal.executed(0), bench.fake.robot.done
    assert list(blocks.seq) == list(range(bench.journal.passes[0].contact_from, done)), "each once, to the last"
    assert done - left[0] >= 8, "they ran"
    assert (blocks.touched[blocks.seq < 100] == 1).all()
    assert np.isfinite(blocks.force_n[blocks.seq < 100]).all()
    after = blocks.touched[blocks.seq > left[0]]
    assert np.isnan(after).sum() >= 8
    assert not (after == 1).any()
    assert not blocks.recovered.any()
    ends = bench.journal.uncertain(0)[-1][1]
    assert left[0] + 8 <= ends <= done + 1, "until the tool was up"
    rows = (bench.tmp_path / "run/cycle-00/executed.csv").read_text().splitlines()
    assert len(rows) - 1 - blocks.seq.size == max(ends - done, 0), "the one that the robot stands in, too"


async def test_where_the_robot_takes_the_tool_off_its_landing_point_the_first_block_is_uncertain(bench: Bench) -> None:
    """The actuator falls silent on its way to the part: what the robot moves then, it moves in the first block."""
    actuator = bench.fake.actuator
    actuator.times = ActuatorTimes(silence_s=0.02)
    actuator.acts.before["set_force"] = lambda: setattr(actuator, "silent", True)
    actuator.acts.fails["make_safe"] = LinkError("no answer")
    bench.fake.robot.acts.before["lift"] = lambda: bench.fake.clock.advance(0.5)
    with pytest.raises(LinkError, match="no sample"):
        await bench.polish()
    assert "robot.lift 15" in bench.fake.events
    (record,) = bench.journal.passes
    assert record.uncertain == (record.contact_from, record.contact_from + 1)


async def test_a_robot_that_says_no_more_leaves_a_bound(bench: Bench) -> None:
    """Its link is lost: marked is what the tool can have reached until it was up, and not the rest of the program."""
    bench.fake.robot.block_s = 0.5
    cut = lambda: bench.fake.robot.acts.fails.update({"progress": LinkError("gone")})  # noqa: E731
    bench.fake.actuator.acts.before["make_safe"] = lambda: (cut(), setattr(bench.fake.robot, "stands", True))
    bench.fake.actuator.reads = lambda s: replace(s, fault=4) if bench.fake.robot.done > 100 else s
    with pytest.raises(LinkError, match="gone"):
        await bench.polish(bench.job(contact=SLOW))
    (record,) = bench.journal.passes
    assert record.uncertain is not None
    first, end = record.uncertain
    assert first == bench.journal.tally(0).last_seq + 1
    # 4 s of lift, and 1.5 s by which its last word may have been late; blocks are written to take less than 0.5 s
    assert 0.5 * (end - first) >= 5.5
    assert end < record.contact_to
    assert record.ended_s is None, "the next start asks the robot"


async def test_a_low_speed_override_begins_no_pass(bench: Bench) -> None:
    bench.fake.robot.override = 0.5
    job = bench.job(contact=replace(LIMITS, least_override=0.95))
    with pytest.raises(DeviceFault, match=r"override is 50%, at least 95% .*robot\.least_override.* no pass was begun"):
        await bench.polish(job)
    assert not bench.journal.passes
    assert not bench.fake.of("robot.resume", "actuator.set_force")


async def test_a_robot_that_says_it_runs_and_stands_leaves_contact_in_order(bench: Bench) -> None:
    bench.fake.robot.lies = True
    bench.fake.robot.before_block = lambda: stand(bench)
    task = asyncio.ensure_future(bench.polish())
    await time_passes(bench.fake, 60.0, task)
    with pytest.raises(SafetyStop, match=r"robot does not advance: block \d+ expected \d\.\d\d s, no progress for"):
        await task
    assert bench.fake.events[-4:] == SAFE


async def stand(bench: Bench) -> None:
    """From the thirtieth block on."""
    await asyncio.sleep(0)
    bench.fake.robot.stands = bench.fake.robot.done >= 30


async def test_the_feeder_dies_in_contact(bench: Bench) -> None:
    bench.fake.robot.acts.before["send"] = lambda: bench.fake.robot.acts.fails.update(
        {"send": LinkError("cut")} if bench.fake.robot.done > 5 else {}
    )
    with pytest.raises(LinkError, match="cut"):
        await bench.polish()
    assert bench.fake.events[-4:] == SAFE


async def test_a_program_that_the_robot_drops_in_contact(bench: Bench) -> None:
    bench.fake.robot.ends_at = 60
    with pytest.raises(DeviceFault, match="ended the program at block 60"):
        await bench.polish()
    assert bench.fake.events[-4:] == SAFE


async def test_a_journal_that_cannot_keep_up_with_the_truth_ends_contact(bench: Bench) -> None:
    job = bench.job()
    job.executed = lambda cycle, block: (_ for _ in ()).throw(SafetyStop("the journal is lost"))
    with pytest.raises(SafetyStop, match="journal is lost"):
        await bench.polish(job)
    assert bench.fake.events[-4:] == SAFE


async def test_cancelled_in_contact(bench: Bench) -> None:
    task = asyncio.ensure_future(bench.polish())
    job_events = bench.fake.events
    while bench.fake.robot.done < 100:  # noqa: ASYNC110  pytest's timeout is the limit
        await asyncio.sleep(0)
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await task
    assert job_events[-4:] == SAFE
    assert bench.phases()[-1] == "0 run cancelled"
    assert bench.journal.unfinished() is not None


async def test_the_spindle_that_will_not_stop_fails_the_run_but_the_tool_is_off(bench: Bench) -> None:
    bench.fake.spindle.acts.before["set_speed"] = lambda: bench.fake.spindle.acts.fails.update(
        {"set_speed": DeviceFault("spindle: runs on")} if "actuator.retract" in bench.fake.events else {}
    )
    with pytest.raises(DeviceFault, match="runs on"):
        await bench.polish()
    assert bench.fake.actuator.retracted
    assert bench.journal.passes[0].how is None


# links


async def test_a_link_that_was_lost_out_of_contact_is_opened_again_before_the_run(bench: Bench) -> None:
    acts = bench.fake.spindle.acts
    acts.fails["status"] = LinkError("sleeping")
    acts.before["open"] = acts.fails.clear
    await bench.polish(bench.job(max_cycles=1))
    calls = bench.fake.of("spindle.close", "spindle.open", "spindle.make_safe", "robot.prepare")
    assert calls == ["spindle.close", "spindle.open", "spindle.make_safe", "robot.prepare"]


async def test_a_link_that_stays_lost_moves_nothing(bench: Bench) -> None:
    bench.fake.spindle.acts.fails |= {"status": LinkError("sleeping"), "open": LinkError("no answer")}
    with pytest.raises(LinkError, match="no answer"):
        await bench.polish()
    assert bench.moved() == []
    assert bench.journal.passes == ()


@pytest.mark.full
async def test_garbage_is_searched_for_in_little_while_the_tool_presses(bench: Bench) -> None:
    frozen: list[int] = []
    for call in ("set_force", "retract"):
        bench.fake.actuator.acts.before[call] = lambda: frozen.append(gc.get_freeze_count())
    await bench.polish(bench.job(recipe=small_recipe(tolerance_nm=1.5)))
    assert min(frozen) > 10_000
    assert gc.get_freeze_count() == 0


# what passes show


@pytest.mark.full
async def test_passes_that_bring_nothing_end_the_job(bench: Bench) -> None:
    job = bench.job(recipe=small_recipe(tolerance_nm=1e-6), max_cycles=9)
    assert await bench.polish(job) is Outcome.STALLED
    assert [event.kind for event in job.published if isinstance(event, FindingReported)] == ["stall"]
    assert len(bench.journal.passes) < 9


@pytest.mark.full
async def test_a_worn_tool_waits_for_a_person_who_may_go_on_with_it(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    worn = Finding("wear", "the rate fell", "cell")
    found = [(worn,), ()]
    monkeypatch.setattr("polishd.daemon.job.job.watch", lambda *_: found.pop(0))
    job = bench.job(recipe=small_recipe(tolerance_nm=1e-6), max_cycles=2)
    with pytest.raises(ToolStop, match="the rate fell"):
        await bench.polish(job)
    assert len(bench.journal.passes) == 1
    assert [event.stops for event in job.published if isinstance(event, FindingReported)] == ["cell"]
    bench.fake.metrology.measure = lambda: as_map(bench.measure().height_nm + 1e-6)
    monkeypatch.setattr("polishd.daemon.job.job.watch", lambda *_: ())
    assert await bench.polish(job) is Outcome.CYCLES_USED


async def test_a_part_in_tolerance_is_accepted_by_a_worn_tool_too(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    worn = Finding("wear", "the rate fell", "cell")
    monkeypatch.setattr("polishd.daemon.job.job.watch", lambda *_: (worn,))
    job = bench.job(recipe=small_recipe(tolerance_nm=5.0))
    assert await bench.polish(job) is Outcome.IN_TOLERANCE
    assert job.findings == (worn,), "the next job starts with them"
