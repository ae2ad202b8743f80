"""Robot kinematics against an assembly of the mechanism joint by joint with scipy's rotations."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from polishd.model.process import HybridRobot
from polishd.model.surface import FloatArray
from polishd.process.robot.compliance import reachable
from tests.unit.process.robot.hybrid_matrices import pose_of
from tests.unit.process.robot.hybrid_poses import CROOKED, ROBOT, ROBOTS, cylinder, workspace

ROOMY = dataclasses.replace(
    ROBOT, stroke_mm=(300.0, 3000.0), workspace_radius_mm=2500.0, workspace_height_mm=(-2000.0, 3000.0)
)


def circle(robot: HybridRobot, radius_mm: float) -> FloatArray:
    """(3, 3) joints on a circle, by turning the first one."""
    turns = Rotation.from_euler("Z", robot.first_limb_deg + 120.0 * np.arange(3)[:, None], degrees=True)
    return np.asarray(turns.apply([radius_mm, 0.0, 0.0]))


def assemble(
    robot: HybridRobot, alpha: float, beta: float, length: float, c: float, a: float
) -> tuple[FloatArray, ...]:
    """Tip, axis and limb lengths of the mechanism put together from its joints, U joint first."""
    outer = np.array(robot.outer_axis) / np.linalg.norm(robot.outer_axis)
    inner = np.cross([0.0, 0.0, 1.0], outer)
    inner /= np.linalg.norm(inner)  # as it lies at home, where the UP limb points along z
    platform = Rotation.from_rotvec(alpha * outer) * Rotation.from_rotvec(beta * inner)
    home = Rotation.from_matrix(np.column_stack([np.cross(inner, [0.0, 0.0, 1.0]), inner, [0.0, 0.0, 1.0]]))
    spindle = platform * home * Rotation.from_euler("ZX", [c, a])
    centre = platform.apply([0, 0, length])
    tip = platform.apply([0, 0, length + robot.wrist_length_mm]) + spindle.apply([0, 0, robot.tool_length_mm])
    ends = np.asarray(robot.platform_joints_mm or circle(robot, robot.platform_radius_mm))
    limbs = centre + platform.apply(ends) - np.asarray(robot.base_joints_mm or circle(robot, robot.base_radius_mm))
    return tip, spindle.apply([0, 0, -1.0]), np.linalg.norm(limbs, axis=1)


def tool(c: float, a: float) -> FloatArray:
    """Tool axis along the platform's axes, from the tip into the spindle."""
    return -np.array([np.sin(c) * np.sin(a), -np.cos(c) * np.sin(a), np.cos(a)])


angles = st.floats(-0.4, 0.4)
components = st.floats(-1, 1)
outer_axes = st.tuples(components, components, components).filter(lambda e: np.hypot(e[0], e[1]) > 0.5)


@pytest.mark.full
@given(angles, angles, st.floats(1000, 1650), st.floats(-3.1, 3.1), st.floats(0.02, 0.8), st.floats(0, 90))
def test_inverse_undoes_an_assembly_from_joint_values(
    alpha: float, beta: float, length: float, c: float, a: float, first: float
) -> None:
    robot = dataclasses.replace(ROOMY, first_limb_deg=first)
    tip, axis, limbs = assemble(robot, alpha, beta, length, c, a)
    pose = pose_of(robot, tip[None], axis[None])
    np.testing.assert_allclose(pose.limb_mm[0], limbs, rtol=0, atol=1e-9)
    assert np.linalg.norm(pose.platform_mm[0]) == pytest.approx(length, abs=1e-9)
    np.testing.assert_allclose(pose.tool[0], tool(c, a), rtol=0, atol=1e-9)


@given(outer_axes, angles, angles, st.floats(1000, 1650), st.floats(-3.1, 3.1), st.floats(0.02, 0.8))
def test_any_geometry_is_assembled_from_the_same_joint_values(
    outer: tuple[float, float, float], alpha: float, beta: float, length: float, c: float, a: float
) -> None:
    robot = dataclasses.replace(
        ROOMY,
        outer_axis=outer,
        base_joints_mm=CROOKED.base_joints_mm,
        platform_joints_mm=CROOKED.platform_joints_mm,
    )
    tip, axis, limbs = assemble(robot, alpha, beta, length, c, -a)
    pose = pose_of(robot, tip[None], axis[None])
    np.testing.assert_allclose(pose.limb_mm[0], limbs, rtol=0, atol=1e-9)
    np.testing.assert_allclose(pose.tool[0], tool(c, -a), rtol=0, atol=1e-9)


def test_the_published_workspace_fits_the_published_stroke_but_for_its_rim() -> None:
    tip, axis = cylinder(27)
    reach = reachable(ROBOT, tip, axis)
    length = pose_of(ROBOT, tip[reach], axis[reach]).limb_mm
    assert 0.94 < reach.mean() < 0.97
    assert length.min() == pytest.approx(953, abs=1.0)
    assert length.max() == pytest.approx(1750, abs=1.0)
    radius = np.hypot(tip[:, 0], tip[:, 1])
    lowest = tip[:, 2] == 2335
    assert reach[lowest & (radius < 420)].all()
    assert not reach[lowest & (radius > 520)].any()


@pytest.mark.parametrize("robot", ROBOTS)
def test_every_member_is_where_the_joints_let_it_be(robot: HybridRobot) -> None:
    tip, axis = workspace(9, robot)
    pose = pose_of(robot, tip, axis)
    u, v, w = pose.frame.transpose(2, 0, 1)
    assert np.abs(v @ pose.outer).max() < 1e-15
    np.testing.assert_allclose(np.cross(u, v), w, atol=1e-14)
    np.testing.assert_allclose(np.cross(pose.platform_mm, w), 0, atol=1e-10)
    for other in (w, pose.axis):
        assert np.abs(np.einsum("ni,ni->n", pose.hinge, other)).max() < 1e-12
    base = np.asarray(robot.base_joints_mm or circle(robot, robot.base_radius_mm))
    ends = np.asarray(robot.platform_joints_mm or circle(robot, robot.platform_radius_mm))
    from_base, from_platform = base + pose.limbs_mm, pose.platform_mm[:, None] + pose.joints_mm
    np.testing.assert_allclose(from_base, from_platform, rtol=0, atol=1e-10)
    spread = pose.joints_mm @ pose.joints_mm.transpose(0, 2, 1)
    np.testing.assert_allclose(spread, np.broadcast_to(ends @ ends.T, spread.shape), rtol=0, atol=1e-9)


def test_a_turned_robot_is_the_same_robot() -> None:
    turn = Rotation.from_euler("Z", 37.0, degrees=True)
    assert CROOKED.base_joints_mm
    assert CROOKED.platform_joints_mm
    turned = dataclasses.replace(
        CROOKED,
        base_joints_mm=tuple(map(tuple, turn.apply(CROOKED.base_joints_mm))),
        platform_joints_mm=tuple(map(tuple, turn.apply(CROOKED.platform_joints_mm))),
        outer_axis=tuple(3 * turn.apply(CROOKED.outer_axis)),
    )
    tip, axis = workspace(7, CROOKED)
    want = pose_of(CROOKED, tip, axis)
    got = pose_of(turned, turn.apply(tip), turn.apply(axis))
    np.testing.assert_allclose(got.limb_mm, want.limb_mm, rtol=0, atol=1e-9)
    np.testing.assert_allclose(got.tool, want.tool, rtol=0, atol=1e-12)


def test_joints_on_circles_may_be_given_as_vectors() -> None:
    tip, axis = workspace(5)
    given_out = dataclasses.replace(
        ROBOT,
        base_joints_mm=tuple(map(tuple, circle(ROBOT, 250.0))),
        platform_joints_mm=tuple(map(tuple, circle(ROBOT, 120.0))),
        base_radius_mm=1.0,
        platform_radius_mm=1.0,
    )
    want = pose_of(ROBOT, tip, axis).limb_mm
    np.testing.assert_allclose(pose_of(given_out, tip, axis).limb_mm, want, rtol=0, atol=1e-9)


def test_no_points_are_no_points() -> None:
    nothing = np.empty((0, 3))
    assert pose_of(ROBOT, nothing, nothing).limb_mm.shape == (0, 3)
    assert reachable(ROBOT, nothing, nothing).shape == (0,)
