"""The solvers that the plugin declares: both solve, agree, pickle and refuse."""

from __future__ import annotations

import pickle
from dataclasses import replace

import numpy as np
import pluggy
import pytest
import qpsolvers

from polishd import hookspecs
from polishd.api import API_VERSION, ComputeError, DwellSolver
from polishd.plugins import dwell_solvers
from polishd.plugins.dwell_solvers import qp
from polishd.process.dwell import newton_cg
from tests.unit.process.gaussian import dwell_problem


def declared() -> list[DwellSolver]:
    manager = pluggy.PluginManager(hookspecs.PROJECT)
    manager.add_hookspecs(hookspecs)
    manager.register(dwell_solvers)
    manager.check_pending()
    return [solver for solvers in manager.hook.polishd_dwell_solvers() for solver in solvers]


def test_the_plugin_declares_both_the_default_first() -> None:
    assert API_VERSION == dwell_solvers.POLISHD_API
    assert [solver.name for solver in declared()] == ["newton_cg", "qp"]


@pytest.mark.parametrize("solver", declared(), ids=lambda solver: solver.name)
def test_each_pickles_and_solves(solver: DwellSolver) -> None:
    problem = pickle.loads(pickle.dumps(dwell_problem(radius_mm=8)))
    solution = pickle.loads(pickle.dumps(solver)).solve(problem, 20.0)
    certificate = solution.certificate
    assert certificate.stopped == "converged"
    assert certificate.kkt_residual < 1e-4
    assert certificate.bound_violation_s == 0
    assert certificate.solver.split(":")[0] == solver.name


def test_they_agree_where_bounds_bind_on_both_sides() -> None:
    problem = dwell_problem(radius_mm=15, unreached=0.05)
    problem = replace(problem, upper_s=np.maximum(problem.lower_s, 0.12))
    ours, theirs = newton_cg.solve(problem, 20, 1e-9), qp.solve(problem, 20)
    assert min(ours.certificate.at_lower, ours.certificate.at_upper) > 20
    assert ours.certificate.objective == pytest.approx(theirs.certificate.objective, rel=1e-7)
    assert ours.certificate.objective <= theirs.certificate.objective * (1 + 1e-10)
    assert theirs.time_s == pytest.approx(ours.time_s, abs=1e-3)


def test_infinite_upper_bounds() -> None:
    problem = dwell_problem(radius_mm=8)
    problem = replace(problem, upper_s=np.full(problem.effect.n, np.inf))
    ours, theirs = newton_cg.solve(problem, 20, 1e-9), qp.solve(problem, 20)
    assert ours.certificate.objective == pytest.approx(theirs.certificate.objective, rel=1e-7)


def test_the_qp_cannot_use_an_effect_that_is_no_matrix() -> None:
    problem = dwell_problem(radius_mm=6)

    class Opaque:
        grid, n = problem.effect.grid, problem.effect.n
        removal_nm, adjoint = problem.effect.removal_nm, problem.effect.adjoint

    with pytest.raises(ComputeError, match="qp needs the effect as a matrix, not as Opaque"):
        qp.solve(replace(problem, effect=Opaque()), 5)


def test_the_qp_checks_the_problem_first() -> None:
    problem = dwell_problem(radius_mm=6)
    with pytest.raises(ComputeError, match="lower_s is above upper_s at point 0"):
        qp.solve(replace(problem, upper_s=problem.lower_s / 2), 5)


def test_without_a_backend_it_says_which_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(qpsolvers, "available_solvers", [])
    with pytest.raises(ComputeError, match="no QP backend is installed: one of clarabel"):
        qp.solve(dwell_problem(radius_mm=6), 5)


def test_a_backend_that_finds_nothing_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(qp, "_run", lambda program, backend, within_s: qpsolvers.Solution(program))
    with pytest.raises(ComputeError, match="clarabel found no dwell within 5 s"):
        qp.solve(dwell_problem(radius_mm=6), 5)


def test_out_of_time_it_says_so_or_refuses() -> None:
    try:
        certificate = qp.solve(dwell_problem(radius_mm=30), 0.02).certificate
    except ComputeError as error:
        assert "found no dwell within" in str(error)  # noqa: PT017  either is honest
    else:
        assert certificate.stopped == "deadline"
        assert certificate.bound_violation_s == 0
