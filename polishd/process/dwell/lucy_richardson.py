"""Lucy-Richardson deconvolution: the literature's baseline for dwell time, and what a better solver is shown beside.

(Richardson, J. Opt. Soc. Am. 62 (1972) 55; Lucy, Astron. J. 79 (1974) 745.) It climbs the likelihood of counts, which
is not the dwell problem's objective, and is stopped early where others regularise.
"""

from __future__ import annotations

import numpy as np

from polishd.model.dwell import DwellSolution
from polishd.model.errors import ComputeError
from polishd.model.surface import FloatArray
from polishd.process.dwell.certificate import certify_dwell
from polishd.process.dwell.problem import DwellProblem, TimeLimit, check, require_no_feed_change

NAME = "lucy_richardson"
ITERATIONS = 100
FLOOR = 1e-9
"""Least removal that is divided by, over the largest target: transforms leave rounding where no spot reaches."""
NOTES = ("Lucy-Richardson does not minimise the objective: regularisation and price only chose among its iterates",)


def solve(problem: DwellProblem, within_s: float, iterations: int = ITERATIONS) -> DwellSolution:
    """The best dwell, by the problem's objective, of so many multiplicative steps ``t R'(w h / R t) / R'w``.

    Weights are honoured, and bounds by clipping each step to them. Regularisation and price only choose the
    iterate.
    A target below 0 counts as 0. A dwell at a lower bound of 0 would stay there, so it starts above.

    Args:
        problem: what to solve, with any effect. A warm start's dwell is taken where it fits.
        within_s: CPU seconds for the whole call (see TimeLimit); when they are over, the best dwell so far is returned.
        iterations: how many steps.

    Returns:
        The dwell; its certificate says how far from the minimum it is, and ``iterations`` or ``deadline``.

    Raises:
        ComputeError: the problem is malformed, or nothing is to be removed anywhere.
    """
    limit = TimeLimit(within_s)
    check(problem)
    require_no_feed_change(problem, NAME)
    effect, mask = problem.effect, problem.solve_mask
    weight = np.where(mask, 1.0 if problem.weight is None else problem.weight, 0.0)
    target = np.where(mask, np.maximum(problem.target_nm, 0.0), 0.0)
    if not target.any():
        raise ComputeError(f"{NAME} has nothing to remove: the target is nowhere above 0")
    reached = effect.adjoint(weight)
    time_s = _start(problem, target, weight)
    best_s, least, done = time_s, np.inf, 0
    while True:
        removal = effect.removal_nm(time_s)
        value = _objective(problem, time_s, removal, weight)
        if value < least:
            best_s, least = time_s, value
        late = limit.expired()
        if late or done >= iterations:
            break
        ratio = target / np.maximum(removal, FLOOR * target.max())
        step = np.divide(effect.adjoint(weight * ratio), reached, out=np.ones_like(time_s), where=reached > 0)
        time_s = np.clip(time_s * np.maximum(step, 0.0), problem.lower_s, problem.upper_s)
        done += 1
    return certify_dwell(
        problem,
        best_s,
        solver=NAME,
        iterations=done,
        seconds=limit.cpu_s,
        stopped="deadline" if late and done < iterations else "iterations",
        notes=NOTES,
    )


def _start(problem: DwellProblem, target_nm: FloatArray, weight: FloatArray) -> FloatArray:
    """(n,) s: the warm start's dwell; else the same everywhere, so that the whole target is removed on the whole."""
    lower, upper, warm = problem.lower_s, problem.upper_s, problem.warm
    even = np.ones_like(lower)
    even *= float((weight * target_nm).sum() / (weight * problem.effect.removal_nm(even)).sum())
    if warm is None or warm.time_s.shape != lower.shape:
        return np.clip(even, lower, upper)
    return np.clip(np.maximum(warm.time_s, 1e-3 * even), lower, upper)


def _objective(problem: DwellProblem, time_s: FloatArray, removal_nm: FloatArray, weight: FloatArray) -> float:
    """nm^2: the problem's own, see DwellProblem."""
    miss = (removal_nm - problem.target_nm)[problem.solve_mask]
    held = problem.regularisation * float(time_s @ time_s) + problem.price_nm2_per_s * float(time_s.sum())
    return float(weight[problem.solve_mask] @ miss**2) / miss.size + held
