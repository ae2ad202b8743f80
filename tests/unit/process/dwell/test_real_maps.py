"""Two published mirrors, through the public array API: the whole curve against exact solutions."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from polishd.model.surface import FloatArray
from polishd.process.dwell import interior_point, newton_cg
from polishd.process.dwell.certificate import certify_dwell
from polishd.process.dwell.from_arrays import DwellCase, array_problem, dwell_from_arrays
from polishd.process.dwell.problem import DwellProblem
from polishd.process.dwell.residual_curve import CurvePoint, floor_cost, highest_price, price_curve, solve_within_budget
from tests.unit.process.dwell.exact_dwell import by_nnls, by_pivoting, clipped_lsmr, fista, richardson_lucy

pytestmark = pytest.mark.full

TIF_PITCH_MM = 0.25
CASES = {
    # rows, columns, peak nm/s, sigma mm, points, RMS at the start
    "xray": (slice(19, 62), slice(26, 553), 10.0, 1.0, 5226, 145.0),
    "elongated": (slice(103, 145), slice(82, 498), 0.4, 2.7752 / np.sqrt(8 * np.log(2)), 915, 18.0),
}
solve = partial(interior_point.solve, within_s=60.0)


def mirror(folder: Path, name: str) -> DwellCase:
    """The case exactly as the data's README defines it."""
    rows, columns, peak, sigma, *_ = CASES[name]
    with np.load(folder / f"{name}_mirror_map.npz") as file:
        x, y, z = (file[key][rows, columns] * factor for key, factor in (("X", 1e3), ("Y", 1e3), ("Z", 1e9)))
    plane = np.stack([np.ones(z.size), x.ravel(), y.ravel()], axis=1)
    z = z - (plane @ np.linalg.lstsq(plane, z.ravel())[0]).reshape(z.shape)
    u = np.arange(-5, 5 + 1e-9, TIF_PITCH_MM)
    r = np.hypot(u[None, :], u[:, None])
    tif = np.where(r <= 5, peak * np.exp(-(r**2) / (2 * sigma**2)), 0.0)
    return DwellCase(x, y, z - z.min(), tif, TIF_PITCH_MM)


@pytest.fixture(params=CASES)
def named(request: pytest.FixtureRequest, shared_data: Path) -> tuple[str, DwellCase]:
    return request.param, mirror(shared_data, request.param)


def off(found: CurvePoint, exact_s: FloatArray) -> float:
    """Return the relative difference of the residual RMS from the exact one's."""
    exact = certify_dwell(found.problem, exact_s, solver="exact", iterations=0, seconds=0, stopped="").certificate
    assert exact.kkt_residual < 1e-8
    assert exact.objective == pytest.approx(found.solution.certificate.objective, rel=1e-7)
    return abs(found.rms_nm / exact.predicted_rms_nm - 1)


def test_the_cases_are_the_published_ones(named: tuple[str, DwellCase]) -> None:
    name, case = named
    _, _, peak, sigma, points, start_nm = CASES[name]
    assert case.height_nm.std() == pytest.approx(start_nm, rel=0.015)
    problem, at = array_problem(case)
    assert at.shape == (points, 2)
    # the spline against the Gaussian itself, at every sample of some columns
    x, y = np.asarray(case.x_mm), np.asarray(case.y_mm)
    for k in (0, points // 3, points // 2):
        r2 = (x - at[k, 0]) ** 2 + (y - at[k, 1]) ** 2
        gauss = np.where(r2 <= 25, peak * np.exp(-r2 / (2 * sigma**2)), 0.0)
        assert np.abs(problem.effect.removal_nm(np.eye(1, points, k)[0]) - gauss).max() < 3e-4 * peak


def test_the_curve_is_exact_from_end_to_end(named: tuple[str, DwellCase]) -> None:
    problem, _ = array_problem(named[1])
    prices = highest_price(problem) * np.array([1e-1, 1e-3, 1e-5, 0.0])
    curve = price_curve(problem, solve, prices)
    for point in curve.points:
        assert point.solution.certificate.stopped == "converged"
        assert point.solution.certificate.kkt_residual <= 1e-8
        assert off(point, by_pivoting(point.problem, point.solution.time_s)) < 1e-4
    totals, misses = [p.total_s for p in curve.points], [p.rms_nm for p in curve.points]
    assert totals == sorted(totals)
    assert misses == sorted(misses, reverse=True)


@pytest.mark.parametrize("rho", [1e-8, 1e-12])
def test_it_agrees_with_nnls_which_starts_from_nothing(shared_data: Path, rho: float) -> None:
    problem, _ = array_problem(replace(mirror(shared_data, "elongated"), rho=rho))
    found = CurvePoint(problem, solve(problem))
    assert off(found, by_nnls(problem)) < 1e-5


def test_newton_cg_comes_within_a_hundredth_where_p_is_moderate(shared_data: Path) -> None:
    problem, _ = array_problem(replace(mirror(shared_data, "elongated"), rho=1e-5))
    exact = solve(problem).certificate.predicted_rms_nm
    assert newton_cg.solve(problem, 60, 1e-6).certificate.predicted_rms_nm == pytest.approx(exact, rel=1e-2)


def figures(problem: DwellProblem, time_s: FloatArray) -> tuple[float, float]:
    """Return RMS and total time of a dwell."""
    return float((problem.target_nm - problem.effect.removal_nm(time_s)).std()), float(time_s.sum())


@pytest.mark.slow
def test_fista_is_not_better_in_its_own_time(named: tuple[str, DwellCase]) -> None:
    problem, _ = array_problem(replace(named[1], rho=1e-10))
    rms_nm, total_s = figures(problem, fista(problem, 200))
    ours = solve_within_budget(problem, total_s, solve, tolerance=2e-2)
    assert ours.total_s <= total_s
    assert ours.rms_nm < 0.97 * rms_nm


@pytest.mark.slow
def test_nor_is_any_other_method_of_the_literature(named: tuple[str, DwellCase]) -> None:
    problem, _ = array_problem(replace(named[1], rho=1e-10))
    for theirs in (clipped_lsmr(problem, 100), clipped_lsmr(problem, 1000), richardson_lucy(problem, 100)):
        rms_nm, total_s = figures(problem, theirs)
        assert solve_within_budget(problem, total_s, solve, tolerance=1e-2).rms_nm < 0.95 * rms_nm


@pytest.mark.slow
def test_the_knee_is_a_sensible_choice(shared_data: Path) -> None:
    problem, _ = array_problem(mirror(shared_data, "elongated"))
    curve = price_curve(problem, solve, highest_price(problem) * np.array([1e-2, 1e-4, 1e-5, 1e-6, 0.0]))
    best, knee = curve.points[-1], curve.knee()
    assert knee.rms_nm < 1.03 * best.rms_nm
    assert knee.total_s < 0.7 * best.total_s


def test_a_floor_costs_time_and_no_residual_where_time_may_be_spent(named: tuple[str, DwellCase]) -> None:
    problem, _ = array_problem(replace(named[1], lower_s=0.2))
    cost = floor_cost(problem, solve)
    assert (cost.raised.solution.time_s >= 0.2).all()
    assert cost.raised.rms_nm < 1.02 * cost.free.rms_nm
    assert cost.bounded.rms_nm > 1.04 * cost.free.rms_nm  # at the same target it digs
    assert 0 < cost.raised.total_s - cost.free.total_s < 1.5 * problem.lower_s.sum()
    clipped = np.maximum(cost.free.solution.time_s, 0.2)
    assert figures(problem, clipped)[0] > 1.02 * cost.bounded.rms_nm


def test_arbitrary_points_through_the_arrays(shared_data: Path) -> None:
    case = mirror(shared_data, "elongated")
    lattice = dwell_from_arrays(case)
    rng = np.random.default_rng(0)
    moved = lattice.points_mm + rng.uniform(-0.3, 0.3, lattice.points_mm.shape)
    moved = np.clip(moved, lattice.points_mm.min(axis=0), lattice.points_mm.max(axis=0))
    found = dwell_from_arrays(replace(case, points_mm=rng.permutation(moved)))
    assert found.certificate.kkt_residual <= 1e-8
    assert found.certificate.predicted_rms_nm < 1.5 * lattice.certificate.predicted_rms_nm
    assert off(CurvePoint(found.problem, found.solution), by_nnls(found.problem)) < 1e-5
