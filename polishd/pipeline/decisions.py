"""What follows a measurement: one order of decisions for the daemon and for studies.

The first that fits holds: accept, diverge, tool worn, stalled, passes used, another pass (docs/cycle.md). So a stall on
the last pass that a job may make is a stall, and its part is put aside.
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
    """The surface is clearly worse than it has been."""

    outcome: Outcome = Outcome.DIVERGED


@dataclass(frozen=True, slots=True)
class ToolWorn:
    """The tool is no longer what plans count with: no pass is made with it until a person has seen to it."""

    why: str


@dataclass(frozen=True, slots=True)
class Stalled:
    """Passes bring so little that no more are made."""

    why: str
    outcome: Outcome = Outcome.STALLED


@dataclass(frozen=True, slots=True)
class PassesUsed:
    """All passes that the job may make are made."""

    outcome: Outcome


@dataclass(frozen=True, slots=True)
class AnotherPass:
    """The job goes on."""


Decision = Accept | Diverge | ToolWorn | Stalled | PassesUsed | AnotherPass


def corrects(recipe: Recipe) -> bool:
    """Return whether passes are to correct the surface, and not to be made as programmed, to teach."""
    return recipe.dwell.objective != AS_PROGRAMMED


def passes_used(recipe: Recipe) -> PassesUsed:
    """Return how a job ends whose passes are all made."""
    return PassesUsed(Outcome.CYCLES_USED if corrects(recipe) else Outcome.AS_PROGRAMMED)


def decide(
    recipe: Recipe,
    history: Sequence[float],
    surface: MeasureResult,
    findings: Sequence[Finding],
    passes_left: int,
) -> Decision:
    """Decide what follows a measurement, once its pass was learned from.

    A job that polishes as programmed, to teach, ends by its tool or when its passes are made, and not before.

    Args:
        recipe: the job's.
        history: RMS in nm of its earlier measurements (`Measured.figure_nm`), those before a torn pass left out.
        surface: the last measurement.
        findings: of the last pass.
        passes_left: that the job may still make.
    """
    teaches = not corrects(recipe)
    if not teaches and part_holds(surface.judged):
        return Accept()
    if not teaches and has_diverged(history, surface.figure_nm):
        return Diverge()
    if of_tool := [found.what for found in findings if found.stops == "cell"]:
        return ToolWorn("; ".join(of_tool))
    if not teaches and (stalls := [found.what for found in findings if found.kind == "stall"]):
        return Stalled("; ".join(stalls))
    return passes_used(recipe) if passes_left <= 0 else AnotherPass()


def worthless_pass(recipe: Recipe, forecast: Forecast | None) -> Finding | None:
    """Return why a pass that is planned will hardly leave the surface better than it is; None where it is made.

    ``forecast``: what the plan expects of it; None where nothing is expected.
    """
    if forecast is None or not corrects(recipe):
        return None
    return gain_too_small(forecast, recipe.finding)
