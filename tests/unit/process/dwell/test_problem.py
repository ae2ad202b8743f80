"""Each malformed dwell problem is refused with one clear message; a solve has CPU seconds and a backstop."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
import pytest
from scipy import sparse

from polishd.model.errors import ComputeError
from polishd.model.surface import Grid
from polishd.process.dwell.newton_cg import solve
from polishd.process.dwell.problem import DwellProblem, TimeLimit, backstop_s, check
from polishd.process.removal.effect import SparseEffect
from tests.unit.process.gaussian import dwell_problem, scaled

GOOD = dwell_problem(radius_mm=6)
N = GOOD.effect.n


def changed(array: np.ndarray, index: object, value: float) -> np.ndarray:
    other = array.copy()
    other[index] = value
    return other


def effect(**entry: float) -> SparseEffect:
    matrix = GOOD.effect.matrix.copy()
    matrix.data[7] = entry["value"]
    return SparseEffect(GOOD.effect.grid, matrix)


INSIDE = tuple(np.argwhere(GOOD.metric_mask)[0])
OUTSIDE = tuple(np.argwhere(~GOOD.solve_mask)[0])

CASES = {
    "target shape": ({"target_nm": np.zeros((3, 3))}, r"target_nm is \(3, 3\), the effect's grid is \(22, 22\)"),
    "mask shape": ({"solve_mask": np.ones((3, 3), bool)}, "solve_mask is"),
    "metric shape": ({"metric_mask": np.ones((3, 3), bool)}, "metric_mask is"),
    "lower shape": ({"lower_s": np.zeros(3)}, rf"lower_s is \(3,\), the effect has {N} dwell points"),
    "upper shape": ({"upper_s": np.zeros((N, 1))}, "upper_s is"),
    "empty mask": ({"solve_mask": np.zeros((22, 22), bool)}, "solve_mask is empty"),
    "empty aperture": ({"metric_mask": np.zeros((22, 22), bool)}, "metric_mask is empty"),
    "metric outside": ({"metric_mask": changed(GOOD.metric_mask, OUTSIDE, True)}, "1 samples of metric_mask lie out"),
    "target nan": ({"target_nm": changed(GOOD.target_nm, INSIDE, np.nan)}, "not finite at 1 samples of solve_mask"),
    "target inf": ({"target_nm": changed(GOOD.target_nm, INSIDE, np.inf)}, "not finite at 1 samples of solve_mask"),
    "lower nan": ({"lower_s": changed(GOOD.lower_s, 5, np.nan)}, "lower_s is not finite at point 5"),
    "lower inf": ({"lower_s": changed(GOOD.lower_s, 5, np.inf)}, "lower_s is not finite at point 5"),
    "upper nan": ({"upper_s": changed(GOOD.upper_s, 6, np.nan)}, "upper_s is NaN at point 6"),
    "negative": ({"lower_s": changed(GOOD.lower_s, 8, -0.1)}, "lower_s is negative at point 8"),
    "contradiction": (
        {"upper_s": changed(GOOD.upper_s, slice(9, 12), 0.001)},
        r"lower_s is above upper_s at point 9 \(lower 0.02\d* s, upper 0.001 s\), 3 points in all",
    ),
    "P negative": ({"regularisation": -1.0}, "regularisation must be finite and not negative"),
    "P nan": ({"regularisation": float("nan")}, "regularisation must be finite and not negative"),
    "effect nan": ({"effect": effect(value=np.nan)}, "the effect is not finite"),
    "effect negative": ({"effect": effect(value=-1.0)}, "the effect is negative somewhere"),
    "effect zero": ({"effect": scaled(GOOD.effect, 0.0)}, "the effect is zero at every sample"),
}


@pytest.mark.parametrize(("changes", "message"), CASES.values(), ids=CASES.keys())
def test_refused(changes: dict, message: str) -> None:
    with pytest.raises(ComputeError, match=message):
        solve(replace(GOOD, **changes), 1.0)


def test_a_good_problem_passes_and_so_does_what_does_not_matter() -> None:
    check(GOOD)
    check(replace(GOOD, target_nm=changed(GOOD.target_nm, OUTSIDE, np.nan)))
    check(replace(GOOD, upper_s=np.full(N, np.inf), regularisation=0.0))
    check(replace(GOOD, upper_s=GOOD.lower_s))


def test_a_target_without_data_outside_the_mask_is_solved() -> None:
    blank = np.where(GOOD.solve_mask, GOOD.target_nm, np.nan)
    np.testing.assert_array_equal(solve(replace(GOOD, target_nm=blank), 5).time_s, solve(GOOD, 5).time_s)


def test_no_points() -> None:
    grid = Grid(2, 2, 1.0)
    ones = np.ones((2, 2), bool)
    nothing = SparseEffect(grid, sparse.csr_array((4, 0)))
    problem = DwellProblem(nothing, np.ones((2, 2)), ones, ones, np.zeros(0), np.zeros(0), 0.0)
    with pytest.raises(ComputeError, match="no dwell points"):
        check(problem)


class Twisted:
    """An effect that is no matrix, with an adjoint that answers something else."""

    grid = GOOD.effect.grid
    n = N

    def __init__(self, answer: np.ndarray) -> None:
        self.answer = answer

    def removal_nm(self, time_s: np.ndarray) -> np.ndarray:
        return np.zeros(self.grid.shape)

    def adjoint(self, weight: np.ndarray) -> np.ndarray:
        return self.answer


@pytest.mark.parametrize(
    ("answer", "message"),
    [
        (np.ones(3), r"adjoint answers \(3,\)"),
        (np.full(N, np.nan), "not finite"),
        (-np.ones(N), "negative"),
        (np.zeros(N), "zero at every sample"),
    ],
)
def test_effects_that_are_no_matrix_are_judged_by_their_adjoint(answer: np.ndarray, message: str) -> None:
    with pytest.raises(ComputeError, match=message):
        check(replace(GOOD, effect=Twisted(answer)))


class Clocks:
    """CPU and wall time as the test says."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.cpu = self.wall = 100.0
        monkeypatch.setattr(time, "thread_time", lambda: self.cpu)
        monkeypatch.setattr(time, "monotonic", lambda: self.wall)


def test_only_cpu_seconds_count(monkeypatch: pytest.MonkeyPatch) -> None:
    clocks = Clocks(monkeypatch)
    limit = TimeLimit(10.0)
    clocks.wall += backstop_s(10.0) - 0.1
    clocks.cpu += 9.0
    assert not limit.expired()
    assert limit.left_s == pytest.approx(1.0)
    assert str(limit) == "9.0 s of CPU time and 159.9 s of wall time"
    clocks.cpu += 1.0
    assert limit.expired()
    assert limit.left_s == 0.0


def test_what_uses_no_cpu_ends_at_the_backstop(monkeypatch: pytest.MonkeyPatch) -> None:
    clocks = Clocks(monkeypatch)
    limit = TimeLimit(10.0)
    clocks.wall += 160.0
    assert limit.expired()
    assert limit.left_s == 0.0
