"""A sharper proof of how far a dwell is from the least: the dual point refined, its range taken from what is removed.

The objective is at least its tangent at *any* dwell s, with what the regularisation P bends it by: for all x

    f(x) >= f(s) + g(s) (x - s) + P |x - s|^2

whose least value within the bounds is a lower bound of the least objective (the dual's value at the residual of s). s
need not be the dwell that is judged, nor lie within the bounds. With next to no regularisation the tangent at the dwell
itself says little: a gradient that hardly counts is divided by P. At the end of a few steps by conjugate residuals,
which take from the gradient what bends, it says much; the steps may be as rough as they like.

A dwell x that is better than one of objective f also keeps to ``|R x - h|^2 <= m f``, so that ``sum(R x)`` is at most
``sum(h) + m sqrt(f)`` (Cauchy): a bound of all points together, which holds without any regularisation. It enters by a
multiplier; each that is not negative proves something, and the best of a few is taken.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from polishd.model.dwell import DwellSolution
from polishd.model.surface import BoolArray, FloatArray
from polishd.process.dwell.alternating_directions import coarse_problem
from polishd.process.dwell.problem import DwellProblem, TimeLimit
from polishd.process.dwell.quadratic import Product, QuadraticObjective, quadratic
from polishd.process.removal.spread_effect import SpreadEffect

ROUNDS, STEPS = 8, 60
"""Tangents that are tried, and steps of conjugate residuals before each, at most: few long ways see late which points a
bound holds, many short ones forget what they know of how the objective bends."""
MULTIPLIERS = 0.25 ** np.arange(12)
"""Factors on the removal's bound to try, over the one that holds every point."""
ROUNDING = 1e-12
"""Largest relative rounding error of sums in float64."""
SPARE = 0.1
"""Part of what is to be proved that the gradient is to be worth at the end of the steps."""


@dataclass(frozen=True, slots=True)
class LowerBound:
    """Limits of every dwell that is no worse than a given objective."""

    low: FloatArray
    """(n,) s"""
    high: FloatArray
    """(n,) s, where there is no regularisation perhaps infinite."""
    removes: FloatArray
    """(n,) nm/s: all that a second removes from samples that count, summed."""
    most_nm: float
    """Limit of the sum over all points."""

    @classmethod
    def of(cls, problem: DwellProblem, f: QuadraticObjective, value: float) -> LowerBound:
        """Return the limits for an objective of at most ``value`` (nm^2); one product with R transposed."""
        high, m = problem.upper_s, f.target.size
        if problem.regularisation > 0:
            high = np.minimum(high, np.sqrt(max(value, 0.0) / problem.regularisation))
        most = float(f.target.sum()) + m * float(np.sqrt(max(value, 0.0)))
        return cls(problem.lower_s, np.maximum(high, problem.lower_s), f.backward(np.ones(m)), most)

    def least(self, at_s: FloatArray, value: float, gradient: FloatArray, p: float) -> float:
        """nm^2: no such dwell has a lower objective; from value and gradient (n,) at (n,) ``at_s``, whatever it is."""
        return max(0.0, *(self._least(at_s, value, gradient, p, at) for at in self._multipliers(gradient)))

    def _multipliers(self, gradient: FloatArray) -> FloatArray:
        removes = self.removes > 0
        every = float((-gradient[removes] / self.removes[removes]).max(initial=0.0))
        return np.append(every * (1 + 1e-12) * MULTIPLIERS, 0.0)

    def _least(self, at_s: FloatArray, value: float, gradient: FloatArray, p: float, multiplier: float) -> float:
        slope = gradient + multiplier * self.removes
        if p > 0:
            x = np.clip(at_s - slope / (2 * p), self.low, self.high)
        else:
            x = np.where(slope < 0, self.high, self.low)
            if not np.isfinite(x).all():
                return -np.inf
        way = x - at_s
        held = multiplier * (float(self.removes @ at_s) - self.most_nm)
        return float(value + (slope * way + p * way**2).sum() + held)


def prove_lower_bound(problem: DwellProblem, solution: DwellSolution, enough: float, within_s: float) -> DwellSolution:
    """The same dwell, its certificate with the smallest gap that could be proved.

    Args:
        problem: what was solved.
        solution: the dwell, certified; one whose gap is small enough already is given back.
        enough: relative gap to stop at.
        within_s: CPU seconds to stop after (see TimeLimit); what is proved by then counts.

    Returns:
        The dwell as it is. ``gap`` and ``gap_nm`` as of `Certificate`, never larger than they were.

    Raises:
        ComputeError: as the effect's own products.
    """
    certificate, value = solution.certificate, solution.certificate.objective
    if value <= 0 or (certificate.gap is not None and certificate.gap <= enough):
        return solution
    f = quadratic(problem)
    gap = smallest_gap(problem, f, solution.time_s, enough, TimeLimit(within_s).expired)
    if not np.isfinite(gap) or (certificate.gap is not None and gap >= certificate.gap * value):
        return solution
    gap_nm = value**0.5 - max(value - gap, 0.0) ** 0.5
    return replace(solution, certificate=replace(certificate, gap=gap / value, gap_nm=gap_nm))


def smallest_gap(
    problem: DwellProblem, f: QuadraticObjective, time_s: FloatArray, enough: float, expired: Callable[[], bool]
) -> float:
    """By how much the objective at ``time_s`` (n,) is above the least one within the bounds, at most, nm^2.

    As `certificate.largest_gap`, by ROUNDS tangents; stops at ``enough`` of the objective, or when ``expired`` says so.
    Infinite where nothing could be proved.
    """
    p, bend = problem.regularisation, _bend(problem, f)
    value, gradient = f.at(time_s)
    reach, at_s, at_value = LowerBound.of(problem, f, value), time_s, value
    least = reach.least(at_s, at_value, gradient, p)
    for _ in range(ROUNDS):
        if value - least <= enough * value or expired():
            break
        free = ~(((at_s <= reach.low) & (gradient >= 0)) | ((at_s >= reach.high) & (gradient <= 0)))
        goal = SPARE * enough * value * 4 * max(p, np.finfo(float).tiny)
        at_s = np.clip(at_s + _way(bend, gradient, free, goal, expired), reach.low, reach.high)
        at_value, gradient = f.at(at_s)
        least = max(least, reach.least(at_s, at_value, gradient, p))
    return max(value - least, 0.0) + ROUNDING * value


def _bend(problem: DwellProblem, f: QuadraticObjective) -> Product:
    """The Hessian's product, roughly: of the effect on a coarser grid where it has one."""
    effect = problem.effect
    if isinstance(effect, SpreadEffect) and effect.coarse is not None:
        return quadratic(coarse_problem(problem, effect)).rough_curvature
    return f.rough_curvature


def _way(bend: Product, gradient: FloatArray, free: BoolArray, goal: float, expired: Callable[[], bool]) -> FloatArray:
    """(n,) s that take the gradient away at the free points: its square's sum falls at each step, to the goal at most.

    Conjugate residuals (Stiefel, 1955), which have the least residual of all steps of their number.
    """
    way, left = np.zeros_like(gradient), np.where(free, -gradient, 0.0)
    step, bent = left.copy(), np.where(free, bend(left), 0.0)
    step_bent, across = bent.copy(), float(left @ bent)
    for _ in range(STEPS):
        square = float(step_bent @ step_bent)
        if float(left @ left) <= goal or square <= 0 or across <= 0 or expired():
            break
        size = across / square
        way += size * step
        left -= size * step_bent
        bent = np.where(free, bend(left), 0.0)
        across, last = float(left @ bent), across
        step = left + across / last * step
        step_bent = bent + across / last * step_bent
    return way
