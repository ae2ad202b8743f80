"""RMS of bands on masked surfaces whose bands are known."""

from __future__ import annotations

import numpy as np
import pytest

from polishd.model.surface import Grid
from polishd.process.metrics import EDGES_MM as USUAL_EDGES_MM
from polishd.process.metrics import split_bands
from tests.unit.process.masked import EDGES_MM, shapes, three_bands

GRID = Grid(300, 300, 1.0)
MASKS = shapes(GRID)


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
