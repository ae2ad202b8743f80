"""The default solver takes the right one of polishd's own, and hands its answer through."""

from __future__ import annotations

from dataclasses import replace

import pytest

from polishd.model.errors import ComputeError
from polishd.process.dwell import automatic
from polishd.process.dwell.quadratic import regularisation_from_rho
from tests.unit.process.gaussian import dwell_problem
from tests.unit.process.lattices import as_matrix, lattice_problem


def test_convolutions_are_split_and_matrices_are_not() -> None:
    problem = lattice_problem(radius_mm=9.0)
    split, written = (automatic.solve(p, 30.0) for p in (problem, as_matrix(problem)))
    assert split.certificate.solver == "douglas_rachford"
    assert written.certificate.solver == "newton_cg"
    assert split.certificate.objective == pytest.approx(written.certificate.objective, rel=1e-4)


def test_an_ill_conditioned_matrix_is_factorised() -> None:
    problem = dwell_problem(radius_mm=8)
    ill = replace(problem, regularisation=regularisation_from_rho(problem.effect, problem.solve_mask, 1e-8))
    assert automatic.solve(ill, 30.0).certificate.solver == "interior_point"
    assert automatic.solve(problem, 30.0).certificate.solver == "newton_cg"


def test_many_points_are_not(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = dwell_problem(radius_mm=8)
    monkeypatch.setattr(automatic, "FEW", problem.effect.n - 1)
    ill = replace(problem, regularisation=regularisation_from_rho(problem.effect, problem.solve_mask, 1e-7))
    assert automatic.solve(ill, 30.0).certificate.solver == "newton_cg"


def test_a_malformed_problem_is_refused_as_ever() -> None:
    problem = dwell_problem(radius_mm=8)
    with pytest.raises(ComputeError, match="lower_s is negative"):
        automatic.solve(replace(problem, lower_s=problem.lower_s - 1), 1.0)
