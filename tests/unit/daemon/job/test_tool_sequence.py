"""Several tools for one part on a cell in memory: order, requests for a change, and estimates of each."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from polishd.daemon.contact.interruption import settle_interrupted_pass
from polishd.daemon.contact.safety import ContactLimits
from polishd.daemon.job.tool_sequence import ToolStepState, mounted
from polishd.daemon.journal.records import PassRecord
from polishd.hookspecs import RemovalAnswer, RemovalModel, RemovalRequest
from polishd.model.errors import HandlingError, SafetyStop
from polishd.model.part_handling import BetweenPasses, HandlingStep
from polishd.model.process import ToolProcess
from polishd.model.states import Outcome
from polishd.pipeline.recipe import Recipe, ToolStep
from tests.unit.daemon.small_job import Bench, open_journal, small_program, small_recipe
from tests.unit.process.gaussian import spot_effect

WIDE_N = 20.0
WIDE_TRUTH = 0.8
"""True removal of the wide tool relative to its model; the narrow tool agrees with its model."""


def wide_effect(request: RemovalRequest) -> RemovalAnswer:
    """A spot twice as wide as the narrow one's, with the same rate at its middle."""
    program = request.program
    middle = (program.start_mm + program.end_mm) / 2
    effect = spot_effect(request.grid, middle, sigma_mm=3.0, rate_nm_s=20.0 * request.rate)
    return RemovalAnswer(effect, np.full(program.n, 1.3), np.full(program.n, 0.9), ("a wide spot",))


def wide(**changes: Any) -> Recipe:
    process = ToolProcess(dip_deg=0.0, force_n=WIDE_N)
    model = RemovalModel("wide", wide_effect)
    return small_recipe(process=process, model=model, turn=ToolStep("wide", 1, 0.0), **changes)


def narrow(passes: int = 1, **changes: Any) -> Recipe:
    return small_recipe(turn=ToolStep("narrow", passes, 0.0), **changes)


class TwoTools(Bench):
    """A cell with a wide and a narrow tool."""

    def truth_of(self, record: PassRecord) -> Recipe:
        if record.facts["tool"] != "wide":
            return narrow()
        return replace(wide(), model=RemovalModel("wide", lambda asked: wide_effect(replace(asked, rate=WIDE_TRUTH))))

    def job(self, wide_passes: int = 1, change: HandlingStep | None = None, **changes: Any) -> Any:
        between = BetweenPasses(change=change) if change else BetweenPasses()
        terms = {"part_handling": between, "tolerance_nm": 1e-6}
        first = replace(wide(**terms), turn=ToolStep("wide", wide_passes, 0.0))
        # The fake robot takes 1.5 mm for each block's length, and this tolerance would allow no time beyond the plan.
        contact = ContactLimits(force_n=12.0, rpm=1000.0, force_band=0.25, alarm_delay_s=0.3, excess_nm=5.0)
        turns = (
            ToolStepState(first, (small_program(),), replace(contact, force_n=WIDE_N)),
            ToolStepState(narrow(**terms), (small_program(),), contact),
        )
        job = super().job(**{"max_cycles": 2, "turns": turns, **changes})
        publish = job.publish
        job.publish = lambda event: (publish(event), self.journal.record_event(event))
        return job

    async def polish_by_hand(self, job: Any) -> tuple[Outcome, list[str]]:
        """Run the job to its end; the operator mounts each tool. Return the requests."""
        asked: list[str] = []
        while len(asked) < 9:
            try:
                return await self.polish(job), asked
            except HandlingError as error:
                asked.append(str(error))
        raise AssertionError(asked)


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[TwoTools]:
    with open_journal(tmp_path) as journal:
        yield TwoTools(tmp_path, journal)


def tools(bench: Bench) -> list[str]:
    return [record.facts["tool"] for record in bench.journal.passes]


@pytest.mark.full
async def test_each_tool_has_its_turn_with_its_own_force_and_is_asked_for_by_name(bench: TwoTools) -> None:
    outcome, asked = await bench.polish_by_hand(bench.job())
    assert outcome is Outcome.CYCLES_USED
    assert [line.split(".")[0] for line in asked] == [
        "change: mount the tool 'wide'",
        "change: mount the tool 'narrow'",
    ]
    assert tools(bench) == ["wide", "narrow"]
    assert bench.fake.of("actuator.set_force")[:3:2] == ["actuator.set_force 20", "actuator.set_force 12"]
    assert mounted(bench.journal) == "narrow"


@pytest.mark.full
async def test_the_first_pass_leaves_what_the_later_tool_does_better(bench: TwoTools) -> None:
    """One problem for both: the plan of the first pass expects more to be left than the joint one does."""
    job = bench.job()
    await bench.polish_by_hand(job)
    first, second = (record.facts for record in bench.journal.passes)
    (note,) = [one for one in first["certificate"]["notes"] if "after all" in one or "narrow" in one]
    assert "narrow" in note
    assert second["certificate"]["predicted_rms_nm"] < first["certificate"]["predicted_rms_nm"]
    after = [record.stats["rms_nm"] for record in bench.journal.history]
    assert after[2] < after[1] < after[0]


@pytest.mark.full
async def test_a_tool_that_is_mounted_is_not_asked_for_again(bench: TwoTools) -> None:
    await bench.polish_by_hand(bench.job())
    again = bench.job(max_cycles=3)
    assert again.tool == "wide", "a job is made with its first tool"
    await again.load()
    assert again.tool == "narrow", "and goes on with the one of its last pass"
    outcome, asked = await bench.polish_by_hand(again)
    assert (outcome, asked) == (Outcome.CYCLES_USED, [])
    assert tools(bench) == ["wide", "narrow", "narrow"], "the last tool goes on to the end"


@pytest.mark.full
async def test_what_a_pass_taught_of_one_tool_is_believed_of_that_tool_alone(bench: TwoTools) -> None:
    job = bench.job(wide_passes=2, max_cycles=3)
    await bench.polish_by_hand(job)
    rates = {record.cycle: record.facts["rate"] for record in bench.journal.passes}
    assert rates[0] == 1.0
    assert rates[1] == pytest.approx(WIDE_TRUTH, abs=0.1), "of the wide tool, from its first pass"
    assert rates[2] == 1.0, "nothing is known of the narrow one"
    restarted = bench.job(wide_passes=2, max_cycles=3)
    await restarted.load()
    assert restarted.tool == "narrow"
    restarted.tools.take_of(bench.journal.passes[0])
    job.tools.take_of(bench.journal.passes[0])
    assert restarted.tools.estimates.rate == pytest.approx(job.tools.estimates.rate)


@pytest.mark.full
async def test_a_pass_that_is_torn_off_is_made_again_with_its_tool(bench: TwoTools) -> None:
    job = bench.job(max_cycles=4)
    bench.fake.actuator.reads = lambda sample: replace(sample, force_n=60.0) if sample.force_n > 15 else sample
    with pytest.raises(HandlingError):
        await bench.polish(job)
    with pytest.raises(SafetyStop):
        await bench.polish(job)
    bench.fake.actuator.reads = lambda sample: sample
    await settle_interrupted_pass(bench.fake.cell, bench.journal)
    await bench.polish_by_hand(job)
    done = [(record.facts["tool"], record.how) for record in bench.journal.passes]
    assert done[0] == ("wide", "interrupted")
    assert done[1:3] == [("wide", "done"), ("narrow", "done")]


CHANGER = """
import os, pathlib
pathlib.Path({log!r}).open("a").write(os.environ["POLISHD_TOOL"] + "\\n")
raise SystemExit(int(pathlib.Path({broken!r}).exists()))
"""


@pytest.mark.full
async def test_a_command_changes_the_tool_and_is_run_again_where_it_failed(bench: TwoTools, tmp_path: Path) -> None:
    log, broken = tmp_path / "log", tmp_path / "broken"
    broken.touch()
    script = CHANGER.format(log=str(log), broken=str(broken))
    job = bench.job(change=HandlingStep(command=(sys.executable, "-c", script), timeout_s=60.0))
    with pytest.raises(HandlingError, match="change"):
        await bench.polish(job)
    assert not bench.fake.of("actuator.set_force"), "no force with an unknown tool"
    assert mounted(bench.journal) == ""
    broken.unlink()
    assert await bench.polish(job) is Outcome.CYCLES_USED
    assert log.read_text().split() == ["wide", "wide", "narrow"]
    (row, *_) = json.loads(json.dumps(job.summary()["cycles"]))
    assert row["tool"] == "wide"
