"""Curves of residual against time: order, certificates, warm starts, rows, and the rules that choose a point."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache, partial

import numpy as np
import pytest

from polishd.model.dwell import DwellSolution
from polishd.model.errors import ComputeError
from polishd.process.dwell import interior_point
from polishd.process.dwell.certificate import certify_dwell
from polishd.process.dwell.problem import DwellProblem
from polishd.process.dwell.quadratic import quadratic
from polishd.process.dwell.residual_curve import CurvePoint, ResidualCurve, highest_price, price_curve, solve_once
from tests.unit.process.gaussian import dwell_problem

PROBLEM = dwell_problem(radius_mm=8, rho=1e-6, feed_mm_s=500)
solve = partial(interior_point.solve, within_s=30.0)


@cache
def whole_curve() -> ResidualCurve:
    """Sixteen solves, which collecting need not wait for."""
    return price_curve(PROBLEM, solve)


def made(pairs: list[tuple[float, float]]) -> ResidualCurve:
    """A curve of these total times and residuals."""
    points, first = [], whole_curve().points[0].solution
    for total_s, rms_nm in pairs:
        certificate = replace(first.certificate, dwell_total_s=total_s, predicted_rms_nm=rms_nm)
        points.append(CurvePoint(PROBLEM, replace(first, certificate=certificate)))
    return ResidualCurve(tuple(points))


def test_the_price_curve_trades_time_for_residual_and_every_point_is_certified() -> None:
    assert len(whole_curve().points) == 16
    assert whole_curve().points[-1].problem.price_nm2_per_s == 0
    misses = []
    for point in whole_curve().points:
        c = point.solution.certificate
        assert (c.stopped, c.bound_violation_s) == ("converged", 0)
        assert c.kkt_residual <= 1e-8
        # the certificate is that of the problem that stands beside it
        anew = certify_dwell(point.problem, point.solution.time_s, solver="", iterations=0, seconds=0, stopped="")
        assert anew.certificate.objective == c.objective
        misses.append(quadratic(replace(point.problem, price_nm2_per_s=0.0)).value(point.solution.time_s))
    totals = [point.total_s for point in whole_curve().points]
    assert totals == sorted(totals)
    assert misses == sorted(misses, reverse=True)
    assert misses[0] > 10 * misses[-1]


def test_no_dwell_of_the_curve_is_beaten_at_its_own_time() -> None:
    """Pareto: the others' price-free objective is lower only with more time."""
    free = quadratic(PROBLEM)
    front = [(point.total_s, free.value(point.solution.time_s)) for point in whole_curve().points]
    held = [
        solve_once(replace(PROBLEM, regularisation=PROBLEM.regularisation * 10.0**k), solve) for k in range(4, -7, -1)
    ]
    others = [(p.total_s, free.value(p.solution.time_s)) for p in held]
    for total_s, miss in others:
        quicker = [m for t, m in front if t <= total_s]
        slower = [m for t, m in front if t >= total_s]
        if quicker and slower:
            assert miss > min(slower) * (1 - 1e-9)


def test_each_point_starts_from_the_last() -> None:
    seen: list[DwellSolution | None] = []

    def spy(problem: DwellProblem) -> DwellSolution:
        seen.append(problem.warm)
        return solve(problem)

    first = solve(PROBLEM)
    curve = price_curve(replace(PROBLEM, warm=first), spy, [1.0, 0.1, 0.0])
    assert seen == [first, curve.points[0].solution, curve.points[1].solution]
    assert all(point.problem.warm is None for point in curve.points)  # or the whole path would stay in memory


def test_at_the_highest_price_nothing_is_polished_and_just_below_something_is() -> None:
    top = highest_price(PROBLEM)
    at, below = price_curve(PROBLEM, solve, [top, 0.9 * top]).points
    assert at.total_s == pytest.approx(PROBLEM.lower_s.sum(), rel=1e-6)
    assert below.total_s > 1.001 * at.total_s
    assert highest_price(replace(PROBLEM, target_nm=np.zeros_like(PROBLEM.target_nm))) == 0


def test_p_that_conditions_no_more_is_noted() -> None:
    noted = [
        any("ill-conditioned" in note for note in solve_once(problem, solve).solution.certificate.notes)
        for problem in (PROBLEM, replace(PROBLEM, regularisation=0.0))
    ]
    assert noted == [False, True]


def test_rows_are_json_and_say_what_was_asked() -> None:
    rows = json.loads(json.dumps(whole_curve().rows()))
    assert len(rows) == len(whole_curve().points)
    assert rows[3]["price_nm2_per_s"] == whole_curve().points[3].problem.price_nm2_per_s
    assert rows[3]["rms_nm"] == whole_curve().points[3].rms_nm
    assert {"total_s", "pv_nm", "kkt_residual", "stopped", "notes", "regularisation", "piston_nm"} <= set(rows[0])


def test_choosing_by_target_and_by_budget() -> None:
    curve = made([(10, 5.0), (20, 2.0), (40, 1.0), (80, 0.9)])
    assert curve.at_target(2.0).total_s == 20
    assert curve.at_target(1.5).total_s == 40
    assert curve.within(79).rms_nm == 1.0
    assert curve.within(80).rms_nm == 0.9
    with pytest.raises(ComputeError, match=r"reaches 0.5 nm RMS: the best is 0.9 nm in 80 s"):
        curve.at_target(0.5)
    with pytest.raises(ComputeError, match=r"at most 9 s: the quickest takes 10"):
        curve.within(9)


@pytest.mark.parametrize(
    ("pairs", "knee_s"),
    [
        ([(10, 5.0), (20, 2.0), (40, 0.9), (80, 0.8)], 40),  # 20 -> 40 s: twice the time, less than half the residual
        ([(10, 5.0), (20, 2.0), (40, 1.1), (80, 1.0)], 20),
        ([(1, 5.0), (10, 4.9), (20, 0.1), (40, 0.09)], 20),  # the flat stretch at the beginning is no knee
        ([(10, 5.0), (20, 2.0), (40, 0.5)], 40),  # it still pays at the end
        ([(10, 5.0)], 10),
        ([(80, 0.8), (40, 0.9), (10, 5.0), (20, 2.0)], 40),  # whatever the order
    ],
)
def test_the_knee(pairs: list[tuple[float, float]], knee_s: float) -> None:
    assert made(pairs).knee().total_s == knee_s


def test_a_longer_tail_does_not_move_the_knee() -> None:
    pairs = [(10, 5.0), (20, 2.0), (40, 0.9), (80, 0.8)]
    assert made([*pairs, (160, 0.79), (1000, 0.78)]).knee().total_s == made(pairs).knee().total_s == 40


def test_what_cannot_be_walked_is_refused() -> None:
    with pytest.raises(ComputeError, match="at least one point"):
        price_curve(PROBLEM, solve, [])
    with pytest.raises(ComputeError, match="price of time"):
        price_curve(PROBLEM, solve, [-1.0])
    with pytest.raises(ComputeError, match="regularisation must be finite"):
        price_curve(replace(PROBLEM, regularisation=float("nan")), solve)
