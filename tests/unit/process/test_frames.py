"""Frames against scipy's rotations, hand-worked cases and round trips."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from polishd.model.errors import ComputeError
from polishd.model.process import ComplianceOptions, Optic, Placement
from polishd.model.surface import FloatArray
from polishd.process import frames
from polishd.sim_backends.common.hidden_truth import tool_axis
from tests.unit.process.moves import inward_axis

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
    np.testing.assert_allclose(frames.surface_normals(shipped(), np.zeros((2, 3))), [[0, 0, -1]] * 2, atol=1e-12)


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
        frames.surface_normals(Placement((0.0, np.inf, 0.0), np.eye(3)), np.zeros((1, 3)))
    with pytest.raises(ComputeError, match="point 1: point in the part's frame is inf mm"):
        frames.points_to_base(shipped(), np.array([[0.0, 0.0, 0.0], [0.0, np.inf, 0.0]]))


def test_the_spindle_leans_towards_the_base_axis() -> None:
    tip = np.array([[300.0, 0.0, 2000.0], [0.0, -50.0, 2100.0], [-30.0, 40.0, 1900.0]])
    axis = inward_axis(tip, np.tile([0.0, 0.0, -1.0], (3, 1)), 30.0)
    s, c = 0.5, np.sqrt(0.75)
    np.testing.assert_allclose(axis, [[-s, 0, -c], [0, s, -c], [0.6 * s, -0.8 * s, -c]], atol=1e-12)
    np.testing.assert_allclose(frames.dips_deg(axis, np.tile([0.0, 0.0, -1.0], (3, 1))), 30.0, atol=1e-12)


@given(st.integers(0, 2**31))
def test_on_a_tilted_part_the_dip_is_still_from_the_normal_and_inward(seed: int) -> None:
    rng = np.random.default_rng(seed)
    tip = rng.uniform(100, 600, (4, 3))
    normal = rng.normal(size=(4, 3)) * [0.3, 0.3, 0.1] + [0, 0, -1.0]
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    axis = inward_axis(tip, normal, 15.0)
    np.testing.assert_allclose(np.linalg.norm(axis, axis=1), 1.0, atol=1e-12)
    np.testing.assert_allclose(np.einsum("ni,ni->n", axis, normal), np.cos(np.radians(15)), atol=1e-12)
    lean = axis - np.cos(np.radians(15)) * normal
    plane = np.einsum("ni,ni->n", np.cross(lean, normal), tip * [1, 1, 0])
    np.testing.assert_allclose(plane, 0.0, atol=1e-9)  # leans in the plane of the normal and the radius
    assert (np.einsum("ni,ni->n", lean, tip * [1, 1, 0]) < 0).all()


def test_no_inward_direction_is_a_refusal() -> None:
    up = np.array([[0.0, 0.0, -1.0]] * 2)
    with pytest.raises(ComputeError, match=r"point 1: the way to the base's z axis .* is 0 mm"):
        inward_axis(np.array([[100.0, 0, 2000], [0, 0, 2000.0]]), up, 15.0)
    with pytest.raises(ComputeError, match="the dip is 90 deg, it must be above -90 and below 90"):
        inward_axis(np.array([[100.0, 0, 2000]] * 2), up, 90.0)


def test_angles_of_axes_by_hand() -> None:
    for axis, a_deg, c_deg in (((0, -1, 0), 90, 0), ((1, 0, 0), 90, 90), ((0, 0.5, np.sqrt(0.75)), 30, 180)):
        a, c = frames.angles_from_axis(np.array([axis]))
        assert (a[0], c[0]) == pytest.approx((a_deg, c_deg), abs=1e-9)


@given(st.floats(0.001, 179.9), st.floats(-179.9, 179.9))
def test_axes_to_angles_and_back(a_deg: float, c_deg: float) -> None:
    axis = tool_axis(np.array([a_deg]), np.array([c_deg]))
    a, c = frames.angles_from_axis(axis)
    assert a[0] == pytest.approx(a_deg, abs=1e-9)
    assert c[0] == pytest.approx(c_deg, abs=1e-6)


def test_c_runs_on_where_the_axis_turns_on() -> None:
    c_deg = np.linspace(0.0, 1000.0, 200)
    _, got = frames.angles_from_axis(tool_axis(np.full(200, 15.0), c_deg))
    np.testing.assert_allclose(got, c_deg, atol=1e-9)


def test_c_stays_where_it_is_not_defined() -> None:
    a_deg = np.array([0.0, 0.0, 10.0, 0.0, 10.0, 0.0])
    c_deg = np.array([5.0, 5.0, 170.0, 5.0, -170.0, 5.0])
    a, c = frames.angles_from_axis(tool_axis(a_deg, c_deg))
    np.testing.assert_allclose(a, a_deg, atol=1e-12)
    np.testing.assert_allclose(c, [170, 170, 170, 170, 190, 190], atol=1e-9)
    np.testing.assert_array_equal(frames.angles_from_axis(np.array([[0.0, 0.0, 1.0]]))[1], [0.0])


def test_an_axis_that_is_not_a_unit_vector_is_refused() -> None:
    with pytest.raises(ComputeError, match="point 0: the length of tool axis is 2"):
        frames.angles_from_axis(np.array([[0.0, 0.0, 2.0]]))


HOME = Placement((0.0, 0.0, 0.0), np.eye(3))


@pytest.mark.parametrize(("radius", "conic"), [(800.0, 0.0), (-800.0, 0.0), (500.0, -1.0), (500.0, -1.7), (900.0, 0.6)])
def test_normals_of_a_conic_are_those_of_its_sag(radius: float, conic: float) -> None:
    rng = np.random.default_rng(4)
    points = np.column_stack([rng.uniform(-150, 150, (50, 2)), np.zeros(50)])

    def sag(x: FloatArray, y: FloatArray) -> FloatArray:
        r2 = x**2 + y**2
        return np.asarray(r2 / (radius * (1 + np.sqrt(1 - (1 + conic) * r2 / radius**2))))

    x, y, h = points[:, 0], points[:, 1], 1e-3
    slope = [(sag(x + h, y) - sag(x - h, y)) / (2 * h), (sag(x, y + h) - sag(x, y - h)) / (2 * h)]
    want = np.column_stack([-slope[0], -slope[1], np.ones(50)])
    want /= np.linalg.norm(want, axis=1)[:, None]
    np.testing.assert_allclose(frames.surface_normals(HOME, points, Optic(radius, conic)), want, atol=1e-8)


def test_a_concave_sphere_looks_at_its_centre() -> None:
    points = np.array([[30.0, -40.0, 0.0]])
    centre = np.array([0.0, 0.0, 250.0])
    on_sphere = np.array([30.0, -40.0, 250 - np.sqrt(250**2 - 2500)])
    want = (centre - on_sphere) / 250
    np.testing.assert_allclose(frames.surface_normals(HOME, points, Optic(250.0))[0], want, atol=1e-12)


def test_a_point_beyond_the_sphere_is_named() -> None:
    points = np.array([[0.0, 0.0, 0.0], [60.0, 0.0, 0.0]])
    with pytest.raises(ComputeError, match=r"point 1: the distance from the part's axis is 60 mm"):
        frames.surface_normals(HOME, points, Optic(50.0))
    with pytest.raises(ComputeError, match="radius of curvature is 0"):
        frames.surface_normals(HOME, points, Optic(0.0))


def meander() -> FloatArray:
    """A path to the right, up, and to the left, that rests twice at one point."""
    return np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0], [2, 0, 0], [2, 0, 0], [2, 1, 0], [2, 2, 0], [1, 2, 0.0]])


def test_tangents_are_central_differences_and_survive_rests() -> None:
    r = np.sqrt(0.5)
    want = [[1, 0, 0], [1, 0, 0], [1, 0, 0], [1, 0, 0], [0, 1, 0], [0, 1, 0], [-r, r, 0], [-1, 0, 0]]
    np.testing.assert_allclose(frames.path_tangents(meander()), want, atol=1e-12)


def test_a_path_without_direction_is_refused() -> None:
    with pytest.raises(ComputeError, match="coincide"):
        frames.path_tangents(np.ones((3, 3)))
    with pytest.raises(ComputeError, match="1 points"):
        frames.path_tangents(np.ones((1, 3)))


@pytest.mark.parametrize(
    ("options", "lean"),
    [
        (ComplianceOptions(dip_direction="along"), [1.0, 0.0, 0.0]),
        (ComplianceOptions(dip_direction="across"), [0.0, 1.0, 0.0]),
        (ComplianceOptions(dip_direction="fixed", dip_azimuth_deg=30.0), [np.sqrt(0.75), 0.5, 0.0]),
        (ComplianceOptions(dip_direction="inward"), [-0.6, 0.8, 0.0]),
    ],
)
def test_where_the_spindle_leans(options: ComplianceOptions, lean: list[float]) -> None:
    tip = np.array([[30.0, -40.0, 0.0], [30.001, -40.0, 0.0]])
    normal = np.tile([0.0, 0.0, 1.0], (2, 1))
    axis = frames.dipped_axes(options, HOME, tip, normal, 20.0)
    want = np.sin(np.radians(20)) * np.array(lean) + [0, 0, np.cos(np.radians(20))]
    np.testing.assert_allclose(axis[0], want, atol=1e-4)
    np.testing.assert_allclose(frames.dips_deg(axis, normal), 20.0, atol=1e-9)
    back = frames.normals_from_axes(axis, frames.lean_directions(options, HOME, tip, normal), 20.0)
    np.testing.assert_allclose(back, normal, atol=1e-12)


def test_a_fixed_lean_is_fixed_on_the_part_wherever_it_lies() -> None:
    turned = Placement((300.0, 0.0, 2000.0), frames.rotation_from_rpy_deg(180.0, 0.0, 40.0))
    options = ComplianceOptions(dip_direction="fixed", dip_azimuth_deg=70.0)
    part = np.random.default_rng(1).uniform(-50, 50, (5, 3))
    normal = frames.surface_normals(turned, part)
    axis = frames.dipped_axes(options, turned, frames.points_to_base(turned, part), normal, 10.0) @ turned.rotation
    np.testing.assert_allclose(np.degrees(np.arctan2(axis[:, 1], axis[:, 0])), 70.0, atol=1e-9)


def test_an_unknown_dip_is_refused() -> None:
    tip, normal = np.ones((1, 3)), np.array([[0.0, 0.0, 1.0]])
    with pytest.raises(ComputeError, match="none of inward"):
        frames.dipped_axes(ComplianceOptions(dip_direction="up"), HOME, tip, normal, 15.0)  # type: ignore[arg-type]
    with pytest.raises(ComputeError, match="the dip is 90 deg"):
        frames.dipped_axes(ComplianceOptions(), HOME, tip, normal, 90.0)


def test_binormals_of_a_helix_are_those_of_the_books() -> None:
    t = np.linspace(0, 6, 4001)
    r, c = 20.0, 5.0
    path = np.column_stack([r * np.cos(t), r * np.sin(t), c * t])
    got, defined = frames.frenet_binormals(path)
    want = np.column_stack([c * np.sin(t), -c * np.cos(t), np.full_like(t, r)]) / np.hypot(r, c)
    assert defined[1:-1].all()
    assert not defined[[0, -1]].any()
    np.testing.assert_allclose(got[1:-1], want[1:-1], atol=2e-6)


def test_a_raster_has_binormals_at_its_corners_only() -> None:
    binormal, defined = frames.frenet_binormals(meander())
    np.testing.assert_array_equal(np.flatnonzero(defined), [6])
    np.testing.assert_allclose(binormal[6], [0, 0, 1], atol=1e-12)


def test_the_rounding_of_a_program_is_not_a_curve() -> None:
    x = np.arange(200.0)
    y = np.round(0.3 * x + 0.00004 * np.random.default_rng(0).standard_normal(200), 4)
    _, defined = frames.frenet_binormals(np.column_stack([x, y, np.zeros(200)]))
    assert not defined.any()


def test_an_axis_seen_upright_keeps_its_dip_and_its_lean() -> None:
    rng = np.random.default_rng(8)
    points = np.column_stack([rng.uniform(-100, 100, (40, 2)), np.zeros(40)])
    optic = Optic(300.0, -0.5)
    normal = frames.surface_normals(HOME, points, optic)
    options = ComplianceOptions(dip_direction="fixed", dip_azimuth_deg=50.0)
    seen = frames.axes_on_level_surface(frames.dipped_axes(options, HOME, points, normal, 15.0), normal)
    np.testing.assert_allclose(seen[:, 2], np.cos(np.radians(15)), atol=1e-12)
    azimuth = np.degrees(np.arctan2(seen[:, 1], seen[:, 0]))
    np.testing.assert_allclose(azimuth, 50.0, atol=3.0)  # the lean is level in the part's frame, not in the surface's
    np.testing.assert_allclose(frames.axes_on_level_surface(normal, normal), np.tile([0, 0, 1.0], (40, 1)), atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(seen, axis=1), 1.0, atol=1e-12)


def test_on_a_flat_part_an_axis_is_seen_as_it_is() -> None:
    axis = np.array([[0.2, -0.1, np.sqrt(0.95)]])
    np.testing.assert_array_equal(frames.axes_on_level_surface(axis, np.array([[0.0, 0.0, 1.0]])), axis)
    with pytest.raises(ComputeError, match="looks down"):
        frames.axes_on_level_surface(axis, np.array([[0.0, 0.0, -1.0]]))


def test_rotation_vectors_are_those_that_the_rotations_were_made_of() -> None:
    """From none to half a turn, where both signs are right, and about each axis, where a component of three is 0."""
    rng = np.random.default_rng(4)
    away = rng.normal(size=(3000, 3))
    away[:3], away[3:6] = np.eye(3), -np.eye(3)
    size = np.concatenate(
        [[0.0], np.logspace(-17, 0, 1000), rng.uniform(0.0, np.pi, 998), np.pi - np.logspace(-16, 0, 1001)]
    )
    rng.shuffle(size)
    vector = away / np.linalg.norm(away, axis=1, keepdims=True) * size[:, None]
    found = frames.rotation_vectors(Rotation.from_rotvec(vector).as_matrix())
    other = vector - 2 * np.pi * vector / np.maximum(size, 1e-300)[:, None]  # the same rotation, the long way round
    off = np.minimum(*(np.linalg.norm(found - one, axis=1) for one in (vector, other)))
    assert off.max() < 1e-14
    assert np.linalg.norm(found, axis=1).max() < np.pi + 1e-14
    assert frames.rotation_vectors(np.zeros((0, 3, 3))).shape == (0, 3)
