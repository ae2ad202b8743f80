"""What is learned from removal whose truth is known."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from polishd.model.estimates import Estimate, Estimates, EstimateUpdate, PassEvidence
from polishd.model.surface import Grid
from polishd.process.identification.removal_fit import learn_rate
from tests.unit.process.gaussian import rough

GRID = Grid(70, 70, 1.0)
MASK = GRID.radius_mm() <= 30
X, Y = np.meshgrid(GRID.x_mm, GRID.y_mm)
PREDICTED = 60 + rough(GRID, rms_nm=15)
NOISE = rough(GRID, rms_nm=1.0, seed=9, cut_mm=2)


def learned(predicted: np.ndarray, measured: np.ndarray, rate: float = 1.0, **changes: Any) -> EstimateUpdate:
    values = {"tells_rate": True, "rates": (0.0, 10.0)} | changes
    beliefs = Estimates(Estimate(rate))
    return learn_rate(PassEvidence(beliefs, np.zeros(1), predicted, measured, MASK, GRID.pitch_mm, **values))


@pytest.mark.parametrize("true", [0.6, 0.9, 0.97, 1.05, 1.3])
def test_the_rate_is_found_whatever_piston_and_tilt(true: float) -> None:
    lesson = learned(PREDICTED, true * PREDICTED + 0.3 * NOISE - 300 + 0.8 * X - 2 * Y)
    rate, found = lesson.beliefs.rate, lesson.found
    assert rate.sigma == found["rate_sigma"]
    assert rate.value == pytest.approx(true, abs=3 * found["rate_sigma"])
    assert rate.value == found["rate"] == found["measured_rate"]
    assert 1e-4 < found["rate_sigma"] < 0.02
    assert found["explained"] > 0.98
    assert found["correlation"] > 0.99
    assert lesson.notes == ()


def test_what_was_believed_is_scaled_and_what_else_is_believed_stays() -> None:
    lesson = learned(PREDICTED, 0.9 * PREDICTED + 0.3 * NOISE, rate=0.8)
    assert lesson.beliefs.rate.value == pytest.approx(0.72, rel=0.01)
    assert lesson.beliefs.rate.sigma == pytest.approx(0.8 * lesson.found["rate_sigma"])


def test_a_rate_that_is_not_significant_changes_nothing() -> None:
    lesson = learned(PREDICTED, 1.005 * PREDICTED + 6 * NOISE)
    assert lesson.beliefs.rate.value == lesson.found["rate"] == 1
    assert lesson.found["measured_rate"] != 1
    assert lesson.beliefs.rate.sigma is not None, "but it is known how well"
    assert "is not significant" in lesson.notes[0]


def test_the_standard_error_is_about_the_scatter() -> None:
    rates, sigmas = [], []
    for seed in range(40):
        noise = rough(GRID, rms_nm=3.0, seed=100 + seed, cut_mm=5)
        found = learned(PREDICTED, 0.8 * PREDICTED + noise).found
        rates.append(found["measured_rate"])
        sigmas.append(found["rate_sigma"])
    assert np.mean(sigmas) == pytest.approx(np.std(rates), rel=0.5)
    white = 3.0 / (PREDICTED[MASK].std() * np.sqrt(MASK.sum()))
    assert np.mean(sigmas) > 1.5 * white  # neighbours are not independent


@pytest.mark.parametrize("flat", [np.full(GRID.shape, 55.0), 55 + 0.4 * X])
def test_even_removal_teaches_nothing(flat: np.ndarray) -> None:
    lesson = learned(flat, PREDICTED)
    assert lesson.beliefs == Estimates()
    assert np.isnan(lesson.found["measured_rate"])
    assert "the rate stays" in lesson.notes[0]


def test_a_flipped_map_does_not_correlate_and_is_the_gates_business() -> None:
    found = learned(PREDICTED, PREDICTED[:, ::-1] + NOISE).found
    assert found["correlation"] < 0.8
    assert found["explained"] < 0.7


@settings(max_examples=25)
@given(st.integers(0, 10**6), st.floats(0.3, 3), st.floats(-500, 500))
def test_units_and_pistons_cancel(seed: int, factor: float, piston: float) -> None:
    predicted = rough(GRID, rms_nm=10, seed=seed)
    measured = 0.8 * predicted + NOISE
    once = learned(predicted, measured).found
    same = learned(factor * predicted, factor * measured + piston).found
    assert same["measured_rate"] == pytest.approx(once["measured_rate"], rel=1e-9)
    assert same["rate_sigma"] == pytest.approx(once["rate_sigma"], rel=1e-6)
    assert same["explained"] == pytest.approx(once["explained"], rel=1e-6)


def test_what_is_withheld_is_still_reported() -> None:
    lesson = learned(PREDICTED, 0.8 * PREDICTED, tells_rate=False)
    assert lesson.beliefs == Estimates()
    assert lesson.found["measured_rate"] == pytest.approx(0.8)
    assert re.match(r"a rate of 0\.8 \+- \S+ was fitted, but this pass cannot show", lesson.notes[0])


def test_what_lies_outside_the_mask_does_not_count() -> None:
    outside = np.where(MASK, PREDICTED, np.nan)
    assert learned(outside, outside * 1.1).beliefs.rate.value == pytest.approx(1.1)
