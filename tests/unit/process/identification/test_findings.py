"""Stall, drift, wear and another spot, separated by the figures of the passes.

What passes show of a tool that wears or changes: on synthetic passes, with how often it is wrong.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pytest

from polishd.model.estimates import Estimate, Finding, FindingLimits, PassIndicators, PassSeries
from polishd.model.surface import FloatArray, Grid
from polishd.process.dwell import newton_cg
from polishd.process.identification.findings import (
    REFERENCE,
    SIGMAS,
    WearIndicators,
    extend_series,
    findings,
    half_width_mm,
    traces,
)
from polishd.process.removal.effect import SparseEffect
from polishd.process.removal.transfer_function import SpotTransferFunction
from polishd.process.toolpath.apertures import circle
from polishd.process.toolpath.paths import raster
from tests.unit.process.gaussian import dwell_problem, spot_effect

LIMITS = FindingLimits()
HOUR = 3600.0


def a_pass(
    before: float = 10.0,
    after: float = 1.2,
    predicted: float | None = 1.0,
    *,
    reach: float | None = 1.0,
    hours: float = 1.0,
    rate: float | None = 1.0,
    rate_sigma: float = 0.01,
    fade: tuple[float, float] | None = (0.0, 0.02),
    width: tuple[float, float] | None = (0.0, 0.03),
) -> PassIndicators:
    return PassIndicators(
        before,
        predicted,
        after,
        reach,
        hours * HOUR,
        None if rate is None else Estimate(rate, rate_sigma),
        None if fade is None else Estimate(*fade),
        None if width is None else Estimate(*width),
    )


def found(passes: Sequence[PassIndicators], limits: FindingLimits = LIMITS) -> list[Finding]:
    """In all of them, a job each."""
    series, seen = PassSeries("p"), []
    for one in passes:
        series = extend_series(series, one)
        seen += findings(series, [one], limits)
    return seen


def kinds(passes: Sequence[PassIndicators]) -> list[str]:
    return [one.kind for one in found(passes)]


def test_good_passes_show_nothing() -> None:
    assert found([a_pass(rate=rate) for rate in (0.95, 1.0, 0.97, 1.02, 0.93, 1.1)]) == []


def test_a_rate_that_falls_while_the_tool_polishes_is_wear() -> None:
    rates = [1.0 * 0.93**k for k in range(8)]
    (first, *_) = found([a_pass(rate=rate, fade=(-0.07, 0.02)) for rate in rates])
    assert (first.kind, first.stops) == ("wear", "cell")
    assert "changed by -25 +- " in first.what
    assert "in 6 passes, 6.0 h in contact, and it falls while the tool polishes: dress or change" in first.what


def test_a_rate_that_falls_between_the_passes_is_drift() -> None:
    (first, *_) = found([a_pass(rate=rate) for rate in (1.0, 1.0, 1.0, 0.9, 0.8, 0.7)])
    assert (first.kind, first.stops) == ("drift", "cell")
    assert "and not within the passes: look at slurry, temperature, force and speed" in first.what


@pytest.mark.parametrize("fade", [None, (-0.05, 0.2)])
def test_a_fade_without_a_known_place_says_so(fade: tuple[float, float] | None) -> None:
    (first, *_) = found([a_pass(rate=rate, fade=fade) for rate in (1.0, 1.0, 1.0, 0.7)])
    assert first.kind == "drift"
    assert "within the passes or between them: look at slurry" in first.what


def test_a_rate_that_rises_is_no_wear() -> None:
    assert kinds([a_pass(rate=rate, fade=(0.1, 0.02)) for rate in (1.0, 1.0, 1.0, 1.4)]) == ["drift"]


def test_a_pad_that_wears_within_one_pass_needs_no_other_pass() -> None:
    (only,) = found([a_pass(fade=(-0.35, 0.05), hours=0.5)])
    assert (only.kind, only.stops) == ("wear", "cell")
    assert only.what.startswith("the removal rate changed by -35 +- 5 % during one pass of 30 min")


@pytest.mark.parametrize(
    "passes",
    [
        [a_pass(fade=(-0.35, 0.15))],
        [a_pass(width=(0.4, 0.15))],
        [a_pass(width=(0.34, 0.08))],
        [a_pass()] * REFERENCE + [a_pass(rate=0.6, rate_sigma=0.2)],
        [a_pass()] * (REFERENCE - 1) + [a_pass(rate=0.6)],
        [a_pass(rate=None, fade=None, width=None)] * 5,
    ],
    ids=["fade", "width", "width near its limit", "rate", "no reference yet", "shows nothing"],
)
def test_what_is_not_sure_is_not_found(passes: Sequence[PassIndicators]) -> None:
    assert found(passes) == []


@pytest.mark.parametrize(("width", "word"), [(0.45, "wider"), (-0.42, "narrower")])
def test_another_spot(width: float, word: str) -> None:
    (only,) = found([a_pass(width=(width, 0.05))])
    assert (only.kind, only.stops) == ("spot", "cell")
    assert f"{100 * abs(width):.0f} +- 5 % {word} than the plans count with" in only.what


def stalls(job: Sequence[PassIndicators], limits: FindingLimits = LIMITS) -> list[str]:
    series = PassSeries("p")
    for one in job:
        series = extend_series(series, one)
    return [one.what for one in findings(series, job, limits) if one.kind == "stall"]


def test_two_passes_in_a_row_that_bring_little_are_a_stall() -> None:
    slow = [a_pass(10.0, 3.0), a_pass(3.0, 2.8, 1.0), a_pass(2.8, 2.7, 1.0, reach=0.4)]
    assert stalls(slow[:2]) == []
    (what,) = stalls(slow)
    assert what.startswith("the last 2 passes brought the RMS from 3.00 to 2.70 nm, and 1.00 and 1.00 were predicted")
    assert what.endswith("0.40 nm of what is left has periods that this spot corrects: take another tool, or tolerance")


def test_a_plan_that_expects_nothing_gains_nothing() -> None:
    assert stalls([a_pass(2.0, 1.99, 1.98), a_pass(1.99, 1.9, 1.97)])
    assert stalls([a_pass(2.0, 2.0, None), a_pass(2.0, 2.0, None)]) == [], "no prediction, so no finding"
    assert stalls([a_pass(2.0, 2.0, 1.0)] * 2, FindingLimits(min_improvement=0.0)) == []


def test_what_is_left_within_reach_is_looked_for_in_the_report() -> None:
    (what,) = stalls([a_pass(3.0, 2.9, 1.0, reach=2.5), a_pass(2.9, 2.8, 1.0, reach=2.5)])
    assert what.endswith("look in the report where predicted and measured differ")
    (what,) = stalls([a_pass(3.0, 2.9, 1.0, reach=None)] * 2)
    assert "spot corrects" not in what


def test_a_tool_that_changed_is_why_it_stalls() -> None:
    job = [a_pass(3.0, 2.9, 1.0), a_pass(2.9, 2.8, 1.0, width=(0.5, 0.05))]
    assert [one.kind for one in findings(extend_series(PassSeries("p"), job[-1]), job, LIMITS)] == ["spot"]


@pytest.mark.parametrize("seeds", [100, pytest.param(20_000, marks=pytest.mark.slow)])
def test_how_often_twenty_good_parts_show_a_drift(seeds: int) -> None:
    """60 passes each, rates that scatter by 2 % beyond their errors and drift by 1 % to and fro."""
    wrong = 0
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        drift = 0.01 * np.sin(np.arange(60) / 9 + rng.uniform(0, 6))
        sigma = rng.uniform(0.005, 0.08, 60)
        rates = 0.95 * (1 + drift) * rng.normal(1.0, np.hypot(sigma, 0.02))
        fades = rng.normal(0.0, 1.0, 60) * 2 * sigma
        each = zip(rates, sigma, fades, strict=True)
        passes = [a_pass(rate=r, rate_sigma=s, fade=(f, 2 * s), hours=0.2) for r, s, f in each]
        wrong += bool(found(passes))
    assert wrong <= 0.01 * seeds


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


@pytest.mark.full
def test_what_the_model_does_not_explain_limits_what_a_smooth_removal_shows() -> None:
    y, x = np.mgrid[-14:14.01:0.5, -14:14.01:0.5]
    mask = np.hypot(x, y) < 12
    errors = []
    for period_mm in (30.0, 8.0):
        removal_nm = 60 + 20 * np.sin(2 * np.pi * x / period_mm) + 10 * np.cos(np.pi * y / period_mm)
        seen = traces(removal_nm, removal_nm * x / 28, removal_nm, mask, pitch_mm=0.5, spot_mm=0.7)
        assert seen.width == pytest.approx(0, abs=1e-6)
        errors.append(seen.width_sigma)
    smooth, fine = errors
    assert smooth > 0.3 > 0.05 > fine, (
        "a spot twice as wide would change the smooth removal by less than the model is off"
    )


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
