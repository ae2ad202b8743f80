"""Robot kinematics against an assembly of the mechanism joint by joint with scipy's rotations, and a round trip."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from polishd.model.errors import ComputeError
from polishd.model.process import HybridRobot
from polishd.model.surface import FloatArray
from polishd.process.robot import forward_kinematics, inverse_kinematics, limb_lengths_mm, reachable

ROBOT = HybridRobot()
TIP = np.array([[300.0, 220.0, 2315.0]])
DOWN = np.array([[0.0, 0.0, -1.0]])
DIP = np.radians(15.0)


def workspace(n: int = 13) -> tuple[FloatArray, FloatArray]:
    """Tips in Table I's cylinder with the spindle leaning inward by 15 degrees, as (tips, axes), in reach or not."""
    grid, height = np.linspace(-660, 660, n), np.linspace(200, 910, n)
    x, y, h = (a.ravel() for a in np.meshgrid(grid, grid, height))
    radius = np.hypot(x, y)
    keep = (radius <= 660) & (radius > 1)
    tip = np.stack([x, y, 2535 - h], axis=1)[keep]
    lean = -tip[:, :2] / radius[keep][:, None] * np.sin(DIP)
    return tip, np.column_stack([lean, np.full(len(tip), -np.cos(DIP))])


def assemble(
    robot: HybridRobot, alpha: float, beta: float, length: float, c: float, a: float
) -> tuple[FloatArray, ...]:
    """Tip, axis and limb lengths of the mechanism put together from its joints, U joint first."""
    platform = Rotation.from_euler("XY", [alpha, beta])
    spindle = platform * Rotation.from_euler("ZX", [c, a])
    centre = platform.apply([0, 0, length])
    tip = platform.apply([0, 0, length + robot.wrist_length_mm]) + spindle.apply([0, 0, robot.tool_length_mm])
    limbs = []
    for k in range(3):
        turn = Rotation.from_euler("Z", robot.first_limb_deg + 120 * k, degrees=True)
        below = centre + platform.apply(turn.apply([robot.platform_radius_mm, 0, 0]))
        limbs.append(np.linalg.norm(below - turn.apply([robot.base_radius_mm, 0, 0])))
    return tip, spindle.apply([0, 0, -1.0]), np.array(limbs)


angles = st.floats(-0.4, 0.4)


@given(angles, angles, st.floats(1000, 1650), st.floats(-3.1, 3.1), st.floats(0.02, 0.8), st.floats(0, 90))
def test_inverse_undoes_an_assembly_from_joint_values(
    alpha: float, beta: float, length: float, c: float, a: float, first: float
) -> None:
    robot = dataclasses.replace(ROBOT, first_limb_deg=first, stroke_mm=(500.0, 2500.0))
    tip, axis, limbs = assemble(robot, alpha, beta, length, c, a)
    pose = inverse_kinematics(robot, tip[None], axis[None])
    np.testing.assert_allclose(pose.limb_mm[0], limbs, rtol=0, atol=1e-9)
    np.testing.assert_allclose(limb_lengths_mm(robot, tip[None], axis[None])[0], limbs, rtol=0, atol=1e-9)
    assert np.linalg.norm(pose.platform_mm[0]) == pytest.approx(length, abs=1e-9)
    assert pose.a_rad[0] == pytest.approx(a, abs=1e-9)
    assert np.exp(1j * pose.c_rad[0]) == pytest.approx(np.exp(1j * c), abs=1e-9)


def test_forward_finds_the_assembly() -> None:
    tip, axis, limbs = assemble(ROBOT, 0.2, -0.15, 1400.0, 2.0, 0.4)
    got_tip, got_axis = forward_kinematics(ROBOT, limbs[None], np.array([2.0]), np.array([0.4]))
    np.testing.assert_allclose(got_tip[0], tip, rtol=0, atol=1e-9)
    np.testing.assert_allclose(got_axis[0], axis, rtol=0, atol=1e-12)


def test_round_trip_over_the_workspace() -> None:
    tip, axis = workspace()
    reach = reachable(ROBOT, tip, axis)
    assert reach.sum() > 1000
    pose = inverse_kinematics(ROBOT, tip[reach], axis[reach])
    got_tip, got_axis = forward_kinematics(ROBOT, pose.limb_mm, pose.c_rad, pose.a_rad)
    assert np.abs(got_tip - tip[reach]).max() < 1e-9
    assert np.abs(got_axis - axis[reach]).max() < 1e-12


def test_the_published_workspace_fits_the_published_stroke_but_for_its_rim() -> None:
    tip, axis = workspace(27)
    reach = reachable(ROBOT, tip, axis)
    length = limb_lengths_mm(ROBOT, tip[reach], axis[reach])
    assert 0.94 < reach.mean() < 0.97
    assert length.min() == pytest.approx(953, abs=1.0)
    assert length.max() == pytest.approx(1750, abs=1.0)
    radius = np.hypot(tip[:, 0], tip[:, 1])
    lowest = tip[:, 2] == 2335
    assert reach[lowest & (radius < 420)].all()
    assert not reach[lowest & (radius > 520)].any()


def test_the_platform_turns_about_both_axes_of_the_u_joint_only() -> None:
    tip, axis = workspace(9)
    reach = reachable(ROBOT, tip, axis)
    pose = inverse_kinematics(ROBOT, tip[reach], axis[reach])
    u, v, w = pose.frame.transpose(2, 0, 1)
    assert np.abs(v[:, 0]).max() < 1e-15
    np.testing.assert_allclose(np.cross(u, v), w, atol=1e-14)
    for other in (w, pose.axis):
        assert np.abs(np.einsum("ni,ni->n", pose.hinge, other)).max() < 1e-12


def test_c_turns_on_past_half_a_turn() -> None:
    angle = np.linspace(0, 4 * np.pi, 200)
    tip = np.tile([0.0, 0.0, 2000.0], (200, 1))
    axis = np.stack([np.cos(angle) * np.sin(DIP), np.sin(angle) * np.sin(DIP), np.full(200, -np.cos(DIP))], axis=1)
    pose = inverse_kinematics(ROBOT, tip, axis)
    assert abs(pose.c_rad[-1] - pose.c_rad[0]) == pytest.approx(4 * np.pi, abs=1e-9)
    assert (pose.a_rad > 0).all()


def test_the_branch_stays_continuous_where_the_axis_passes_through_the_limb() -> None:
    lean = np.radians(np.linspace(5, -5, 20))
    tip = np.tile([0.0, 0.0, 2000.0], (20, 1))
    pose = inverse_kinematics(ROBOT, tip, np.stack([np.sin(lean), 0 * lean, -np.cos(lean)], axis=1))
    assert np.abs(np.diff(pose.c_rad)).max() < 0.02
    assert pose.a_rad[0] > 0 > pose.a_rad[-1]
    assert (np.diff(pose.a_rad) < 0).all()


def test_no_points_are_no_points() -> None:
    nothing = np.empty((0, 3))
    assert inverse_kinematics(ROBOT, nothing, nothing).limb_mm.shape == (0, 3)
    assert reachable(ROBOT, nothing, nothing).shape == (0,)


@pytest.mark.parametrize(
    ("tip", "axis", "says"),
    [
        ([0.0, 100.0, 2600.0], [0.0, -np.sin(DIP), -np.cos(DIP)], r"longest limb is .* mm, out of stroke 950 to 1750"),
        ([0.0, 100.0, 1500.0], [0.0, -np.sin(DIP), -np.cos(DIP)], r"shortest limb is .* mm, out of stroke"),
        ([0.0, 0.0, 2000.0], [0.0, 0.0, -1.0], r"wrist \|A\| is 0 deg, singular"),
        ([0.0, 0.0, -500.0], [0.0, 0.0, -1.0], r"below the U joint is -920 mm, out of the workspace"),
        ([0.0, 0.0, 600.0], [0.0, 0.0, -1.0], r"distance from the U joint is 180 mm, out of the workspace"),
        ([np.nan, 0.0, 2000.0], [0.0, 0.0, -1.0], r"tool tip is nan mm"),
        ([0.0, 0.0, 2000.0], [0.0, 0.0, -1.1], r"length of tool axis is 1.1"),
        ([0.0, 0.0, 420.0], [0.0, 0.0, -1.0], r"distance from the U joint is 0 mm"),
    ],
)
def test_a_refusal_names_the_point_the_value_and_the_unit(tip: list[float], axis: list[float], says: str) -> None:
    tips = np.vstack([TIP, TIP, [tip]])
    axes = np.vstack([DOWN, DOWN, [axis]])
    with pytest.raises(ComputeError, match="point 2: .*" + says):
        inverse_kinematics(ROBOT, tips, axes)


def test_reachable_says_no_where_the_inverse_refuses() -> None:
    tips = np.array([TIP[0], [0, 100, 2600.0], [0, 0, 2000.0], [0, 0, -500.0], [0, 0, 600.0]])
    assert reachable(ROBOT, tips, np.tile(DOWN, (5, 1))).tolist() == [True, False, False, False, False]


def test_shapes_and_robots_that_cannot_be_are_refused() -> None:
    with pytest.raises(ComputeError, match=r"shape \(3,\), it must be \(n, 3\) in mm"):
        inverse_kinematics(ROBOT, TIP[0], DOWN)
    with pytest.raises(ComputeError, match="1 tool tips come with 2 tool axes"):
        inverse_kinematics(ROBOT, TIP, np.vstack([DOWN, DOWN]))
    with pytest.raises(ComputeError, match="longest limb allowed is 900 mm"):
        inverse_kinematics(dataclasses.replace(ROBOT, stroke_mm=(950.0, 900.0)), TIP, DOWN)
    with pytest.raises(ComputeError, match="tool_length_mm is -1 mm"):
        inverse_kinematics(dataclasses.replace(ROBOT, tool_length_mm=-1.0), TIP, DOWN)


def test_limb_lengths_without_a_pose_are_refused() -> None:
    with pytest.raises(ComputeError, match="no platform pose"):
        forward_kinematics(ROBOT, np.array([[1000.0, 1000.0, 2500.0]]), np.zeros(1), np.ones(1))
