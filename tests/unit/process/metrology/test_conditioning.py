"""Resampling conserves volume, holes are filled, masks are kept, and bad maps refused.

Spikes and islands are taken out and counted; surfaces are left alone.

Implausible dates and lateral scales are removed from a map of any reader.
"""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from polishd.model.errors import MapError
from polishd.model.instrument import Instrument
from polishd.model.outline import Circle
from polishd.model.surface import Grid, SurfaceMap
from polishd.plugins.interferometer.formats.metropro import METROPRO
from polishd.process.metrology.conditioning import (
    ConditionedMap,
    Masks,
    clean_map,
    condition,
    drop_implausible,
    fill_holes,
    process_grid,
    remove_islands,
    remove_spikes,
)
from polishd.process.metrology.instrument import apply_profile
from polishd.process.metrology.resampling import resample_registered
from polishd.process.metrology.statistics import polynomial
from tests.unit.process.gaussian import rough

FINE = Grid(240, 240, 0.25)


def disc_map(grid: Grid = FINE, radius_mm: float = 26.0, seed: int = 0) -> SurfaceMap:
    height = rough(grid, seed=seed)
    return SurfaceMap(np.where(grid.radius_mm() <= radius_mm, height, np.nan), grid.pitch_mm, path=Path("a.dat"))


def conditioned(surface: SurfaceMap, **changes: Any) -> ConditionedMap:
    return condition(surface, **({"outline": Circle(25.0), "edge_mm": 3.0, "grid_mm": 1.0} | changes))


@settings(max_examples=30)
@given(st.integers(4, 30), st.integers(4, 30), st.floats(0.1, 2), st.floats(0.1, 4))
def test_resampling_conserves_volume(ny: int, nx: int, pitch: float, onto: float) -> None:
    source = Grid(ny, nx, pitch)
    height = np.random.default_rng(ny * nx).standard_normal(source.shape) + 5
    # an odd margin, so that the cells' edges do not coincide
    target = Grid(int(ny * pitch / onto) + 3, int(nx * pitch / onto) + 3, onto)
    there = resample_registered(np.pad(height, 20), Grid(ny + 40, nx + 40, pitch), target)
    held = np.nan_to_num(there).sum() * onto**2
    if (np.array(target.shape) * onto < (np.array(source.shape) + 40) * pitch).all():
        assert held == pytest.approx(height.sum() * pitch**2, rel=1e-9)


def test_a_block_is_averaged() -> None:
    height = np.arange(16.0).reshape(4, 4)
    expected = height.reshape(2, 2, 2, 2).mean(axis=(1, 3))
    np.testing.assert_allclose(resample_registered(height, Grid(4, 4, 0.5), Grid(2, 2, 1.0)), expected)


def test_missing_data_do_not_enter_the_average() -> None:
    height = np.arange(16.0).reshape(4, 4)
    height[0, :2] = np.nan  # half of the first cell
    height[2:, :2] = np.nan
    height[3, 3] = np.nan
    height[2, 3] = np.nan
    there = resample_registered(height, Grid(4, 4, 0.5), Grid(2, 2, 1.0))
    assert there[0, 0] == 4.5
    assert np.isnan(there[1, 0])
    assert there[1, 1] == 12
    height[1, 0] = np.nan
    assert np.isnan(resample_registered(height, Grid(4, 4, 0.5), Grid(2, 2, 1.0))[0, 0])


def test_the_centre_stays_and_nothing_is_turned() -> None:
    x, y = np.meshgrid(FINE.x_mm, FINE.y_mm)
    target = Grid(41, 40, 1.0)
    there = resample_registered(3 * x - 2 * y, FINE, target)
    expected = 3 * target.x_mm[None, :] - 2 * target.y_mm[:, None]
    np.testing.assert_allclose(there, expected, atol=1e-9)


def test_the_grid_covers_the_aperture_and_a_margin() -> None:
    assert process_grid(Circle(50.0), 1.0) == Grid(110, 110, 1.0)
    assert process_grid(Circle(50.0), 0.7, 0.0).nx * 0.7 >= 100
    assert process_grid(Circle(0.15), 0.1, 0.0) == Grid(3, 3, 0.1)


def test_a_map_is_brought_onto_the_grid_and_levelled() -> None:
    surface = disc_map()
    x, y = np.meshgrid(FINE.x_mm, FINE.y_mm)
    tilted = conditioned(surface.with_height(surface.height_nm + 500 + 3 * x - 7 * y), removal="tilt")
    part = conditioned(surface, removal="tilt")
    assert part.grid == Grid(60, 60, 1.0)
    np.testing.assert_allclose(tilted.height_nm, part.height_nm, atol=1e-9)
    inside = part.height_nm[part.metric_mask]
    assert inside.mean() == pytest.approx(0, abs=1e-10)
    np.testing.assert_allclose(polynomial(part.height_nm, part.metric_mask, 1), 0, atol=1e-9)
    raw = resample_registered(surface.height_nm, surface.grid, part.grid)
    raw = raw - polynomial(raw, part.metric_mask, 1)
    np.testing.assert_allclose(inside, raw[part.metric_mask], atol=1e-9)


def test_a_tilt_stays_unless_it_is_to_go() -> None:
    surface = disc_map()
    slope = 3 * np.broadcast_to(FINE.x_mm, FINE.shape)
    part = conditioned(surface.with_height(surface.height_nm + 500 + slope))
    assert part.height_nm[part.metric_mask].mean() == pytest.approx(0, abs=1e-10)
    change = part.height_nm - conditioned(surface).height_nm
    expected = np.broadcast_to(3 * part.grid.x_mm, part.grid.shape)
    np.testing.assert_allclose(change[part.solve_mask], expected[part.solve_mask], atol=0.5)  # rim cells hold a part


def test_the_masks_are_aperture_and_clear_aperture() -> None:
    part = conditioned(disc_map())
    np.testing.assert_array_equal(part.solve_mask, part.grid.radius_mm() <= 25)
    np.testing.assert_array_equal(part.metric_mask, part.grid.radius_mm() <= 22)
    assert np.isfinite(part.height_nm[part.solve_mask]).all()
    assert np.isnan(part.height_nm[~part.solve_mask]).all()


def with_hole(surface: SurfaceMap, x_mm: float, y_mm: float, radius_mm: float) -> SurfaceMap:
    grid = surface.grid
    hole = np.hypot(grid.x_mm[None, :] - x_mm, grid.y_mm[:, None] - y_mm) <= radius_mm
    return surface.with_height(np.where(hole, np.nan, surface.height_nm))


def test_a_hole_is_filled_but_does_not_count() -> None:
    surface = with_hole(disc_map(), 5, -4, 2.5)
    part = conditioned(surface)
    whole = conditioned(disc_map())
    lost = whole.solve_mask & ~part.solve_mask
    assert 12 < lost.sum() < 25
    assert np.isfinite(part.height_nm[lost]).all()
    row, column = np.argwhere(lost).mean(axis=0)
    assert (row, column) == pytest.approx((29.5 + 4, 29.5 + 5), abs=0.6)  # y up: below the middle, to the right


def test_frozen_masks_stay_and_their_holes_are_filled() -> None:
    first = conditioned(disc_map())
    masks = Masks(first.solve_mask, first.metric_mask)
    later = conditioned(with_hole(disc_map(), 5, -4, 2.5), masks=masks)
    np.testing.assert_array_equal(later.solve_mask, first.solve_mask)
    np.testing.assert_array_equal(later.metric_mask, first.metric_mask)
    assert np.isfinite(later.height_nm[later.solve_mask]).all()
    assert np.abs(later.height_nm - first.height_nm)[first.solve_mask].max() < 10
    with pytest.raises(MapError, match="samples that the first map had are missing"):
        conditioned(with_hole(disc_map(), 5, -4, 8), masks=masks)
    with pytest.raises(MapError, match="the masks of the first map are"):
        conditioned(disc_map(), masks=masks, grid_mm=0.5)


def test_a_harmonic_fill_is_exact_for_harmonic_surfaces() -> None:
    y, x = np.mgrid[:20, :30].astype(float)
    harmonic = 3 * x - y + (x**2 - y**2) / 10
    holes = np.zeros(x.shape, bool)
    holes[5:12, 6:17] = True
    holes[15, 20:22] = True
    np.testing.assert_allclose(fill_holes(np.where(holes, np.nan, harmonic)), harmonic, atol=1e-9)


@settings(max_examples=30)
@given(st.integers(0, 10**6), st.floats(0.0, 0.99))
def test_a_fill_keeps_the_data_and_stays_between_their_extremes(seed: int, share: float) -> None:
    rng = np.random.default_rng(seed)
    height = np.where(rng.random((12, 9)) < share, np.nan, rng.standard_normal((12, 9)))
    height[3, 3] = 0.5
    filled = fill_holes(height)
    known = np.isfinite(height)
    np.testing.assert_array_equal(filled[known], height[known])
    assert filled.min() >= height[known].min() - 1e-9
    assert filled.max() <= height[known].max() + 1e-9


def test_refusals() -> None:
    surface = disc_map()
    with pytest.raises(MapError, match=r"a\.dat has no lateral scale"):
        conditioned(SurfaceMap(surface.height_nm, None, path=Path("a.dat")))
    with pytest.raises(MapError, match=r"a\.dat holds no data"):
        conditioned(surface.with_height(np.full(FINE.shape, np.nan)))
    with pytest.raises(MapError, match=r"the map is 60 mm wide, the aperture 70 mm\. .*check the map's units"):
        conditioned(SurfaceMap(surface.height_nm, 0.25), outline=Circle(35.0))
    with pytest.raises(MapError, match="fewer than 100"):
        conditioned(surface, grid_mm=5.0)
    with pytest.raises(MapError, match="of the aperture has data, less than 80%"):
        conditioned(disc_map(radius_mm=21))
    with pytest.raises(MapError, match="no data"):
        fill_holes(np.full((3, 3), np.nan))


def test_a_measured_map(shared_data: Path) -> None:
    with np.load(shared_data / "elongated_mirror_map.npz") as file:
        names = {name.lower(): name for name in file.files}
        x, z = file[names["x"]], file[names["z"]]
    pitch = float(np.median(np.abs(np.diff(x, axis=int(x[0, 0] != x[0, 1]))))) * 1e3
    height = z * 1e9
    surface = SurfaceMap(height, pitch)
    size = min(height.shape) * pitch - 1
    across = round(size / pitch / 2)  # a square of the elongated map: a map much larger than the aperture is refused
    middle = height.shape[1] // 2
    height = height[:, middle - across : middle + across] if height.shape[1] > height.shape[0] else height
    surface = SurfaceMap(height, pitch)
    part = conditioned(surface, outline=Circle(size / 2), edge_mm=1.0, grid_mm=0.5)
    there = part.grid.radius_mm() <= size / 2 - 1
    assert part.metric_mask.sum() == there.sum()
    fine = height[surface.grid.radius_mm() <= size / 2 - 1]
    assert part.height_nm[part.metric_mask].std() == pytest.approx(np.nanstd(fine), rel=0.05)


def test_power_is_removed_where_asked() -> None:
    surface = disc_map()
    x, y = np.meshgrid(FINE.x_mm, FINE.y_mm)
    bowl = surface.with_height(surface.height_nm + 0.5 * (x**2 + y**2) + 2 * x)
    plain, bent = conditioned(surface, removal="power"), conditioned(bowl, removal="power")
    np.testing.assert_allclose(bent.height_nm[bent.metric_mask], plain.height_nm[plain.metric_mask], atol=0.02)
    assert (
        conditioned(bowl, removal="tilt").height_nm[bent.metric_mask].std() > 2 * bent.height_nm[bent.metric_mask].std()
    )


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


NOW = datetime(2026, 3, 1, 12, tzinfo=UTC)
WRITTEN = NOW - timedelta(hours=1)
MAP = SurfaceMap(np.zeros((40, 64)), 0.5, taken_at=NOW - timedelta(days=30))


def found(surface: SurfaceMap) -> SurfaceMap:
    return drop_implausible(surface, NOW, WRITTEN)


def test_a_map_that_may_be_is_as_it_was() -> None:
    assert found(MAP) is MAP
    assert MAP.measured_at == MAP.taken_at
    ahead = replace(MAP, taken_at=NOW + timedelta(hours=14))  # a local time without its zone
    assert found(ahead) is ahead


@pytest.mark.parametrize(
    ("at", "why"),
    [
        (datetime(1984, 12, 31, 23, tzinfo=UTC), "before 1985"),
        (datetime(1970, 1, 9), "before 1985"),  # noqa: DTZ001  as a plugin's reader may say it
    ],
)
def test_a_date_of_no_map_is_guessed(at: datetime, why: str) -> None:
    surface = found(replace(MAP, taken_at=at))
    assert (surface.date_from, surface.measured_at) == ("guessed", None)
    assert why in surface.warnings[0]


def test_a_date_ahead_is_warned_of_and_keeps_its_place_in_the_order() -> None:
    surface = found(replace(MAP, taken_at=NOW + timedelta(days=400)))
    assert surface.measured_at == NOW + timedelta(days=400)
    assert "in the future" in surface.warnings[0]


def test_where_the_header_says_nothing_the_file_system_does() -> None:
    surface = found(replace(MAP, taken_at=None))
    assert (surface.taken_at, surface.date_from, surface.measured_at) == (WRITTEN, "file system", None)
    assert surface.warnings == ()


def test_a_guess_stays_one() -> None:
    surface = replace(MAP, date_from="guessed")
    assert found(surface) is surface
    assert surface.measured_at is None


def test_a_date_without_a_zone_is_utc() -> None:
    assert replace(MAP, taken_at=datetime(2026, 1, 2, 3)).measured_at == datetime(2026, 1, 2, 3, tzinfo=UTC)  # noqa: DTZ001


@pytest.mark.parametrize(
    ("pitch_mm", "why"),
    [
        (312.6, "more than 20 m"),
        (np.inf, "more than 20 m"),
        (0.9e-6, "less than 1 nm"),
        (-0.5, "less"),
        (np.nan, "less"),
    ],
)
def test_a_scale_of_no_part_is_none(pitch_mm: float, why: str) -> None:
    surface = found(replace(MAP, pitch_mm=pitch_mm))
    assert (surface.pitch_mm, set(surface.unsaid)) == (None, {"pitch"})
    assert why in surface.warnings[0]
    looked_at = apply_profile(surface, Instrument("shop", pitch_mm=0.25))
    assert (looked_at.pitch_mm, looked_at.warnings) == (0.25, ())


@pytest.mark.parametrize("pitch_mm", [312.5, 1e-6])
def test_the_largest_and_the_smallest_scale(pitch_mm: float) -> None:
    assert found(replace(MAP, pitch_mm=pitch_mm)).pitch_mm == pitch_mm


def test_a_profile_cannot_give_such_a_scale_either() -> None:
    with pytest.raises(MapError, match=r"profile 'shop' gives it a pitch of 312\.6 mm.*more than 20 m"):
        apply_profile(replace(MAP, pitch_mm=None, unsaid=frozenset({"pitch"})), Instrument("shop", pitch_mm=312.6))
