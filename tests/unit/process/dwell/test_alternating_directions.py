"""Alternating directions against projected Newton-CG, which shares no step with it."""

from __future__ import annotations

import time
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from polishd.model.dwell import WarmStart
from polishd.model.errors import ComputeError
from polishd.model.surface import FloatArray
from polishd.plugins.dwell_solvers import solve_auto
from polishd.process.dwell import alternating_directions, alternating_step, newton_cg
from polishd.process.dwell.lower_bound import prove_lower_bound
from polishd.process.dwell.problem import DwellProblem, negligible_share, without_traces
from polishd.process.dwell.quadratic import quadratic, regularisation_from_rho
from polishd.process.removal import combined_effect
from polishd.process.removal.effect import SparseEffect
from polishd.process.removal.spread_effect import SpreadEffect
from tests.unit.process.moves import inward_program
from tests.unit.process.removal.test_spread_effect import GRID, both, moves

DISC = GRID.radius_mm() < 19


def raster(step_mm: float = 1.0) -> FloatArray:
    """(n, 2) points of lines to and fro over the grid and a little more."""
    line = np.arange(-22, 22.01, step_mm)
    return np.concatenate([np.column_stack([line[:: (-1) ** k], np.full(line.size, y)]) for k, y in enumerate(line)])


@cache
def problem(path: str = "raster", rho: float = 1e-3) -> DwellProblem:
    """A figure of which some lies too deep, so that bounds hold."""
    points = raster()
    program = inward_program(points[:-1], points[1:]) if path == "raster" else moves(1500)
    quick, _ = both(program)
    x, y = GRID.axes_mm
    target = np.maximum(100 + 140 * np.sin(x / 6) * np.cos(y / 7), 0.0)
    n = program.n
    p = regularisation_from_rho(quick, DISC, rho)
    return DwellProblem(quick, target, DISC, DISC, np.full(n, 1e-4), np.full(n, 0.5), p)


def agree(asked: DwellProblem, solver: str = alternating_directions.NAME) -> None:
    found, want = alternating_directions.solve(asked, 120.0, 1e-5, 0.0), newton_cg.solve(asked, 120.0, 1e-6)
    assert found.certificate.solver == solver
    assert found.certificate.stopped == "converged"
    assert found.certificate.kkt_residual <= 1e-5
    value = quadratic(asked).value
    at_lower = value(asked.lower_s)
    assert value(found.time_s) - value(want.time_s) < 1e-6 * (at_lower - value(want.time_s))
    assert (found.time_s >= asked.lower_s).all()
    assert (found.time_s <= asked.upper_s).all()


@pytest.mark.full
def test_it_finds_what_projected_newton_finds() -> None:
    asked = problem()
    agree(asked)
    found = alternating_directions.solve(asked, 120.0)
    assert (found.time_s <= asked.lower_s).mean() > 0.05, "no bound holds: this shows little"


@pytest.mark.full
def test_it_finds_it_on_a_path_that_is_here_dense_and_there_thin() -> None:
    """Where the metric, which is of a path that is everywhere as dense, is a bad one."""
    agree(problem("anywhere"))


@pytest.mark.full
def test_where_steps_lead_nowhere_projected_newton_goes_on(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(alternating_directions, "STALLED", 0.0)
    monkeypatch.setattr(alternating_directions, "LOOKS", 1)
    asked = problem()
    begun_s = time.thread_time()
    found = alternating_directions.solve(asked, 120.0, 1e-7, 0.0).certificate
    spent_s = time.thread_time() - begun_s
    assert (found.solver, found.stopped) == (newton_cg.NAME, "converged")
    assert found.kkt_residual <= 1e-7
    assert 0.8 * spent_s < found.seconds <= spent_s, "both solvers' time"


@pytest.mark.full
@pytest.mark.parametrize("pull", [0.1, 30.0])
def test_too_weak_a_pull_is_noticed_and_too_strong_a_one_only_takes_longer(
    pull: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(alternating_step, "PULL", pull)
    found = alternating_directions.solve(problem(), 120.0, 1e-5, 0.0).certificate
    assert (found.solver, found.stopped) == (alternating_directions.NAME, "converged")


@pytest.mark.full
def test_it_finds_it_where_an_upper_bound_holds() -> None:
    asked = problem()
    free = alternating_directions.solve(asked, 120.0).time_s
    agree(replace(asked, upper_s=np.full(free.size, float(np.quantile(free, 0.8)))))


@pytest.mark.full
def test_weights_and_the_price_of_time_have_their_part() -> None:
    asked = problem()
    weighed = replace(asked, weight=np.where(GRID.radius_mm() < 9, 2.0, 1.0), price_nm2_per_s=0.5)
    agree(weighed)
    assert (
        alternating_directions.solve(weighed, 120.0).time_s.sum()
        < alternating_directions.solve(asked, 120.0).time_s.sum()
    )


@pytest.mark.full
def test_little_regularisation_takes_longer_and_comes_there() -> None:
    agree(problem(rho=1e-4))


@pytest.mark.full
def test_steps_in_float32_come_closer_than_float32() -> None:
    """Where it stands is found in float64, and what steps were off by is put right."""
    found = alternating_directions.solve(problem(), 120.0, 1e-9, 0.0).certificate
    assert found.solver == alternating_directions.NAME
    assert found.kkt_residual <= 1e-9


@pytest.mark.full
def test_a_gap_that_is_proved_to_be_small_is_enough() -> None:
    asked = problem()
    soon, whole = (
        alternating_directions.solve(asked, 120.0, 0.0, 1e-3).certificate,
        alternating_directions.solve(asked, 120.0, 0.0, 1e-7).certificate,
    )
    assert soon.iterations < whole.iterations
    assert soon.gap is not None
    assert soon.gap <= 1e-3
    assert soon.kkt_residual <= alternating_directions.ACCEPTED
    assert soon.objective <= whole.objective * (1 + 1e-3)


@pytest.mark.full
def test_a_sharper_proof_is_found_by_the_coarser_effect_and_holds() -> None:
    asked = problem(rho=1e-5)
    found = alternating_directions.solve(asked, 120.0, 1e-4, 0.0)
    sharper = prove_lower_bound(asked, found, 1e-6, 60.0).certificate
    assert found.certificate.gap is not None
    assert sharper.gap is not None
    assert sharper.gap < 0.2 * found.certificate.gap
    best = alternating_directions.solve(asked, 120.0, 1e-7, 0.0).certificate.objective
    assert found.certificate.objective - best <= sharper.gap * found.certificate.objective


@pytest.mark.full
def test_what_the_effect_is_off_by_is_said_in_nm_too() -> None:
    asked = problem()
    found = alternating_directions.solve(asked, 120.0)
    effect = asked.effect
    assert isinstance(effect, SpreadEffect)
    off_nm = effect.error * found.removal_nm.max()
    assert effect.note in found.certificate.notes
    assert f"without a matrix this removal is off by up to {off_nm:.2g} nm" in found.certificate.notes


@pytest.mark.full
def test_steps_on_a_coarser_grid_come_to_the_same_dwell() -> None:
    asked = problem()
    effect = asked.effect
    assert isinstance(effect, SpreadEffect)
    plain = alternating_directions.solve(replace(asked, effect=replace(effect, coarse=None)), 120.0, 1e-7, 0.0)
    assert effect.coarse is not None
    found = alternating_directions.solve(asked, 120.0, 1e-7, 0.0)
    assert np.abs(found.removal_nm - plain.removal_nm)[DISC].max() < 1e-3 * plain.removal_nm.max()


@pytest.mark.full
def test_a_warm_start_is_soon_there() -> None:
    asked = problem()
    cold = alternating_directions.solve(asked, 120.0, 1e-5, 0.0)
    nearly = replace(asked, target_nm=asked.target_nm * 1.002)
    again = alternating_directions.solve(replace(nearly, warm=WarmStart(cold.time_s, {})), 120.0, 1e-5, 0.0)
    assert again.certificate.kkt_residual <= 1e-5
    assert (
        again.certificate.iterations
        < 0.7 * alternating_directions.solve(nearly, 120.0, 1e-5, 0.0).certificate.iterations
    )


@pytest.mark.full
def test_out_of_time_it_returns_what_it_has_and_says_so() -> None:
    asked = problem()
    found = alternating_directions.solve(asked, 0.0)
    assert found.certificate.stopped == "deadline"
    assert (found.time_s >= asked.lower_s).all()


@pytest.mark.full
def test_the_default_takes_it_where_there_is_no_matrix() -> None:
    assert solve_auto(problem(), 120.0).certificate.solver == alternating_directions.NAME


def test_traces_below_zero_are_nothing_and_more_stays_to_be_refused() -> None:
    """Of a plan of 500 mm: 0.16 nm of 1,188, where the path ends."""
    cleared = without_traces(np.array([[1188.0, -0.16], [0.5, -1.3]]), negligible_share(problem().effect))
    assert cleared.tolist() == [[1188.0, 0.0], [0.5, -1.3]]
    assert without_traces(np.array([[-1.0]]), 1e-3).tolist() == [[-1.0]]


@pytest.mark.full
def test_another_effect_is_refused() -> None:
    asked = problem()
    assert isinstance(asked.effect, SpreadEffect)
    matrix = SparseEffect(GRID, both(moves())[1].matrix)
    few = replace(asked, effect=matrix, lower_s=np.zeros(2000), upper_s=np.full(2000, np.inf))
    with pytest.raises(ComputeError, match="needs an effect without a matrix"):
        alternating_directions.solve(few, 1.0)


@pytest.mark.full
def test_compiled_steps_come_to_the_same_dwell(monkeypatch: pytest.MonkeyPatch) -> None:
    """With weights, and a bound above that holds at some points."""
    asked = problem()
    some = float(np.quantile(alternating_directions.solve(asked, 120.0).time_s, 0.9))
    weighed = replace(asked, weight=np.where(GRID.radius_mm() < 9, 2.0, 1.0), upper_s=np.full(asked.upper_s.size, some))
    plain = alternating_directions.solve(weighed, 120.0, 1e-7, 0.0)
    monkeypatch.setattr(combined_effect, "COMPILED_BLOCKS", 0)
    found = alternating_directions.solve(weighed, 120.0, 1e-7, 0.0)
    assert found.certificate.kkt_residual <= 1e-7
    assert found.certificate.iterations == pytest.approx(plain.certificate.iterations, rel=0.2)
    np.testing.assert_allclose(found.time_s, plain.time_s, atol=1e-4 * plain.time_s.max())
