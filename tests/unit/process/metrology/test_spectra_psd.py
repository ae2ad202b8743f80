"""Parseval, frequencies and units of the power spectral densities."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from polishd.model.errors import MapError
from polishd.model.surface import Grid
from polishd.process.metrology.spectra import RadialPsd, Window, radial_psd
from polishd.process.metrology.statistics import remove_terms
from tests.unit.process.gaussian import rough
from tests.unit.process.masked import shapes


def total(ring: RadialPsd) -> float:
    return float((ring.density_nm2_mm2 * ring.area_per_mm2).sum())


WINDOWS: tuple[Window, ...] = ("extended", "mask", "taper")


@settings(max_examples=25)
@given(st.integers(0, 10**6), st.integers(30, 61), st.integers(30, 61), st.floats(0.05, 5), st.integers(0, 4))
def test_it_sums_to_the_variance(seed: int, ny: int, nx: int, pitch: float, number: int) -> None:
    grid = Grid(ny, nx, pitch)
    masks = [np.ones(grid.shape, dtype=bool), *shapes(grid).values()]
    mask = masks[number]
    height = np.where(mask, rough(grid, seed=seed, cut_mm=3 * pitch), np.nan)
    variance = remove_terms(height, mask, "tilt")[mask].var()
    for window in ("extended", "mask"):
        assert total(radial_psd(height, mask, pitch, window)) == pytest.approx(variance, rel=1e-12)


@pytest.mark.parametrize("name", ["circle", "annulus", "ellipse", "rectangle"])
def test_the_taper_sums_to_about_the_variance(name: str) -> None:
    grid = Grid(90, 84, 0.5)
    mask = shapes(grid)[name]
    height = np.random.default_rng(3).standard_normal(grid.shape) * 5
    assert total(radial_psd(height, mask, 0.5, "taper")) == pytest.approx(height[mask].var(), rel=0.15)


def test_white_noise_is_flat_at_variance_times_cell() -> None:
    height = 3 * np.random.default_rng(5).standard_normal((256, 256))
    mask = shapes(Grid(256, 256, 0.5))["circle"]
    ring = radial_psd(height, mask, 0.5, "taper")
    for low, high in ((0.1, 0.3), (0.3, 0.6), (0.6, 1.0)):
        some = (ring.frequency_per_mm > low) & (ring.frequency_per_mm < high)
        mean = np.average(ring.density_nm2_mm2[some], weights=ring.area_per_mm2[some])
        assert mean == pytest.approx(9 * 0.25, rel=0.05)


def test_rings_are_two_pi_f_df_wide() -> None:
    grid = Grid(128, 128, 0.5)
    ring = radial_psd(rough(grid, cut_mm=3), np.ones(grid.shape, dtype=bool), 0.5, "mask")
    f, step = ring.frequency_per_mm, 1 / (128 * 0.5)
    some = (f > 10 * step) & (f < 60 * step)
    np.testing.assert_allclose(ring.area_per_mm2[some], 2 * np.pi * f[some] * step, rtol=0.12)
    whole = (ring.density_nm2_mm2 * 2 * np.pi * f * step).sum()
    assert whole == pytest.approx(total(ring), rel=0.05)


@pytest.mark.parametrize("window", WINDOWS)
@pytest.mark.parametrize(("along_x", "along_y"), [(1 / 8, 0.0), (0.0, 1 / 10), (1 / 8, 1 / 10), (1 / 8, -1 / 10)])
def test_a_wave_stands_at_its_frequency(window: Window, along_x: float, along_y: float) -> None:
    grid = Grid(80, 120, 1.0)
    x, y = np.meshgrid(grid.x_mm, grid.y_mm)
    wave = np.sin(2 * np.pi * (along_x * x + along_y * y))
    mask = np.ones(grid.shape, dtype=bool)
    ring = radial_psd(wave, mask, 1.0, window)
    found = ring.frequency_per_mm[ring.density_nm2_mm2.argmax()]
    assert found == pytest.approx(np.hypot(along_x, along_y), abs=0.008)


def test_a_whole_number_of_waves_is_one_line_of_known_height() -> None:
    x = (np.arange(64) - 31.5) * 0.25  # even about the middle: it has no tilt
    wave = np.broadcast_to(2 * np.cos(2 * np.pi * x / 2), (48, 64)).copy()
    mask = np.ones(wave.shape, dtype=bool)
    ring = radial_psd(wave, mask, 0.25, "mask")
    power = ring.density_nm2_mm2 * ring.area_per_mm2
    assert ring.frequency_per_mm[power.argmax()] == pytest.approx(0.5, abs=0.5 / (16 * 0.25))
    assert power.max() == pytest.approx(2, rel=1e-9)
    assert np.sort(power)[-2] < 1e-20


def test_prysm_has_the_same_density_where_nothing_is_masked() -> None:
    from prysm.interferogram import psd as prysm_psd

    grid = Grid(64, 64, 0.5)
    mask = np.ones(grid.shape, dtype=bool)
    level = remove_terms(rough(grid, cut_mm=2), mask, "tilt")
    x, y, expected = prysm_psd(level, 0.5, np.ones(grid.shape))
    ring = np.rint(np.hypot(x, y) * 32).astype(int).ravel()
    mean = np.bincount(ring, expected.ravel()) / np.bincount(ring)
    own = radial_psd(level, mask, 0.5, "mask").density_nm2_mm2
    np.testing.assert_allclose(own, mean[1:], rtol=1e-9, atol=1e-9 * expected.max())


@settings(max_examples=15)
@given(st.integers(0, 10**6), st.floats(-1e4, 1e4), st.floats(-9, 9), st.floats(0.1, 9))
def test_tilt_does_not_matter_and_density_goes_with_the_square(seed: int, c: float, a: float, factor: float) -> None:
    grid = Grid(50, 44, 1.0)
    mask = shapes(grid)["ellipse"]
    height = rough(grid, seed=seed)
    plain = radial_psd(height, mask, 1.0).density_nm2_mm2
    other = radial_psd(factor * height + c + a * grid.x_mm[None, :], mask, 1.0).density_nm2_mm2
    np.testing.assert_allclose(other, factor**2 * plain, rtol=1e-6, atol=1e-9 * factor**2 * plain.max())


def test_refusals() -> None:
    height, mask = np.ones((20, 20)), np.ones((20, 20), dtype=bool)
    with pytest.raises(ValueError, match="extended, mask, taper"):
        radial_psd(height, mask, 1.0, "hann")  # type: ignore[arg-type]
    with pytest.raises(MapError, match="no sample"):
        radial_psd(height, ~mask, 1.0)


@pytest.mark.parametrize("window", WINDOWS)
def test_a_flat_surface_has_none(window: Window) -> None:
    mask = np.ones((20, 24), dtype=bool)
    assert radial_psd(np.full((20, 24), 7.0), mask, 1.0, window).density_nm2_mm2.max() < 1e-20
