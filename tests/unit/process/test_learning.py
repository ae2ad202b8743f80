"""What is learned from removal whose truth is known."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from polishd.model.errors import ComputeError
from polishd.model.surface import Grid
from polishd.process.learning import learn_rate, withheld
from tests.unit.process.gaussian import rough

GRID = Grid(70, 70, 1.0)
MASK = GRID.radius_mm() <= 30
X, Y = np.meshgrid(GRID.x_mm, GRID.y_mm)
PREDICTED = 60 + rough(GRID, rms_nm=15)
NOISE = rough(GRID, rms_nm=1.0, seed=9, cut_mm=2)


@pytest.mark.parametrize("true", [0.6, 0.9, 0.97, 1.05, 1.3])
def test_the_rate_is_found_whatever_piston_and_tilt(true: float) -> None:
    measured = true * PREDICTED + 0.3 * NOISE - 300 + 0.8 * X - 2 * Y
    learned = learn_rate(PREDICTED, measured, MASK)
    assert learned.rate == pytest.approx(true, abs=3 * learned.rate_sigma)
    assert learned.rate == learned.measured_rate
    assert 1e-4 < learned.rate_sigma < 0.02
    assert learned.explained > 0.98
    assert learned.correlation > 0.99
    assert learned.notes == ()


def test_a_rate_that_is_not_significant_changes_nothing() -> None:
    measured = 1.005 * PREDICTED + 6 * NOISE
    learned = learn_rate(PREDICTED, measured, MASK)
    assert learned.rate == 1
    assert learned.measured_rate != 1
    assert "is not significant" in learned.notes[0]


def test_the_standard_error_is_about_the_scatter() -> None:
    rates, sigmas = [], []
    for seed in range(40):
        noise = rough(GRID, rms_nm=3.0, seed=100 + seed, cut_mm=5)
        learned = learn_rate(PREDICTED, 0.8 * PREDICTED + noise, MASK)
        rates.append(learned.measured_rate)
        sigmas.append(learned.rate_sigma)
    assert np.mean(sigmas) == pytest.approx(np.std(rates), rel=0.5)
    white = 3.0 / (PREDICTED[MASK].std() * np.sqrt(MASK.sum()))
    assert np.mean(sigmas) > 1.5 * white  # neighbours are not independent


def test_weights_count() -> None:
    half = X > 0
    measured = np.where(half, 0.7, 1.0) * (PREDICTED - PREDICTED[MASK].mean())
    weight = np.where(half, 1.0, 0.0)
    assert learn_rate(PREDICTED, measured, MASK, weight=weight).measured_rate == pytest.approx(0.7)
    assert learn_rate(PREDICTED, measured, MASK, weight=1 - weight).rate == 1


@pytest.mark.parametrize("flat", [np.full(GRID.shape, 55.0), 55 + 0.4 * X])
def test_even_removal_teaches_nothing(flat: np.ndarray) -> None:
    learned = learn_rate(flat, PREDICTED, MASK)
    assert learned.rate == 1
    assert np.isnan(learned.measured_rate)
    assert "teaches nothing" in learned.notes[0]


def test_a_flipped_map_does_not_correlate_and_is_the_gates_business() -> None:
    learned = learn_rate(PREDICTED, PREDICTED[:, ::-1] + NOISE, MASK)
    assert learned.correlation < 0.8
    assert learned.explained < 0.7


@settings(max_examples=25)
@given(st.integers(0, 10**6), st.floats(0.3, 3), st.floats(-500, 500))
def test_units_and_pistons_cancel(seed: int, factor: float, piston: float) -> None:
    predicted = rough(GRID, rms_nm=10, seed=seed)
    measured = 0.8 * predicted + NOISE
    once = learn_rate(predicted, measured, MASK)
    same = learn_rate(factor * predicted, factor * measured + piston, MASK)
    assert same.measured_rate == pytest.approx(once.measured_rate, rel=1e-9)
    assert same.rate_sigma == pytest.approx(once.rate_sigma, rel=1e-6)
    assert same.explained == pytest.approx(once.explained, rel=1e-6)


def test_what_is_withheld_is_still_told() -> None:
    learned = learn_rate(PREDICTED, 0.8 * PREDICTED, MASK)
    kept = withheld(learned)
    assert kept.rate == 1
    assert kept.measured_rate == learned.measured_rate == pytest.approx(0.8)
    assert kept.notes[0].startswith("a rate of 0.800 +- 0.000 was fitted, but this pass could not show")
    even = learn_rate(np.full(GRID.shape, 55.0), PREDICTED, MASK)
    assert withheld(even) is even, "it stays anyway, and says why"


def test_refusals() -> None:
    with pytest.raises(ComputeError, match="measured is"):
        learn_rate(PREDICTED, PREDICTED[1:], MASK)
    with pytest.raises(ComputeError, match="measured is not finite"):
        learn_rate(PREDICTED, np.where(X == 0.5, np.nan, PREDICTED), MASK)
    with pytest.raises(ComputeError, match="too few"):
        learn_rate(PREDICTED, PREDICTED, GRID.radius_mm() < 1.5)
    with pytest.raises(ComputeError, match="weights must not be negative"):
        learn_rate(PREDICTED, PREDICTED, MASK, weight=-np.ones(GRID.shape))
    outside = np.where(MASK, PREDICTED, np.nan)
    assert learn_rate(outside, outside * 1.1, MASK).rate == pytest.approx(1.1)
