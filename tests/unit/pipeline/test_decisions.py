"""What follows a measurement: one order, and the daemon and a study decide alike on the same histories."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from polishd.daemon.job.job import watch
from polishd.model.dwell import AS_PROGRAMMED
from polishd.model.estimates import Estimate, Finding, PassIndicators, PassSeries
from polishd.model.states import Outcome
from polishd.model.tolerance import LineResult
from polishd.pipeline import steps
from polishd.pipeline.decisions import Accept, AnotherPass, Decision, Diverge, PassesUsed, Stalled, ToolWorn, decide
from polishd.pipeline.recipe import Recipe
from polishd.pipeline.records import MeasureResult
from polishd.process.identification.findings import extend_series, findings
from polishd.studies.closed_loop import decision_of
from tests.unit.daemon.small import open_journal, small_job, small_map, small_recipe

STALL = Finding("stall", "too little", "job")
WEAR = Finding("wear", "the rate fell", "cell")
TOLERANCE_NM = 0.5


@pytest.fixture(scope="module")
def recipe() -> Recipe:
    return small_recipe(tolerance_nm=TOLERANCE_NM)


@pytest.fixture(scope="module")
def measured(recipe: Recipe) -> MeasureResult:
    return steps.condition(recipe, small_map())


def at(measured: MeasureResult, rms_nm: float) -> MeasureResult:
    """The same surface at another RMS, and whether that is in tolerance."""
    judged = (LineResult("RMS", rms_nm, TOLERANCE_NM, "nm"),)
    return replace(measured, stats=replace(measured.stats, rms_nm=rms_nm), judged=judged)


@pytest.mark.parametrize(
    ("history", "rms_nm", "found", "left", "decision"),
    [
        ((), 0.4, (WEAR, STALL), 0, Accept()),
        ((2.0,), 9.0, (WEAR, STALL), 0, Diverge()),
        ((9.0,), 8.0, (STALL, WEAR), 0, ToolWorn("the rate fell")),
        ((9.0,), 8.0, (STALL,), 0, Stalled("too little")),
        ((9.0,), 8.0, (STALL,), 2, Stalled("too little")),
        ((9.0,), 8.0, (), 0, PassesUsed(Outcome.CYCLES_USED)),
        ((9.0,), 8.0, (), 1, AnotherPass()),
        ((), 8.0, (), 1, AnotherPass()),
    ],
)
def test_the_first_that_fits_holds(
    recipe: Recipe,
    measured: MeasureResult,
    history: Sequence[float],
    rms_nm: float,
    found: Sequence[Finding],
    left: int,
    decision: Decision,
) -> None:
    assert decide(recipe, history, at(measured, rms_nm), found, left) == decision


@pytest.mark.parametrize(
    ("rms_nm", "found", "left", "decision"),
    [
        (0.4, (), 1, AnotherPass()),
        (90.0, (STALL,), 1, AnotherPass()),
        (90.0, (STALL,), 0, PassesUsed(Outcome.AS_PROGRAMMED)),
        (90.0, (WEAR,), 1, ToolWorn("the rate fell")),
    ],
)
def test_a_job_that_teaches_ends_when_its_passes_are_made(
    measured: MeasureResult, rms_nm: float, found: Sequence[Finding], left: int, decision: Decision
) -> None:
    teaches = small_recipe(tolerance_nm=TOLERANCE_NM, objective=AS_PROGRAMMED)
    assert decide(teaches, (2.0,), at(measured, rms_nm), found, left) == decision


def histories(count: int) -> list[tuple[int, list[float], list[PassIndicators]]]:
    """Passes that a job may make, RMS in nm of each measurement, and what each pass shows."""
    draw = np.random.default_rng(37)
    found = []
    for _ in range(count):
        passes = int(draw.integers(1, 6))
        figures, shown = [float(draw.uniform(0.3, 20.0))], []
        gain, rate = draw.choice([0.02, 0.5, 0.9]), 1.0
        for _ in range(passes):
            before = figures[-1]
            after = before * float(draw.choice([1.0 - gain, 1.0 - gain * draw.uniform(), draw.uniform(0.9, 1.5)]))
            rate *= float(draw.choice([1.0, 1.0, 1.0, 0.6]))
            figures.append(after)
            promised = before * (1.0 - gain)
            shown.append(
                PassIndicators(before, promised, after, None, 600.0, Estimate(rate, 0.01), Estimate(0.0, 0.02), None)
            )
        found.append((passes, figures, shown))
    return found


def of_daemon(
    folder: Path, recipe: Recipe, surfaces: Sequence[MeasureResult], shown: Sequence[PassIndicators], passes: int
) -> list[Decision]:
    """A job's decisions by its journal, until one ends it."""
    said: list[Decision] = []
    folder.mkdir()
    with open_journal(folder) as journal:
        job = small_job(folder, journal, recipe=recipe)
        job.max_cycles = passes
        for cycle, surface in enumerate(surfaces):
            journal.record_map(cycle, f"map {cycle}", "x", surface.facts())
            job.findings = watch(journal, cycle - 1, shown[cycle - 1], recipe.finding) if cycle else ()
            said.append(job.decide(cycle, surface))
            if said[-1] != AnotherPass():
                break
            journal.begin_pass(cycle, "sha", "boot", 3)
            journal.end_pass(cycle, "done")
    return said


def of_study(
    recipe: Recipe, surfaces: Sequence[MeasureResult], shown: Sequence[PassIndicators], passes: int
) -> list[Decision]:
    """A closed loop's decisions, until one ends it."""
    said, series = list[Decision](), PassSeries("")
    for cycle, surface in enumerate(surfaces):
        found: tuple[Finding, ...] = ()
        if cycle:
            series = extend_series(series, shown[cycle - 1])
            found = findings(series, shown[:cycle], recipe.finding)
        rms_nm = [one.figure_nm for one in surfaces[: cycle + 1]]
        said.append(decision_of(recipe, surface, rms_nm, found, passes))
        if said[-1] != AnotherPass():
            break
    return said


def test_the_daemon_and_a_study_decide_alike_on_the_same_histories(
    tmp_path: Path, recipe: Recipe, measured: MeasureResult
) -> None:
    ends = set()
    for number, (passes, figures, shown) in enumerate(histories(60)):
        surfaces = [at(measured, rms_nm) for rms_nm in figures]
        daemon = of_daemon(tmp_path / str(number), recipe, surfaces, shown, passes)
        assert daemon == of_study(recipe, surfaces, shown, passes), (passes, figures)
        ends.add((type(daemon[-1]), len(daemon) == passes + 1))
    last = {(kind, True) for kind in (Accept, Diverge, ToolWorn, Stalled, PassesUsed)}
    assert last <= ends, "each of them after the last pass, too"
