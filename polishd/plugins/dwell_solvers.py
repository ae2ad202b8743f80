"""polishd's own dwell solvers.

``auto`` takes the fastest for the effect at hand: ``douglas_rachford`` for sums of convolutions, ``newton_cg``
for a matrix, or ``interior_point`` where that is ill-conditioned and not too large.
``qp`` is an independent cross-check, with ``qp:clarabel`` and so on for each backend of qpsolvers that is installed;
``lucy_richardson`` is the literature's baseline.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy
from scipy import sparse

from polishd.api import (
    ComputeError,
    ConvolutionEffect,
    DwellProblem,
    DwellSolution,
    DwellSolver,
    SparseEffect,
    hookimpl,
)
from polishd.model.surface import FloatArray
from polishd.process.dwell import (
    alternating_directions,
    douglas_rachford,
    interior_point,
    lucy_richardson,
    newton_cg,
)
from polishd.process.dwell.certificate import certify_dwell
from polishd.process.dwell.problem import SLOWEST, TimeLimit, check
from polishd.process.dwell.quadratic import condition
from polishd.process.removal.spread_effect import SpreadEffect

if TYPE_CHECKING:
    import qpsolvers

# The default solver: the fastest of polishd's for the effect at hand.

AUTO_NAME = "auto"
ILL = 1e5
"""Condition number above which factorising beats conjugate gradients (rho of about 1e-5)."""
FEW = 5_800
"""Points whose factor the interior point takes, however wide its band."""


def solve_auto(problem: DwellProblem, within_s: float) -> DwellSolution:
    """Splitting for a sum of convolutions, alternating directions where there is no matrix; else Newton-CG or a factor.

    Conjugate gradients win where regularisation conditions the problem, a factor where it does not and is small.
    Arguments, result and errors as those solvers'; the certificate names the one that was taken.
    """
    plain = problem.feed_change is None
    if isinstance(problem.effect, ConvolutionEffect) and plain:
        return douglas_rachford.solve(problem, within_s)
    check(problem)
    if isinstance(problem.effect, SpreadEffect) and plain:
        return alternating_directions.solve(problem, within_s)
    if problem.effect.n <= FEW and isinstance(problem.effect, SparseEffect) and condition(problem) > ILL:
        return interior_point.solve(problem, within_s)
    return newton_cg.solve(problem, within_s)


# The dwell problem as a sparse quadratic program, for any backend of qpsolvers that takes sparse matrices.

QP_NAME = "qp"
ENOUGH = 1e-6
"""KKT residual (see Certificate) up to which an answer counts as converged, whatever the backend says of it."""
DENSE_POINTS = 1.5
"""Points for each sample above which ``R'R`` costs more than R. At one a sample it halves clarabel's time; measured."""
MOST_ENTRIES = 20_000_000
"""Of a matrix made from convolutions: a quarter of a gigabyte; what a backend makes of it is several times that."""
NEGLIGIBLE = 1e-12
"""Share of the largest value below which a kernel's entry is a transform's rounding."""


@dataclass(frozen=True, slots=True)
class QpBackend:
    """How one backend is asked, for a relative gap of 1e-8 or better on a program in natural units."""

    options: Mapping[str, Any] = field(default_factory=dict)
    time_limit: str | None = None
    """Its option for a limit in wall seconds."""
    takes_hessian: bool = True


BACKENDS = {
    # in one thread, whose CPU time is counted; more gain nothing here
    "clarabel": QpBackend(
        {"tol_gap_abs": 1e-13, "tol_gap_rel": 1e-13, "tol_feas": 1e-10, "max_threads": 1}, "time_limit"
    ),
    "piqp": QpBackend({"eps_abs": 1e-12, "eps_rel": 1e-12, "eps_duality_gap_abs": 1e-14, "eps_duality_gap_rel": 1e-14}),
    "scs": QpBackend({"eps_abs": 1e-9, "eps_rel": 1e-9, "max_iters": 1_000_000}, "time_limit_secs"),
    "qpalm": QpBackend({"eps_abs": 1e-9, "eps_rel": 1e-9, "max_iter": 100_000}, "time_limit"),
    "osqp": QpBackend({"eps_abs": 1e-9, "eps_rel": 1e-9, "max_iter": 1_000_000, "polishing": True}, "time_limit"),
    "proxqp": QpBackend({"eps_abs": 1e-9, "eps_rel": 0.0}),
    "highs": QpBackend(
        time_limit="time_limit", takes_hessian=False
    ),  # it errs on a full Hessian as qpsolvers passes it
}
"""In order of preference; any other is asked as it comes, and its certificate says how far it got."""


SPARSE = (
    "clarabel", "copt", "cvxopt", "gurobi", "highs", "kvxopt", "mosek", "osqp", "pdhcg", "piqp", "proxqp", "qpalm",
    "qtqp", "scs", "sip",
)  # fmt: skip
"""Backends of qpsolvers that take sparse matrices."""
LIBRARIES = {"copt": "coptpy", "gurobi": "gurobipy", "highs": "highspy", "proxqp": "proxsuite", "sip": "sip_qp_python"}
"""Module of a backend where its name is another one."""


def installed() -> list[str]:
    """The backends that are installed and take sparse matrices, those preferred first."""
    import qpsolvers

    there = [name for name in qpsolvers.available_solvers if name in qpsolvers.sparse_solvers]
    return [*(name for name in BACKENDS if name in there), *sorted(set(there) - set(BACKENDS))]


def _declared() -> list[str]:
    """Names of the same without an import of any: qpsolvers and its backends take a twentieth of a check."""
    others = sorted(set(SPARSE) - set(BACKENDS))
    return [name for name in (*BACKENDS, *others) if find_spec(LIBRARIES.get(name, name)) is not None]


def solve_qp(problem: DwellProblem, within_s: float, backend: str | None = None) -> DwellSolution:
    """Solve as a quadratic program; needs the effect as a matrix, or one that can be written out.

    A backend has no feasible best so far: where the time runs out, what it has is clipped to the bounds and certified
    as it is, and refused only if there is nothing. Some know no time limit; the one who asked must end those. It does
    not tell its iterations.

    Args:
        problem: what to solve; its effect must be a SparseEffect, or a ConvolutionEffect of moderate size.
        within_s: CPU seconds for the whole call (see TimeLimit).
        backend: its name in qpsolvers; None for the best that is installed.

    Raises:
        ComputeError: the problem is malformed, its effect has no matrix, the backend is not installed or found nothing.
    """
    limit = TimeLimit(within_s)
    check(problem)
    there = installed()
    if not there:
        raise ComputeError(f"no QP backend is installed: one of {', '.join(BACKENDS)} is needed")
    name = backend or there[0]
    if name not in there:
        raise ComputeError(f"QP backend {name} is not installed; there are: {', '.join(there)}")
    answers: list[DwellSolution] = []
    late = False
    for with_hessian in _forms(problem, BACKENDS.get(name, QpBackend())):
        if late:
            break
        dwell, late = _asked(problem, name, with_hessian, limit)
        if dwell is None:
            continue
        answers.append(
            certify_dwell(
                problem, dwell, solver=f"{QP_NAME}:{name}", iterations=0, seconds=limit.cpu_s, stopped="converged"
            )
        )
        if answers[-1].certificate.kkt_residual <= ENOUGH:
            return answers[-1]
    if not answers:
        raise ComputeError(f"{name} found no dwell within {within_s:g} s of CPU time, in {limit}")
    best = min(answers, key=lambda answer: answer.certificate.objective)
    return replace(best, certificate=replace(best.certificate, stopped="deadline" if late else "iterations"))


def _forms(problem: DwellProblem, how: QpBackend) -> list[bool]:
    """Whether to write ``R'R`` out: where that is quicker first; without it, no digit is lost to cancellation."""
    dense = problem.effect.n > DENSE_POINTS * np.count_nonzero(problem.solve_mask)
    return [False] if dense or not how.takes_hessian else [True, False]


def _asked(problem: DwellProblem, name: str, with_hessian: bool, limit: TimeLimit) -> tuple[FloatArray | None, bool]:
    """(n,) dwell within the bounds that the backend found, certain or not; and whether its time was over."""
    import qpsolvers

    program, unit_s = _program(problem, with_hessian)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # advice of a backend on matrix formats
        try:
            solution, late = _in_time(program, name, limit)
        except (qpsolvers.QPError, ValueError) as error:
            raise ComputeError(f"{name} failed: {error}") from error
    found, n = solution.x, problem.effect.n
    if found is None or not np.isfinite(np.asarray(found)[:n]).all():
        return None, late
    dwell = problem.lower_s + unit_s * np.asarray(found, dtype=np.float64)[:n]
    return np.asarray(np.clip(dwell, problem.lower_s, problem.upper_s)), late


def _in_time(program: qpsolvers.Problem, name: str, limit: TimeLimit) -> tuple[qpsolvers.Solution, bool]:
    """What the backend comes to in the CPU time that is left, and whether that is over.

    Backends count wall seconds: one whose wall seconds were over before it had its CPU seconds is asked again, for as
    much longer as the machine was slow, if more are left than were not enough.
    """
    import qpsolvers

    how = BACKENDS.get(name, QpBackend())
    slowness = 1.0
    while True:
        cpu, wall, wall_limit = limit.cpu_s, limit.wall_s, slowness * max(limit.left_s, 1e-3)
        options = dict(how.options) if how.time_limit is None else {**how.options, how.time_limit: wall_limit}
        solution = qpsolvers.solve_problem(program, solver=name, **options)
        cpu, wall = limit.cpu_s - cpu, limit.wall_s - wall
        late = limit.expired() or wall >= wall_limit
        if solution.found or how.time_limit is None or not late or limit.left_s <= cpu:
            return solution, late
        slowness = min(wall / max(cpu, 1e-3), SLOWEST)


def _program(problem: DwellProblem, with_hessian: bool) -> tuple[qpsolvers.Problem, float]:
    """The program in u = (t - lower) / unit, and the unit in s, with which a point's curvature is about 1.

    In u alone, with ``R'R`` written out, or in (u, v) with the misfit v as an equality, so that it never appears.
    """
    import qpsolvers

    matrix, lower = matrix_of(problem), problem.lower_s
    m, n = matrix.shape
    weight = np.ones(m) if problem.weight is None else problem.weight[problem.solve_mask]
    rows = sparse.csr_array(sparse.diags_array(np.sqrt(2 / m * weight)) @ matrix)
    miss = rows @ lower - np.sqrt(2 / m * weight) * problem.target_nm[problem.solve_mask]
    p = 2 * problem.regularisation
    curvature = np.asarray(rows.multiply(rows).sum(axis=0)).ravel() + p
    unit = float(1 / np.sqrt(np.median(curvature[curvature > 0])))
    rows = sparse.csr_array(unit * rows)
    linear, most = unit * (p * lower + problem.price_nm2_per_s), (problem.upper_s - lower) / unit
    held = sparse.csr_array(p * unit**2 * sparse.eye_array(n))
    if problem.feed_change is not None:
        change = 2 * (problem.feed_change.T @ problem.feed_change)
        held, linear = sparse.csr_array(held + unit**2 * change), linear + unit * (change @ lower)
    if with_hessian:
        hessian = _csc(rows.T @ rows + held)
        return qpsolvers.Problem(hessian, linear + rows.T @ miss, lb=np.zeros(n), ub=most), unit
    free: FloatArray = np.full(m, np.inf)
    return qpsolvers.Problem(
        _csc(sparse.block_diag([held, sparse.eye_array(m)])),
        np.concatenate([linear, np.zeros(m)]),
        A=_csc(sparse.hstack([rows, -sparse.eye_array(m)])),
        b=-miss,
        lb=np.concatenate([np.zeros(n), -free]),
        ub=np.concatenate([most, free]),
    ), unit


def _csc(matrix: Any) -> sparse.csc_matrix:
    """As every backend takes it: piqp answers nonsense where a column's rows are out of order."""
    made = sparse.csc_matrix(matrix)
    made.sort_indices()
    return made


def matrix_of(problem: DwellProblem) -> sparse.csr_array:
    """(m, n) nm/s: R at the m samples of ``solve_mask``.

    Raises:
        ComputeError: the effect is neither a matrix nor a sum of convolutions, or its matrix would be too large.
    """
    effect = problem.effect
    if isinstance(effect, SparseEffect):
        matrix = effect.matrix
    elif isinstance(effect, ConvolutionEffect):
        matrix = _written_out(effect)
    else:
        raise ComputeError(f"a QP needs the effect as a matrix, not as {type(effect).__name__}: use newton_cg")
    return sparse.csr_array(sparse.csr_array(matrix)[np.flatnonzero(problem.solve_mask.ravel())])


def _written_out(effect: ConvolutionEffect) -> sparse.csr_array:
    """(ny nx, n) nm/s: the kernels laid down at each point."""
    grid, columns, (top, left) = effect.grid, effect.lattice[1], effect.corner
    # the corner is the kernels' reach, or more where the lattice goes beyond the grid: it holds them whole
    kernels = scipy.fft.irfft2(effect.spectra, effect.size)[:, : 2 * top + 1, : 2 * left + 1]
    size = np.abs(kernels).max(axis=0)
    down, across = np.nonzero(size > NEGLIGIBLE * size.max())
    if effect.n * down.size > MOST_ENTRIES:
        raise ComputeError(
            f"{effect.n} points of {down.size} samples each are too many for a QP: use douglas_rachford, "
            "and cross-check on fewer points"
        )
    value = effect.coefficients @ kernels[:, down, across]
    row = np.add.outer(effect.node // columns - top, down)
    column = np.add.outer(effect.node % columns - left, across)
    point = np.broadcast_to(np.arange(effect.n)[:, None], row.shape)
    on = (row >= 0) & (row < grid.ny) & (column >= 0) & (column < grid.nx)
    entries = (value[on], ((row * grid.nx + column)[on], point[on]))
    return sparse.csr_array(sparse.coo_array(entries, shape=(grid.ny * grid.nx, effect.n)))


POLISHD_API = 1

OWN = (newton_cg, douglas_rachford, interior_point, lucy_richardson)


@hookimpl
def polishd_dwell_solvers() -> Sequence[DwellSolver]:
    """The default solver first."""
    return [
        DwellSolver(AUTO_NAME, solve_auto),
        *(DwellSolver(own.NAME, own.solve) for own in OWN),
        DwellSolver(QP_NAME, solve_qp),
        *(DwellSolver(f"{QP_NAME}:{name}", partial(solve_qp, backend=name)) for name in _declared()),
    ]
