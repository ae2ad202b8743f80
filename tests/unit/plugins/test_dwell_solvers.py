"""The solvers that the plugin declares: all solve, agree, pickle and refuse; the default one takes the right solver."""

from __future__ import annotations

import pickle
import time
from dataclasses import replace

import numpy as np
import pluggy
import pytest
import qpsolvers

from polishd import hookspecs
from polishd.api import API_VERSION, ComputeError, DwellSolver
from polishd.plugins import dwell_solvers
from polishd.process.dwell import douglas_rachford, newton_cg
from polishd.process.dwell.problem import DwellProblem
from polishd.process.dwell.quadratic import regularisation_from_rho
from tests.unit.process.gaussian import dwell_problem
from tests.unit.process.lattices import as_matrix, lattice_problem


def test_convolutions_are_split_and_matrices_are_not() -> None:
    problem = lattice_problem(radius_mm=9.0)
    split, written = (dwell_solvers.solve_auto(p, 30.0) for p in (problem, as_matrix(problem)))
    assert split.certificate.solver == "douglas_rachford"
    assert written.certificate.solver == "newton_cg"
    assert split.certificate.objective == pytest.approx(written.certificate.objective, rel=1e-4)


def test_an_ill_conditioned_matrix_is_factorised() -> None:
    problem = dwell_problem(radius_mm=8)
    ill = replace(problem, regularisation=regularisation_from_rho(problem.effect, problem.solve_mask, 1e-8))
    assert dwell_solvers.solve_auto(ill, 30.0).certificate.solver == "interior_point"
    assert dwell_solvers.solve_auto(problem, 30.0).certificate.solver == "newton_cg"


def test_many_points_are_not(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = dwell_problem(radius_mm=8)
    monkeypatch.setattr(dwell_solvers, "FEW", problem.effect.n - 1)
    ill = replace(problem, regularisation=regularisation_from_rho(problem.effect, problem.solve_mask, 1e-7))
    assert dwell_solvers.solve_auto(ill, 30.0).certificate.solver == "newton_cg"


def test_a_malformed_problem_is_refused_as_ever() -> None:
    problem = dwell_problem(radius_mm=8)
    with pytest.raises(ComputeError, match="lower_s is negative"):
        dwell_solvers.solve_auto(replace(problem, lower_s=problem.lower_s - 1), 1.0)


def declared() -> list[DwellSolver]:
    manager = pluggy.PluginManager(hookspecs.PROJECT)
    manager.add_hookspecs(hookspecs)
    manager.register(dwell_solvers)
    manager.check_pending()
    return [solver for solvers in manager.hook.polishd_dwell_solvers() for solver in solvers]


EXACT = [solver for solver in declared() if solver.name != "lucy_richardson"]
QP = [solver for solver in EXACT if solver.name.startswith("qp")]


def test_the_plugin_declares_the_default_first_and_each_backend_by_name() -> None:
    assert API_VERSION == dwell_solvers.POLISHD_API
    names = [solver.name for solver in declared()]
    assert names[0] == "auto"
    assert {"newton_cg", "douglas_rachford", "lucy_richardson"} <= set(names)
    assert names[names.index("qp") + 1 :] == [f"qp:{name}" for name in dwell_solvers.installed()]
    assert "qp:clarabel" in names


@pytest.mark.parametrize("solver", EXACT, ids=lambda solver: solver.name)
def test_each_pickles_and_solves(solver: DwellSolver) -> None:
    made = lattice_problem(radius_mm=8)
    problem = pickle.loads(pickle.dumps(as_matrix(made) if solver.name == "interior_point" else made))
    solution = pickle.loads(pickle.dumps(solver)).solve(problem, 20.0)
    certificate = solution.certificate
    assert certificate.stopped == "converged"
    assert certificate.kkt_residual < 1e-5
    assert certificate.bound_violation_s == 0
    assert certificate.solver.startswith(solver.name) or solver.name == "auto"


def bounded() -> DwellProblem:
    """Both bounds hold somewhere; weights and a price."""
    problem = dwell_problem(radius_mm=10, unreachable=0.05)
    weight = np.random.default_rng(2).uniform(0.2, 3.0, problem.solve_mask.shape)
    upper = np.maximum(problem.lower_s, 0.12)
    return replace(problem, upper_s=upper, weight=weight, price_nm2_per_s=0.2)


@pytest.mark.parametrize("solver", QP, ids=lambda solver: solver.name)
def test_each_backend_finds_the_minimum_to_eight_digits(solver: DwellSolver) -> None:
    problem = bounded()
    ours, theirs = newton_cg.solve(problem, 20, 1e-11).certificate, solver.solve(problem, 20).certificate
    assert min(ours.at_lower, ours.at_upper) > 20
    assert theirs.objective == pytest.approx(ours.objective, rel=1e-8)
    assert theirs.kkt_residual <= 1e-6
    assert theirs.bound_violation_s == 0


def few_samples() -> DwellProblem:
    """Three points for each sample: the form with the misfit as variables."""
    problem = dwell_problem(radius_mm=10)
    mask = problem.solve_mask & (np.indices(problem.solve_mask.shape).sum(axis=0) % 3 == 0)
    return replace(problem, solve_mask=mask, metric_mask=mask & problem.metric_mask)


@pytest.mark.parametrize("make", [bounded, few_samples])
@pytest.mark.parametrize("hessian", [True, False])
def test_both_forms_have_the_same_minimum(make: object, hessian: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    assert callable(make)
    problem = make()
    monkeypatch.setitem(
        dwell_solvers.BACKENDS, "clarabel", replace(dwell_solvers.BACKENDS["clarabel"], takes_hessian=hessian)
    )
    ours = newton_cg.solve(problem, 20, 1e-11).certificate
    theirs = dwell_solvers.solve_qp(problem, 20, "clarabel").certificate
    assert theirs.objective == pytest.approx(ours.objective, rel=1e-8)


def spied(monkeypatch: pytest.MonkeyPatch, answer: float | None = None) -> list[qpsolvers.Problem]:
    """The programs that backends are given from now on; with an answer, they are not solved."""
    programs = []
    solve = qpsolvers.solve_problem

    def spy(program: qpsolvers.Problem, **rest: object) -> qpsolvers.Solution:
        programs.append(program)
        if answer is None:
            return solve(program, **rest)
        return qpsolvers.Solution(program, found=True, x=np.full(program.q.shape, answer))

    monkeypatch.setattr(qpsolvers, "solve_problem", spy)
    return programs


def test_the_hessian_is_formed_where_points_are_no_denser_than_samples(monkeypatch: pytest.MonkeyPatch) -> None:
    programs = spied(monkeypatch)
    for problem in (bounded(), few_samples()):
        dwell_solvers.solve_qp(problem, 20)
    assert [program.A is None for program in programs] == [True, False]
    for program in programs:
        assert program.P.has_sorted_indices  # else piqp answers nonsense
        assert abs(program.P - program.P.T).max() < 1e-12 * program.P.max()


def test_what_the_hessian_form_does_not_solve_is_tried_without(monkeypatch: pytest.MonkeyPatch) -> None:
    solve = qpsolvers.solve_problem

    def poor(program: qpsolvers.Problem, **rest: object) -> qpsolvers.Solution:
        if program.A is None:
            return qpsolvers.Solution(program, found=True, x=np.zeros(program.q.shape))
        return solve(program, **rest)

    monkeypatch.setattr(qpsolvers, "solve_problem", poor)
    certificate = dwell_solvers.solve_qp(bounded(), 20).certificate
    assert certificate.stopped == "converged"
    assert certificate.kkt_residual <= 1e-6


def test_infinite_upper_bounds() -> None:
    problem = dwell_problem(radius_mm=8)
    problem = replace(problem, upper_s=np.full(problem.effect.n, np.inf))
    ours, theirs = newton_cg.solve(problem, 20, 1e-11), dwell_solvers.solve_qp(problem, 20)
    assert ours.certificate.objective == pytest.approx(theirs.certificate.objective, rel=1e-8)


def test_bounds_that_meet_leave_no_choice() -> None:
    problem = dwell_problem(radius_mm=6)
    fixed = replace(problem, upper_s=problem.lower_s.copy())
    np.testing.assert_allclose(dwell_solvers.solve_qp(fixed, 20).time_s, problem.lower_s)


# effects that are no matrix


def test_convolutions_are_written_out_as_the_matrix_that_they_are() -> None:
    problem = lattice_problem(radius_mm=7)
    written = dwell_solvers.matrix_of(problem)
    assert written.shape == (np.count_nonzero(problem.solve_mask), problem.effect.n)
    assert written.nnz < 0.2 * written.shape[0] * written.shape[1]
    exact = dwell_solvers.matrix_of(as_matrix(problem)).toarray()
    np.testing.assert_allclose(written.toarray(), exact, atol=1e-11 * exact.max())


def test_the_qp_and_the_transforms_agree() -> None:
    problem = lattice_problem(radius_mm=9)
    ours, theirs = (
        douglas_rachford.solve(problem, 30, 1e-9).certificate,
        dwell_solvers.solve_qp(problem, 30).certificate,
    )
    assert theirs.objective == pytest.approx(ours.objective, rel=1e-8)


def test_too_many_convolutions_are_refused_with_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(dwell_solvers, "MOST_ENTRIES", 1000)
    with pytest.raises(ComputeError, match=r"points of \d+ samples each are too many for a QP: use douglas_rachford"):
        dwell_solvers.solve_qp(lattice_problem(radius_mm=7), 5)


def test_the_qp_cannot_use_an_effect_that_it_knows_no_matrix_of() -> None:
    problem = dwell_problem(radius_mm=6)

    class Opaque:
        grid, n = problem.effect.grid, problem.effect.n
        removal_nm, adjoint = problem.effect.removal_nm, problem.effect.adjoint

    with pytest.raises(ComputeError, match="a QP needs the effect as a matrix, not as Opaque: use newton_cg"):
        dwell_solvers.solve_qp(replace(problem, effect=Opaque()), 5)


# refusals


def test_the_qp_checks_the_problem_first() -> None:
    problem = dwell_problem(radius_mm=6)
    with pytest.raises(ComputeError, match="lower_s is above upper_s at point 0"):
        dwell_solvers.solve_qp(replace(problem, upper_s=problem.lower_s / 2), 5)


def test_without_a_backend_it_says_which_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(qpsolvers, "available_solvers", [])
    with pytest.raises(ComputeError, match="no QP backend is installed: one of clarabel"):
        dwell_solvers.solve_qp(dwell_problem(radius_mm=6), 5)


def test_a_backend_that_is_not_installed_is_named_with_those_that_are() -> None:
    with pytest.raises(ComputeError, match="QP backend gurobo is not installed; there are: clarabel"):
        dwell_solvers.solve_qp(dwell_problem(radius_mm=6), 5, "gurobo")


def test_dense_backends_are_not_offered_and_unknown_ones_come_last(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(qpsolvers, "available_solvers", ["quadprog", "abacus", "highs", "clarabel"])
    monkeypatch.setattr(qpsolvers, "sparse_solvers", ["abacus", "highs", "clarabel"])
    assert dwell_solvers.installed() == ["clarabel", "highs", "abacus"]


def test_a_backend_that_finds_nothing_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(qpsolvers, "solve_problem", lambda program, **rest: qpsolvers.Solution(program))
    with pytest.raises(ComputeError, match="clarabel found no dwell within 5 s"):
        dwell_solvers.solve_qp(dwell_problem(radius_mm=6), 5, "clarabel")


def test_a_backend_that_fails_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(program: qpsolvers.Problem, **rest: object) -> None:
        raise qpsolvers.SolverError("singular")

    monkeypatch.setattr(qpsolvers, "solve_problem", fails)
    with pytest.raises(ComputeError, match="clarabel failed: singular"):
        dwell_solvers.solve_qp(dwell_problem(radius_mm=6), 5, "clarabel")


@pytest.mark.parametrize(("within_s", "stopped", "asked"), [(100.0, "iterations", 2), (0.0, "deadline", 1)])
def test_what_a_backend_believes_of_its_answer_does_not_count(
    within_s: float, stopped: str, asked: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    problem = dwell_problem(radius_mm=6)
    programs = spied(monkeypatch, answer=-1.0)
    solution = dwell_solvers.solve_qp(problem, within_s)
    assert (solution.certificate.stopped, len(programs)) == (stopped, asked)
    np.testing.assert_array_equal(solution.time_s, problem.lower_s)
    assert solution.certificate.kkt_residual > 0.1


def test_the_time_that_is_left_is_what_the_backend_gets(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: dict[str, float] = {}

    def spy(program: qpsolvers.Problem, **options: float) -> qpsolvers.Solution:
        asked.update(options)
        return qpsolvers.Solution(program, x=np.zeros(program.q.shape))

    monkeypatch.setattr(qpsolvers, "solve_problem", spy)
    dwell_solvers.solve_qp(dwell_problem(radius_mm=6), 7.0, "clarabel")
    assert 0 < asked["time_limit"] <= 7.0


@pytest.mark.parametrize(("slowness", "asked"), [(1.0, [10.0]), (5.0, [10.0, 40.0])])
def test_a_backend_that_was_starved_is_asked_again_for_longer(
    slowness: float, asked: list[float], monkeypatch: pytest.MonkeyPatch
) -> None:
    """It counts wall seconds, and needs 7 of CPU: on a machine that is five times slower, 35."""
    given: list[float] = []
    cpu = 0.0

    def backend(program: qpsolvers.Problem, *, time_limit: float, **rest: object) -> qpsolvers.Solution:
        nonlocal cpu
        given.append(time_limit)
        used = min(time_limit / slowness, 7.0)
        cpu += used
        return qpsolvers.Solution(program, x=np.zeros(program.q.shape), found=used == 7.0)

    monkeypatch.setattr(time, "thread_time", lambda: cpu)
    monkeypatch.setattr(time, "monotonic", lambda: slowness * cpu)
    monkeypatch.setattr(qpsolvers, "solve_problem", backend)
    monkeypatch.setattr(dwell_solvers, "_forms", lambda problem, how: [True])
    dwell_solvers.solve_qp(dwell_problem(radius_mm=6), 10.0, "clarabel")
    assert given == pytest.approx(asked)


def test_out_of_time_it_says_so_or_refuses() -> None:
    try:
        certificate = dwell_solvers.solve_qp(dwell_problem(radius_mm=30), 0.02).certificate
    except ComputeError as error:
        assert "found no dwell within" in str(error)  # noqa: PT017  either is honest
    else:
        assert certificate.stopped == "deadline"
        assert certificate.bound_violation_s == 0
