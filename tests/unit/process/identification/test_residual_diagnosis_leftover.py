"""What two maps differ by, beside a removal: its rate and shift, and the low orders of set-up and mount."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from polishd.model.surface import BoolArray, FloatArray, Grid
from polishd.process.identification.residual_diagnosis import fit_residual

GRID = Grid(41, 41, 1.0)
X, Y = np.meshgrid(GRID.x_mm, GRID.y_mm)
MASK: BoolArray = np.hypot(X, Y) <= 17.0
U, V = X / 17.0, Y / 17.0
"""Over the circle of the mask."""
POWER = np.sqrt(3.0) * (2 * (U**2 + V**2) - 1)
ASTIGMATISM = np.sqrt(6.0) * 2 * U * V
TREFOIL = np.sqrt(8.0) * (3 * U**2 * V - V**3)


def removal(seed: int = 1) -> FloatArray:
    """Some 60 nm, 15 of it figure with periods of 10 mm and more."""
    rough = ndimage.gaussian_filter(np.random.default_rng(seed).standard_normal(GRID.shape), 4.0)
    return np.asarray(60.0 + 15.0 * rough / rough[MASK].std())


def noise(nm: float, seed: int = 2) -> FloatArray:
    return nm * np.random.default_rng(seed).standard_normal(GRID.shape)


def test_each_is_distinguished_from_all_others() -> None:
    """At once: a rate of 0.8, a shift, and what set-ups add; the errors say how well."""
    predicted = removal()
    moved = ndimage.shift(predicted, (-0.3, 0.4), order=3, mode="nearest")  # 0.4 mm right, 0.3 up
    bent = -3.0 * POWER + 1.5 * ASTIGMATISM + 2.0 * TREFOIL
    left = fit_residual(0.8 * moved + bent + 40.0 + 3.0 * U + noise(0.2), MASK, 1.0, predicted)
    assert left is not None
    assert left.rate is not None
    wanted = {"power_nm": -3.0, "astigmatism_nm": 1.5, "trefoil_nm": 2.0, "shift_mm": 0.5}
    for name, size in wanted.items():
        found = getattr(left, name)
        assert found.value == pytest.approx(size, abs=4 * found.sigma), name
        assert found.sigma < 0.15, name
    assert left.rate.value == pytest.approx(0.8, abs=0.01), "slopes are of first order: 0.5 mm takes 0.005 off the rate"


def test_errors_are_those_of_many_draws() -> None:
    """Maps that differ by noise alone: what is found scatters as its standard error says."""
    pulls = []
    for seed in range(60):
        left = fit_residual(removal() + noise(0.3, seed), MASK, 1.0, removal())
        assert left is not None
        pulls.append(left.power_nm.value / (left.power_nm.sigma or 1.0))
    assert 0.5 < np.std(pulls) < 1.6


def test_power_alone_does_not_read_as_a_shift() -> None:
    """What the gate's fit, which leaves power out, takes for more than half a millimetre."""
    left = fit_residual(removal() - 4.0 * POWER + noise(0.2), MASK, 1.0, removal())
    assert left is not None
    assert left.shift_mm.value < 0.05
    assert left.rate is not None
    assert left.rate.value == pytest.approx(1.0, abs=0.02)


def test_two_maps_with_no_pass_between() -> None:
    left = fit_residual(2.0 * TREFOIL + noise(0.2), MASK, 1.0)
    assert left is not None
    assert left.rate is None
    assert left.shift_mm.value == 0.0
    assert left.trefoil_nm.value == pytest.approx(2.0, abs=0.05)
    assert abs(left.power_nm.value) < 0.05


def test_where_power_is_alignment_none_is_reported() -> None:
    left = fit_residual(removal() + 50.0 * POWER + 1.5 * TREFOIL + noise(0.2), MASK, 1.0, removal(), removal="power")
    assert left is not None
    assert left.power_nm.value == pytest.approx(0.0, abs=1e-9)
    assert left.trefoil_nm.value == pytest.approx(1.5, abs=0.1)
    assert left.shift_mm.value < 0.05


def test_too_few_samples_tell_nothing() -> None:
    few = np.zeros_like(MASK)
    few[20, 20:30] = True
    assert fit_residual(removal(), few, 1.0, removal()) is None
