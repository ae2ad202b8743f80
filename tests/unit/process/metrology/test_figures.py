"""Figures of surfaces whose figures are known."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from polishd.model.errors import MapError
from polishd.model.surface import Grid
from polishd.process.metrology.spectra import band_rms, radial_psd, split_bands, surface_stats
from polishd.process.metrology.statistics import polynomial, remove_terms
from tests.unit.process.gaussian import rough

GRID = Grid(120, 120, 1.0)
DISC = GRID.radius_mm() <= 50
ALL = np.ones(GRID.shape, dtype=bool)
X, Y = np.meshgrid(GRID.x_mm, GRID.y_mm)


def test_rms_and_pv_by_hand() -> None:
    height = np.full((20, 20), np.nan)
    height[5:9, 5:9] = 100.0
    height[5, 5:9] = [103, 97, 103, 97]
    stats = surface_stats(height, np.isfinite(height), 1.0, lsf_period_mm=10)
    assert stats.rms_nm == pytest.approx(np.sqrt(4 * 9 / 16))
    assert stats.pv_nm == 6
    assert stats.samples == 16
    assert stats.band_rms_nm is None


def test_the_mean_does_not_count() -> None:
    height = rough(GRID)
    once = surface_stats(height, DISC, 1.0, lsf_period_mm=33, band_period_mm=20)
    more = surface_stats(height + 1e4, DISC, 1.0, lsf_period_mm=33, band_period_mm=20)
    assert more.rms_nm == pytest.approx(once.rms_nm)
    assert more.lsf_rms_nm == pytest.approx(once.lsf_rms_nm)
    assert more.band_rms_nm == pytest.approx(once.band_rms_nm)
    assert once.lsf_rms_nm < once.band_rms_nm < once.rms_nm


@pytest.mark.parametrize(("period", "above"), [(60.0, 1.0), (40.0, 1.0), (24.0, 0.31), (8.0, 0.04)])
def test_a_wave_over_a_disc_is_in_its_band(period: float, above: float) -> None:
    wave = np.sin(2 * np.pi * (X * np.cos(0.4) + Y * np.sin(0.4)) / period)
    share = band_rms(wave, DISC, 1.0, 33.0) / wave[DISC].std()
    # three periods on the disc: a wave near the cut at 33 mm cannot be determined better
    assert share == pytest.approx(above, abs=0.04)


def test_a_rough_surface_splits_as_it_would_without_a_mask() -> None:
    big = Grid(240, 240, 1.0)
    height = rough(big, seed=4, cut_mm=4)
    frequency = np.hypot(np.fft.fftfreq(240)[:, None], np.fft.fftfreq(240)[None, :])
    long = np.fft.ifft2(np.where(frequency <= 1 / 33, np.fft.fft2(height), 0)).real
    disc = big.radius_mm() <= 100
    # over the disc the two parts are not orthogonal: what they share counts where the split counts it
    level, wave = (part - part[disc].mean() for part in (height, long))
    long = wave * ((wave * level)[disc].sum() / (wave**2)[disc].sum())
    figure, rest = split_bands(height, disc, 1.0, (33.0,))
    assert figure[disc].std() == pytest.approx(long[disc].std(), rel=0.02)
    assert rest[disc].std() == pytest.approx((height - long)[disc].std(), rel=0.15)
    zero_filled = np.fft.ifft2(np.where(frequency <= 1 / 33, np.fft.fft2(np.where(disc, height, 0)), 0)).real
    worst = np.abs((height - zero_filled)[disc].std() - (height - long)[disc].std())
    assert np.abs(rest[disc].std() - (height - long)[disc].std()) < worst / 2


@pytest.mark.full
@settings(max_examples=60)
@given(st.data())
def test_the_squares_of_the_bands_add_up_whatever_the_mask(data: st.DataObject) -> None:
    """Also where the map is short against the longest edge, in pieces, a line, or a single sample."""
    seed = data.draw(st.integers(0, 10**6))
    rows, columns = data.draw(st.integers(1, 90)), data.draw(st.integers(1, 90))
    pitch = data.draw(st.floats(0.05, 3.0))
    edges = sorted(data.draw(st.lists(st.floats(0.5, 300), min_size=1, max_size=4, unique=True)), reverse=True)
    rng = np.random.default_rng(seed)
    mask = rng.random((rows, columns)) < data.draw(st.sampled_from([1.0, 0.8, 0.3, 0.02]))
    if data.draw(st.booleans()):
        y, x = np.mgrid[:rows, :columns]
        mask &= np.hypot(x - columns * rng.random(), y - rows * rng.random()) < max(rows, columns) * rng.random()
    mask[rng.integers(rows), rng.integers(columns)] = True
    tilted = rng.standard_normal((rows, columns)).cumsum(0).cumsum(1) + 1e3 * np.arange(columns)
    level = remove_terms(tilted, mask, "tilt")
    bands = split_bands(level, mask, pitch, edges)
    total = np.sqrt(sum(band[mask].var() for band in bands))
    assert total == pytest.approx(level[mask].std(), rel=1e-6, abs=1e-9)
    np.testing.assert_allclose(sum(bands)[mask], level[mask], atol=1e-7)


def test_no_band_of_a_short_map_is_more_than_the_whole() -> None:
    """The shared map is 51 mm wide: plain filters at 33 mm gave an MSF of 46.4 of 44.6 nm in all."""
    mask = DISC
    height = rough(GRID, seed=9, cut_mm=5) + 40 * np.cos(2 * np.pi * np.hypot(X, Y) / 60)
    level = remove_terms(height, mask, "tilt")
    for period in (60.0, 100.0, 200.0):
        assert max(band[mask].std() for band in split_bands(level, mask, 1.0, (period,))) <= level[mask].std()


@settings(max_examples=20)
@given(st.integers(0, 10**6), st.lists(st.floats(0.5, 80), min_size=1, max_size=4, unique=True))
def test_the_bands_sum_to_the_map(seed: int, edges: list[float]) -> None:
    height = rough(GRID, seed=seed)
    bands = split_bands(np.where(DISC, height, np.nan), DISC, 1.0, sorted(edges, reverse=True))
    assert len(bands) == len(edges) + 1
    np.testing.assert_allclose(sum(bands)[DISC], height[DISC], atol=1e-10)
    assert all(np.isnan(band[~DISC]).all() for band in bands)


def test_what_is_below_nyquist_holds_nothing() -> None:
    bands = split_bands(rough(GRID), DISC, 1.0, (33.0, 0.12))
    np.testing.assert_allclose(bands[2][DISC], 0, atol=1e-9)
    assert bands[1][DISC].std() > 1


def test_a_low_order_figure_belongs_to_the_longest_band() -> None:
    bowl = (X**2 + Y**2) / 100 + 0.3 * X
    figure, rest = split_bands(bowl, DISC, 1.0, (33.0,))
    np.testing.assert_allclose(figure[DISC], bowl[DISC], atol=1e-9)
    np.testing.assert_allclose(rest[DISC], 0, atol=1e-9)


@pytest.mark.parametrize("edges", [(), (0.0,), (10.0, 20.0), (10.0, 10.0), (-3.0,)])
def test_edges_must_fall(edges: tuple[float, ...]) -> None:
    with pytest.raises(ValueError, match="must be positive and fall"):
        split_bands(rough(GRID), DISC, 1.0, edges)


@settings(max_examples=20)
@given(st.integers(0, 10**6), st.floats(0.05, 5), st.booleans())
def test_the_psd_sums_to_the_variance(seed: int, pitch: float, masked: bool) -> None:
    mask = DISC if masked else ALL
    height = rough(GRID, seed=seed)
    psd = radial_psd(height, mask, pitch)
    variance = (height - polynomial(height, mask, 1))[mask].var()
    assert (psd.density_nm2_mm2 * psd.area_per_mm2).sum() == pytest.approx(variance, rel=1e-12)
    assert (np.diff(psd.frequency_per_mm) > 0).all()


def test_the_psd_of_a_wave_peaks_at_its_frequency() -> None:
    wave = np.sin(2 * np.pi * X / 8)
    psd = radial_psd(wave, DISC, 1.0)
    power = psd.density_nm2_mm2 * psd.area_per_mm2
    near = np.abs(psd.frequency_per_mm - 1 / 8) < 0.02
    assert power[near].sum() > 0.85 * power.sum()
    assert psd.frequency_per_mm[psd.density_nm2_mm2.argmax()] == pytest.approx(1 / 8, abs=0.01)


def test_the_psd_does_not_depend_on_the_pitch() -> None:
    coarse, fine = Grid(60, 60, 1.0), Grid(120, 120, 0.5)
    waves = []
    for grid in (coarse, fine):
        x = np.broadcast_to(grid.x_mm, grid.shape)
        waves.append(radial_psd(np.sin(2 * np.pi * x / 10), np.ones(grid.shape, bool), grid.pitch_mm))
    one, two = waves
    assert two.density_nm2_mm2.max() == pytest.approx(one.density_nm2_mm2.max(), rel=0.05)


def test_a_flat_surface_has_no_power() -> None:
    psd = radial_psd(np.zeros(GRID.shape), DISC, 1.0)
    assert not psd.density_nm2_mm2.any()
    assert surface_stats(np.zeros(GRID.shape), DISC, 1.0, lsf_period_mm=33).lsf_rms_nm == pytest.approx(0, abs=1e-12)


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_a_polynomial_is_fitted_exactly(degree: int) -> None:
    rng = np.random.default_rng(degree)
    height = sum(rng.standard_normal() * X**i * Y**j for i in range(4) for j in range(4) if i + j <= degree)
    np.testing.assert_allclose(polynomial(np.where(DISC, height, np.nan), DISC, degree), height, rtol=1e-6, atol=1e-6)


def test_refusals() -> None:
    height = rough(GRID)
    with pytest.raises(MapError, match="no sample"):
        surface_stats(height, ~ALL, 1.0, lsf_period_mm=33)
    with pytest.raises(MapError, match="1 samples inside the mask have no data"):
        surface_stats(np.where((X == 0.5) & (Y == 0.5), np.nan, height), DISC, 1.0, lsf_period_mm=33)
    with pytest.raises(MapError, match="its mask"):
        radial_psd(height, DISC[1:], 1.0)
