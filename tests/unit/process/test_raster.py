"""The geometry of rasters: what is covered, where turns lie, how blocks are cut."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import KDTree

from polishd.model.surface import FloatArray, Grid
from polishd.process.raster import normals, raster, raster_over_mask


def lengths(points: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.norm(np.diff(points, axis=0), axis=1))


def turns(points: FloatArray) -> FloatArray:
    """Both ends of every block that changes y."""
    moves = np.abs(np.diff(points[:, 1])) > 1e-9
    return np.concatenate([points[:-1][moves], points[1:][moves]])


def test_the_demo_raster() -> None:
    points = raster(50, 1.0, 1.0)
    assert points.shape[1] == 3
    assert 8_000 < len(points) < 9_000
    assert not points[:, 2].any()
    assert points[0, 1] > 0 > points[-1, 1]  # from the top down
    assert points[1, 0] > points[0, 0]  # to the right


@settings(max_examples=40)
@given(st.floats(5, 60), st.floats(0.5, 4), st.floats(0.5, 3), st.floats(0, 3), st.floats(0, 8), st.floats(0, 8))
def test_any_raster(radius: float, step: float, block: float, overrun: float, landing: float, lead_in: float) -> None:
    points = raster(radius, step, block, overrun_mm=overrun, landing_mm=landing, lead_in_mm=lead_in)
    distance = np.hypot(points[:, 0], points[:, 1])
    assert min(distance[0], distance[-1]) >= radius + landing - 1e-9
    bends = turns(points)
    assert (np.hypot(bends[:, 0], bends[:, 1]) >= radius + overrun - 1e-9).all()
    size = lengths(points)
    assert size.max() <= 1.5 * block + 1e-9
    assert size.min() > 0
    lines = np.unique(np.round(points[:, 1] / step)[np.isclose(points[:, 1] % step, 0) | True])
    assert len(lines) >= 2 * radius / step - 1
    x = np.linspace(-radius, radius, 41)
    samples = np.array([(a, b) for a in x for b in x if np.hypot(a, b) <= radius])
    away = KDTree(points[:, :2]).query(samples)[0]
    assert away.max() <= np.hypot(step, 1.5 * block) + 1e-9


def test_lines_are_straight_and_alternate() -> None:
    points = raster(20, 2.0, 1.0)
    move = np.diff(points, axis=0)
    along_x, along_y = np.abs(move[:, 0]) > 1e-9, np.abs(move[:, 1]) > 1e-9
    assert (along_x ^ along_y).all()
    assert (move[along_y, 1] < 0).all()
    sign = np.sign(move[along_x, 0])
    line = np.round(points[:-1][along_x, 1], 6)
    for y in np.unique(line):
        assert len(set(sign[line == y])) == 1
    order = [sign[line == y][0] for y in sorted(np.unique(line), reverse=True)]
    assert order == [1.0 if k % 2 == 0 else -1.0 for k in range(len(order))]


def test_blocks_on_a_stretch_are_equal_and_near_the_wanted_length() -> None:
    points = raster(30, 1.0, 0.7)
    on_line = np.abs(np.diff(points[:, 1])) < 1e-9
    long = on_line & (np.hypot(points[:-1, 0], points[:-1, 1]) < 25)
    size = lengths(points)[long]
    assert size.min() > 0.69 * 0.98
    assert size.max() < 0.71 * 1.02


def test_the_way_in_lies_on_the_first_line() -> None:
    points = raster(50, 1.0, 1.0, landing_mm=7, lead_in_mm=5)
    assert np.hypot(*points[0, :2]) >= 57
    first = points[np.isclose(points[:, 1], points[0, 1])]
    assert len(first) > 5
    assert (np.diff(first[:-1, 0]) > 0).all()


def test_a_raster_over_a_rectangle_and_over_a_disc() -> None:
    grid = Grid(60, 100, 1.0)
    box = (np.abs(grid.y_mm)[:, None] < 20) & (np.abs(grid.x_mm)[None, :] < 40)
    for mask in (box, grid.radius_mm() < 25):
        points = raster_over_mask(grid, mask, 1.0, 1.0, overrun_mm=1.0, landing_mm=6.0)
        inside = np.argwhere(mask)
        samples = np.column_stack([grid.x_mm[inside[:, 1]], grid.y_mm[inside[:, 0]]])
        assert KDTree(points[:, :2]).query(samples)[0].max() < 1.2
        ends = turns(points)
        assert KDTree(samples).query(ends[:, :2])[0].min() > 1.0
        assert KDTree(samples).query(points[[0, -1], :2])[0].min() > 6.0
        assert lengths(points).max() <= 1.5 + 1e-9


def test_normals_of_a_flat_part() -> None:
    points = raster(5, 1.0, 1.0)
    up = normals(points)
    assert up.shape == points.shape
    np.testing.assert_array_equal(up[:, 2], 1)
    np.testing.assert_array_equal(up[:, :2], 0)


@pytest.mark.parametrize("bad", [(0.0, 1.0, 1.0), (5.0, -1.0, 1.0), (5.0, 1.0, 0.0), (5.0, 1.0, float("inf"))])
def test_lengths_must_be_positive(bad: tuple[float, float, float]) -> None:
    with pytest.raises(ValueError, match="must be positive"):
        raster(*bad)


def test_other_refusals() -> None:
    with pytest.raises(ValueError, match="must not be negative"):
        raster(5.0, 1.0, 1.0, overrun_mm=-1.0)
    grid = Grid(5, 5, 1.0)
    with pytest.raises(ValueError, match="mask is empty"):
        raster_over_mask(grid, np.zeros(grid.shape, bool), 1.0, 1.0)
