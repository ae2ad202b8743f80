"""Parseval, frequencies and units of the power spectral densities."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from polishd.model.errors import BadMap
from polishd.model.surface import Grid
from polishd.process.metrics import psd_2d, psd_x, psd_y, radial_psd, without
from polishd.process.metrics.psd import Window
from tests.unit.process.gaussian import rough
from tests.unit.process.masked import shapes

WINDOWS: tuple[Window, ...] = ("extended", "mask", "taper")


@settings(max_examples=25)
@given(st.integers(0, 10**6), st.integers(30, 61), st.integers(30, 61), st.floats(0.05, 5), st.integers(0, 4))
def test_every_view_sums_to_the_variance(seed: int, ny: int, nx: int, pitch: float, number: int) -> None:
    grid = Grid(ny, nx, pitch)
    masks = [np.ones(grid.shape, dtype=bool), *shapes(grid).values()]
    mask = masks[number]
    height = np.where(mask, rough(grid, seed=seed, cut_mm=3 * pitch), np.nan)
    variance = without(height, mask, "tilt")[mask].var()
    for window in ("extended", "mask"):
        whole = psd_2d(height, mask, pitch, window)
        along, across, ring = (view(height, mask, pitch, window) for view in (psd_x, psd_y, radial_psd))
        sums = (
            whole.density_nm2_mm2.sum() * whole.cell_per_mm2,
            along.density_nm2_mm.sum() * along.step_per_mm,
            across.density_nm2_mm.sum() * across.step_per_mm,
            (ring.density_nm2_mm2 * ring.area_per_mm2).sum(),
        )
        assert sums == pytest.approx([variance] * 4, rel=1e-12)


@pytest.mark.parametrize("name", ["circle", "annulus", "ellipse", "rectangle"])
def test_the_taper_is_the_definition_to_the_letter(name: str) -> None:
    """All views of one window are one spectrum; its sum is the weighted mean square, near the variance."""
    grid = Grid(90, 84, 0.5)
    mask = shapes(grid)[name]
    height = np.random.default_rng(3).standard_normal(grid.shape) * 5
    whole = psd_2d(height, mask, 0.5, "taper")
    total = whole.density_nm2_mm2.sum() * whole.cell_per_mm2
    assert total == pytest.approx(height[mask].var(), rel=0.15)
    along = psd_x(height, mask, 0.5, "taper")
    assert along.density_nm2_mm.sum() * along.step_per_mm == pytest.approx(total, rel=1e-12)


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
    assert whole == pytest.approx((ring.density_nm2_mm2 * ring.area_per_mm2).sum(), rel=0.05)


@pytest.mark.parametrize("window", WINDOWS)
@pytest.mark.parametrize(("along_x", "along_y"), [(1 / 8, 0.0), (0.0, 1 / 10), (1 / 8, 1 / 10), (1 / 8, -1 / 10)])
def test_a_wave_stands_at_its_frequency_and_direction(window: Window, along_x: float, along_y: float) -> None:
    grid = Grid(80, 120, 1.0)
    x, y = np.meshgrid(grid.x_mm, grid.y_mm)
    wave = np.sin(2 * np.pi * (along_x * x + along_y * y))
    mask = np.ones(grid.shape, dtype=bool)
    whole = psd_2d(wave, mask, 1.0, window)
    row, column = np.unravel_index(whole.density_nm2_mm2.argmax(), whole.density_nm2_mm2.shape)
    found = np.array([whole.x_per_mm[column], whole.y_per_mm[row]])
    found *= np.sign(found @ np.array([along_x, along_y]))  # a real wave stands at both signs
    assert found == pytest.approx([along_x, along_y], abs=0.008)
    for view, expected in ((psd_x, along_x), (psd_y, along_y)):
        line = view(wave, mask, 1.0, window)
        assert line.frequency_per_mm[line.density_nm2_mm.argmax()] == pytest.approx(abs(expected), abs=0.008)


def test_a_whole_number_of_waves_is_one_line_of_known_height() -> None:
    x = (np.arange(64) - 31.5) * 0.25  # even about the middle: it has no tilt
    wave = np.broadcast_to(2 * np.cos(2 * np.pi * x / 2), (48, 64)).copy()
    mask = np.ones(wave.shape, dtype=bool)
    line = psd_x(wave, mask, 0.25, "mask")
    assert line.density_nm2_mm.max() == pytest.approx(2 / line.step_per_mm, rel=1e-9)  # its variance over df
    assert line.frequency_per_mm[line.density_nm2_mm.argmax()] == 0.5
    assert np.sort(line.density_nm2_mm)[-2] < 1e-20


def test_prysm_has_the_same_density_where_nothing_is_masked() -> None:
    from prysm.interferogram import psd as prysm_psd

    grid = Grid(64, 64, 0.5)
    mask = np.ones(grid.shape, dtype=bool)
    level = without(rough(grid, cut_mm=2), mask, "tilt")
    _, _, expected = prysm_psd(level, 0.5, np.ones(grid.shape))
    own = psd_2d(level, mask, 0.5, "mask").density_nm2_mm2
    np.testing.assert_allclose(own, expected, rtol=1e-9, atol=1e-9 * expected.max())


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
        psd_2d(height, mask, 1.0, "hann")  # type: ignore[arg-type]
    for view in (psd_2d, psd_x, psd_y, radial_psd):
        with pytest.raises(BadMap, match="no sample"):
            view(height, ~mask, 1.0)


@pytest.mark.parametrize("window", WINDOWS)
def test_a_flat_surface_has_none(window: Window) -> None:
    mask = np.ones((20, 24), dtype=bool)
    assert psd_2d(np.full((20, 24), 7.0), mask, 1.0, window).density_nm2_mm2.max() < 1e-20
