"""Figures of a plan, as an operator approves them, with the limits of machine and process beside them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from polishd.model.program import Plan
from polishd.pipeline.acceptance import ripple_notes
from polishd.pipeline.recipe import Recipe
from polishd.pipeline.records import MeasureResult, PlanResult, SolveResult

NM_MM2_PER_MM3 = 1e6
AXES = ("x", "y", "z")


@dataclass(frozen=True, slots=True)
class PlanLimit:
    """A figure of a plan, and the limit from the config that it keeps."""

    key: str
    """Config key of the limit."""
    value: float
    limit: float
    unit: str
    least: bool = False
    """The limit is a minimum, else a maximum."""


@dataclass(frozen=True, slots=True)
class PlanFigures:
    """Figures of one plan. RMS is of the clear aperture; null: unknown."""

    before_rms_nm: float
    """RMS of the map for which the pass was planned."""
    predicted_rms_nm: float
    """RMS that the plan leaves, with the ripple that the process grid averages away."""
    predicted_pv_nm: float
    """PV on the process grid."""
    expected_nm: tuple[float, float] | None
    """Interval of the next map's RMS."""
    level: float | None
    """Probability of that interval."""
    better: float | None
    """Probability that the next map is better than the last one."""
    ripple_rms_nm: float | None
    """RMS of the pattern that the path leaves, as modeled."""
    ripple_rms_high_nm: float | None
    """The same with a spot whose radius is off."""
    ripple: str
    """Largest harmonic of the pattern; empty: unknown, or none."""
    removal_mean_nm: float
    """Mean removal in the clear aperture."""
    removal_max_nm: float
    """Largest removal anywhere on the process grid."""
    removal_mm3: float
    """Removed volume in the clear aperture."""
    dwell_s: float
    """Expected process time."""
    points: int
    """Number of timed points."""
    points_at_least_time: int
    """Points at which the machine cannot be faster."""
    force_n: float
    rpm: float
    limits: tuple[PlanLimit, ...]
    notes: tuple[str, ...]
    """Warnings of program, solver and path."""

    def facts(self) -> dict[str, Any]:
        """Return the figures for journal and events."""
        return asdict(self)


def plan_figures(
    recipe: Recipe, measured: MeasureResult, solved: SolveResult, plan: Plan, planned: PlanResult
) -> PlanFigures:
    """Return the figures of a plan for that surface."""
    mask, removal = measured.metric_mask, plan.predicted_removal_nm
    mean_nm = float(removal[mask].mean())
    expected, ripple = planned.forecast, planned.ripple
    known = bool(ripple.lines)
    certificate = planned.certificate
    return PlanFigures(
        before_rms_nm=measured.stats.rms_nm,
        predicted_rms_nm=planned.predicted_rms_nm,
        predicted_pv_nm=certificate.predicted_pv_nm,
        expected_nm=None if expected is None else (expected.low_nm, expected.high_nm),
        level=None if expected is None else expected.level,
        better=None if expected is None else expected.better,
        ripple_rms_nm=ripple.rms_nm if known else None,
        ripple_rms_high_nm=ripple.rms_high_nm if known else None,
        ripple=ripple.words if known else "",
        removal_mean_nm=mean_nm,
        removal_max_nm=float(removal.max()),
        removal_mm3=mean_nm * int(mask.sum()) * measured.grid.pitch_mm**2 / NM_MM2_PER_MM3,
        dwell_s=plan.total_s,
        points=plan.program.n,
        points_at_least_time=certificate.at_lower,
        force_n=recipe.process.force_n,
        rpm=recipe.process.rpm,
        limits=tuple(_limits(recipe, plan)),
        notes=_notes(recipe, measured, solved, plan, planned),
    )


def _limits(recipe: Recipe, plan: Plan) -> Iterator[PlanLimit]:
    envelope, program = recipe.envelope, plan.program
    yield PlanLimit("limits.max_removal_nm", float(plan.predicted_removal_nm.max()), envelope.max_removal_nm, "nm")
    yield PlanLimit("limits.max_pass_s", plan.total_s, envelope.max_pass_s, "s")
    fastest = program.max_feed_mm_min / 60
    if program.encoding != "dwell":  # the time of a dwell is no feed
        moves = program.length_mm > 0
        feeds = program.length_mm[moves] / program.time_s[moves]
        if feeds.size:
            fastest = max(fastest, float(feeds.max()))
            yield PlanLimit("machine.min_feed_mm_s", float(feeds.min()), envelope.min_feed_mm_s, "mm/s", least=True)
    yield PlanLimit("machine.max_feed_mm_s", fastest, envelope.max_feed_mm_s, "mm/s")
    tip = np.concatenate([program.start_mm, program.end_mm])
    for axis, name, (low, high) in zip(range(3), AXES, (envelope.x_mm, envelope.y_mm, envelope.z_mm), strict=True):
        yield PlanLimit(f"machine.{name}_mm", float(tip[:, axis].min()), low, "mm", least=True)
        yield PlanLimit(f"machine.{name}_mm", float(tip[:, axis].max()), high, "mm")


def _notes(
    recipe: Recipe, measured: MeasureResult, solved: SolveResult, plan: Plan, planned: PlanResult
) -> tuple[str, ...]:
    side_mm = max(measured.grid.shape) * measured.grid.pitch_mm
    found: Sequence[str] = (
        *plan.program.warnings,
        *solved.answer.notes,
        *ripple_notes(recipe.lines, planned.ripple, side_mm, solved.answer.acting),
        *planned.certificate.notes,
    )
    return tuple(dict.fromkeys(found))
