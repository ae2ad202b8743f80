"""What a pass is expected to leave, against passes that are drawn."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from polishd.model.estimates import FindingLimits
from polishd.model.surface import FloatArray
from polishd.process.identification.findings import (
    UNEXPLAINED,
    WITHIN,
    Forecast,
    forecast,
    gain_too_small,
    pool_unexplained,
    unexplained_share,
)
from polishd.process.removal.ripple import Ripple, RippleLine

N = 72
X, Y = np.meshgrid(np.linspace(-1, 1, N), np.linspace(-1, 1, N))
MASK = np.hypot(X, Y) <= 1.0
NOISE_NM = 0.3


def field(rng: np.random.Generator) -> FloatArray:
    """(n,) a smooth surface over the disc of twelve independent parts, RMS 1 in the mean."""
    height = np.zeros(MASK.shape)
    for a, b in rng.uniform(-12.0, 12.0, (6, 2)):
        even, odd = rng.standard_normal(2) / np.sqrt(6)
        height += even * np.cos(a * X + b * Y) + odd * np.sin(a * X + b * Y)
    return height[MASK]


def figure(rng: np.random.Generator) -> FloatArray:
    """(n,) likewise, RMS 1, less piston and tilt."""
    height = field(rng)
    plane = np.column_stack([np.ones(MASK.sum()), X[MASK], Y[MASK]])
    left = height - plane @ np.linalg.lstsq(plane, height, rcond=None)[0]
    return np.asarray(left / left.std())


@pytest.mark.full
@pytest.mark.one_of_each
@pytest.mark.parametrize(("rate_sigma", "share"), [(0.05, 0.0), (0.0, 0.02), (0.1, 0.02), (0.01, 0.005)])
def test_nine_of_ten_come_between(rate_sigma: float, share: float) -> None:
    rng = np.random.default_rng(7)
    held = 0
    for _ in range(300):
        true = 18.0 * figure(rng)
        seen = true + NOISE_NM * rng.standard_normal(true.size)
        removal = 0.98 * true
        cast = forecast(seen, removal, removed_nm=60.0, rate_sigma=rate_sigma, unexplained=share)
        odd = share * 60.0 * np.exp(WITHIN * rng.standard_normal()) * field(rng) if share else 0.0
        after = true - (1 + rate_sigma * rng.standard_normal()) * removal - odd
        came = float((after + NOISE_NM * rng.standard_normal(true.size)).std())
        held += cast.low_nm <= came <= cast.high_nm
    assert 0.82 <= held / 300 <= 0.97, f"{held} of 300: 90 % are expected, and 300 distinguish 90 from 82"


def test_a_known_machine_has_a_narrow_forecast_and_an_unknown_one_a_wide() -> None:
    now = 18.0 * figure(np.random.default_rng(1))
    narrow = forecast(now, now, removed_nm=60.0, rate_sigma=0.01, unexplained=0.002)
    wide = forecast(now, now, removed_nm=60.0, rate_sigma=0.2, unexplained=0.02)
    assert narrow.high_nm - narrow.low_nm < 0.1 * (wide.high_nm - wide.low_nm)
    assert narrow.low_nm <= narrow.median_nm <= narrow.high_nm
    assert narrow.better == wide.better == 1.0


def test_the_rate_s_error_is_of_what_varies_of_the_removal() -> None:
    """An even removal has no rate that could be seen."""
    now = 2.0 * figure(np.random.default_rng(2))
    cast = forecast(now, np.full(now.size, 100.0), removed_nm=100.0, rate_sigma=0.3, unexplained=0.0)
    assert cast.low_nm == cast.high_nm == pytest.approx(2.0)


def test_what_no_rate_explains_goes_with_all_that_is_removed() -> None:
    now = 2.0 * figure(np.random.default_rng(2))
    little, much = (
        forecast(now, now, removed_nm=removed, rate_sigma=0.0, unexplained=0.01) for removed in (20.0, 200.0)
    )
    assert much.median_nm == pytest.approx(10 * little.median_nm, rel=1e-6)


def test_noise_that_no_spot_follows_comes_again() -> None:
    now = 10.0 * figure(np.random.default_rng(3))
    noise = 0.5 * np.random.default_rng(4).standard_normal(now.size)
    cast = forecast(now + noise, now, removed_nm=60.0, rate_sigma=0.0, unexplained=0.0)
    assert cast.median_nm == pytest.approx(0.5, rel=0.03)


def test_a_ripple_between_tracks_stays_and_grows_with_each_pass() -> None:
    now = 2.0 * figure(np.random.default_rng(3))
    stays, grows = (
        forecast(now, now, removed_nm=60.0, rate_sigma=0.0, unexplained=0.0, finer_nm=1.0, known_ripple=ripple)
        for ripple in (0.0, 0.015)
    )
    assert stays.low_nm == stays.high_nm == pytest.approx(1.0)
    assert 1.0 <= grows.low_nm < 1.1
    assert 1.2 < grows.median_nm < 1.0 + 0.015 * 60.0 < grows.high_nm
    cast = {"rate_sigma": 0.0, "unexplained": 0.0, "finer_nm": 1.0, "known_ripple": 0.015}
    none_to_gain = forecast(0.1 * now, 0.1 * now, removed_nm=60.0, **cast)
    assert none_to_gain.better < 0.2


def test_what_no_rate_explains_is_found_beside_noise() -> None:
    rng = np.random.default_rng(4)
    predicted, odd = np.zeros(MASK.shape), np.zeros(MASK.shape)
    predicted[MASK], odd[MASK] = 40.0 + 18.0 * figure(rng), figure(rng)
    noise = NOISE_NM * rng.standard_normal((2, *MASK.shape))
    measured = 0.9 * predicted + 40.0 + 3.0 * X + odd + noise[0] - noise[1]
    assert unexplained_share(predicted, measured, MASK, NOISE_NM) == pytest.approx(1.0 / np.hypot(40.0, 18.0), rel=0.1)
    nothing = 0.9 * predicted + noise[0] - noise[1]
    assert unexplained_share(predicted, nothing, MASK, NOISE_NM) == pytest.approx(0.0, abs=0.002)


def test_a_weak_pass_shows_nothing_of_it() -> None:
    predicted = np.zeros(MASK.shape)
    predicted[MASK] = 1.2 * figure(np.random.default_rng(5))
    assert unexplained_share(predicted, predicted, MASK, 0.0) is None
    assert unexplained_share(10.0 * predicted, predicted, MASK, 4.0) is None
    assert pool_unexplained(UNEXPLAINED, None) == UNEXPLAINED


def test_what_a_pass_showed_counts_as_much_as_all_before() -> None:
    assert pool_unexplained(0.05, 0.05) == pytest.approx(0.05)
    assert pool_unexplained(0.05, 0.01) == pytest.approx(np.sqrt((0.05**2 + 0.01**2) / 2))


def test_a_pass_that_will_hardly_gain_is_not_worth_it() -> None:
    limits, hopeless = FindingLimits(), Forecast(0.60, 0.64, 0.70, 0.9, 0.04)
    found = gain_too_small(hopeless, limits)
    assert found is not None
    assert (found.kind, found.stops) == ("stall", "job")
    assert found.what == (
        "the next pass would leave 0.60 to 0.70 nm (90 %), with a chance of 4 % that it is less than now: it is not "
        "made. Take another tool, or tolerance, or a quieter map"
    )
    assert gain_too_small(Forecast(0.60, 0.64, 0.70, 0.9, 0.06), limits) is None
    assert gain_too_small(hopeless, FindingLimits(min_improvement=0.0)) is None, "who turns it off has it off"


def test_a_pass_that_gains_less_than_its_ripple_states_both_and_what_the_floor_removes() -> None:
    ripple = Ripple((RippleLine("across", 1.2, 1.4, 1.0, 1.2, 0.3),))
    forecast_ = Forecast(0.60, 0.64, 0.70, 0.9, 0.5, ripple, 0.4, 20.0)
    found = gain_too_small(forecast_, FindingLimits())
    assert found is not None
    assert "would gain 0.40 nm RMS and add a ripple of 1.00 nm RMS (1.20 mm across" in found.what
    assert "the machine's shortest times remove 20 nm in the mean" in found.what
    assert gain_too_small(replace(forecast_, gain_nm=1.1), FindingLimits()) is None


def test_noise_of_a_map_s_own_samples_adds_in_quadrature_and_costs_no_chance_to_gain() -> None:
    now = 10.0 * figure(np.random.default_rng(3))
    cast = forecast(now, 0.96 * now, removed_nm=60.0, rate_sigma=0.0, unexplained=0.0, noise_nm=0.3)
    assert cast.median_nm == pytest.approx(0.5, rel=0.01)
    poor = forecast(0.1 * now, 0.1 * now, removed_nm=60.0, rate_sigma=0.0, unexplained=0.0, noise_nm=3.0)
    assert poor.better == 1.0
