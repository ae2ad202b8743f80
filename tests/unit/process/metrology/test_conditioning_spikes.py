"""Spikes and islands are taken out and counted; surfaces are left alone."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from polishd.model.errors import MapError
from polishd.model.outline import Circle
from polishd.model.surface import Grid, SurfaceMap
from polishd.plugins.interferometer.formats.metropro import METROPRO
from polishd.process.metrology.conditioning import clean_map, condition, remove_islands, remove_spikes
from tests.unit.process.gaussian import rough

GRID = Grid(120, 120, 0.5)
DISC = GRID.radius_mm() <= 28
SMOOTH = np.where(DISC, rough(GRID, seed=2, cut_mm=8), np.nan)


@pytest.mark.full
@settings(max_examples=20)
@given(st.integers(0, 10**6), st.integers(1, 30), st.floats(1.5, 4.0), st.booleans())
def test_spikes_are_found_and_nothing_else(seed: int, n: int, decades: float, negative: bool) -> None:
    rng = np.random.default_rng(seed)
    rows, columns = (axis[rng.choice(len(axis), n, replace=False)] for axis in np.nonzero(GRID.radius_mm() <= 26))
    where = sorted(set(zip(rows.tolist(), columns.tolist(), strict=True)))
    where = [(row, column) for row, column in where if DISC[row, column]]
    height = SMOOTH.copy()
    for row, column in where:
        height[row, column] += (-1 if negative else 1) * 10 * 10**decades
    found, spikes = remove_spikes(height)
    expected = np.zeros(DISC.shape, dtype=bool)
    for row, column in where:
        expected[max(row - 1, 0) : row + 2, max(column - 1, 0) : column + 2] = True
    assert spikes == len(where)
    np.testing.assert_array_equal(found, np.where(expected, np.nan, SMOOTH))


def test_a_surface_without_spikes_is_left_alone() -> None:
    for seed in range(5):
        height = np.where(DISC, rough(GRID, seed=seed), np.nan)
        found, spikes = remove_spikes(height)
        assert spikes == 0
        np.testing.assert_array_equal(found, height)
    x = GRID.x_mm[None, :] * np.ones(GRID.shape)
    assert remove_spikes(np.where(DISC, 100 * x**2, np.nan))[1] == 0  # nothing but form: no scatter to go by


def test_too_many_are_a_bad_map() -> None:
    height = SMOOTH.copy()
    rows, columns = np.nonzero(DISC)
    some = np.random.default_rng(1).choice(rows.size, rows.size // 40, replace=False)
    height[rows[some], columns[some]] += 5000
    with pytest.raises(MapError, match=r"samples stand more than .* nm off the surface, more than 1\.0% of the map"):
        remove_spikes(height)
    assert remove_spikes(height, most=0.05)[1] == some.size


def test_the_threshold_counts() -> None:
    height = SMOOTH.copy()
    height[60, 60] += 200.0
    assert remove_spikes(height)[1] == 1
    assert remove_spikes(height, mads=1000)[1] == 0
    with pytest.raises(ValueError, match="positive"):
        remove_spikes(height, mads=0)


def test_islands_go_and_pieces_of_the_part_stay() -> None:
    height = SMOOTH.copy()
    height[2, 2] = 5.0
    height[2, 110:112] = 7.0
    np.testing.assert_array_equal(remove_islands(height), SMOOTH)
    halves = SMOOTH.copy()
    halves[:, 55:60] = np.nan
    np.testing.assert_array_equal(remove_islands(halves), halves)
    empty = np.full((4, 4), np.nan)
    assert np.isnan(remove_islands(empty)).all()


def test_a_map_is_conditioned_without_its_spikes() -> None:
    spiked = SMOOTH.copy()
    spiked[40, 50] += 3e4
    arguments = {"outline": Circle(25.0), "edge_mm": 3.0, "grid_mm": 1.0}
    found = {mads: clean_map(SurfaceMap(spiked, 0.5), mads) for mads in (0.0, 12.0)}
    assert [count for _, count in found.values()] == [0, 1]
    assert clean_map(SurfaceMap(SMOOTH, 0.5), 12.0)[1] == 0
    plain = condition(SurfaceMap(SMOOTH, 0.5), **arguments)  # type: ignore[arg-type]
    as_it_is, clean = (condition(surface, **arguments) for surface, _ in found.values())  # type: ignore[arg-type]
    inside = plain.metric_mask & clean.metric_mask
    assert np.abs(as_it_is.height_nm - plain.height_nm)[plain.metric_mask].max() > 1000
    assert np.abs(clean.height_nm - plain.height_nm)[inside].max() < 5


@pytest.mark.full
def test_a_measured_map_keeps_nearly_all_of_itself(shared_data: Path) -> None:
    surface = METROPRO.read(shared_data / "zygo_metropro.dat")
    found, _ = remove_spikes(surface.height_nm)
    assert np.isfinite(found).sum() > 0.99 * surface.valid.sum()
