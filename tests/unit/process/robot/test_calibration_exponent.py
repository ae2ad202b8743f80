"""The exponent of gamma: of spots that are made with one, against numpy's fit, and of spans that are too short."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from polishd.model.errors import ComputeError
from polishd.model.process import ToolProcess
from polishd.model.surface import FloatArray
from polishd.process.removal.contact import hertz_depth_mm, volume_rate_nm_mm2_s
from polishd.process.robot.calibration import fit_exponent

GAMMA = np.linspace(0.75, 1.0, 9)


def noisy(exponent: float, noise: float, seed: int, gamma: FloatArray = GAMMA) -> FloatArray:
    return 0.058 * gamma**exponent * (1 + noise * np.random.default_rng(seed).standard_normal(len(gamma)))


@given(st.floats(0.5, 3.0), st.floats(1e-6, 1e6))
def test_a_pure_power_comes_back(exponent: float, scale: float) -> None:
    fit = fit_exponent(GAMMA, scale * GAMMA**exponent)
    assert fit.exponent == pytest.approx(exponent, abs=1e-10)
    assert fit.scale == pytest.approx(scale, rel=1e-10)
    assert fit.errors.max_percent < 1e-9


def test_it_is_numpys_straight_line_through_the_logarithms() -> None:
    volume = noisy(1.4, 0.05, 1)
    fit = fit_exponent(GAMMA, volume)
    (slope, offset), covariance = np.polyfit(np.log(GAMMA), np.log(volume), 1, cov=True)
    assert fit.exponent == pytest.approx(slope, rel=1e-9)
    assert fit.scale == pytest.approx(np.exp(offset), rel=1e-9)
    assert fit.uncertainty == pytest.approx(np.sqrt(covariance[0, 0]), rel=1e-9)


def test_the_uncertainty_is_that_of_many_repetitions() -> None:
    fits = [fit_exponent(GAMMA, noisy(1.5, 0.03, seed)) for seed in range(400)]
    found = np.array([fit.exponent for fit in fits])
    assert found.mean() == pytest.approx(1.5, abs=0.03)
    assert found.std() == pytest.approx(np.sqrt(np.mean([fit.uncertainty**2 for fit in fits])), rel=0.1)


def test_hertz_is_distinguished_from_the_papers_linear_mode_over_the_papers_span() -> None:
    gamma = np.linspace(0.835, 0.913, 12)
    for exponent, other in ((1.5, 1.0), (1.0, 1.5)):
        fit = fit_exponent(gamma, noisy(exponent, 0.01, 4, gamma))
        assert abs(fit.exponent - exponent) < 2.5 * fit.uncertainty
        assert abs(fit.exponent - other) > 2.5 * fit.uncertainty


def test_spots_of_the_contact_model_have_nearly_three_halves() -> None:
    """Force goes as depth to 1.5, and the sliding speed a little down with it: the axis lies nearer."""
    process = ToolProcess()
    volume = volume_rate_nm_mm2_s(process, GAMMA * hertz_depth_mm(process))
    fit = fit_exponent(GAMMA, volume)
    assert fit.exponent == pytest.approx(1.5, abs=0.02)
    assert fit.errors.max_percent < 0.1


def test_errors_are_of_the_measured_volumes() -> None:
    volume = GAMMA**1.5
    volume[4] *= 1.1
    fit = fit_exponent(GAMMA, volume)
    off = 100 * np.abs(fit.scale * GAMMA**fit.exponent / volume - 1)
    assert fit.errors.max_percent == pytest.approx(off.max())
    assert fit.errors.mean_percent == pytest.approx(off.mean())
    assert fit.errors.tests == 9
    assert 7 < off.max() < 9.1


@pytest.mark.parametrize(
    ("gamma", "volume", "says"),
    [
        (np.full(5, 0.87), np.ones(5), "gamma from 0.87 to 0.87 is no span"),
        (np.linspace(0.86, 0.88, 6), noisy(1.5, 0.03, 1, np.linspace(0.86, 0.88, 6)), r"from 0.86 to 0.88 .* \+- "),
        (np.array([0.87, 0.8701, 0.8702]), np.ones(3), "gamma from 0.87 to 0.8702 is too small a span"),
        (GAMMA[:2], np.ones(2), "2 spots are too few"),
        (GAMMA, np.ones(8), "9 depth ratios, 8 volumes"),
        (GAMMA[None], np.ones(9), r"depth ratio gamma has the shape \(1, 9\)"),
        (np.append(GAMMA, 0.0), np.ones(10), "point 9: depth ratio gamma is 0"),
        (GAMMA, np.append(np.ones(8), -2.0), "point 8: spot volume is -2"),
        (GAMMA, np.append(np.ones(8), np.inf), "point 8: spot volume is inf"),
    ],
)
def test_what_cannot_tell_is_refused(gamma: FloatArray, volume: FloatArray, says: str) -> None:
    with pytest.raises(ComputeError, match=says):
        fit_exponent(gamma, volume)
