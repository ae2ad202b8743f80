"""The plant's own mechanics: against the controller's, which is derived otherwise, and against closed forms."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from polishd.model.process import HybridRobot, SerialRobot
from polishd.model.surface import BoolArray, FloatArray
from polishd.process.robot.compliance import reachable, tip_compliance_mm_per_n
from polishd.sim_backends.common import mechanics
from polishd.sim_backends.common.mechanics import Reaching, reached, tip_gives_mm_per_n
from tests.unit.process.robot.arms import UR5, arm_cell, forward
from tests.unit.process.robot.hybrid_poses import CROOKED, PAPER, ROBOT, SLANTED, random_poses

STIFF = 1e30
RIGID = dataclasses.replace(
    ROBOT,
    limb_stiffness_n_per_mm=STIFF,
    up_bending_n_mm2=STIFF,
    up_torsion_n_mm2=STIFF,
    a_stiffness_n_mm_per_rad=STIFF,
    c_stiffness_n_mm_per_rad=STIFF,
)
SIZED = dataclasses.replace(PAPER, beam="exact")
"""Limbs that are softer the longer they are."""


@pytest.mark.parametrize("robot", [ROBOT, CROOKED, SLANTED, SIZED], ids=["shipped", "crooked", "slanted", "sized"])
def test_two_derivations_of_the_hybrid_robot_agree(robot: HybridRobot) -> None:
    tip, axis = random_poses(300, robot)
    can, ours = tip_gives_mm_per_n(robot, tip, axis)
    assert can.all()
    np.testing.assert_allclose(ours, tip_compliance_mm_per_n(robot, tip, axis), rtol=1e-9, atol=1e-15)


def test_the_paper_s_beam_is_none_of_statics() -> None:
    tip, axis = random_poses(20, PAPER)
    assert np.array_equal(tip_gives_mm_per_n(PAPER, tip, axis)[1], tip_gives_mm_per_n(SIZED, tip, axis)[1])


@pytest.mark.parametrize("robot", [ROBOT, CROOKED, SLANTED], ids=["shipped", "crooked", "slanted"])
def test_both_find_the_same_poses_within_reach(robot: HybridRobot) -> None:
    rng = np.random.default_rng(3)
    tip = np.column_stack([rng.uniform(-900, 900, (2000, 2)), rng.uniform(1000, 2600, 2000)])
    axis = rng.standard_normal((2000, 3))
    axis *= -np.sign(axis[:, 2:]) / np.linalg.norm(axis, axis=1)[:, None]
    ours = reached(robot, tip, axis)
    assert 0.02 < ours.mean() < 0.5
    assert np.array_equal(ours, reachable(robot, tip, axis))


def test_out_of_reach_nothing_gives() -> None:
    tip, axis = random_poses(2)
    can, gives = tip_gives_mm_per_n(ROBOT, np.vstack([tip, [[0.0, 0.0, 9000.0]]]), np.vstack([axis, axis[:1]]))
    assert can.tolist() == [True, True, False]
    assert not gives[2].any()
    assert np.isfinite(gives).all()


def test_a_soft_wrist_joint_gives_by_its_lever_squared() -> None:
    """A alone: the tip turns about the axis across w and the tool."""
    soft = dataclasses.replace(RIGID, a_stiffness_n_mm_per_rad=4e7)
    tip, axis = random_poses(5, soft)
    at = mechanics.solve_hybrid_poses(soft, tip, axis)
    tilt = np.cross(at.along, axis)
    moved = np.cross(tilt / np.linalg.norm(tilt, axis=1)[:, None], -soft.tool_length_mm * axis)
    expected = moved[:, :, None] * moved[:, None, :] / 4e7
    np.testing.assert_allclose(tip_gives_mm_per_n(soft, tip, axis)[1], expected, rtol=1e-9, atol=1e-15)


def test_limbs_alone_give_as_three_springs_along_the_up_limb() -> None:
    """With the robot upright a force along w goes down three limbs, each of which leans alike."""
    soft = dataclasses.replace(RIGID, limb_stiffness_n_per_mm=2e4, workspace_height_mm=(0.0, 1200.0))
    lean = np.radians(1.0)
    axis = np.array([[np.sin(lean), 0.0, -np.cos(lean)]])
    tip = np.array([[0.0, 0.0, 1700.0]]) - soft.tool_length_mm * axis
    at = mechanics.solve_hybrid_poses(soft, tip, axis)
    upright = float(at.limbs[0, 0] @ at.along[0])
    # the load at the tip is beside w, by the tool's lean: its moment is carried across, not along
    along = at.along[0] @ tip_gives_mm_per_n(soft, tip, axis)[1][0] @ at.along[0]
    beside = soft.tool_length_mm * np.sin(lean)
    moments = np.cross(at.ends_mm[0], at.limbs[0])
    turned = beside**2 / (2e4 * float((moments[:, 1] ** 2).sum()))
    assert along == pytest.approx(1.0 / (3.0 * 2e4 * upright**2) + turned, rel=1e-6)


def test_the_up_limb_alone_is_a_cantilever() -> None:
    """Loaded at its jointed end by what the limbs leave across it, Q, it gives way as Q^2 L^3 / (3 EI) per unit force.

    Its joint's couple is about n, which here is w to 1 degree: it bends nothing.
    """
    soft = dataclasses.replace(RIGID, up_bending_n_mm2=4e12, workspace_height_mm=(0.0, 1200.0))
    lean = np.radians(1.0)
    axis = np.array([[np.sin(lean), 0.0, -np.cos(lean)]])
    tip = np.array([[0.0, 0.0, 1700.0]]) - soft.tool_length_mm * axis
    at = mechanics.solve_hybrid_poses(soft, tip, axis)
    stored = mechanics._stored(soft, at)[0]
    push = stored[:, :3] * np.sqrt(soft.limb_stiffness_n_per_mm)
    across = -(push @ at.limbs[0]) - np.eye(3)  # (force, 3) in the UP limb
    bends = np.linalg.norm(across - np.outer(across @ at.along[0], at.along[0]), axis=1) ** 2
    beam = bends * float(at.up_mm[0]) ** 3 / (3.0 * 4e12)
    gives = np.diagonal(tip_gives_mm_per_n(soft, tip, axis)[1][0])
    np.testing.assert_allclose(gives, beam, rtol=1e-6, atol=1e-12)


def arm_poses(count: int = 200) -> tuple[FloatArray, FloatArray]:
    rng = np.random.default_rng(2)
    tip, _ = forward(UR5, np.radians([UR5.home_deg]))
    lean, way = np.radians(rng.uniform(0, 30, count)), rng.uniform(0, 2 * np.pi, count)
    axis = np.column_stack([np.sin(lean) * np.cos(way), np.sin(lean) * np.sin(way), np.cos(lean)])
    return tip + rng.uniform(-150, 150, (count, 3)), axis


MODIFIED = dataclasses.replace(
    UR5,
    convention="modified",
    dh=(
        (0.0, 0.0, 89.159, 0.0),
        (0.0, 90.0, 0.0, 0.0),
        (-425.0, 0.0, 0.0, 0.0),
        (-392.25, 0.0, 109.15, 0.0),
        (0.0, 90.0, 94.65, 0.0),
        (0.0, -90.0, 82.3, 0.0),
    ),
)
"""The arm in Craig's convention."""


@pytest.mark.parametrize("robot", [UR5, MODIFIED], ids=["standard", "modified"])
def test_two_derivations_of_an_arm_agree(robot: SerialRobot) -> None:
    tip, axis = arm_poses()
    can, ours = tip_gives_mm_per_n(robot, tip, axis)
    assert np.array_equal(can, reachable(robot, tip, axis))
    assert can.mean() > 0.9
    theirs = tip_compliance_mm_per_n(robot, tip[can], axis[can])
    np.testing.assert_allclose(ours[can], theirs, rtol=1e-6, atol=1e-9 * theirs.max())


def test_one_soft_joint_of_an_arm_gives_by_its_lever_squared() -> None:
    soft = dataclasses.replace(UR5, joint_stiffness_n_mm_per_rad=(4e7, *(STIFF,) * 5))
    tip, axis = arm_poses(5)
    can, ours = tip_gives_mm_per_n(soft, tip, axis)
    moved = np.column_stack([-tip[:, 1], tip[:, 0], np.zeros(5)])  # about the base's z
    np.testing.assert_allclose(ours[can], (moved[:, :, None] * moved[:, None, :] / 4e7)[can], rtol=1e-6, atol=1e-15)


def test_an_arm_does_not_reach_beyond_its_length_or_its_limits() -> None:
    tip, axis = arm_poses(3)
    far = tip.copy()
    far[1] *= 10.0
    assert reached(UR5, far, axis).tolist() == [True, False, True]
    held = dataclasses.replace(UR5, joint_limits_deg=((-0.5, 0.5), *UR5.joint_limits_deg[1:]))
    assert np.array_equal(reached(held, *arm_poses()), reachable(held, *arm_poses()))
    assert 0 < reached(held, *arm_poses()).sum() < 20


@pytest.mark.parametrize("last_deg", [0.0, 90.0, 180.0, -90.0])
@pytest.mark.parametrize("first_deg", [0.0, 90.0])
def test_a_part_below_home_is_reached_however_the_flange_is_turned_there(first_deg: float, last_deg: float) -> None:
    """For two of these homes the flange's x is exactly opposite to the default ``flange_x``."""
    home = (first_deg, *UR5.home_deg[1:5], last_deg)
    robot = dataclasses.replace(UR5, home_deg=home)
    tip, axis = arm_poses(40)
    middle, upright = forward(robot, np.radians([home]))
    tip = 0.4 * (tip - tip.mean(axis=0)) + middle
    assert reachable(robot, tip, axis).all()
    assert reached(robot, tip, axis).all()
    assert reached(robot, middle, upright).all()


@pytest.mark.parametrize(
    "robot", [UR5, dataclasses.replace(UR5, joint_limits_deg=((-3, 3), *UR5.joint_limits_deg[1:]))]
)
def test_a_path_shown_in_parts_is_reached_where_the_whole_is(robot: SerialRobot) -> None:
    tip, axis = arm_poses()
    order = np.lexsort(tip.T)
    reaching = Reaching(robot)
    parts = [reaching.reached(tip[part], axis[part]) for part in np.array_split(order, [1, 3, 50, 51, 51, 120])]
    assert np.array_equal(np.concatenate(parts), reached(robot, tip[order], axis[order]))
    assert np.concatenate(parts).any()


def _both(seed: int) -> tuple[BoolArray, BoolArray]:
    """Which poses of a random cell the controller and the plant reach."""
    cell = arm_cell(seed)
    return reachable(cell.robot, cell.tip_mm, cell.axis), reached(cell.robot, cell.tip_mm, cell.axis)


@pytest.mark.one_of_each
@pytest.mark.parametrize("seed", [2, 7, 8, 36, 64])
def test_controller_and_plant_reach_the_same_poses_of_a_random_arm(seed: int) -> None:
    theirs, ours = _both(seed)
    assert np.array_equal(ours, theirs)


@pytest.mark.full
def test_controller_and_plant_judge_200_random_arms_alike() -> None:
    """Each part as a whole, and of 28,800 poses all but a few beside a singular one."""
    reported = [_both(seed) for seed in range(200)]
    whole = [(bool(theirs.all()), bool(ours.all())) for theirs, ours in reported]
    assert [seed for seed, (theirs, ours) in enumerate(whole) if theirs != ours] == []
    assert 60 < sum(theirs for theirs, _ in whole) < 140
    assert sum(int((theirs != ours).sum()) for theirs, ours in reported) <= 5
