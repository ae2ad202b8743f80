"""What passes show of a tool that wears or changes: on synthetic passes, with how often it is wrong."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from polishd.model.surface import FloatArray, Grid
from polishd.process.dwell import newton_cg
from polishd.process.identification.findings import SIGMAS, WearIndicators, half_width_mm, traces
from polishd.process.removal.effect import SparseEffect
from polishd.process.removal.transfer_function import SpotTransferFunction
from polishd.process.toolpath.apertures import circle
from polishd.process.toolpath.paths import raster
from tests.unit.process.gaussian import dwell_problem, spot_effect

SPOT_MM = 0.9


@dataclass(frozen=True)
class Passed:
    """A pass on a part of 40 mm, solved and run: what was predicted of it, and what two maps say."""

    seed: int
    fade: float = 0.0
    width: float = 0.0
    noise_nm: float = 0.15
    figure_nm: float = 18.5

    def shows(self) -> WearIndicators:
        rng = np.random.default_rng(self.seed)
        problem = dwell_problem(20.0, self.seed)
        grid, scale = problem.effect.grid, self.figure_nm / 18.5
        dwell = newton_cg.solve(problem, 60.0).time_s
        time_s = problem.lower_s + scale * (dwell - problem.lower_s)
        late = np.cumsum(time_s) / time_s.sum() - 0.5
        effect = _effect(grid, 1.0)
        true = _effect(grid, 1.0 + self.width)
        removed = rng.uniform(0.8, 1.2) * true.removal_nm(time_s * (1 + self.fade * late))
        noise = self.noise_nm * np.sqrt(2) * rng.standard_normal(grid.shape) + _bent(grid, rng.normal(0, 1.0, 3))
        mask = problem.metric_mask
        predicted, lately = effect.removal_nm(time_s), effect.removal_nm(time_s * late)
        return traces(predicted, lately, removed + noise, mask, pitch_mm=grid.pitch_mm, spot_mm=SPOT_MM)


def _effect(grid: Grid, wider: float) -> SparseEffect:
    points = _middle()
    rate = 100 * (1 + 0.05 * np.sin(points[:, 0] / 20)) / wider**2
    return spot_effect(grid, points, SPOT_MM * wider, rate)


def _middle() -> FloatArray:
    points = raster(circle(38.0), 1.0, 1.0)
    return np.asarray((points[1:] + points[:-1]) / 2)


def _bent(grid: Grid, sizes_nm: FloatArray) -> FloatArray:
    """Power and astigmatism by which two maps differ through the set-up."""
    x, y = np.meshgrid(grid.x_mm / 20.0, grid.y_mm / 20.0)
    return np.asarray(np.tensordot(sizes_nm / 2.4, [2 * (x**2 + y**2) - 1, x**2 - y**2, 2 * x * y], 1))


def beyond(value: float, sigma: float, limit: float) -> bool:
    return abs(value) > max(limit, SIGMAS * sigma)


@pytest.mark.parametrize("fade", [-0.3, 0.3])
def test_a_rate_that_changes_during_the_pass_is_seen(fade: float) -> None:
    found = Passed(3, fade=fade).shows()
    assert found.fade == pytest.approx(fade, abs=3 * found.fade_sigma + 0.02)
    assert abs(found.fade) > SIGMAS * found.fade_sigma
    assert abs(found.width) < 0.1


@pytest.mark.parametrize("width", [-0.2, 0.3])
def test_a_spot_of_another_width_is_seen(width: float) -> None:
    found = Passed(3, width=width).shows()
    assert found.width == pytest.approx(width, rel=0.4)
    assert abs(found.width) > SIGMAS * found.width_sigma
    assert abs(found.fade) < 0.1


def test_a_pass_that_removes_nothing_uneven_shows_nothing() -> None:
    assert Passed(1, figure_nm=0.5).shows() == WearIndicators()


@pytest.mark.parametrize("seeds", [12, pytest.param(160, marks=[pytest.mark.slow, pytest.mark.timeout(3600)])])
def test_how_often_a_good_pass_shows_what_is_not_there(seeds: int) -> None:
    """At limits of 10 %, well below those shipped."""
    rng = np.random.default_rng(7)
    shown = [Passed(s, noise_nm=rng.uniform(0.1, 0.5), figure_nm=rng.uniform(4, 20)).shows() for s in range(seeds)]
    assert sum(beyond(one.fade, one.fade_sigma, 0.1) for one in shown) == 0
    assert sum(beyond(one.width, one.width_sigma, 0.1) for one in shown) == 0


def test_the_half_width_of_a_transfer_function() -> None:
    frequency = np.linspace(0.0, 1.0, 400)
    gaussian = np.exp(-((2 * np.pi * frequency * SPOT_MM) ** 2) / 2)
    assert half_width_mm(SpotTransferFunction(frequency, gaussian, 0.05, 2.0, None)) == pytest.approx(SPOT_MM, rel=0.03)
    assert half_width_mm(SpotTransferFunction(np.zeros(1), np.ones(1), 0.05, 5.0, None)) == 0.0
