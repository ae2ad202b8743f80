"""RMS of bands on masked surfaces whose bands are known."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from polishd.model.surface import Grid
from polishd.process.metrology.spectra import EDGES_MM as USUAL_EDGES_MM
from polishd.process.metrology.spectra import extend_rim, split_bands
from tests.unit.process.masked import EDGES_MM, shapes, three_bands

GRID = Grid(300, 300, 1.0)
MASKS = shapes(GRID)


@pytest.mark.full
@pytest.mark.one_of_each
@pytest.mark.parametrize("name", sorted(MASKS))
def test_band_rms_is_within_one_percent(name: str) -> None:
    """50 surfaces over four shapes: each band of each within 1 %, and their maps sum to the surface."""
    mask = MASKS[name]
    first = sorted(MASKS).index(name)
    for seed in range(first, 50, len(MASKS)):
        parts = three_bands(GRID, mask, seed)
        height = np.where(mask, sum(parts), np.nan)
        bands = split_bands(height, mask, GRID.pitch_mm, EDGES_MM)
        assert np.abs(sum(bands)[mask] - height[mask]).max() < 1e-9
        found = [band[mask].std() for band in bands]
        assert found == pytest.approx([40, 8, 2], rel=0.01), seed


@pytest.mark.one_of_each
@pytest.mark.parametrize(("share", "off"), [(0.1, 0.01), (0.2, 0.015), (0.3, 0.025)])
@pytest.mark.parametrize("name", ["annulus", "ellipse"])
def test_drop_outs_do_not_make_short_periods(name: str, share: float, off: float) -> None:
    """Filled from the nearest edge, each left a step: an HSF of 2 nm read 3 nm where 30 % were missing."""
    mask = MASKS[name] & (np.random.default_rng(5).random(GRID.shape) > share)
    parts = three_bands(GRID, mask, 61)
    bands = split_bands(np.where(mask, sum(parts), np.nan), mask, GRID.pitch_mm, EDGES_MM)
    assert [band[mask].std() for band in bands] == pytest.approx([40, 8, 2], rel=off)


def test_holes_are_continued_as_a_plate_and_the_rest_from_the_edge() -> None:
    x, y = np.meshgrid(GRID.x_mm, GRID.y_mm)
    wave = 30 * np.cos(x / 9) * np.cos(y / 11)
    drops = np.random.default_rng(6).random(GRID.shape) > 0.2
    mask = MASKS["circle"] & drops
    wide, window = extend_rim(np.where(mask, wave, np.nan), mask, 40)
    found = wide[window]
    np.testing.assert_array_equal(found[mask], wave[mask])
    inside = ndimage.binary_erosion(ndimage.binary_closing(mask, iterations=3), iterations=6) & ~drops
    assert np.sqrt(np.mean((found - wave)[inside] ** 2)) < 0.15
    assert not wide[:2].any()


def test_zero_filling_would_not_do() -> None:
    mask = MASKS["circle"]
    parts = three_bands(GRID, mask, 1)
    f = np.hypot(np.fft.fftfreq(GRID.ny)[:, None], np.fft.fftfreq(GRID.nx)[None, :])
    spectrum = np.fft.fft2(np.where(mask, sum(parts), 0.0))
    middle = np.fft.ifft2(np.where((f > 1 / EDGES_MM[0]) & (f <= 1 / EDGES_MM[1]), spectrum, 0)).real
    assert abs(middle[mask].std() / 8 - 1) > 0.05


def test_the_usual_edges_are_the_documented_ones() -> None:
    assert USUAL_EDGES_MM == (33.0, 0.12)
    mask = MASKS["circle"]
    height = sum(three_bands(GRID, mask, 2))
    for with_default, named in zip(
        split_bands(height, mask, 1.0), split_bands(height, mask, 1.0, (33.0, 0.12)), strict=True
    ):
        np.testing.assert_array_equal(with_default, named)


def test_what_lies_outside_the_mask_does_not_matter() -> None:
    mask = MASKS["annulus"]
    height = sum(three_bands(GRID, mask, 3))
    clean = split_bands(np.where(mask, height, np.nan), mask, 1.0, EDGES_MM)
    dirty = split_bands(np.where(mask, height, 1e6), mask, 1.0, EDGES_MM)
    for one, other in zip(clean, dirty, strict=True):
        np.testing.assert_allclose(one[mask], other[mask], atol=1e-9)


def test_an_edge_longer_than_the_part_leaves_the_fit_in_the_first_band() -> None:
    mask = MASKS["circle"]
    parts = three_bands(GRID, mask, 4)
    first, rest = split_bands(sum(parts), mask, 1.0, (5000.0,))
    assert np.abs((first + rest)[mask] - sum(parts)[mask]).max() < 1e-9
    assert first[mask].std() < sum(parts)[mask].std()
