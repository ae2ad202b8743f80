"""The geometry of rasters: what is covered, where turns lie, how moves are cut, on flats and on optics."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import KDTree

from polishd.model.errors import ComputeError
from polishd.model.process import FLAT, Optic
from polishd.model.surface import FloatArray, Grid
from polishd.process.optic_surface import sag_mm
from polishd.process.toolpath.apertures import Aperture, annulus, circle, ellipse, over_mask, rectangle
from polishd.process.toolpath.paths import LEAD_IN_MM, crossed_raster, raster

APERTURES = {"circle": circle(60), "ellipse": ellipse(70, 30), "rectangle": rectangle(50, 24), "ring": annulus(60, 20)}


def lengths(points: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.norm(np.diff(points, axis=0), axis=1))


def turns(points: FloatArray) -> FloatArray:
    """Both ends of every move that changes y."""
    moves = np.abs(np.diff(points[:, 1])) > 1e-9
    return np.concatenate([points[:-1][moves], points[1:][moves]])


def outside(aperture: Aperture, points: FloatArray) -> FloatArray:
    """(n,) how far points lie outside an aperture: for far ones the distance, for near ones no more than that."""
    x, y = points.T[:2]
    angle = np.arange(len(aperture.reach_mm)) * 2 * np.pi / len(aperture.reach_mm)
    beyond = np.cos(angle)[:, None] * x + np.sin(angle)[:, None] * y - aperture.reach_mm[:, None]
    return np.asarray(beyond.max(axis=0))


def samples(aperture: Aperture, n: int = 61) -> FloatArray:
    line = np.linspace(-aperture.radius_mm, aperture.radius_mm, n)
    grid = np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)
    return np.asarray(grid[outside(aperture, grid) <= 0])


def test_the_demo_raster() -> None:
    points = raster(circle(100), 1.0, 1.0)
    assert points.shape == (8409, 3)
    assert not points[:, 2].any()
    assert points[0, 1] > 0 > points[-1, 1]  # from the top down
    assert points[1, 0] > points[0, 0]  # to the right


@pytest.mark.full
@settings(max_examples=40)
@given(st.floats(5, 60), st.floats(0.5, 4), st.floats(0.5, 3), st.floats(0, 3), st.floats(0, 8))
def test_any_raster(radius: float, pitch: float, step: float, overrun: float, landing: float) -> None:
    points = raster(circle(2 * radius), pitch, step, overrun_mm=overrun, landing_mm=landing)
    distance = np.hypot(points[:, 0], points[:, 1])
    assert min(distance[0], distance[-1]) >= radius + landing - 1e-9
    bends = turns(points)
    assert (np.hypot(bends[:, 0], bends[:, 1]) >= radius + overrun - 1e-9).all()
    size = lengths(points)
    assert size.max() <= 1.5 * step + 1e-9
    assert size.min() > 0
    away = KDTree(points[:, :2]).query(samples(circle(2 * radius), 41))[0]
    assert away.max() <= np.hypot(pitch, 1.5 * step) + 1e-9


def test_lines_are_straight_and_alternate() -> None:
    points = raster(circle(40), 2.0, 1.0)
    move = np.diff(points, axis=0)
    along_x, along_y = np.abs(move[:, 0]) > 1e-9, np.abs(move[:, 1]) > 1e-9
    assert (along_x ^ along_y).all()
    assert (move[along_y, 1] < 0).all()
    sign, line = np.sign(move[along_x, 0]), np.round(points[:-1][along_x, 1], 6)
    np.testing.assert_array_equal(np.unique(line), np.arange(-20.0, 21.0, 2.0))
    order = [set(sign[line == y]) for y in sorted(np.unique(line), reverse=True)]
    assert order == [{1.0 if k % 2 == 0 else -1.0} for k in range(len(order))]


def test_moves_on_a_stretch_are_equal_and_near_the_wanted_length() -> None:
    points = raster(circle(60), 1.0, 0.7)
    on_line = np.abs(np.diff(points[:, 1])) < 1e-9
    long = on_line & (np.hypot(points[:-1, 0], points[:-1, 1]) < 25)
    size = lengths(points)[long]
    assert size.min() > 0.69 * 0.98
    assert size.max() < 0.71 * 1.02


def test_the_way_in_lies_on_the_first_line() -> None:
    points = raster(circle(100), 1.0, 1.0, landing_mm=7)
    assert np.hypot(*points[0, :2]) >= 57 - 1e-9
    first = points[np.isclose(points[:, 1], points[0, 1])]
    assert len(first) > LEAD_IN_MM
    assert (np.diff(first[:-1, 0]) > 0).all()


@pytest.mark.full
@pytest.mark.one_of_each
@pytest.mark.parametrize("name", APERTURES)
@pytest.mark.parametrize("direction", [0.0, 30.0, 90.0, -137.0])
def test_any_aperture_in_any_direction(name: str, direction: float) -> None:
    aperture = APERTURES[name]
    points = raster(aperture, 1.0, 1.0, direction_deg=direction, overrun_mm=1.5, landing_mm=6.0)
    turn = np.radians(direction)
    move = np.diff(points[:, :2], axis=0) / lengths(points)[:, None]
    along = move @ [np.cos(turn), np.sin(turn)]
    assert np.minimum(abs(abs(along) - 1), abs(along)).max() < 1e-6, "along the lines or across them"
    assert along[0] == pytest.approx(1)
    across = abs(along) < 0.5
    ends = np.concatenate([points[:-1][across], points[1:][across]])
    assert outside(aperture, ends).min() > 1.5 - 1e-3, "turns lie outside"
    assert outside(aperture, points[[0, -1]]).min() > 6.0 - 1e-3
    assert KDTree(points[:, :2]).query(samples(aperture))[0].max() < 1.2


def test_a_mask() -> None:
    grid = Grid(60, 100, 1.0)
    box = (np.abs(grid.y_mm)[:, None] < 20) & (np.abs(grid.x_mm)[None, :] < 40)
    for mask in (box, grid.radius_mm() < 25):
        points = raster(over_mask(grid, mask), 1.0, 1.0, overrun_mm=1.0, landing_mm=6.0)
        inside = np.argwhere(mask)
        covered = np.column_stack([grid.x_mm[inside[:, 1]], grid.y_mm[inside[:, 0]]])
        assert KDTree(points[:, :2]).query(covered)[0].max() < 1.2
        ends = turns(points)
        assert KDTree(covered).query(ends[:, :2])[0].min() > 1.0
        assert KDTree(covered).query(points[[0, -1], :2])[0].min() > 6.0


@pytest.mark.parametrize("optic", [Optic(90.0), Optic(-90.0, -1.0), Optic(150.0, -0.6, (1e-7,), (40.0, -25.0))])
@pytest.mark.parametrize("direction", [0.0, 50.0])
def test_on_an_optic(optic: Optic, direction: float) -> None:
    """Points lie on it, moves are equal along it, and the lines are the pitch apart along it at the centre."""
    points = raster(circle(60), 1.0, 1.0, optic=optic, direction_deg=direction)
    np.testing.assert_allclose(points[:, 2], sag_mm(optic, points[:, :2]), atol=1e-12)
    turn = np.radians(direction)
    u, v = points[:, :2] @ [np.cos(turn), np.sin(turn)], points[:, :2] @ [-np.sin(turn), np.cos(turn)]
    lines = np.unique(np.round(v[np.abs(u) < 5], 6))
    section = np.column_stack([-np.sin(turn) * lines, np.cos(turn) * lines])
    fine = np.linspace(section[:-1], section[1:], 21)
    at = np.concatenate([fine, sag_mm(optic, fine.reshape(-1, 2)).reshape(*fine.shape[:2], 1)], axis=2)
    apart = np.linalg.norm(np.diff(at, axis=0), axis=2).sum(axis=0)
    np.testing.assert_allclose(apart, 1.0, rtol=2e-4)
    flat = raster(circle(60), 1.0, 1.0, direction_deg=direction)
    assert len(points) > len(flat), "there is more of a curved surface"
    assert np.abs(lines).min() < 1e-9, "one line passes through the centre"
    size = lengths(points)
    on_line = np.abs(np.diff(v)) < 1e-9
    for line in lines[[3, len(lines) // 2, -4]]:
        here = size[on_line & (np.abs(v[:-1] - line) < 1e-6)]
        inner = here[8:-8]  # the stretch on which a line ends may be the way to the next
        np.testing.assert_allclose(inner, inner.mean(), rtol=1e-3)


def test_a_flat_optic_is_no_optic() -> None:
    np.testing.assert_array_equal(raster(circle(30), 1, 1, optic=Optic(None, -1.0)), raster(circle(30), 1, 1))
    weak = raster(circle(30), 1, 1, optic=Optic(1e9))
    np.testing.assert_allclose(weak, raster(circle(30), 1, 1), atol=1e-5)


def test_an_optic_that_ends_before_the_path_does() -> None:
    assert np.isfinite(raster(circle(80), 1.0, 1.0, optic=Optic(50.0), landing_mm=1.0)).all()
    with pytest.raises(
        ComputeError, match=r"the distance from the part's axis is \d+\.?\d* mm, .* 50 mm from its axis"
    ):
        raster(circle(98), 1.0, 1.0, optic=Optic(50.0), overrun_mm=2.0)


@pytest.mark.full
def test_a_million_points() -> None:
    points = raster(circle(1100), 1.0, 1.0, optic=Optic(4000.0, -1.0))
    assert 0.95e6 < len(points) < 1.05e6
    assert np.isfinite(points).all()


@pytest.mark.parametrize(
    ("pitch", "step", "overrun", "landing", "what"),
    [
        (-1.0, 1.0, 1.0, 5.0, "the pitch is -1 mm, it must be above 0"),
        (1.0, 0.0, 1.0, 5.0, "the step is 0 mm"),
        (1.0, float("inf"), 1.0, 5.0, "the step is inf"),
        (1.0, 1.0, -0.5, 5.0, "the overrun is -0.5 mm"),
        (1.0, 1.0, 1.0, float("nan"), "the landing's distance is nan"),
        (1.0, 1e-7, 1.0, 5.0, "the number of points"),
        (1e-7, 1.0, 1.0, 5.0, "the number of lines"),
    ],
)
def test_lengths_that_are_none(pitch: float, step: float, overrun: float, landing: float, what: str) -> None:
    for optic in (FLAT, Optic(100.0)):
        with pytest.raises(ComputeError, match=what):
            raster(circle(30), pitch, step, optic=optic, overrun_mm=overrun, landing_mm=landing)


@pytest.mark.full
def test_a_phase_shifts_the_lines() -> None:
    both = (raster(circle(60), 2.0, 1.0, phase=phase) for phase in (0.0, 0.5))
    first, second = (np.unique(np.round(one[np.abs(one[:, 0]) < 5, 1], 6)) for one in both)
    np.testing.assert_allclose(np.diff(second), 2.0)
    assert np.abs(first[:, None] - second).min() == pytest.approx(1.0)
    np.testing.assert_array_equal(raster(circle(60), 2.0, 1.0, phase=3.0), raster(circle(60), 2.0, 1.0))
    assert KDTree(raster(circle(60), 2.0, 1.0, phase=0.3)[:, :2]).query(samples(circle(60)))[0].max() < 1.2


@pytest.mark.parametrize("name", APERTURES)
@pytest.mark.parametrize("cross", [60.0, 90.0])
def test_a_crossed_raster_is_two_rasters_and_a_way_round(name: str, cross: float) -> None:
    aperture = APERTURES[name]
    points = crossed_raster(aperture, 1.5, 1.0, cross_deg=cross, landing_mm=6.0)
    first, second = (raster(aperture, 1.5, 1.0, direction_deg=turn, landing_mm=6.0) for turn in (0.0, cross))
    np.testing.assert_array_equal(points[: len(first)], first)
    np.testing.assert_array_equal(points[-len(second) :], second)
    way = points[len(first) - 1 : len(points) - len(second) + 1]
    assert (outside(aperture, way) > 5.9).all(), "the tool does not cross the part between both"
    assert lengths(points).max() < 1.6
    assert lengths(way).sum() < np.pi * (aperture.radius_mm + 20) + 20, "the shorter way"


@pytest.mark.parametrize("cross", [0.0, 180.0, float("nan")])
def test_rasters_that_do_not_cross(cross: float) -> None:
    with pytest.raises(ComputeError, match="the angle between both rasters is"):
        crossed_raster(circle(60), 1.5, 1.0, cross_deg=cross)
