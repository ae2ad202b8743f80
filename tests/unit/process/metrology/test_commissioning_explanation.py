"""One map explained by another: correlation over shifts against the definition, and every turn found at its place."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from polishd.model.surface import Grid
from polishd.process.frames import ORIENTATIONS, ArrayOrientation
from polishd.process.identification.removal_fit import remove_plane
from polishd.process.metrology.commissioning import REACH_MM, Explanation, correlations, explanations, peak
from tests.unit.process.gaussian import rough

GRID = Grid(40, 40, 1.0)
X, Y = np.meshgrid(GRID.x_mm, GRID.y_mm)
MAP = rough(GRID, rms_nm=10, seed=2)
PART = (np.hypot(X, Y) < 17) & (X < 9)


# correlation over shifts


def test_each_shift_is_the_correlation_over_what_overlaps() -> None:
    """Against the definition, for two masks and maps of odd shape, one of them far from zero."""
    rng = np.random.default_rng(1)
    a, b = rng.normal(1e3, 1, (21, 30)), rng.normal(-50, 9, (21, 30))
    a_mask, b_mask = rng.random((21, 30)) < 0.8, rng.random((21, 30)) < 0.9
    found = correlations(a, a_mask, b, b_mask, 3)
    assert found.shape == (7, 7)
    for down in range(-3, 4):
        for right in range(-3, 4):
            pairs = [
                (a[i - down, j - right], b[i, j])
                for i, j in np.argwhere(b_mask)
                if 0 <= i - down < 21 and 0 <= j - right < 30 and a_mask[i - down, j - right]
            ]
            expected = np.corrcoef(np.array(pairs).T)[0, 1]
            assert found[3 + down, 3 + right] == pytest.approx(expected, abs=1e-6), (down, right)


def test_what_lies_outside_the_masks_does_not_matter() -> None:
    plain = correlations(np.where(PART, MAP, 0), PART, np.where(PART, MAP, 0), PART, 4)
    for outside in (np.nan, 1e9):
        dirty = np.where(PART, MAP, outside)
        np.testing.assert_allclose(correlations(dirty, PART, dirty, PART, 4), plain, atol=1e-9)


def test_little_overlap_and_even_maps_correlate_with_nothing() -> None:
    left, right = X < -10, X > 10
    assert not correlations(MAP, left, MAP, right, 3).any()
    assert not correlations(np.full_like(MAP, 7.0), PART, MAP, PART, 3).any()


@pytest.mark.parametrize(("down", "right"), [(0.0, 0.0), (1.3, -2.6), (-0.4, 3.2)])
def test_the_peak_lies_between_samples(down: float, right: float) -> None:
    moved = ndimage.shift(MAP, (down, right), order=5, mode="nearest")
    whole = np.ones_like(PART)
    value, row, column = peak(correlations(MAP, whole, moved, whole, 5))
    assert value > 0.97
    assert (row, column) == pytest.approx((down, right), abs=0.15)
    assert peak(-correlations(MAP, whole, moved, whole, 5))[0] == -value


def test_a_peak_at_the_border_stays_there() -> None:
    found = np.zeros((5, 5))
    found[0, 2] = 0.5
    assert peak(found) == (0.5, -2.0, 0.0)


# explanations


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("way", ORIENTATIONS, ids=lambda way: way.name)
def test_the_right_explanation_is_the_best(way: ArrayOrientation, sign: int) -> None:
    seen = sign * ndimage.shift(way.turn(MAP), (2, -3), order=1, mode="nearest")
    turned = np.asarray(way.turn(PART))
    found = list(explanations(MAP - MAP[PART].mean(), seen, PART, turned, GRID.pitch_mm))
    assert len(found) == 16
    best = max(found, key=lambda e: e.correlation)
    assert (best.orientation, best.negated) == (way, sign < 0)
    assert best.samples(GRID.pitch_mm) == (2, -3)
    assert best.shift_mm == pytest.approx((-3, -2), abs=0.2)
    assert best.as_it_is == (best.name == "as it is")
    again = ndimage.shift(best.turn(MAP), best.samples(GRID.pitch_mm), order=0, mode="nearest")
    np.testing.assert_allclose(again, seen, atol=1e-9)
    np.testing.assert_array_equal(best.turn_mask(PART), turned)


def test_an_oblong_map_is_turned_by_180_only_and_reach_is_in_mm() -> None:
    grid = Grid(30, 44, 2.0)
    height, mask = rough(grid), np.ones(grid.shape, dtype=np.bool_)
    found = list(explanations(remove_plane(height, mask), height, mask, mask, grid.pitch_mm))
    assert {e.orientation.rotation_deg for e in found} == {0, 180}
    assert len(found) == 8
    assert max(abs(v) for e in found for v in e.shift_mm) <= REACH_MM + grid.pitch_mm


@pytest.mark.parametrize(
    ("way", "negated", "name"),
    [(0, False, "as it is"), (0, True, "negated"), (1, False, "turned 90"), (5, True, "transposed and negated")],
)
def test_names(way: int, negated: bool, name: str) -> None:
    assert Explanation(ORIENTATIONS[way], negated, 0.5, (0.0, 0.0)).name == name
