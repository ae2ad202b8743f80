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
from polishd.pipeline.decisions import (
    Accept,
    AnotherPass,
    Decision,
    Diverge,
    PassesUsed,
    Stalled,
    ToolWorn,
    decide,
    purpose_notes,
)
from polishd.pipeline.recipe import Recipe
from polishd.pipeline.records import MeasureResult
from polishd.process.identification.findings import Forecast
from polishd.process.removal.ripple import NO_RIPPLE
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


GOOD, POOR, WORSE = (Forecast(0.6, 0.64, 0.7, 0.9, better) for better in (0.99, 0.04, 0.4))


@pytest.mark.parametrize(
    ("rms_nm", "forecast", "starts"),
    [
        (0.6, GOOD, []),
        (0.6, None, []),
        (0.4, GOOD, ["already in tolerance (RMS 0.4 nm of 0.5 nm allowed): run makes no pass"]),
        (
            0.4,
            WORSE,
            ["already in tolerance (", "this pass makes it worse: 0.40 nm RMS now, 0.60 to 0.70 nm (90 %) exp"],
        ),
        (0.6, POOR, ["this pass makes it worse: 0.60 nm RMS now, "]),
        (
            0.6,
            replace(GOOD, ripple=NO_RIPPLE, gain_nm=-0.1),
            ["the next pass would gain -0.10 nm RMS and add a ripple"],
        ),
    ],
)
def test_a_plan_that_is_not_worth_its_pass_says_so(
    recipe: Recipe, measured: MeasureResult, rms_nm: float, forecast: Forecast | None, starts: list[str]
) -> None:
    notes = purpose_notes(recipe, at(measured, rms_nm), forecast)
    assert len(notes) == len(starts)
    assert all(note.startswith(start) for note, start in zip(notes, starts, strict=True)), notes


def test_a_plan_that_teaches_need_not_improve_the_part(measured: MeasureResult) -> None:
    teaches = small_recipe(tolerance_nm=TOLERANCE_NM, objective=AS_PROGRAMMED)
    assert purpose_notes(teaches, at(measured, 0.4), WORSE) == []
