"""The certificate of a dwell: everything is computed anew, in float64, from the solution itself."""

from __future__ import annotations

import numpy as np

from polishd.model.dwell import DwellSolution, OptimalityCertificate
from polishd.model.errors import ComputeError
from polishd.model.surface import FloatArray
from polishd.process.dwell.problem import DwellProblem
from polishd.process.dwell.quadratic import (
    QuadraticObjective,
    conditioning_note,
    feed_change_nm2,
    projected_gradient,
    quadratic,
)
from polishd.process.metrology.spectra import band_rms
from polishd.process.removal.combined_effect import effect_error, effect_note


def certify_dwell(
    problem: DwellProblem,
    time_s: FloatArray,
    *,
    solver: str,
    iterations: int,
    seconds: float,
    stopped: str,
    notes: tuple[str, ...] = (),
    f: QuadraticObjective | None = None,
) -> DwellSolution:
    """A dwell with its certificate and the surface that it predicts.

    No result of the solver enters: objective, gradient and bound violations are those of ``time_s`` on the
    problem as given. ``residual_nm`` is target less removal, less its mean in the clear aperture.

    Args:
        problem: what was solved, passed by ``validation.check``.
        time_s: (n,) the dwell, s.
        solver: the solver's name.
        iterations: its iterations.
        seconds: CPU seconds it took.
        stopped: ``converged``, ``deadline`` or ``iterations``.
        notes: anything a person should know.
        f: the problem's objective where it is at hand.

    Raises:
        ComputeError: ``time_s`` has another shape or is not finite.
    """
    t = np.asarray(time_s, dtype=np.float64)
    if t.shape != (problem.effect.n,) or not np.isfinite(t).all():
        raise ComputeError(f"{solver} gave no finite dwell for each of the {problem.effect.n} points")
    removal = problem.effect.removal_nm(t)
    residual = np.where(problem.solve_mask, problem.target_nm - removal, np.nan)
    residual = residual - residual[problem.metric_mask].mean()
    inside = residual[problem.metric_mask]
    band = None
    if problem.band_period_mm is not None:
        pitch, mask = problem.effect.grid.pitch_mm, problem.metric_mask
        band = band_rms(residual, mask, pitch, problem.band_period_mm)
    f = f or quadratic(problem)
    objective, slope = f.at(t)
    gap = gap_at(problem, t, objective, slope)
    found = (conditioning_note(problem, f), _feed_note(problem, t), *_effect_notes(problem, removal))
    computed = [note for note in found if note is not None]
    certificate = OptimalityCertificate(
        solver=solver,
        objective=objective,
        kkt_residual=_kkt_residual(problem, t, f, slope),
        bound_violation_s=float(max(0.0, (problem.lower_s - t).max(), (t - problem.upper_s).max())),
        predicted_rms_nm=float(inside.std()),
        predicted_pv_nm=float(np.ptp(inside)),
        dwell_total_s=float(t.sum()),
        piston_nm=float(problem.target_nm[problem.metric_mask].mean()),
        at_lower=int(np.count_nonzero(t <= problem.lower_s)),
        at_upper=int(np.count_nonzero(t >= problem.upper_s)),
        iterations=iterations,
        seconds=seconds,
        stopped=stopped,
        notes=(*notes, *computed),
        gap=_finite(gap / objective if objective > 0 else 0.0),
        gap_nm=None if np.isinf(gap) else objective**0.5 - max(objective - gap, 0.0) ** 0.5,
        predicted_band_rms_nm=band,
    )
    return DwellSolution(t, removal, residual, certificate, problem.lower_s, problem.upper_s)


def _feed_note(problem: DwellProblem, time_s: FloatArray) -> str | None:
    if problem.feed_change is None:
        return None
    counts = feed_change_nm2(problem.feed_change, time_s)
    return f"the change of feed between blocks counts {counts:.3g} nm^2 in the objective"


def _effect_notes(problem: DwellProblem, removal: FloatArray) -> tuple[str, ...]:
    """Error of the effect, also in nm of this removal. The gap does not contain it."""
    note, share = effect_note(problem.effect), effect_error(problem.effect)
    if note is None or not share > 0:
        return () if note is None else (note,)
    return note, f"without a matrix this removal is off by up to {share * removal.max():.2g} nm"


def _finite(value: float) -> float | None:
    return value if np.isfinite(value) else None


def largest_gap(problem: DwellProblem, time_s: FloatArray, f: QuadraticObjective | None = None) -> float:
    """By how much the objective at ``time_s`` (n,) is above the least one within the bounds, at most, nm^2.

    The objective curves by twice the regularisation P at least: ``f(s) >= f(t) + g (s - t) + P |s - t|^2``, whose least
    value within the bounds follows point by point. A dwell that is better than this one also has
    ``P s^2 <= f(t)`` at each point. With next to no regularisation it is far too much, and says little; without it and
    an upper bound, infinite. It costs one gradient.
    """
    f = f or quadratic(problem)
    return gap_at(problem, time_s, *f.at(time_s))


def gap_at(problem: DwellProblem, time_s: FloatArray, value: float, g: FloatArray) -> float:
    """`largest_gap` where objective and gradient (n,) are at hand."""
    p = problem.regularisation
    down = np.where(g > 0, time_s - problem.lower_s, 0.0)
    up = np.where(g < 0, problem.upper_s - time_s, 0.0)
    step = np.maximum(np.maximum(up, down), 0.0)
    if p > 0:
        most = np.sqrt(max(value, 0.0) / p) - time_s
        step = np.minimum(step, np.where(g < 0, np.maximum(most, 0.0), step))
        step = np.minimum(step, np.abs(g) / (2 * p))
    return float((np.abs(g) * step - (p * step**2 if p > 0 else 0.0)).sum())


def kkt_residual(problem: DwellProblem, time_s: FloatArray, f: QuadraticObjective | None = None) -> float:
    """Largest projected gradient at ``time_s`` (n,), relative to the largest gradient at the lower bound.

    0 exactly at the minimum, at most about 1 at the lower bound. Where the lower bound itself has no gradient, 0 for a
    minimum and infinity for anything else. ``f`` is the problem's objective where it is at hand.
    """
    f = f or quadratic(problem)
    return _kkt_residual(problem, time_s, f, f.gradient(time_s))


def _kkt_residual(problem: DwellProblem, time_s: FloatArray, f: QuadraticObjective, slope: FloatArray) -> float:
    lower = problem.lower_s
    left = float(np.abs(projected_gradient(slope, time_s, lower, problem.upper_s, f.safe_step)).max())
    scale = float(np.abs(f.gradient(lower)).max())
    if scale == 0:
        return 0.0 if left == 0 else float("inf")
    return left / scale
