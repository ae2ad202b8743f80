"""The step of a raster that leaves no ripple: a null of the spot's spectrum."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from polishd.process.toolpath.paths import quiet_step_mm


def ripple(radius_mm: float, step_mm: float) -> float:
    """Depth of the first harmonic that lines a step apart leave, relative to the removal: by summing the spots."""
    y = np.arange(256) / 256 * step_mm
    lines = np.arange(-np.ceil(radius_mm / step_mm) - 1, np.ceil(radius_mm / step_mm) + 2) * step_mm
    depth = np.maximum(1 - ((y[:, None] - lines) / radius_mm) ** 2, 0.0).sum(axis=1)
    return float(2 * abs(np.fft.rfft(depth)[1]) / depth.sum())


@pytest.mark.parametrize("radius_mm", [1.0, 1.63, 1.8, 2.5, 4.0])
def test_the_ripple_is_gone(radius_mm: float) -> None:
    step = quiet_step_mm(radius_mm, 1.0)
    assert step <= 1.0
    assert ripple(radius_mm, step) < 2e-4
    assert ripple(radius_mm, step) < ripple(radius_mm, 1.02 * step) / 5
    assert ripple(radius_mm, step) < ripple(radius_mm, 0.98 * step) / 5


@given(st.floats(0.8, 20.0), st.floats(0.2, 3.0))
def test_it_is_the_largest_such_step(radius_mm: float, at_most_mm: float) -> None:
    step = quiet_step_mm(radius_mm, at_most_mm)
    assert 0 < step <= at_most_mm
    u = 2 * np.pi * radius_mm / step
    if step < at_most_mm:
        assert abs(np.sin(u) - u * np.cos(u)) < 2e-3 * u, "tan u = u"
        between = np.linspace(2 * np.pi * radius_mm / at_most_mm, u * (1 - 1e-3), 400)
        signs = np.sign(np.sin(between) - between * np.cos(between))
        assert (signs == signs[0]).all(), "no null between this step and the wanted one"


def test_it_scales() -> None:
    assert quiet_step_mm(3.6, 2.0) == pytest.approx(2 * quiet_step_mm(1.8, 1.0))


def test_the_wanted_step_where_a_spot_is_far_smaller() -> None:
    """Then there is a null below it all the same, or the wanted one is kept where none is in the table."""
    assert quiet_step_mm(0.3, 1.0) == pytest.approx(2 * np.pi * 0.3 / 4.4934, rel=1e-3)
    assert quiet_step_mm(1000.0, 1.0) == 1.0
