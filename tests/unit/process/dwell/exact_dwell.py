"""Independent reference solutions for the dwell solvers, and methods of the literature."""

from __future__ import annotations

import numpy as np
from scipy import linalg, optimize, sparse
from scipy.sparse.linalg import lsmr

from polishd.model.surface import FloatArray
from polishd.process.dwell.problem import DwellProblem


def normal_equations(problem: DwellProblem) -> tuple[sparse.csr_array, FloatArray]:
    """Return Hessian H and gradient c at 0 of the objective ``t'Ht/2 + c't``, written out."""
    counted = problem.solve_mask.ravel()
    rows = sparse.csr_array(sparse.csr_array(problem.effect.matrix)[np.flatnonzero(counted)])
    m, n = rows.shape
    weight = np.ones(m) if problem.weight is None else problem.weight.ravel()[counted]
    hessian = 2 / m * (rows.T @ (sparse.diags_array(weight) @ rows)) + 2 * problem.regularisation * sparse.eye_array(n)
    return sparse.csr_array(hessian), problem.price_nm2_per_s - 2 / m * (
        rows.T @ (weight * problem.target_nm.ravel()[counted])
    )


def by_nnls(problem: DwellProblem) -> FloatArray:
    """(n,) s by scipy's nnls on the Cholesky factor; t >= 0 only."""
    hessian, c = normal_equations(problem)
    factor = linalg.cholesky(hessian.toarray(), lower=True)
    time_s, _ = optimize.nnls(factor.T, -linalg.solve_triangular(factor, c, lower=True), maxiter=50 * c.size)
    return np.asarray(time_s)


def by_pivoting(problem: DwellProblem, guess_s: FloatArray) -> FloatArray:
    """(n,) s that meet the optimality conditions of ``t >= 0`` outright; the guess says which points may be at 0.

    Gauss on the points off 0; what came out negative goes to 0, what pulls away from 0 comes off it, until neither is
    left. The problem is convex: what meets the conditions is the minimum, wherever the guess came from.
    """
    hessian, c = normal_equations(problem)
    scale = float(np.abs(c).max())
    band = sparse.coo_array(hessian)
    width = int(np.abs(band.row - band.col).max())
    free = guess_s > 0
    for _ in range(60):
        where = np.flatnonzero(free)
        part = sparse.coo_array(hessian[where][:, where])
        below = part.row >= part.col
        matrix = np.zeros((width + 1, where.size))
        matrix[(part.row - part.col)[below], part.col[below]] = part.data[below]
        factor = (linalg.cholesky_banded(matrix, lower=True, check_finite=False), True)
        x = linalg.cho_solve_banded(factor, -c[where])
        for _ in range(2):  # what rounding left of it
            x -= linalg.cho_solve_banded(factor, hessian[where][:, where] @ x + c[where])
        time_s = np.zeros(c.size)
        time_s[where] = x
        gradient = hessian @ time_s + c
        negative, pulling = time_s < 0, ~free & (gradient < -1e-13 * scale)
        if not (negative.any() or pulling.any()):
            assert np.abs(gradient[where]).max() <= 1e-10 * scale
            return time_s
        free = (free & ~negative) | pulling
    raise AssertionError("pivoting did not settle: the guess is no solution")


def fista(problem: DwellProblem, iterations: int) -> FloatArray:
    """(n,) s by Beck and Teboulle's method, t >= 0, without P."""
    rows, target = problem.effect.matrix, problem.target_nm.ravel()
    columns = sparse.csr_array(rows.T)
    step = 1 / float((columns @ (rows @ np.ones(rows.shape[1]))).max())
    last = ahead = np.zeros(rows.shape[1])
    pace = 1.0
    for _ in range(iterations):
        now = np.maximum(0, ahead - step * (columns @ (rows @ ahead - target)))
        quicker = (1 + np.sqrt(1 + 4 * pace**2)) / 2
        ahead, last, pace = now + (pace - 1) / quicker * (now - last), now, quicker
    return np.asarray(last)


def clipped_lsmr(problem: DwellProblem, iterations: int) -> FloatArray:
    """(n,) s of unconstrained least squares, with what is negative set to 0."""
    found = lsmr(problem.effect.matrix, problem.target_nm.ravel(), atol=0, btol=0, conlim=0, maxiter=iterations)[0]
    return np.asarray(np.maximum(found, 0.0))


def richardson_lucy(problem: DwellProblem, iterations: int) -> FloatArray:
    """(n,) s by multiplicative corrections."""
    rows, target = problem.effect.matrix, np.maximum(problem.target_nm.ravel(), 1e-9)
    columns = sparse.csr_array(rows.T)
    reach = columns @ np.ones(target.size)
    used = reach > 1e-9 * reach.max()
    time_s = np.where(used, target.mean() / float((rows @ np.ones(rows.shape[1])).mean()), 0.0)
    for _ in range(iterations):
        correction = columns @ (target / np.maximum(rows @ time_s, 1e-12))
        time_s = np.where(used, time_s * correction / np.where(used, reach, 1.0), 0.0)
    return time_s
