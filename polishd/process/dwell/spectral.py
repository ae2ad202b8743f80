"""Alternating directions for an effect without a matrix: a large part, a large spot, a tool that moves.

One dwell minimises the objective, another keeps to the bounds, and a multiplier draws them together (ADMM; Boyd et al.,
Found. Trends Mach. Learn. 3 (2011) 1). The first is never solved for: from where it was it takes one step down, in the
metric of the mean spot under a path that is everywhere as dense, which transforms invert in closed form. A step costs
one product and one adjoint of the effect on a coarser grid, which knows how the objective bends well enough; where it
stands is found with the effect itself, every so many steps, and what the coarser one was off by is put right (defect
correction). Projected Newton-CG needs many times as many where the spot is large.

Nothing here is trusted: the certificate is computed anew.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy

from polishd.model.dwell import DwellSolution
from polishd.model.errors import ComputeError
from polishd.model.surface import BoolArray, FloatArray
from polishd.process.dwell import newton_cg
from polishd.process.dwell.certificate import certified, gap_at
from polishd.process.dwell.limit import TimeLimit
from polishd.process.dwell.problem import DwellProblem
from polishd.process.dwell.quadratic import Quadratic, projected_gradient, quadratic, warm_start_s
from polishd.process.dwell.validation import check
from polishd.process.spreading.effect import SpreadEffect

NAME = "spectral"
MAX_STEPS = 5000
RELAXATION = 1.7
PULL = 3.0
"""How strongly the two dwells are drawn together, over the geometric mean of the objective's least and most curvature.
At 1.5 a KKT residual of 1e-4 takes a quarter more steps, at 0.7 half as many again."""
LEAST_REGULARISATION = 1e-5
"""Regularisation below this share of the most curvature is taken for this, in the pull only."""
LOOK_EVERY = 80
"""Steps between two looks with the effect itself: each costs as much as ten to fifty of them, and in so many the
objective comes four times as near to the least."""
ACCEPTED = 5e-5
"""KKT residual at which a gap that is small enough ends it: a cell accepts 1e-4."""
FINELY = 1e-6, 1e-5
"""KKT residual and gap below which looks must be in float64; above, float32 tells as much in half of the time."""
STALLED, LOOKS = 0.9, 5
"""A residual above this share of what it was so many looks ago has met float32's floor."""


@dataclass(frozen=True, slots=True)
class Metric:
    """About the objective's curvature and so much more, inverted; made by `metric`."""

    effect: SpreadEffect
    """In float32."""
    held: float
    """Curvature that no spot gives: regularisation and pull."""
    share: FloatArray
    """What of each frequency the spots hold, over ``held``; on nodes of the effect's layout."""

    def inverse(self, slope: FloatArray) -> FloatArray:
        """(n,) -> (n,): ``(held + S K* K S')^-1``, exact where the path lays down the same on every node."""
        where, weights = self.effect.where, self.effect.weights
        nodes = (weights.T @ slope.astype(self.share.dtype)).reshape(where.lattice)
        spectrum = scipy.fft.rfft2(nodes, where.size)
        back = scipy.fft.irfft2(self.share * spectrum, where.size)[: where.lattice[0], : where.lattice[1]]
        return np.asarray((slope - weights @ back.ravel()) / self.held, dtype=np.float64)


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
    if not isinstance(problem.effect, SpreadEffect):
        raise ComputeError(f"{NAME} needs an effect without a matrix: use newton_cg")
    f = quadratic(problem)
    found, steps, stopped = _minimise(problem, problem.effect, f, (kkt_tolerance, gap), limit)
    if stopped == "stalled":
        last = newton_cg.solve(problem, limit.left_s, kkt_tolerance, found)
        return replace(last, certificate=replace(last.certificate, seconds=limit.cpu_s))
    return certified(problem, found, solver=NAME, iterations=steps, seconds=limit.cpu_s, stopped=stopped, f=f)


def metric(problem: DwellProblem, effect: SpreadEffect) -> tuple[Metric, float]:
    """The metric of a problem of that effect, and the pull between its two dwells, nm^2/s^2."""
    kernel = np.tensordot(effect.coefficients.mean(axis=0), effect.spectra, axes=1)
    mask, weight = (
        problem.solve_mask,
        1.0 if problem.weight is None else float(problem.weight[problem.solve_mask].mean()),
    )
    flat = float(np.median(effect.removal_nm(np.ones(effect.n))[mask]))
    density = flat / float(kernel[0, 0].real)  # points to a node
    square = np.abs(kernel) ** 2 * (2 * weight / (np.count_nonzero(mask) * effect.finer**2))
    least, most = 2 * problem.regularisation, density * float(square.max())
    pull = PULL * float(np.sqrt(max(least, LEAST_REGULARISATION * most) * most))
    held = least + pull
    return Metric(effect.single(), held, (square / (held + density * square)).astype(np.float32)), pull


def stepping(problem: DwellProblem, effect: SpreadEffect) -> DwellProblem:
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
    problem: DwellProblem, effect: SpreadEffect, f: Quadratic, tolerances: tuple[float, float], limit: TimeLimit
) -> tuple[FloatArray, int, str]:
    """(n,) the best dwell by its KKT residual, the steps taken, and why it stopped."""
    kkt_tolerance, gap = tolerances
    lower, upper = problem.lower_s, problem.upper_s
    bending = stepping(problem, effect)
    near, pull = metric(bending, effect.coarse or effect)
    bend_of = f.rough_curvature if bending is problem else quadratic(bending).rough_curvature
    start = warm_start_s(problem, f)
    bounded = lower.copy() if start is None else np.clip(start, lower, upper)
    look_at = f.rough_at if kkt_tolerance >= FINELY[0] and gap >= FINELY[1] else f.at
    at_lower = look_at(lower)
    value, gradient = at_lower if start is None else look_at(bounded)
    scale = float(np.abs(at_lower[1]).max()) or 1.0
    multiplier = -np.where(_held_back(gradient, bounded, lower, upper), gradient, 0.0) / pull
    free = slope = bounded.copy()  # the dwell without bounds, and its gradient
    best, least, history, look = bounded, np.inf, list[float](), 0
    for steps in range(MAX_STEPS):
        late = limit.expired()
        if late or steps == look:
            value, gradient = look_at(bounded) if steps else (value, gradient)
            left = float(np.abs(projected_gradient(gradient, bounded, lower, upper, f.safe_step)).max()) / scale
            history.append(left)
            if left < least:
                best, least = bounded.copy(), left
            proved = left <= ACCEPTED and gap_at(problem, bounded, value, gradient) <= gap * value
            if proved or least <= kkt_tolerance:
                return bounded if proved else best, steps, "converged"
            if late:
                return best, steps, "deadline"
            look = steps + LOOK_EVERY
            if len(history) > LOOKS and least > STALLED * min(history[:-LOOKS]):
                return best, steps, "stalled"
            slope = gradient + bend_of(free - bounded)  # of what is small: float32's floor is of that
        uphill = slope + pull * (free - bounded + multiplier)
        way = near.inverse(-uphill)
        bend = bend_of(way)
        size = -float(uphill @ way) / float(way @ bend + pull * (way @ way))
        free = free + size * way
        slope = slope + size * bend
        drawn = RELAXATION * free + (1 - RELAXATION) * bounded + multiplier
        bounded = np.clip(drawn, lower, upper)
        multiplier = drawn - bounded
    return best, MAX_STEPS, "iterations"


def _held_back(gradient: FloatArray, time_s: FloatArray, lower: FloatArray, upper: FloatArray) -> BoolArray:
    """(n,) where a bound keeps the dwell from what would bring the objective down."""
    return np.asarray(((time_s <= lower) & (gradient > 0)) | ((time_s >= upper) & (gradient < 0)))
