"""Rate and shift of a removal whose rate and shift are known, and whether their errors are what they are said to be."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from polishd.model.surface import FloatArray, Grid
from polishd.process.identification import removal_fit
from polishd.process.identification.removal_fit import Fit, compare_predictions, remove_plane, shift_samples
from tests.unit.process.gaussian import rough

GRID = Grid(60, 70, 0.8)
MASK = GRID.radius_mm() <= 22
X, Y = np.meshgrid(GRID.x_mm, GRID.y_mm)
PREDICTED = rough(GRID, rms_nm=12, seed=3)


def noise(seed: int, rms_nm: float, wide_px: float = 0.0) -> FloatArray:
    white = ndimage.gaussian_filter(np.random.default_rng(seed).normal(size=GRID.shape), wide_px, mode="wrap")
    return np.asarray(rms_nm * white / white.std())


def fit(measured: FloatArray, samples: tuple[int, int] | None = (0, 0)) -> Fit:
    return removal_fit.fit(remove_plane(PREDICTED, MASK), remove_plane(measured, MASK), MASK, samples, GRID.pitch_mm)


def test_levelled_has_no_plane_and_nothing_outside() -> None:
    level = remove_plane(PREDICTED + 40 - 3 * X + 0.7 * Y, MASK)
    np.testing.assert_allclose(level, remove_plane(PREDICTED, MASK), atol=1e-10)
    assert not level[~MASK].any()
    assert [abs((level * v)[MASK].sum()) < 1e-6 for v in (np.ones_like(X), X, Y)] == [True] * 3


@pytest.mark.parametrize(("down", "right"), [(0, 0), (2, -3), (-1, 4)])
def test_arrays_are_shifted_by_whole_samples(down: int, right: int) -> None:
    expected = ndimage.shift(PREDICTED, (down, right), order=0, cval=0.0)
    np.testing.assert_array_equal(shift_samples(PREDICTED, down, right), expected)
    assert shift_samples(MASK, down, right).dtype == np.bool_


@pytest.mark.parametrize("rate", [0.5, 1.0, -1.3])
@pytest.mark.parametrize(("x_mm", "y_mm"), [(0.0, 0.0), (0.15, -0.2), (1.7, 0.1)])
def test_rate_and_shift_are_found(rate: float, x_mm: float, y_mm: float) -> None:
    pitch = GRID.pitch_mm
    measured = rate * ndimage.shift(PREDICTED, (-y_mm / pitch, x_mm / pitch), order=5, mode="nearest") + 90 + X
    found = fit(measured, (round(-y_mm / pitch), round(x_mm / pitch)))
    assert found.rate == pytest.approx(rate, rel=0.01)
    assert found.shift_mm == pytest.approx((x_mm, y_mm), abs=0.02)
    assert found.correlation == pytest.approx(np.sign(rate), abs=0.01)
    assert np.nanmax(abs(found.model_nm - remove_plane(measured, MASK))) < 3
    assert found.rate_excess < 1e-3


@pytest.mark.parametrize("wide_px", [0.0, 2.0])
def test_the_standard_errors_are_about_the_scatter(wide_px: float) -> None:
    found = [fit(PREDICTED + noise(seed, 3.0, wide_px)) for seed in range(60)]
    rates, rate_sigmas = [f.rate for f in found], [f.rate_sigma for f in found]
    assert np.sqrt(np.mean(np.square(rate_sigmas))) == pytest.approx(np.std(rates), rel=0.35)
    for axis in (0, 1):
        shifts, sigmas = [f.shift_mm[axis] for f in found], [f.shift_sigma_mm[axis] for f in found]
        assert np.sqrt(np.mean(np.square(sigmas))) == pytest.approx(np.std(shifts), rel=0.35)


def test_drift_between_the_maps_is_in_the_error() -> None:
    """A change of power is alike in all tiles: leaving each out does not show it."""
    bowl, bent = PREDICTED / 4 + 6 * (X**2 + Y**2) / 22**2, 3 * (X**2 + Y**2) / 22**2
    steady, found = (
        removal_fit.fit(
            remove_plane(bowl, MASK), remove_plane(bowl + drift + noise(1, 0.1), MASK), MASK, None, GRID.pitch_mm
        )
        for drift in (0.0, bent)
    )
    assert abs(found.rate - 1) > 10 * steady.rate_sigma
    assert found.rate_sigma > 0.5 * abs(found.rate - 1)


def test_a_mask_in_a_corner_has_errors_too() -> None:
    """Tiles are of the mask's own box: in one tile of the array nothing would be left to leave out."""
    corner = np.zeros_like(MASK)
    corner[3:15, 2:17] = True
    level = remove_plane(PREDICTED, corner)
    found = removal_fit.fit(level, remove_plane(PREDICTED + noise(2, 2.0), corner), corner, None, GRID.pitch_mm)
    assert 0.005 < found.rate_sigma < 0.2


def test_noise_that_was_planned_on_makes_the_rate_too_high_by_no_more_than_said() -> None:
    before, after = noise(3, 4.0, 2.0), noise(4, 4.0, 2.0)
    planned = rough(GRID, rms_nm=5, seed=4) + before
    measured = planned + before - after
    level = remove_plane(planned, MASK)
    found = removal_fit.fit(level, remove_plane(measured, MASK), MASK, (0, 0), GRID.pitch_mm)
    assert found.rate > 1.2
    assert found.rate - found.rate_excess - 3 * found.rate_sigma < 1


def test_a_removal_without_slope_has_no_place() -> None:
    ridge = 10 * np.cos(X / 5)
    found = removal_fit.fit(remove_plane(ridge, MASK), remove_plane(ridge, MASK), MASK, (0, 0), GRID.pitch_mm)
    assert found.shift_sigma_mm[0] < 0.01
    assert found.shift_sigma_mm[1] == np.inf


def test_too_little_to_fit_says_nothing() -> None:
    few = np.zeros_like(MASK)
    few[:5, :5] = True
    found = removal_fit.fit(PREDICTED, PREDICTED, few, None, GRID.pitch_mm)
    assert np.isnan(found.rate)
    assert found.rate_sigma == np.inf
    assert compare_predictions(PREDICTED, PREDICTED, PREDICTED, few) == (0.0, np.inf)


def test_the_right_one_of_two_wins() -> None:
    other = PREDICTED[::-1]
    for truth, sign in ((PREDICTED, -1), (other, 1)):
        gap, sigma = compare_predictions(other, PREDICTED, 0.8 * truth + noise(5, 1.0) + X, MASK)
        assert gap == pytest.approx(0.8 * sign, abs=0.1)
        assert sigma < 0.1


def test_what_is_alike_wins_no_contest() -> None:
    alike = PREDICTED + noise(6, 0.5)
    gap, sigma = compare_predictions(alike, PREDICTED, PREDICTED + noise(7, 6.0), MASK)
    assert abs(gap) < 3 * sigma
    assert sigma > 0.2
