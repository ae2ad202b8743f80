"""Resampling conserves volume, holes are filled, masks are kept, and bad maps refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from polishd.model.errors import MapError
from polishd.model.outline import Circle
from polishd.model.surface import Grid, SurfaceMap
from polishd.process.metrology.conditioning import ConditionedMap, Masks, condition, fill_holes, process_grid
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
    with pytest.raises(MapError, match="the map is 60 mm wide, the aperture 70 mm"):
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
