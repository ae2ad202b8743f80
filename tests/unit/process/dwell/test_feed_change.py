"""The change of feed in the dwell's objective, against scipy's bounded least squares with the term as rows."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy import optimize, sparse

from polishd.model.dwell import DwellSolution
from polishd.model.errors import ComputeError
from polishd.model.surface import FloatArray
from polishd.plugins import dwell_solvers
from polishd.process.dwell import douglas_rachford, interior_point, lucy_richardson, newton_cg
from polishd.process.dwell.lower_bound import prove_lower_bound
from polishd.process.dwell.problem import DwellProblem, check
from polishd.process.removal.effect import SparseEffect
from tests.unit.process.lattices import as_matrix, lattice_problem

WEIGHT = 3.0


def with_term(weight: float = WEIGHT, seed: int = 2) -> DwellProblem:
    problem = as_matrix(lattice_problem(radius_mm=6, seed=seed))
    n = problem.effect.n
    rows = sparse.csr_array(sparse.diags_array([-np.ones(n - 1), np.ones(n - 1)], offsets=[0, 1], shape=(n - 1, n)))
    upper = np.full(n, 3 * float(newton_cg.solve(problem, 30).time_s.mean()))
    return replace(problem, feed_change=rows * weight, upper_s=upper)


def exact(problem: DwellProblem) -> tuple[FloatArray, float]:
    """The minimum and its value, with every term as rows of one least-squares problem."""
    effect = problem.effect
    assert isinstance(effect, SparseEffect)
    assert problem.feed_change is not None
    n, mask = effect.n, problem.solve_mask
    rows = effect.matrix.toarray()[mask.ravel()] / np.sqrt(mask.sum())
    a = np.vstack([rows, np.sqrt(problem.regularisation) * np.eye(n), problem.feed_change.toarray()])
    b = np.concatenate([problem.target_nm[mask] / np.sqrt(mask.sum()), np.zeros(len(a) - len(rows))])
    bounds = problem.lower_s, np.minimum(problem.upper_s, 1e9)
    found = optimize.lsq_linear(a, b, bounds, method="bvls", tol=1e-14).x
    return found, float(np.sum((a @ found - b) ** 2))


SOLVERS: list[Callable[[DwellProblem], DwellSolution]] = [
    lambda problem: newton_cg.solve(problem, 30, 1e-9),
    lambda problem: interior_point.solve(problem, 30, 1e-8),
    lambda problem: dwell_solvers.solve_qp(problem, 30),
    lambda problem: dwell_solvers.solve_auto(problem, 30),
]


@pytest.mark.one_of_each
@pytest.mark.parametrize("solve", SOLVERS, ids=["newton_cg", "interior_point", "qp", "auto"])
def test_the_minimum_is_that_of_one_least_squares_problem(solve: Callable[[DwellProblem], DwellSolution]) -> None:
    problem = with_term()
    time_s, least = exact(problem)
    found = solve(problem)
    assert found.certificate.objective == pytest.approx(least, rel=1e-6)
    assert found.time_s == pytest.approx(time_s, abs=2e-3 * time_s.max())
    assert found.certificate.kkt_residual < 1e-4


def test_the_certificate_counts_the_term_and_its_gap_stays_a_proof() -> None:
    problem = with_term()
    _, least = exact(problem)
    early = newton_cg.solve(problem, 30, 1e-2)
    proved = prove_lower_bound(problem, early, 1e-6, 30).certificate
    assert proved.gap is not None
    assert proved.objective * (1 - proved.gap) <= least * (1 + 1e-9)
    assert problem.feed_change is not None
    change = problem.feed_change @ early.time_s
    assert any(f"counts {float(change @ change):.3g} nm^2" in note for note in proved.notes)
    without = newton_cg.solve(replace(problem, feed_change=None), 30, 1e-9).time_s
    smooth = newton_cg.solve(problem, 30, 1e-9).time_s
    assert np.linalg.norm(np.diff(smooth)) < 0.8 * np.linalg.norm(np.diff(without))


@pytest.mark.parametrize("solver", [douglas_rachford, lucy_richardson])
def test_a_solver_that_does_not_know_the_term_refuses_it(solver: object) -> None:
    problem = replace(lattice_problem(radius_mm=6), feed_change=with_term().feed_change)
    with pytest.raises(ComputeError, match="does not know the change of feed"):
        solver.solve(problem, 30)  # type: ignore[attr-defined]


def test_a_term_of_other_points_is_refused() -> None:
    problem = with_term()
    with pytest.raises(ComputeError, match="feed_change is of 3 dwell points"):
        check(replace(problem, feed_change=sparse.csr_array(np.ones((2, 3)))))
