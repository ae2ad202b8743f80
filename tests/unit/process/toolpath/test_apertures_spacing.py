"""Points at equal ways along a curve, and along a polyline on the optic."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from polishd.model.errors import ComputeError
from polishd.model.process import FLAT, Optic
from polishd.model.surface import FloatArray
from polishd.process.toolpath.apertures import along_polyline, on_optic, require_points, resample_evenly

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


def test_so_many_points_nobody_wants() -> None:
    with pytest.raises(ComputeError, match="the number of points is 1e\\+08"):
        along_polyline(FLAT, np.array([[0.0, 0.0], [100.0, 0.0]]), 1e-6)
    with pytest.raises(ComputeError, match="the number of points is nan"):
        require_points(float("nan"))
