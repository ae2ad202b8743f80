"""Apertures: outlines, larger and turned ones, cuts along lines, the rim from the centre.

Points at equal ways along a curve, and along a polyline on the optic.
"""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from polishd.model.errors import ComputeError
from polishd.model.process import FLAT, Optic
from polishd.model.surface import FloatArray, Grid
from polishd.process.toolpath.apertures import (
    along_polyline,
    annulus,
    circle,
    ellipse,
    on_optic,
    over_mask,
    rectangle,
    require_points,
    resample_evenly,
)

SIDES = st.floats(1.0, 500.0)


def area(outline: FloatArray) -> float:
    x, y = outline.T
    return float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)) / 2)


@given(SIDES, SIDES)
def test_areas(width: float, height: float) -> None:
    """Outlines run counterclockwise around what they hold."""
    assert area(circle(width).outline_mm()) == pytest.approx(np.pi * width**2 / 4, rel=1e-6)
    assert area(rectangle(width, height).outline_mm()) == pytest.approx(width * height, rel=1e-9)


@pytest.mark.full
@given(st.floats(10.0, 100.0), st.floats(0.2, 1.0), st.floats(0.0, 5.0))
def test_a_larger_one_is_larger_by_as_much_everywhere(width: float, share: float, by: float) -> None:
    """Steiner's formula: area, perimeter and the rounded corners."""
    inner, outer = ellipse(width, share * width), ellipse(width, share * width).larger(by)
    rim = inner.outline_mm()
    perimeter = np.linalg.norm(np.roll(rim, -1, axis=0) - rim, axis=1).sum()
    assert area(outer.outline_mm()) == pytest.approx(area(rim) + perimeter * by + np.pi * by**2, rel=1e-5)
    square = rectangle(width, share * width).larger(by)
    want = share * width**2 + 2 * (1 + share) * width * by + np.pi * by**2
    assert area(square.outline_mm()) == pytest.approx(want, rel=1e-5)


def test_cuts_of_a_circle() -> None:
    y = np.linspace(-49.9, 49.9, 101)
    left, right = circle(100).spans_mm(y)
    np.testing.assert_allclose(right, np.sqrt(2500 - y**2), rtol=1e-4)
    np.testing.assert_allclose(left, -right, atol=1e-9)
    assert (right >= np.sqrt(2500 - y**2) - 1e-12).all(), "never inside the rim"


def test_cuts_of_a_rectangle_and_of_a_larger_one() -> None:
    y = np.array([-10.0, -3.0, 0.0, 10.0])
    left, right = rectangle(60, 20).spans_mm(y)
    np.testing.assert_allclose(left, -30)
    np.testing.assert_allclose(right, 30)
    left, right = rectangle(60, 20).larger(2.0).spans_mm(np.array([0.0, 10.0, 11.0, 12.0]))
    np.testing.assert_allclose(right[:2], 32)
    assert right[2] == pytest.approx(30 + np.sqrt(3), abs=1e-5), "a rounded corner"
    assert right[3] == pytest.approx(30, abs=0.01)
    np.testing.assert_allclose(left, -right, atol=1e-9)


def test_cuts_of_a_turned_ellipse() -> None:
    aperture = ellipse(80, 40).turned(30)
    y = np.linspace(-20, 20, 41)
    left, right = aperture.spans_mm(y)
    for x in (left, right):
        u = x * np.cos(np.pi / 6) + y * np.sin(np.pi / 6)
        v = -x * np.sin(np.pi / 6) + y * np.cos(np.pi / 6)
        np.testing.assert_allclose((u / 40) ** 2 + (v / 20) ** 2, 1, atol=1e-5)
    assert (left < right).all()


@settings(max_examples=30)
@given(SIDES, st.floats(0.1, 10), st.floats(-10, 10))
def test_the_rim_from_the_centre(width: float, ratio: float, turn: float) -> None:
    height = ratio * width
    azimuth = np.linspace(-7, 7, 200) + turn
    cos, sin = np.cos(azimuth), np.sin(azimuth)
    r = ellipse(width, height).rim_mm(azimuth)
    np.testing.assert_allclose((2 * r * cos / width) ** 2 + (2 * r * sin / height) ** 2, 1, rtol=1e-4)
    r = rectangle(width, height).rim_mm(azimuth)
    np.testing.assert_allclose(np.maximum(2 * r * abs(cos) / width, 2 * r * abs(sin) / height), 1, rtol=1e-9)
    np.testing.assert_allclose(circle(width).rim_mm(azimuth), width / 2, rtol=1e-6)


def test_a_hole_shrinks_as_the_rim_grows() -> None:
    aperture = annulus(100, 30)
    assert (aperture.radius_mm, aperture.hole_mm) == (pytest.approx(50), 15)
    assert aperture.larger(4).hole_mm == 11
    assert aperture.larger(4).radius_mm == pytest.approx(54)
    assert aperture.larger(20).hole_mm == 0
    assert aperture.turned(10).hole_mm == 15


def test_a_mask_is_held_with_its_pixels() -> None:
    grid = Grid(60, 80, 0.5)
    mask = np.hypot(grid.x_mm[None, :] - 3, grid.y_mm[:, None]) < 10
    aperture = over_mask(grid, mask)
    y, x = np.argwhere(mask).T
    corners = np.concatenate(
        [
            np.stack([grid.x_mm[x] + sx * grid.pitch_mm / 2, grid.y_mm[y] + sy * grid.pitch_mm / 2], axis=1)
            for sx in (-1, 1)
            for sy in (-1, 1)
        ]
    )
    left, right = aperture.spans_mm(corners[:, 1])
    assert (left <= corners[:, 0] + 1e-9).all()
    assert (right >= corners[:, 0] - 1e-9).all()
    assert area(aperture.outline_mm()) == pytest.approx(np.pi * 10**2, rel=0.06)
    one = np.zeros(grid.shape, bool)
    one[29:31, 39:41] = True
    assert area(over_mask(grid, one).outline_mm()) == pytest.approx(1.0)


def test_what_is_no_aperture() -> None:
    grid = Grid(5, 5, 1.0)
    with pytest.raises(ComputeError, match="mask is empty"):
        over_mask(grid, np.zeros(grid.shape, bool))
    with pytest.raises(ComputeError, match="the aperture's width is -1 mm"):
        circle(-1)
    with pytest.raises(ComputeError, match="the aperture's height is nan"):
        rectangle(3, float("nan"))
    with pytest.raises(ComputeError, match="the diameter of the hole is 12 mm, it must be above 0 and below 10"):
        annulus(10, 12)


def test_the_centre_lies_inside() -> None:
    grid = Grid(40, 40, 1.0)
    with pytest.raises(ComputeError, match="the least way from the part's centre to the rim is -"):
        over_mask(grid, np.hypot(grid.x_mm[None, :] - 12, grid.y_mm[:, None]) < 5)
    aside = over_mask(grid, np.hypot(grid.x_mm[None, :] - 4, grid.y_mm[:, None]) < 7)
    left, right = aside.spans_mm(np.zeros(1))
    assert -4 < left[0] < -2
    assert 10 < right[0] < 12


SPHERE = Optic(100.0)


def arc(angle: FloatArray) -> FloatArray:
    """A circle of 10 mm, run through ever faster."""
    return np.stack([10 * np.cos(angle**2), 10 * np.sin(angle**2), 0 * angle], axis=1)


def test_a_circle_run_through_ever_faster() -> None:
    knots = np.linspace(0, np.sqrt(2 * np.pi), 200)
    points = resample_evenly(arc, knots, np.array([0, 199]), 0.7)
    assert len(points) == round(20 * np.pi / 0.7) + 1
    chord = np.linalg.norm(np.diff(points, axis=0), axis=1)
    np.testing.assert_allclose(chord, 20 * np.sin(np.pi / (len(points) - 1)), rtol=1e-5)
    np.testing.assert_array_equal(points[[0, -1]], arc(knots[[0, -1]]))


def test_corners_become_points() -> None:
    corners = np.array([[0.0, 0.0], [10.3, 0.0], [10.3, 0.2], [-4.0, 0.2]])
    points = along_polyline(FLAT, corners, 1.0)
    for corner in corners:
        assert np.abs(points[:, :2] - corner).sum(axis=1).min() < 1e-12
    assert len(points) == 1 + 10 + 1 + 14
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    np.testing.assert_allclose(steps[:10], 1.03, rtol=1e-9)
    np.testing.assert_allclose(steps[11:], 14.3 / 14, rtol=1e-9)


@settings(max_examples=40)
@given(st.floats(-60, 60), st.floats(10, 80), st.floats(0.3, 3.0))
def test_on_a_sphere_the_way_on_the_surface_counts(x: float, y: float, step: float) -> None:
    """A line seen from above is part of a circle on the sphere: equal steps are equal angles of it."""
    far = np.sqrt(100.0**2 - y**2) * 0.9
    start, end = np.clip(x, -far, far - 1), far
    points = along_polyline(SPHERE, np.array([[start, y], [end, y]]), step)
    radius = np.sqrt(100.0**2 - y**2)
    angle = np.arctan2(points[:, 0], 100.0 - points[:, 2])
    np.testing.assert_allclose(np.hypot(points[:, 0], 100 - points[:, 2]), radius, rtol=1e-12)
    np.testing.assert_allclose(np.diff(angle), (angle[-1] - angle[0]) / (len(angle) - 1), rtol=2e-3)
    assert len(points) - 1 == max(round((angle[-1] - angle[0]) * radius / step), 1)


def test_steps_in_projection_would_be_far_off() -> None:
    points = along_polyline(SPHERE, np.array([[0.0, 0.0], [90.0, 0.0]]), 1.0)
    seen = np.diff(points[:, 0])
    assert seen[0] == pytest.approx(1.0, rel=3e-3)
    assert seen[-1] < 0.45


def test_a_stretch_of_no_length() -> None:
    corners = np.array([[0.0, 0.0], [0.0, 0.0], [2.0, 0.0]])
    points = along_polyline(FLAT, corners, 1.0)
    assert np.isfinite(points).all()
    np.testing.assert_allclose(points[-1], [2, 0, 0])


def test_points_lie_on_the_optic() -> None:
    plane = np.array([[3.0, 4.0]])
    np.testing.assert_allclose(on_optic(SPHERE, plane), [[3, 4, 100 - np.sqrt(1e4 - 25)]])


def test_too_many_points_are_refused() -> None:
    with pytest.raises(ComputeError, match="the number of points is 1e\\+08"):
        along_polyline(FLAT, np.array([[0.0, 0.0], [100.0, 0.0]]), 1e-6)
    with pytest.raises(ComputeError, match="the number of points is nan"):
        require_points(float("nan"))
