"""Each decision after a measurement, and which of several conditions decides."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import pytest

from polishd.model.dwell import AS_PROGRAMMED
from polishd.model.estimates import Finding
from polishd.model.states import Outcome
from polishd.model.tolerance import LineResult
from polishd.pipeline import steps
from polishd.pipeline.decisions import Accept, AnotherPass, Decision, Diverge, PassesUsed, Stalled, ToolWorn, decide
from polishd.pipeline.recipe import Recipe
from polishd.pipeline.records import MeasureResult
from tests.unit.daemon.small_job import small_map, small_recipe

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
    """Return the measurement with another RMS, judged against the tolerance."""
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
