"""PV, RMS, trim and removal: by hand, by their invariances, and as MetroPro gives them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from polishd.model.errors import MapError
from polishd.model.surface import BoolArray, FloatArray, Grid
from polishd.plugins.interferometer.formats.metropro import METROPRO
from polishd.process.metrology.statistics import Removal, pv_rms, remove_terms, trim_mask
from tests.unit.process.gaussian import rough
from tests.unit.process.masked import shapes

GRID = Grid(64, 70, 0.5)
MASKS = shapes(Grid(64, 70, 0.5))
X, Y = np.meshgrid(GRID.x_mm, GRID.y_mm)
REMOVALS: tuple[Removal, ...] = ("piston", "tilt", "power")
SHAPE = st.sampled_from(sorted(MASKS))


def spread(
    height: FloatArray, mask: BoolArray, *, trim_px: int = 0, removal: Removal = "piston"
) -> tuple[float, float]:
    """PV and RMS after the trim and then the removal, in this order, as MetroPro does."""
    kept = trim_mask(mask, trim_px)
    return pv_rms(remove_terms(height, kept, removal), kept)


def surface(seed: int) -> FloatArray:
    return rough(GRID, seed=seed, cut_mm=2)


def test_by_hand() -> None:
    height = np.array([[1.0, np.nan], [4.0, 1.0]])
    assert pv_rms(height, np.isfinite(height)) == pytest.approx((3.0, np.sqrt(2)))


def test_a_sine_has_its_amplitude_over_root_two() -> None:
    height = 7 * np.sin(2 * np.pi * np.arange(64) / 16)[:, None] * np.ones((1, 50))
    pv, rms = pv_rms(height, np.ones(height.shape, dtype=bool))
    assert (pv, rms) == pytest.approx((14, 7 / np.sqrt(2)), rel=1e-12)


@settings(max_examples=40)
@given(st.integers(0, 10**6), SHAPE, st.floats(-1e4, 1e4), st.floats(-50, 50), st.floats(-50, 50))
def test_piston_and_tilt_do_not_count_once_removed(seed: int, name: str, c: float, a: float, b: float) -> None:
    mask, height = MASKS[name], surface(seed)
    plain = spread(height, mask, removal="tilt")
    moved = spread(height + c + a * X + b * Y, mask, removal="tilt")
    assert moved == pytest.approx(plain, rel=1e-9)
    assert plain[1] <= spread(height, mask)[1] * (1 + 1e-12)


@settings(max_examples=30)
@given(st.integers(0, 10**6), SHAPE, st.floats(-3, 3), st.integers(0, 3), st.booleans())
def test_figures_turn_and_scale_with_the_map(seed: int, name: str, factor: float, turns: int, flip: bool) -> None:
    def turned(array: Any) -> Any:
        return np.rot90(array[:, ::-1] if flip else array, turns)

    mask, height = MASKS[name], surface(seed)
    for removal in REMOVALS:
        plain = spread(height, mask, trim_px=2, removal=removal)
        other = spread(factor * turned(height), turned(mask), trim_px=2, removal=removal)
        expected = (abs(factor) * plain[0], abs(factor) * plain[1])
        assert other == pytest.approx(expected, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("name", sorted(MASKS))
def test_power_is_removed_with_tilt(name: str) -> None:
    mask = MASKS[name]
    bowl = 5 + 3 * X - Y + 0.7 * (X**2 + Y**2)
    assert spread(bowl, mask, removal="power")[0] == pytest.approx(0, abs=1e-9)
    assert spread(bowl, mask, removal="tilt")[0] > 10
    saddle = X**2 - Y**2
    assert spread(saddle, mask, removal="power")[1] > 10


def test_removal_leaves_nothing_outside_the_mask() -> None:
    mask = MASKS["circle"]
    for removal in REMOVALS:
        rest = remove_terms(surface(1), mask, removal)
        np.testing.assert_array_equal(np.isfinite(rest), mask)
        assert rest[mask].mean() == pytest.approx(0, abs=1e-9)


def test_a_trim_is_by_the_cross_and_from_all_edges() -> None:
    mask = np.ones((7, 9), dtype=bool)
    mask[3, 4] = False
    once = trim_mask(mask, 1)
    assert not once[0].any()
    assert not once[:, -1].any()
    assert once[2, 3]  # diagonal to the hole
    assert not once[2, 4]
    np.testing.assert_array_equal(trim_mask(mask, 2), trim_mask(once, 1))
    assert not trim_mask(mask, 4).any()


def test_no_trim_is_a_copy_of_the_mask() -> None:
    mask = MASKS["ellipse"]
    kept = trim_mask(mask, 0)
    np.testing.assert_array_equal(kept, mask)
    assert kept is not mask


def test_refusals() -> None:
    height, mask = surface(3), MASKS["circle"]
    with pytest.raises(MapError, match="no sample"):
        spread(height, mask, trim_px=60)
    broken = height.copy()
    broken[tuple(np.argwhere(mask)[100])] = np.inf
    with pytest.raises(MapError, match="1 samples inside the mask have no data"):
        pv_rms(broken, mask)
    with pytest.raises(MapError, match="its mask"):
        remove_terms(height[1:], mask, "tilt")
    with pytest.raises(ValueError, match="0 or more"):
        trim_mask(mask, -1)
    with pytest.raises(ValueError, match="piston, tilt, power"):
        remove_terms(height, mask, "focus")  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("trim", "removal", "pv", "rms"),
    [(0, "piston", 330.700173, 44.591409), (5, "piston", 262.482, 31.443), (5, "tilt", 263.237, 31.438)],
)
def test_a_measured_map(shared_data: Path, trim: int, removal: Removal, pv: float, rms: float) -> None:
    found = METROPRO.read(shared_data / "zygo_metropro.dat")
    figure = spread(found.height_nm, found.valid, trim_px=trim, removal=removal)
    digits = 1e-6 if trim == 0 else 6e-4  # the page has six digits of the whole map's
    assert figure == pytest.approx((pv, rms), abs=digits)
