"""Alternating directions for an effect without a matrix: a large part, a large spot, a tool that moves.

One dwell minimizes the objective, another keeps to the bounds, and a multiplier draws them together (ADMM; Boyd et al.,
Found. Trends Mach. Learn. 3 (2011) 1). The first is never solved exactly: it takes one step down, in the metric of the
mean spot under a path of constant density, which transforms invert in closed form. A step costs one product and one
adjoint of the effect on a coarser grid, whose curvature is accurate enough. Every LOOK_EVERY steps the effect gives the
gradient, and the error of the coarser grid is corrected (defect correction). Projected Newton-CG needs many times as
many products where the spot is large.

The certificate does not rely on this solver: it is computed anew.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from polishd.model.dwell import DwellSolution
from polishd.model.errors import ComputeError
from polishd.model.surface import FloatArray
from polishd.process.dwell import newton_cg
from polishd.process.dwell.alternating_step import AlternatingStep, step_metric
from polishd.process.dwell.certificate import certify_dwell, gap_at
from polishd.process.dwell.problem import DwellProblem, TimeLimit, check, require_no_feed_change
from polishd.process.dwell.quadratic import QuadraticObjective, projected_gradient, quadratic, warm_start_s
from polishd.process.removal import combined_effect
from polishd.process.removal.spread_effect import SpreadEffect

NAME = "spectral"
MAX_STEPS = 5000
LOOK_EVERY = 60
"""Steps between two checks with the effect itself. A check costs as much as two to thirty steps; in so many steps the
distance of the objective from the minimum falls to a quarter or a tenth."""
ACCEPTED = 5e-5
"""KKT residual at which a gap that is small enough ends it: a cell accepts 1e-4."""
FINELY = 1e-6, 1e-5
"""KKT residual and gap below which checks that may be the last are in float64. Above, float32 is as good and faster."""
STALLED, LOOKS = 0.9, 5
"""A residual above this share of what it was so many looks ago has met float32's floor."""


def solve(problem: DwellProblem, within_s: float, kkt_tolerance: float = 1e-5, gap: float = 1e-4) -> DwellSolution:
    """Solve the dwell problem, or come as far as the time allows.

    Args:
        problem: what to solve; its effect must be a SpreadEffect. It starts from the problem's warm start where that is
            better than ``lower_s``.
        within_s: CPU seconds for the whole call (see TimeLimit); when they are over, the best dwell so far is
            returned, within the bounds, and its certificate says ``deadline`` and how far from the minimum it is.
        kkt_tolerance: the KKT residual (see Certificate) to stop at. Where the steps do not get there, `newton_cg` goes
            on.
        gap: stop at ACCEPTED already where the objective is proved to be within so much of the least, relative; with
            next to no regularisation that proves little, and the residual decides.

    Returns:
        The dwell with its certificate.

    Raises:
        ComputeError: the problem is malformed, or its effect is another one.
    """
    limit = TimeLimit(within_s)
    check(problem)
    require_no_feed_change(problem, NAME)
    if not isinstance(problem.effect, SpreadEffect):
        raise ComputeError(f"{NAME} needs an effect without a matrix: use newton_cg")
    f = quadratic(problem)
    found, steps, stopped = _minimise(problem, problem.effect, f, (kkt_tolerance, gap), limit)
    if stopped == "stalled":
        last = newton_cg.solve(problem, limit.left_s, kkt_tolerance, found)
        return replace(last, certificate=replace(last.certificate, seconds=limit.cpu_s))
    return certify_dwell(problem, found, solver=NAME, iterations=steps, seconds=limit.cpu_s, stopped=stopped, f=f)


def coarse_problem(problem: DwellProblem, effect: SpreadEffect) -> DwellProblem:
    """The problem whose curvature steps are found with: on the effect's coarser grid, where it has one.

    A cell counts by the share of its samples that count, and their weights; its target is nothing.
    """
    if effect.coarse is None:
        return problem
    share = effect.coarsely(np.where(problem.solve_mask, 1.0 if problem.weight is None else problem.weight, 0.0))
    mask = share > 0
    weight = share * (np.count_nonzero(mask) / np.count_nonzero(problem.solve_mask))
    nothing = np.zeros(mask.shape)
    return replace(problem, effect=effect.coarse, target_nm=nothing, solve_mask=mask, metric_mask=mask, weight=weight)


def _minimise(
    problem: DwellProblem,
    effect: SpreadEffect,
    f: QuadraticObjective,
    tolerances: tuple[float, float],
    limit: TimeLimit,
) -> tuple[FloatArray, int, str]:
    """(n,) the best dwell by its KKT residual, the steps taken, and why it stopped."""
    kkt_tolerance, gap = tolerances
    start = warm_start_s(problem, f)
    bounded = problem.lower_s.copy() if start is None else np.clip(start, problem.lower_s, problem.upper_s)
    look = _Look(problem, f, finely=kkt_tolerance < FINELY[0] or gap < FINELY[1])
    value, gradient, left = look.at(bounded)
    way = _walk(coarse_problem(problem, effect), effect.coarse or effect, bounded, gradient)
    best, least, history, next_look = bounded, np.inf, list[float](), 0
    for steps in range(MAX_STEPS):
        late = limit.expired()
        if late or steps == next_look:
            bounded = way.bounded
            value, gradient, left = look.at(bounded) if steps else (value, gradient, left)
            history.append(left)
            if left < least:
                best, least = bounded.copy(), left
            proved = left <= ACCEPTED and gap_at(problem, bounded, value, gradient) <= gap * value
            if proved or least <= kkt_tolerance:
                return bounded if proved else best, steps, "converged"
            if late:
                return best, steps, "deadline"
            next_look = steps + LOOK_EVERY
            if len(history) > LOOKS and least > STALLED * min(history[:-LOOKS]):
                return best, steps, "stalled"
            way.correct_slope(gradient)
        way.step()
    return best, MAX_STEPS, "iterations"


def _walk(problem: DwellProblem, effect: SpreadEffect, start: FloatArray, gradient: FloatArray) -> AlternatingStep:
    """From a dwell within the bounds, (n,) s, and the gradient of the objective there.

    ``problem`` is one of ``effect``, whose curvature is to find steps with.
    """
    near = step_metric(problem, effect)
    lower, upper = problem.lower_s, problem.upper_s
    held_back = ((start <= lower) & (gradient > 0)) | ((start >= upper) & (gradient < 0))
    multiplier = -np.where(held_back, gradient, 0.0) / near.pull
    kind: type[AlternatingStep] = AlternatingStep
    if combined_effect.is_compiled(effect) and effect.finer == 1:
        from polishd.process.dwell.alternating_directions_compiled import CompiledAlternatingStep

        kind = CompiledAlternatingStep
    none, same = np.zeros_like(start), start.copy
    return kind(problem, quadratic(problem), near, same(), same(), same(), multiplier, none, none.copy())


class _Look:
    """Objective and KKT residual of a dwell by the effect itself, in float64 where float32 is too coarse."""

    def __init__(self, problem: DwellProblem, f: QuadraticObjective, *, finely: bool) -> None:
        self._f, self._finely = f, finely
        self._bounds = problem.lower_s, problem.upper_s
        self._scale = float(np.abs(f.rough_at(problem.lower_s)[1]).max()) or 1.0

    def at(self, time_s: FloatArray) -> tuple[float, FloatArray, float]:
        """The objective, its gradient (n,), and the KKT residual."""
        value, gradient = self._f.rough_at(time_s)
        if self._finely and self._left(gradient, time_s) <= ACCEPTED:
            value, gradient = self._f.at(time_s)
        return value, gradient, self._left(gradient, time_s)

    def _left(self, gradient: FloatArray, time_s: FloatArray) -> float:
        left = projected_gradient(gradient, time_s, *self._bounds, self._f.safe_step)
        return float(np.abs(left).max()) / self._scale
