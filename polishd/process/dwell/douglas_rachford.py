"""The dwell solver for points at rest on the grid's nodes: Douglas-Rachford splitting on transforms, in float32.

It needs an effect that is a sum of convolutions, and takes an eighth of the time of scipy's L-BFGS-B or less; see
benchmarks/bench_dwell_large.py. The last digits, where float32 has none, are found in float64.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from polishd.model.dwell import DwellSolution
from polishd.model.errors import ComputeError
from polishd.model.surface import FloatArray
from polishd.process.convolution import ConvolutionEffect
from polishd.process.dwell.certificate import certified
from polishd.process.dwell.limit import TimeLimit
from polishd.process.dwell.problem import DwellProblem
from polishd.process.dwell.quadratic import projected_gradient, quadratic
from polishd.process.dwell.splitting import SplittingState, continued, splitting
from polishd.process.dwell.validation import check

NAME = "douglas_rachford"
MAX_ITERATIONS = 5000
ASK_EVERY = 40
"""Iterations between two looks at the KKT residual, which cost as much as four of them."""
ASK_FIRST = 20
"""And the first look: a warm start may be there."""
STALLED = 0.9
"""A residual above this share of what it was three looks ago has met float32's floor."""

Stop = Callable[[FloatArray], str | None]
"""(n,) dwell -> why to stop, or None to go on."""


def solve(problem: DwellProblem, within_s: float, kkt_tolerance: float = 1e-6) -> DwellSolution:
    """Solve the dwell problem, or come as far as the time allows.

    Args:
        problem: what to solve; its effect must be a ConvolutionEffect. Its warm start's ``state`` is taken where it
            fits, else its dwell.
        within_s: CPU seconds for the whole call (see TimeLimit); when they are over, the best dwell so far is
            returned, within the bounds, and its certificate says ``deadline`` and how far from the minimum it is.
        kkt_tolerance: the KKT residual (see Certificate) to stop at.

    Returns:
        The dwell with its certificate; its ``state`` starts the next problem.

    Raises:
        ComputeError: the problem is malformed, or its effect is no sum of convolutions.
    """
    limit = TimeLimit(within_s)
    check(problem)
    effect = problem.effect
    if not isinstance(effect, ConvolutionEffect):
        raise ComputeError(
            f"{NAME} needs dwell points at rest on the grid's nodes (a sum of convolutions): use newton_cg"
        )
    judge = _Judge(problem, kkt_tolerance)
    work = splitting(problem, effect)
    stopped = minimise(work, judge.stop, limit.expired)
    if stopped == "stalled":
        work = continued(work, splitting(replace(problem, warm=None), effect, np.float64))
        judge.can_stall = False
        stopped = minimise(work, judge.stop, limit.expired)
    if stopped != "converged":
        judge.stop(work.time_s)
    found = certified(
        problem,
        judge.best_s,
        solver=NAME,
        iterations=work.iterations,
        seconds=limit.cpu_s,
        stopped=stopped,
    )
    return replace(found, state=work.state)


def minimise(work: SplittingState, stop: Stop, expired: Callable[[], bool], ask_every: int = ASK_EVERY) -> str:
    """Iterate until ``stop``, asked every so many iterations, says why to, or time is up, or for `MAX_ITERATIONS`."""
    for count in range(1, MAX_ITERATIONS + 1):
        work.iterate()
        if (count % ask_every == 0 or count == ASK_FIRST) and (reason := stop(work.time_s)) is not None:
            return reason
        if expired():
            return "deadline"
    return "iterations"


class _Judge:
    """Looks at a dwell in float64: the best so far, and whether it is good enough."""

    def __init__(self, problem: DwellProblem, kkt_tolerance: float) -> None:
        self.can_stall = True
        self.best_s: FloatArray = problem.lower_s
        self._lower, self._upper = problem.lower_s, problem.upper_s
        self._f = quadratic(problem)
        self._step = self._f.safe_step
        self._at_lower = self._f.gradient(self._lower)
        self._enough = kkt_tolerance * float(np.abs(self._at_lower).max())
        self._least = np.inf
        self._history: list[float] = []

    def stop(self, time_s: FloatArray) -> str | None:
        """``converged`` at the tolerance, ``stalled`` where float32 comes no nearer."""
        t = np.clip(time_s, self._lower, self._upper)
        gradient = self._f.gradient(t)
        value = float((t - self._lower) @ (gradient + self._at_lower)) / 2  # above the objective at the lower bound
        if value < self._least or not self._history:
            self._least, self.best_s = value, t
        left = float(np.abs(projected_gradient(gradient, t, self._lower, self._upper, self._step)).max())
        self._history.append(left)
        if left <= self._enough:
            self.best_s = t
            return "converged"
        stalled = len(self._history) > 3 and left > STALLED * self._history[-4]
        return "stalled" if stalled and self.can_stall else None
