"""The dwell problem as a sparse quadratic program, for whichever interior-point backend qpsolvers finds.

It shares only the problem and the certificate with the default solver, so that their agreement means something.
"""

from __future__ import annotations

import time
import warnings
from typing import Any

import numpy as np
import qpsolvers
from scipy import sparse

from polishd.api import ComputeError, DwellProblem, DwellSolution, SparseEffect
from polishd.model.surface import FloatArray
from polishd.process.dwell.certificate import certified
from polishd.process.dwell.validation import check

NAME = "qp"
# In order of preference; each takes sparse matrices and is accurate enough to certify with.
BACKENDS = ("clarabel", "piqp", "proxqp", "highs")


def solve(problem: DwellProblem, within_s: float) -> DwellSolution:
    """Solve by an interior-point method; needs the effect as a matrix.

    An interior-point method has no feasible best so far: where the time runs out, what it has is clipped to the
    bounds and certified as it is, and refused only if there is nothing. The backend does not tell its iterations.

    Args:
        problem: what to solve; its effect must be a SparseEffect.
        within_s: wall seconds for the backend.

    Raises:
        ComputeError: the problem is malformed, its effect is no matrix, no backend is installed, or it found nothing.
    """
    begin = time.perf_counter()
    check(problem)
    backend = next((name for name in BACKENDS if name in qpsolvers.available_solvers), None)
    if backend is None:
        raise ComputeError(f"no QP backend is installed: one of {', '.join(BACKENDS)} is needed")
    found = _run(_program(problem), backend, max(within_s - (time.perf_counter() - begin), 1e-3))
    n = problem.effect.n
    if found.x is None or not np.isfinite(found.x[:n]).all():
        raise ComputeError(f"{backend} found no dwell within {within_s:g} s")
    return certified(
        problem,
        np.clip(found.x[:n], problem.lower_s, problem.upper_s),
        solver=f"{NAME}:{backend}",
        iterations=0,
        seconds=time.perf_counter() - begin,
        stopped="converged" if found.found else "deadline",
    )


def _program(problem: DwellProblem) -> qpsolvers.Problem:
    """Minimise over (t, y) with ``y = R t - h`` as an equality: R'R, which is dense, never appears."""
    if not isinstance(problem.effect, SparseEffect):
        raise ComputeError(f"{NAME} needs the effect as a matrix, not as {type(problem.effect).__name__}")
    matrix = sparse.csr_array(problem.effect.matrix)[np.flatnonzero(problem.solve_mask.ravel())]
    m, n = matrix.shape
    inside = problem.solve_mask
    weight = np.ones(m) if problem.weight is None else problem.weight[inside]
    weights = np.concatenate([np.full(n, 2 * problem.regularisation), 2 / m * weight])
    unbounded: FloatArray = np.full(m, np.inf)
    return qpsolvers.Problem(
        sparse.diags_array(weights, format="csc"),
        np.concatenate([np.full(n, problem.price_nm2_per_s), np.zeros(m)]),
        A=sparse.hstack([matrix, -sparse.eye_array(m)], format="csc"),
        b=problem.target_nm[problem.solve_mask],
        lb=np.concatenate([problem.lower_s, -unbounded]),
        ub=np.concatenate([problem.upper_s, unbounded]),
    )


def _run(program: qpsolvers.Problem, backend: str, within_s: float) -> qpsolvers.Solution:
    options: dict[str, Any] = {"time_limit": within_s} if backend == "clarabel" else {}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a backend's advice on matrix formats is nobody's business
        return qpsolvers.solve_problem(program, solver=backend, **options)
