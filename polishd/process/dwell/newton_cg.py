"""The default dwell solver: projected Newton steps, each found by conjugate gradients on the points off their bounds.

Measured on the demo's size (8,166 points, 100 mm at 1 mm, spot 3.4 mm) to a relative objective gap of 1e-6, against
projected gradients (SPG, FISTA with restart, MPRGP), scipy's L-BFGS-B and diagonal or neighbour preconditioning, it
needed the least time at 8,000 and at 70,000 points; see benchmarks/bench_dwell.py.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from polishd.model.dwell import DwellSolution
from polishd.model.errors import ComputeError
from polishd.model.surface import FloatArray
from polishd.process.dwell.certificate import certified
from polishd.process.dwell.problem import DwellProblem
from polishd.process.dwell.quadratic import Quadratic, projected_gradient, quadratic
from polishd.process.dwell.validation import check

NAME = "newton_cg"
MAX_ROUNDS = 500
MAX_INNER = 1000
# How far one round's conjugate gradients bring the residual down; flat between 0.03 and 0.1, twice as slow at 0.01.
INNER_TOLERANCE = 0.05

Stop = Callable[[FloatArray, FloatArray], str | None]
"""(t, gradient at t) -> why to stop, or None to go on. Asked once a round."""


def solve(
    problem: DwellProblem, within_s: float, kkt_tolerance: float = 1e-4, start_s: FloatArray | None = None
) -> DwellSolution:
    """Solve the dwell problem, or come as far as the time allows.

    Args:
        problem: what to solve.
        within_s: wall seconds for the whole call; when they are over, the best dwell so far is returned. It is
            always inside the bounds, and its certificate says ``deadline`` and how far from the minimum it is.
        kkt_tolerance: the KKT residual (see Certificate) to stop at.
        start_s: (n,) where to start, for instance the last cycle's dwell; clipped to the bounds. Default: ``lower_s``.

    Returns:
        The dwell with its certificate.

    Raises:
        ComputeError: the problem is malformed.
    """
    begin = time.perf_counter()
    check(problem)
    start = problem.lower_s if start_s is None else start_s
    if start.shape != problem.lower_s.shape or not np.isfinite(start).all():
        raise ComputeError(f"start_s must be {problem.effect.n} finite seconds")
    f = quadratic(problem)
    enough = kkt_tolerance * float(np.abs(f.gradient(problem.lower_s)).max())

    def expired() -> bool:
        return time.perf_counter() - begin >= within_s

    def stop(t: FloatArray, gradient: FloatArray) -> str | None:
        if float(np.abs(projected_gradient(gradient, t, problem.lower_s, problem.upper_s)).max()) <= enough:
            return "converged"
        return "deadline" if expired() else None

    t, rounds, stopped = minimise(f, problem.lower_s, problem.upper_s, start, stop, expired)
    return certified(
        problem, t, solver=NAME, iterations=rounds, seconds=time.perf_counter() - begin, stopped=stopped
    )


def minimise(
    f: Quadratic,
    lower: FloatArray,
    upper: FloatArray,
    start: FloatArray,
    stop: Stop,
    expired: Callable[[], bool] = lambda: False,
) -> tuple[FloatArray, int, str]:
    """Minimise a quadratic between bounds; f falls from round to round and t never leaves the bounds.

    A round is a projected gradient step (which finds the bounds that hold, and alone would converge) and a Newton step
    on the points that are then free.

    Args:
        f: the objective.
        lower: (n,) s.
        upper: (n,) s, may be infinite.
        start: (n,) s, clipped to the bounds.
        stop: asked before each round.
        expired: asked at each conjugate gradient; once true, the round is brought to its end at once.

    Returns:
        (n,) dwell in s, rounds taken, and what ``stop`` said, or ``"iterations"``.
    """
    t = np.clip(start, lower, upper)
    gradient = f.gradient(t)
    for rounds in range(MAX_ROUNDS):
        reason = stop(t, gradient)
        if reason is not None:
            return t, rounds, reason
        steepest = -projected_gradient(gradient, t, lower, upper)
        slope, bend = float(steepest @ steepest), float(steepest @ f.curvature(steepest))
        if slope == 0 or bend <= 0:  # no way down in float64
            return t, rounds, "converged"
        t, gradient = _advance(f, t, gradient, (slope / bend) * steepest, lower, upper)
        free = projected_gradient(gradient, t, lower, upper) != 0
        t, gradient = _advance(f, t, gradient, _newton_direction(f, gradient, free, expired), lower, upper)
    return t, MAX_ROUNDS, "iterations"


def _newton_direction(f: Quadratic, gradient: FloatArray, free: np.ndarray, expired: Callable[[], bool]) -> FloatArray:
    """(n,) about ``-H_FF^-1 g_F`` on the free points, zero elsewhere; downhill however early it is stopped."""
    weight = free.astype(np.float64)
    residual = -gradient * weight
    direction = np.zeros_like(residual)
    search = residual.copy()
    size = float(residual @ residual)
    enough = INNER_TOLERANCE**2 * size
    for _ in range(MAX_INNER):
        if size <= enough or expired():
            break
        image = f.curvature(search)
        image *= weight
        length = size / float(search @ image)
        direction += length * search
        image *= length
        residual -= image
        last, size = size, float(residual @ residual)
        search *= size / last
        search += residual
    return direction


def _advance(
    f: Quadratic, t: FloatArray, gradient: FloatArray, direction: FloatArray, lower: FloatArray, upper: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Go to ``clip(t + direction)``, or less far where f turns up before, or nowhere where that way is not down.

    Returns the new t and the gradient there.
    """
    step = np.clip(t + direction, lower, upper) - t
    slope = float(gradient @ step)
    if slope >= 0:
        return t, gradient
    image = f.curvature(step)
    bend = float(step @ image)
    if bend > -slope:
        step *= -slope / bend
        image *= -slope / bend
    return np.clip(t + step, lower, upper), gradient + image
