"""Repeats: the mean, its uncertainty, and what is left out."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from polishd.model.errors import MapError
from polishd.model.surface import FloatArray, Grid, SurfaceMap
from polishd.process.metrology.averaging import average_maps
from tests.unit.process.gaussian import rough

GRID = Grid(60, 64, 0.5)
DISC = GRID.radius_mm() <= 14
TRUE = rough(GRID, seed=1)
LEVEL = TRUE - np.mean(TRUE[DISC])
NOISE_NM = 2.0


def repeat(number: int, noise_nm: float = NOISE_NM, extra: FloatArray | float = 0.0) -> SurfaceMap:
    """One measurement of the same surface with its own noise and piston."""
    rng = np.random.default_rng(1000 + number)
    height = TRUE + rng.normal(0, noise_nm, GRID.shape) + rng.uniform(-500, 500) + extra
    return SurfaceMap(np.where(DISC, height, np.nan), GRID.pitch_mm, path=Path(f"{number}.dat"))


@pytest.mark.parametrize("n", [3, 5, 12])
def test_noise_falls_with_the_root_of_their_number(n: int) -> None:
    found = average_maps([repeat(i) for i in range(n)], removal="piston")
    assert not found.rejected
    assert found.used == tuple(f"{i}.dat" for i in range(n))
    error = (found.height_nm - LEVEL)[DISC].std()
    assert error == pytest.approx(NOISE_NM / np.sqrt(n), rel=0.1)
    claimed = np.sqrt(np.mean(found.uncertainty_nm[DISC] ** 2))
    assert claimed == pytest.approx(error, rel=0.1)
    np.testing.assert_array_equal(np.isfinite(found.height_nm), DISC)


def test_the_uncertainty_of_rms_is_that_of_many_trials() -> None:
    found = [average_maps([repeat(10 * trial + i, 20.0) for i in range(6)], removal="piston") for trial in range(25)]
    scatter = np.std([each.rms_nm for each in found])
    assert np.median([each.rms_uncertainty_nm for each in found]) == pytest.approx(scatter, rel=0.6)


def test_a_map_that_deviates_is_left_out_by_name() -> None:
    bend = 30 * (GRID.x_mm[None, :] / 15) ** 2 * np.ones(GRID.shape)
    maps = [repeat(0), repeat(1, extra=bend), *(repeat(i) for i in range(2, 6))]
    found = average_maps(maps)
    assert set(found.rejected) == {"1.dat"}
    assert found.rejected["1.dat"] > 3
    assert "1.dat" not in found.used
    without = average_maps([each for i, each in enumerate(maps) if i != 1])
    np.testing.assert_array_equal(found.height_nm[DISC], without.height_nm[DISC])
    assert found.rms_nm == without.rms_nm


def test_single_samples_are_left_out_of_maps_that_stay() -> None:
    spike = np.zeros(GRID.shape)
    spike[30, 30] = 60.0
    maps = [repeat(0, extra=spike), *(repeat(i) for i in range(1, 5))]
    found = average_maps(maps, removal="piston")
    assert not found.rejected
    assert found.samples_rejected >= 1
    assert abs(found.height_nm[30, 30] - LEVEL[30, 30]) < 4 * NOISE_NM


@settings(max_examples=25)
@given(st.integers(0, 10**4), st.integers(3, 8))
def test_good_maps_and_samples_stay(seed: int, n: int) -> None:
    found = average_maps([repeat(seed + i) for i in range(n)])
    assert len(found.used) == n
    assert found.samples_rejected < 0.002 * n * DISC.sum()


def test_alignment_differs_and_does_not_count() -> None:
    tilts = [3.0 * i * GRID.x_mm[None, :] * np.ones(GRID.shape) for i in range(4)]
    maps = [repeat(i, extra=tilt) for i, tilt in enumerate(tilts)]
    plain = average_maps([repeat(i) for i in range(4)])
    np.testing.assert_allclose(average_maps(maps).height_nm[DISC], plain.height_nm[DISC], atol=1e-9)


def test_equal_maps_have_no_uncertainty() -> None:
    found = average_maps([repeat(0)] * 3)
    assert found.uncertainty_nm[DISC].max() < 1e-9
    assert found.rms_uncertainty_nm < 1e-9
    assert found.used == ("0.dat #1", "0.dat #2", "0.dat #3")


def test_only_samples_that_all_have_count_unless_a_mask_is_given() -> None:
    holed = repeat(1)
    height = holed.height_nm.copy()
    height[28:31, 30:33] = np.nan
    maps = [repeat(0), holed.with_height(height), repeat(2)]
    found = average_maps(maps)
    assert found.mask.sum() == DISC.sum() - 9


def test_refusals() -> None:
    maps = [repeat(i) for i in range(4)]
    with pytest.raises(MapError, match="2 repeats are too few"):
        average_maps(maps[:2])
    with pytest.raises(MapError, match=r"2\.dat has 59 x 64 samples"):
        average_maps([*maps[:2], maps[2].with_height(maps[2].height_nm[1:]), maps[3]])
    with pytest.raises(MapError, match=r"pitch of 0\.25 mm"):
        average_maps([*maps[:2], replace(maps[2], pitch_mm=0.25)])
    with pytest.raises(MapError, match="no sample"):
        average_maps([maps[0], maps[1], maps[2].with_height(np.full(GRID.shape, np.nan))])
    bend = 300 * GRID.x_mm[None, :] ** 2 * np.ones(GRID.shape)
    with pytest.raises(MapError, match=r"only 2 of 3 repeats agree \(2\.dat deviate\)"):
        average_maps([repeat(0), repeat(1), repeat(2, extra=bend)])


def test_repeats_whose_noise_is_drift_agree() -> None:
    """Three maps with a few independent patches each differ by chance: 1.5 times the usual refused 1 triple in 100."""
    rng = np.random.default_rng(4)
    for _ in range(60):
        noise = (ndimage.gaussian_filter(rng.normal(size=(40, 40)), 3, mode="wrap") for _ in range(3))
        assert average_maps([SurfaceMap(2 * one / one.std(), 1.0) for one in noise]).rejected == {}
