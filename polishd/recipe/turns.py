"""A tool's turn in a solve step: alone, or one of several that have one problem."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from polishd.hookspecs import RemovalAnswer
from polishd.model.dwell import DwellSolution
from polishd.model.limits import Envelope
from polishd.model.program import Program
from polishd.model.surface import FloatArray
from polishd.process import motion
from polishd.process.dwell.problem import DwellProblem
from polishd.process.metrics import band_rms
from polishd.recipe.recipe import Recipe
from polishd.recipe.records import EstimatesInUse, MeasureResult
from polishd.recipe.steps import effect_of, envelope_of, initial_estimates


class ToolProblem(NamedTuple):
    """A tool's turn: with what recipe, along which program, and by what is believed of it (None: as at first)."""

    recipe: Recipe
    program: Program
    believed: EstimatesInUse | None = None


class DwellBounds(NamedTuple):
    """Time that the machine can give each timed point, (n,) s."""

    lower_s: FloatArray
    upper_s: FloatArray

    def raised(self, least_s: FloatArray) -> DwellBounds:
        """The lower one at least this, the upper one never below it."""
        lower = np.maximum(self.lower_s, least_s)
        return DwellBounds(lower, np.maximum(self.upper_s, lower))


class SolveRound(NamedTuple):
    """A solved problem, and what the machine makes of it."""

    problem: DwellProblem
    dwell: DwellSolution
    asked_s: FloatArray
    expected_s: FloatArray


@dataclass(frozen=True, slots=True)
class ToolSubproblem:
    """A tool's turn with its effect."""

    recipe: Recipe
    program: Program
    believed: EstimatesInUse
    answer: RemovalAnswer
    envelope: Envelope

    def least_s(self) -> FloatArray:
        """(n,) what motion takes at least."""
        return motion.least_time_s(self.program, self.envelope)

    def most_s(self) -> FloatArray:
        """(n,) at most."""
        return motion.most_time_s(self.program, self.envelope)

    def unasked_s(self) -> FloatArray:
        """(n,) what a point gets that is not written into the program."""
        if self.program.encoding == "dwell":
            return self.least_s()
        return np.full(self.program.n, self.envelope.block_overhead_s)

    def divide_by(self) -> FloatArray:
        """(n,) of "pointwise", else 1."""
        return np.ones(self.program.n) if self.answer.divide_by is None else self.answer.divide_by


def tool_subproblem(turn: ToolProblem, measured: MeasureResult) -> ToolSubproblem:
    """Of a turn and the surface that it finds."""
    believed = turn.believed or initial_estimates(turn.recipe)
    answer = effect_of(turn.recipe, turn.program, measured.grid, believed)
    return ToolSubproblem(turn.recipe, turn.program, believed, answer, envelope_of(turn.recipe, turn.program, believed))


def single_tool(
    found: SolveRound, removal_nm: FloatArray, left_nm: FloatArray, own: tuple[FloatArray, FloatArray, FloatArray]
) -> DwellSolution:
    """Of several tools' solution one's: its times and bounds, what it removes, and what is left after it."""
    time_s, lower_s, upper_s = own
    clear, grid = found.problem.metric_mask, found.problem.effect.grid
    residual = left_nm - left_nm[clear].mean()
    period, inside = found.problem.band_period_mm, residual[clear]
    certificate = replace(
        found.dwell.certificate,
        predicted_rms_nm=float(inside.std()),
        predicted_pv_nm=float(np.ptp(inside)),
        predicted_band_rms_nm=None if period is None else band_rms(residual, clear, grid.pitch_mm, period),
        dwell_total_s=float(time_s.sum()),
        at_lower=int(np.count_nonzero(time_s <= lower_s)),
        at_upper=int(np.count_nonzero(time_s >= upper_s)),
    )
    return DwellSolution(time_s, removal_nm, residual, certificate, lower_s, upper_s)


def with_certificate(dwell: DwellSolution, **changes: Any) -> DwellSolution:
    """The same solution; of its certificate those fields changed."""
    return replace(dwell, certificate=replace(dwell.certificate, **changes))


def with_note(dwell: DwellSolution, note: str) -> DwellSolution:
    """The same solution; its certificate says one thing more."""
    return with_certificate(dwell, notes=(*dwell.certificate.notes, note))
