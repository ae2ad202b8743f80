"""Decision after a measurement: one function for the daemon's cycle and for the closed loops of studies.

The first condition that holds decides:

1. `Accept`. The part is finished. No later condition can make it worse, and a pass could.
2. `Diverge`. The last pass damaged the surface. The part is rejected also where the tool is the cause: the daemon
   reports the finding about the tool, and the queue stops over it (`polishd.daemon.queue.queue.judge`).
3. `ToolWorn`. The next part would get the same tool, so an unattended cell stops for an operator. This comes before
   all ends that let the queue go on with the next part.
4. `Stalled`. Passes remove less error than planned, for a cause that an operator can find: the part is set aside. This
   comes before `PassesUsed`, so that a stall on the last allowed pass does not reject the part.
5. `PassesUsed`. The job may make no more passes.
6. `AnotherPass`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from polishd.model.dwell import AS_PROGRAMMED
from polishd.model.estimates import Finding
from polishd.model.states import Outcome
from polishd.model.tolerance import part_holds
from polishd.pipeline.recipe import Recipe
from polishd.pipeline.records import MeasureResult
from polishd.process.identification.findings import Forecast, gain_too_small, has_diverged


@dataclass(frozen=True, slots=True)
class Accept:
    """All lines of the tolerance hold."""

    outcome: Outcome = Outcome.IN_TOLERANCE


@dataclass(frozen=True, slots=True)
class Diverge:
    """The surface is significantly worse than the best one so far."""

    outcome: Outcome = Outcome.DIVERGED


@dataclass(frozen=True, slots=True)
class ToolWorn:
    """The tool removes otherwise than planned: an operator checks it before the next pass."""

    why: str


@dataclass(frozen=True, slots=True)
class Stalled:
    """Passes reduce the error too little to make more of them."""

    why: str
    outcome: Outcome = Outcome.STALLED


@dataclass(frozen=True, slots=True)
class PassesUsed:
    """The job has made all passes that it may make."""

    outcome: Outcome


@dataclass(frozen=True, slots=True)
class AnotherPass:
    """The job makes another pass."""


Decision = Accept | Diverge | ToolWorn | Stalled | PassesUsed | AnotherPass


def corrects(recipe: Recipe) -> bool:
    """Return whether passes correct the surface; False where they run as programmed, to measure the process."""
    return recipe.dwell.objective != AS_PROGRAMMED


def passes_used(recipe: Recipe) -> PassesUsed:
    """Return the end of a job that has made all its passes."""
    return PassesUsed(Outcome.CYCLES_USED if corrects(recipe) else Outcome.AS_PROGRAMMED)


def decide(
    recipe: Recipe,
    history: Sequence[float],
    surface: MeasureResult,
    findings: Sequence[Finding],
    passes_left: int,
) -> Decision:
    """Decide what the job does after a measurement and after the estimates of its last pass are updated.

    A job that polishes as programmed ends when its tool is worn or its passes are used, and for no other cause.

    Args:
        recipe: of the job.
        history: RMS of the earlier measurements, nm (`MeasureResult.figure_nm`), without those before a pass that was
            cut off.
        surface: the last measurement.
        findings: of the last pass.
        passes_left: number of passes that the job may still make.
    """
    correcting = corrects(recipe)
    if correcting and part_holds(surface.judged):
        return Accept()
    if correcting and has_diverged(history, surface.figure_nm):
        return Diverge()
    if worn := [found.what for found in findings if found.stops == "cell"]:
        return ToolWorn("; ".join(worn))
    if correcting and (stalls := [found.what for found in findings if found.kind == "stall"]):
        return Stalled("; ".join(stalls))
    return passes_used(recipe) if passes_left <= 0 else AnotherPass()


def small_gain_finding(recipe: Recipe, forecast: Forecast | None) -> Finding | None:
    """Return a finding where the planned pass will hardly reduce the error; None where the job makes the pass.

    ``forecast``: of the planned pass; None where the plan has none.
    """
    if forecast is None or not corrects(recipe):
        return None
    return gain_too_small(forecast, recipe.finding)


EVEN = 0.5
"""Probability of a better surface, below which a pass probably makes it worse."""


def purpose_notes(recipe: Recipe, measured: MeasureResult, forecast: Forecast | None) -> list[str]:
    """Describe why a plan is not worth its pass: the part is in tolerance, or the pass will not improve it."""
    if not corrects(recipe):
        return []
    notes = []
    if part_holds(measured.judged):
        notes.append(f"already in tolerance ({'; '.join(map(str, measured.judged))}): run makes no pass")
    if forecast is not None and forecast.better < EVEN:
        now_nm = measured.stats.rms_nm
        notes.append(f"this pass makes it worse: {now_nm:.2f} nm RMS now, {forecast.words} expected after it")
    elif found := small_gain_finding(recipe, forecast):
        notes.append(found.what)
    return notes
