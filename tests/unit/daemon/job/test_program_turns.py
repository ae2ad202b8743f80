"""Programs that take turns from pass to pass, on a cell in memory: order, interruption, restart and estimates."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from polishd.daemon.contact.interruption import settle_interrupted_pass
from polishd.daemon.contact.safety import ContactLimits
from polishd.daemon.job.tool_sequence import ToolStepState
from polishd.daemon.journal.records import PassRecord
from polishd.model.errors import SafetyStop
from polishd.model.events import PassStarted
from polishd.model.program import Program
from polishd.model.states import Outcome
from polishd.model.surface import FloatArray
from polishd.pipeline.recipe import ToolStep
from polishd.plugins.rnc_robot.formats import path_program
from polishd.process.toolpath.apertures import circle
from polishd.process.toolpath.paths import raster
from tests.rs274 import RS274
from tests.unit.daemon.small_job import (
    APERTURE_MM,
    Bench,
    open_journal,
    record_warm_starts,
    small_program,
    small_recipe,
)

TRUTH = 0.8
"""True removal of the tool relative to its model."""
CONTACT = ContactLimits(force_n=12.0, rpm=1000.0, force_band=0.25, alarm_delay_s=0.3, excess_nm=1e3)


def shifted(phase: float) -> Program:
    """The small raster with its lines shifted by that part of their distance."""
    points = raster(circle(APERTURE_MM + 2), 1.5, 1.5, phase=phase)
    axes = np.tile([0.0, 0.0, 1.0], (len(points), 1))
    return RS274.read(path_program(points, axes, 900.0, "small"), f"phase-{phase:g}.rnc")


PROGRAMS = small_program(), shifted(0.5), shifted(0.25)


class Turns(Bench):
    """A cell with two programs, whose part is polished along the one of each pass."""

    programs: tuple[Program, ...] = PROGRAMS[:2]

    def program_of(self, record: PassRecord) -> Program:
        """The program whose lines the stored plan has: independent of what the pass says of itself."""
        lines = lines_of(self.journal.arrays.get(record.plan)["end_mm"])
        return next(one for one in PROGRAMS if np.array_equal(lines_of(one.end_mm), lines))

    def job(self, **changes: Any) -> Any:
        turns = (ToolStepState(small_recipe(tolerance_nm=1e-6), self.programs, CONTACT),)
        job = super().job(**{"turns": turns, "max_cycles": 3, **changes})
        job.pass_not_worthwhile = lambda cycle: False
        return job

    def ran(self) -> list[tuple[str, int, str, str | None]]:
        """Program by its lines, number and name in the journal, and end of each pass."""
        return [
            (self.program_of(one).name, one.facts["program"]["number"], one.facts["program"]["name"], one.how)
            for one in self.journal.passes
        ]


def lines_of(end_mm: FloatArray) -> FloatArray:
    return np.unique(np.round(end_mm[:, 1], 3))


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Turns]:
    with open_journal(tmp_path) as journal:
        yield Turns(tmp_path, journal, rate=TRUTH)


def cut_off(bench: Turns, in_pass: int) -> Callable[[], None]:
    """Press too hard in the pass of that number, from 0, until the returned function is called."""
    reads = bench.fake.actuator.reads

    def pressed(sample: Any) -> Any:
        there = len(bench.journal.passes) == in_pass + 1
        return replace(sample, force_n=60.0) if there and sample.force_n > 5 else sample

    bench.fake.actuator.reads = pressed
    return lambda: setattr(bench.fake.actuator, "reads", reads)


@pytest.mark.one_of_each
async def test_each_pass_has_the_program_whose_turn_it_is(bench: Turns) -> None:
    job = bench.job()
    assert await bench.polish(job) is Outcome.CYCLES_USED
    first, second = "small.rnc", "phase-0.5.rnc"
    assert bench.ran() == [(first, 1, first, "done"), (second, 2, second, "done"), (first, 1, first, "done")]
    rows = job.cycles()
    assert [row["program"] for row in rows] == [first, second, first, None]
    started = [event.data["program"] for event in job.published if isinstance(event, PassStarted)]
    assert started == [first, second, first]
    for cycle, program in enumerate((PROGRAMS[0], PROGRAMS[1], PROGRAMS[0])):
        written = (bench.tmp_path / "run" / f"cycle-{cycle:02d}" / "program.rnc").read_bytes()
        assert np.array_equal(lines_of(RS274.read(written, "written").end_mm), lines_of(program.end_mm))


async def test_a_pass_teaches_the_pass_of_the_other_program(bench: Turns) -> None:
    """The removal of each pass is compared along its own program: with the other one it would not explain the maps."""
    await bench.polish(bench.job())
    rates = [one.facts["rate"] for one in bench.journal.passes]
    assert rates[0] == 1.0
    assert rates[1:] == pytest.approx([TRUTH, TRUTH], rel=0.02)
    unexplained = json.loads((bench.tmp_path / "run" / "cycle-02" / "learned.json").read_text())["beliefs"]
    assert unexplained["unexplained"] < 0.05


@pytest.mark.full
async def test_an_interrupted_pass_is_repeated_with_its_program_also_by_a_new_daemon(bench: Turns) -> None:
    mend = cut_off(bench, in_pass=1)
    with pytest.raises(SafetyStop):
        await bench.polish(bench.job())
    mend()
    await settle_interrupted_pass(bench.fake.cell, bench.journal)
    again = bench.job()
    assert again.program is PROGRAMS[0], "a job is made with its first program"
    await again.load()
    assert again.program is PROGRAMS[1], "and goes on with that of its last pass"
    assert await bench.polish(again) is Outcome.CYCLES_USED
    first, second = "small.rnc", "phase-0.5.rnc"
    assert bench.ran() == [
        (first, 1, first, "done"),
        (second, 2, second, "interrupted"),
        (second, 2, second, "done"),
        (first, 1, first, "done"),
    ]


@pytest.mark.full
async def test_a_program_starts_no_solver_where_another_one_ended(
    bench: Turns, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Only the repeated pass has the points of the pass before it."""
    starts = record_warm_starts(monkeypatch)
    mend = cut_off(bench, in_pass=1)
    job = bench.job()
    with pytest.raises(SafetyStop):
        await bench.polish(job)
    mend()
    await settle_interrupted_pass(bench.fake.cell, bench.journal)
    await bench.polish(job)
    assert [start is not None for start in starts] == [False, False, True, False]


@pytest.mark.full
async def test_three_programs_come_round(bench: Turns) -> None:
    bench.programs = PROGRAMS
    await bench.polish(bench.job(max_cycles=4))
    assert [number for _, number, *_ in bench.ran()] == [1, 2, 3, 1]


async def test_each_tool_counts_its_own_passes(bench: Turns) -> None:
    recipe = small_recipe(tolerance_nm=1e-6)
    turns = tuple(
        ToolStepState(replace(recipe, turn=ToolStep(name, 3, 0.0)), programs, CONTACT)
        for name, programs in (("wide", PROGRAMS[:2]), ("narrow", PROGRAMS[1:]))
    )
    job = bench.job(turns=turns)
    bench.journal.begin_pass(
        0, "0" * 64, "boot", 1, contact=(0, 1), facts={"tool": "wide"}, plan="", start="", reach_s=0
    )
    bench.journal.end_pass(0, "done")
    job.tools.take()
    assert (job.tool, job.program.name) == ("wide", "phase-0.5.rnc")
    assert [one.program.name for one in job.tools.to_solve()] == ["phase-0.5.rnc", "phase-0.5.rnc"]
    for cycle in (1, 2, 3):
        tool = "wide" if cycle < 3 else "narrow"
        bench.journal.begin_pass(
            cycle, "0" * 64, "boot", 1, contact=(0, 1), facts={"tool": tool}, plan="", start="", reach_s=0
        )
        bench.journal.end_pass(cycle, "done")
    job.tools.take()
    assert (job.tool, job.program.name) == ("narrow", "phase-0.25.rnc")


async def test_one_program_leaves_no_word_of_turns(bench: Turns) -> None:
    bench.programs = PROGRAMS[:1]
    job = bench.job(max_cycles=1)
    await bench.polish(job)
    (record,) = bench.journal.passes
    assert "program" not in record.facts
    assert all("program" not in row for row in job.cycles())
