"""The default dwell solver: projected Newton steps, each found by conjugate gradients on the points off their bounds.

Measured on the demo's size (8,166 points, 100 mm at 1 mm, spot 3.4 mm) to a relative objective gap of 1e-6, against
projected gradients (SPG, FISTA with restart, MPRGP), scipy's L-BFGS-B and diagonal or neighbour preconditioning, it
needed the least time at 8,000 and at 70,000 points; see benchmarks/bench_dwell.py.

Preconditioning by a convolution does not pay on a raster of 100 mm at 1 mm. Its lines are cut into equal moves, each
line into others, so that the points lie on no lattice, and the inverse has to be right to the share that regularisation
has in the Hessian (1e-4). From the lower bound on the final free points, plain conjugate gradients need 275 products,
with the convolution's inverse they do not get there in 600, and with ten times the regularisation in it and a multiple
of the identity 219, while its two transforms take 0.4 of a product's time. The exact inverse of the whole Hessian,
restricted to the free points, still needs 78. Float32 saves 3 to 13 % of a sparse product.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from polishd.model.dwell import DwellSolution
from polishd.model.errors import ComputeError
from polishd.model.surface import BoolArray, FloatArray
from polishd.process.dwell.certificate import certify_dwell
from polishd.process.dwell.problem import DwellProblem, TimeLimit, check
from polishd.process.dwell.quadratic import QuadraticObjective, projected_gradient, quadratic, warm_start_s

NAME = "newton_cg"
MAX_ROUNDS = 2000
MAX_INNER = 1000
ASK_EVERY = 12
"""Conjugate gradients between two looks at the bounds and at the clock of the system."""
MOST_OUTSIDE = 0.003
"""Share of the points that conjugate gradients may lead out of their bounds before the round ends. With 0 there are
many short rounds, each of which holds a few points more."""
RELEASE = 0.05
"""Points leave their bounds once the gradient there is above this share of the free points' gradient; flat from 0.05 to
0.1, slower at 0.02 and 0.3."""
# How far one round's conjugate gradients bring the residual down; flat from 0.03 to 0.1, twice as slow at 0.01.
INNER_TOLERANCE = 0.1
MAX_HALVINGS = 10
# Share of the decrease that the slope promises with which a step is accepted (Armijo).
SUFFICIENT = 1e-4

Stop = Callable[[FloatArray, FloatArray], str | None]
"""(t, gradient at t) -> why to stop, or None to go on. Asked once a round."""


def solve(
    problem: DwellProblem, within_s: float, kkt_tolerance: float = 1e-5, start_s: FloatArray | None = None
) -> DwellSolution:
    """Solve the dwell problem, or come as far as the time allows.

    Args:
        problem: what to solve.
        within_s: CPU seconds for the whole call (see TimeLimit); when they are over, the best dwell so far is
            returned. It is always inside the bounds, and its certificate says ``deadline`` and how far from the
            minimum it is.
        kkt_tolerance: the KKT residual (see Certificate) to stop at.
        start_s: (n,) where to start, for instance the last cycle's dwell; clipped to the bounds. Default: the
            problem's warm start where that is better than ``lower_s``, else ``lower_s``.

    Returns:
        The dwell with its certificate.

    Raises:
        ComputeError: the problem is malformed.
    """
    limit = TimeLimit(within_s)
    check(problem)
    lower, upper = problem.lower_s, problem.upper_s
    f = quadratic(problem)
    start = warm_start_s(problem, f) if start_s is None else start_s
    start = lower if start is None else start
    if start.shape != lower.shape or not np.isfinite(start).all():
        raise ComputeError(f"start_s must be {lower.size} finite seconds")
    step = f.safe_step
    enough = kkt_tolerance * float(np.abs(f.gradient(lower)).max())

    def stop(t: FloatArray, gradient: FloatArray) -> str | None:
        if float(np.abs(projected_gradient(gradient, t, lower, upper, step)).max()) <= enough:
            return "converged"
        return "deadline" if limit.expired() else None

    t, rounds, stopped = minimise(f, (lower, upper), start, stop, limit.expired)
    return certify_dwell(problem, t, solver=NAME, iterations=rounds, seconds=limit.cpu_s, stopped=stopped)


def minimise(
    f: QuadraticObjective,
    bounds: tuple[FloatArray, FloatArray],
    start: FloatArray,
    stop: Stop,
    expired: Callable[[], bool] = lambda: False,
) -> tuple[FloatArray, int, str]:
    """Minimise a quadratic between bounds; f never rises from round to round and t never leaves the bounds.

    A round is a Newton step on the points off their bounds. A projected gradient step (which alone would converge) goes
    before it where there is something to gain at the bounds: points leave them by it alone. Both the early end of the
    conjugate gradients at a bound and this test (Dostal, SIAM J. Optim. 7 (1997) 871) keep rounds from being spent on
    points that go to and fro between bound and inside.

    Args:
        f: the objective.
        bounds: lower and upper, (n,) s each; upper may be infinite.
        start: (n,) s, clipped to the bounds.
        stop: asked before each round.
        expired: asked at each ``ASK_EVERY``th conjugate gradient; once true, the round is brought to its end at once.

    Returns:
        (n,) dwell in s, rounds taken, and what ``stop`` said, or ``"iterations"``.
    """
    t = np.clip(start, *bounds)
    gradient = f.gradient(t)
    step = f.safe_step
    stuck = False
    for rounds in range(MAX_ROUNDS):
        reason = stop(t, gradient)
        if reason is not None:
            return t, rounds, reason
        free = _between(t, bounds)
        left = projected_gradient(gradient, t, *bounds, step)
        inside, at_bounds = float(np.sum(left**2, where=free)), float(np.sum(left**2, where=~free))
        if stuck or at_bounds > RELEASE**2 * inside:
            t, gradient = _advance(f, bounds, t, gradient, -step * gradient)
            free = _between(t - step * gradient, bounds)
        room = (bounds[0] - t, bounds[1] - t)
        before = t
        t, gradient = _advance(f, bounds, t, gradient, _newton_direction(f, room, gradient, free, expired))
        stuck = t is before
    return t, MAX_ROUNDS, "iterations"


def _between(time_s: FloatArray, bounds: tuple[FloatArray, FloatArray]) -> BoolArray:
    """(n,) whether a dwell is off both its bounds."""
    return (time_s > bounds[0]) & (time_s < bounds[1])


def _leaves(direction: FloatArray, room: tuple[FloatArray, FloatArray], free: BoolArray) -> bool:
    """Return whether a direction (n,) leads too many free points to their bounds or beyond."""
    return int(np.count_nonzero(free & ~_between(direction, room))) > MOST_OUTSIDE * free.size


def _newton_direction(
    f: QuadraticObjective,
    room: tuple[FloatArray, FloatArray],
    gradient: FloatArray,
    free: BoolArray,
    expired: Callable[[], bool],
) -> FloatArray:
    """(n,) about ``-H_FF^-1 g_F`` on the free points, zero elsewhere; downhill however early it is stopped.

    It ends where it leads points out of the room (n,) s down and up to the bounds: what follows would count on points
    that are about to be held. Float32 is enough for it: whether it leads down, and how far, is found in float64.
    """
    weight = free.astype(np.float64)
    residual = -gradient * weight
    direction = np.zeros_like(residual)
    search = residual.copy()
    size = float(residual @ residual)
    enough = INNER_TOLERANCE**2 * size
    for number in range(1, MAX_INNER + 1):
        image = f.rough_curvature(search)
        image *= weight
        bend = float(search @ image)
        if bend <= 0:  # nothing left that f depends on
            break
        direction += (size / bend) * search
        image *= size / bend
        residual -= image
        last, size = size, float(residual @ residual)
        if size <= enough:
            break
        if number % ASK_EVERY == 0 and (expired() or _leaves(direction, room, free)):
            break
        search *= size / last
        search += residual
    return direction


def _advance(
    f: QuadraticObjective,
    bounds: tuple[FloatArray, FloatArray],
    t: FloatArray,
    gradient: FloatArray,
    direction: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """The first of ``clip(t + s direction)``, s = 1, 1/2, 1/4 ..., that brings f down, and the gradient there.

    Stays where it is if none does.
    """
    for _ in range(MAX_HALVINGS):
        there = np.clip(t + direction, *bounds)
        way = there - t
        image = f.curvature(way)
        slope = float(gradient @ way)
        if slope + float(way @ image) / 2 <= SUFFICIENT * slope < 0:
            return there, gradient + image
        direction = direction / 2
    return t, gradient
