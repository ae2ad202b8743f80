"""Tool axes along paths, and the turns of A and C that a wrist is asked for."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from polishd.model.errors import ComputeError
from polishd.model.process import FLAT, ComplianceOptions, Optic, Placement
from polishd.process.frames import angles_from_axis, dips_deg, rotation_from_rpy_deg
from polishd.process.optic_surface import unit_normals
from polishd.process.toolpath.apertures import circle, largest_turn_deg, tool_axes
from polishd.process.toolpath.paths import raster, spiral
from polishd.sim_backends.common.hidden_truth import tool_axis

HOME = Placement((0.0, 0.0, 0.0), np.eye(3))
SPHERE = Optic(200.0)
AZIMUTH = st.floats(-180, 180)


def fixed(azimuth_deg: float) -> ComplianceOptions:
    return ComplianceOptions(dip_direction="fixed", dip_azimuth_deg=azimuth_deg)


@given(st.floats(0, 40), AZIMUTH)
def test_the_axis_is_the_normal_dipped_by_as_much(dip_deg: float, azimuth_deg: float) -> None:
    points = raster(circle(40), 4.0, 4.0, optic=SPHERE)
    normal = unit_normals(SPHERE, points[:, :2])
    axis = tool_axes(points, SPHERE, dip_deg, fixed(azimuth_deg), HOME)
    np.testing.assert_allclose(dips_deg(axis, normal), dip_deg, atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(axis, axis=1), 1, rtol=1e-12)
    way = np.array([np.cos(np.radians(azimuth_deg)), np.sin(np.radians(azimuth_deg)), 0.0])
    across = np.cross(normal, way)
    np.testing.assert_allclose(np.einsum("ni,ni->n", axis, across), 0, atol=1e-12)
    assert (axis @ way >= normal @ way - 1e-12).all(), "it leans there, and not away"


def test_on_a_flat_a_fixed_dip_is_one_axis() -> None:
    points = raster(circle(40), 1.0, 1.0)
    axis = tool_axes(points, FLAT, 15.0, fixed(90.0), HOME)
    want = [0.0, np.sin(np.radians(15)), np.cos(np.radians(15))]
    np.testing.assert_allclose(axis, np.tile(want, (len(axis), 1)), atol=1e-15)
    assert largest_turn_deg(axis) < 1e-12


@pytest.mark.parametrize("direction", ["inward", "fixed", "along", "across"])
def test_the_axes_are_in_the_parts_frame_wherever_the_part_lies(direction: str) -> None:
    options = ComplianceOptions(dip_direction=direction)  # type: ignore[arg-type]
    points = spiral(circle(40), 2.0, 1.0, optic=SPHERE)
    normal = unit_normals(SPHERE, points[:, :2])
    there = Placement((300.0, 220.0, 2315.0), rotation_from_rpy_deg(180.0, 0.0, 30.0))
    axis = tool_axes(points, SPHERE, 15.0, options, there)
    np.testing.assert_allclose(dips_deg(axis, normal), 15.0, atol=1e-9)
    if direction == "inward":
        towards = (np.array([0.0, 0.0, 2315.0]) - there.origin_mm) @ there.rotation
        assert (axis @ towards > normal @ towards).all()
    else:
        np.testing.assert_allclose(axis, tool_axes(points, SPHERE, 15.0, options, HOME), atol=1e-6)


def test_a_line_over_the_pole_changes_the_sign_of_a() -> None:
    """Not C by half a turn: the wrist's other solution is the nearer one."""
    a_deg = np.linspace(10.0, -10.0, 41)
    axis = tool_axis(a_deg, np.full(41, 25.0))
    a, c = angles_from_axis(axis)
    np.testing.assert_allclose(a, a_deg, atol=1e-9)
    np.testing.assert_allclose(c, 25.0, atol=1e-6)
    assert largest_turn_deg(axis) == pytest.approx(0.5)


@given(st.floats(-80, 80), st.floats(-720, 720), st.floats(-3, 3), st.floats(-20, 20))
def test_angles_follow_any_smooth_turn(a0: float, c0: float, a_step: float, c_step: float) -> None:
    """As they were, or all of them as the wrist's other solution, whole turns apart."""
    a_want, c_want = a0 + a_step * np.arange(30) / 30, c0 + c_step * np.arange(30)
    axis = tool_axis(a_want, c_want)
    a, c = angles_from_axis(axis)
    np.testing.assert_allclose(tool_axis(a, c), axis, atol=1e-9)
    if np.abs(a_want).min() > 5 and (a_want > 0).all() == (a_want[0] > 0):
        assert np.abs(np.diff(a)).max() < 0.11
        np.testing.assert_allclose(np.diff(c), c_step, atol=1e-6)


@pytest.mark.parametrize("dip", [0.0, 5.0, 30.0])
@pytest.mark.parametrize("optic", [SPHERE, Optic(-120.0, -1.0), Optic(300.0, -0.4, (1e-8,), (60.0, 20.0))])
def test_shipped_limits_take_ordinary_paths(optic: Optic, dip: float) -> None:
    for points in (raster(circle(60), 1.0, 1.0, optic=optic), spiral(circle(60), 1.0, 1.0, optic=optic)):
        turn = largest_turn_deg(tool_axes(points, optic, dip, fixed(20.0), HOME))
        assert 0 < turn <= 95
        a, c = angles_from_axis(tool_axes(points, optic, dip, fixed(20.0), HOME))
        assert np.abs(np.diff(a)).max() < 2.0, "the tilt itself changes slowly everywhere"
        if dip == 30.0:
            assert turn < 3.0, "and C, too, where the dip keeps off the pole"
            assert np.ptp(c) < 180


def test_too_large_a_turn_is_named() -> None:
    c_deg = np.array([0.0, 1.0, 2.0, 62.0, 63.0])
    axis = tool_axis(np.full(5, 40.0), c_deg)
    assert largest_turn_deg(axis, 61.0) == pytest.approx(60.0)
    with pytest.raises(ComputeError, match=r"from point 2 to 3 the wrist turns by 60 deg .*C 2 to 62\), at most 30"):
        largest_turn_deg(axis, 30.0)


def test_a_dip_along_the_path_turns_at_corners() -> None:
    points = raster(circle(40), 1.0, 1.0)
    axis = tool_axes(points, FLAT, 15.0, ComplianceOptions(dip_direction="along"), HOME)
    with pytest.raises(ComputeError, match="the wrist turns by"):
        largest_turn_deg(axis, 20.0)


def test_a_single_point_does_not_turn() -> None:
    assert largest_turn_deg(np.array([[0.0, 0.0, 1.0]])) == 0.0


def test_a_lean_along_the_normal_is_refused() -> None:
    with pytest.raises(ComputeError, match="the way to the base's z axis"):
        tool_axes(np.zeros((1, 3)), FLAT, 15.0, ComplianceOptions(dip_direction="inward"), HOME)
