"""Frames against scipy's rotations, hand-worked cases and round trips."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from polishd.model.errors import ComputeError
from polishd.model.process import Placement
from polishd.model.surface import FloatArray
from polishd.process import frames

TURN = st.floats(-360, 360)


@given(TURN, TURN, TURN)
def test_rpy_are_intrinsic_turns_about_x_y_z(roll: float, pitch: float, yaw: float) -> None:
    want = Rotation.from_euler("XYZ", [roll, pitch, yaw], degrees=True).as_matrix()
    np.testing.assert_allclose(frames.rotation_from_rpy_deg(roll, pitch, yaw), want, atol=1e-12)


def shipped() -> Placement:
    return Placement((300.0, 220.0, 2315.0), frames.rotation_from_rpy_deg(180.0, 0.0, 0.0))


def test_the_shipped_part_lies_face_up() -> None:
    points = frames.points_to_base(shipped(), np.array([[0.0, 0.0, 0.0], [10.0, 0.0, 0.0], [0.0, 10.0, 5.0]]))
    np.testing.assert_allclose(points, [[300, 220, 2315], [310, 220, 2315], [300, 210, 2310]], atol=1e-9)
    np.testing.assert_allclose(frames.surface_normals(shipped(), 2), [[0, 0, -1]] * 2, atol=1e-12)


def test_directions_turn_but_do_not_move() -> None:
    turned = Placement((1.0, 2.0, 3.0), frames.rotation_from_rpy_deg(0.0, 0.0, 90.0))
    np.testing.assert_allclose(frames.directions_to_base(turned, np.array([[2.0, 0, 0]])), [[0, 2, 0]], atol=1e-12)
    np.testing.assert_allclose(frames.points_to_base(turned, np.array([[2.0, 0, 0]])), [[1, 4, 3]], atol=1e-12)


@pytest.mark.parametrize("rotation", [np.diag([1.0, 1.0, -1.0]), 2 * np.eye(3), np.eye(2), np.full((3, 3), np.nan)])
def test_a_placement_that_is_not_a_rotation_is_refused(rotation: FloatArray) -> None:
    with pytest.raises(ComputeError, match="proper"):
        frames.points_to_base(Placement((0.0, 0.0, 0.0), rotation), np.zeros((1, 3)))


def test_a_placement_or_point_that_is_not_finite_is_refused() -> None:
    with pytest.raises(ComputeError, match="finite origin"):
        frames.surface_normals(Placement((0.0, np.inf, 0.0), np.eye(3)), 1)
    with pytest.raises(ComputeError, match="point 1: point in the part's frame is inf mm"):
        frames.points_to_base(shipped(), np.array([[0.0, 0.0, 0.0], [0.0, np.inf, 0.0]]))


def test_the_spindle_leans_towards_the_base_axis() -> None:
    tip = np.array([[300.0, 0.0, 2000.0], [0.0, -50.0, 2100.0], [-30.0, 40.0, 1900.0]])
    axis = frames.inward_axis(tip, np.tile([0.0, 0.0, -1.0], (3, 1)), 30.0)
    s, c = 0.5, np.sqrt(0.75)
    np.testing.assert_allclose(axis, [[-s, 0, -c], [0, s, -c], [0.6 * s, -0.8 * s, -c]], atol=1e-12)
    np.testing.assert_allclose(frames.dips_deg(axis, np.tile([0.0, 0.0, -1.0], (3, 1))), 30.0, atol=1e-12)


@given(st.integers(0, 2**31))
def test_on_a_tilted_part_the_dip_is_still_from_the_normal_and_inward(seed: int) -> None:
    rng = np.random.default_rng(seed)
    tip = rng.uniform(100, 600, (4, 3))
    normal = rng.normal(size=(4, 3)) * [0.3, 0.3, 0.1] + [0, 0, -1.0]
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    axis = frames.inward_axis(tip, normal, 15.0)
    np.testing.assert_allclose(np.linalg.norm(axis, axis=1), 1.0, atol=1e-12)
    np.testing.assert_allclose(np.einsum("ni,ni->n", axis, normal), np.cos(np.radians(15)), atol=1e-12)
    lean = axis - np.cos(np.radians(15)) * normal
    plane = np.einsum("ni,ni->n", np.cross(lean, normal), tip * [1, 1, 0])
    np.testing.assert_allclose(plane, 0.0, atol=1e-9)  # leans in the plane of the normal and the radius
    assert (np.einsum("ni,ni->n", lean, tip * [1, 1, 0]) < 0).all()


def test_no_inward_direction_is_a_refusal() -> None:
    up = np.array([[0.0, 0.0, -1.0]] * 2)
    with pytest.raises(ComputeError, match=r"point 1: the way to the base's z axis .* is 0 mm"):
        frames.inward_axis(np.array([[100.0, 0, 2000], [0, 0, 2000.0]]), up, 15.0)
    with pytest.raises(ComputeError, match="the dip is 90 deg, it must be above -90 and below 90"):
        frames.inward_axis(np.array([[100.0, 0, 2000]] * 2), up, 90.0)


def test_angles_to_axes_by_hand() -> None:
    axis = frames.axis_from_angles(np.array([0.0, 90.0, 90.0, 30.0]), np.array([77.0, 0.0, 90.0, 180.0]))
    want = [[0, 0, 1], [0, -1, 0], [1, 0, 0], [0, 0.5, np.sqrt(0.75)]]
    np.testing.assert_allclose(axis, want, atol=1e-12)


@given(st.floats(0.001, 179.9), st.floats(-179.9, 179.9))
def test_axes_to_angles_and_back(a_deg: float, c_deg: float) -> None:
    axis = frames.axis_from_angles(np.array([a_deg]), np.array([c_deg]))
    a, c = frames.angles_from_axis(axis)
    assert a[0] == pytest.approx(a_deg, abs=1e-9)
    assert c[0] == pytest.approx(c_deg, abs=1e-6)


def test_c_runs_on_where_the_axis_turns_on() -> None:
    c_deg = np.linspace(0.0, 1000.0, 200)
    _, got = frames.angles_from_axis(frames.axis_from_angles(np.full(200, 15.0), c_deg))
    np.testing.assert_allclose(got, c_deg, atol=1e-9)


def test_c_stays_where_it_is_not_defined() -> None:
    a_deg = np.array([0.0, 0.0, 10.0, 0.0, 10.0, 0.0])
    c_deg = np.array([5.0, 5.0, 170.0, 5.0, -170.0, 5.0])
    a, c = frames.angles_from_axis(frames.axis_from_angles(a_deg, c_deg))
    np.testing.assert_allclose(a, a_deg, atol=1e-12)
    np.testing.assert_allclose(c, [170, 170, 170, 170, 190, 190], atol=1e-9)
    np.testing.assert_array_equal(frames.angles_from_axis(np.array([[0.0, 0.0, 1.0]]))[1], [0.0])


def test_an_axis_that_is_not_a_unit_vector_is_refused() -> None:
    with pytest.raises(ComputeError, match="point 0: the length of tool axis is 2"):
        frames.angles_from_axis(np.array([[0.0, 0.0, 2.0]]))
