"""The hybrid robot's compliance as the paper writes it, in 6 x 6 matrices (eq. 2-15): what the closed form is held to.

Twists are ``[translation mm; rotation rad]`` and wrenches ``[force N; moment N mm]``, all in the base frame. Poses are
the package's own; they are held to an assembly of the mechanism, joint by joint, in test_robot_kinematics.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from polishd.model.process import HybridRobot
from polishd.model.surface import FloatArray
from polishd.process.robot.hybrid import (
    geometry_of,
    limb_stiffness_n_per_mm,
    refuse_unreachable,
    require_poses,
    solve_pose,
    stiffnesses_of,
)


@dataclass(frozen=True)
class Pose:
    """Positions of all members of the robot for n poses; mm, vectors in the base frame."""

    tip_mm: FloatArray
    """(n, 3) tool tip."""
    axis: FloatArray
    """(n, 3) unit tool axis, from the tip into the spindle."""
    tool: FloatArray
    """(n, 3) the same along the platform's axes."""
    wrist_mm: FloatArray
    """(n, 3) wrist centre P."""
    platform_mm: FloatArray
    """(n, 3) centre of the moving platform, ``r`` of eq. 1."""
    outer: FloatArray
    """(3,) unit outer axis of the U joint."""
    frame: FloatArray
    """(n, 3, 3) platform axes u, v, w as columns."""
    joints_mm: FloatArray
    """(n, 3, 3) platform end of limb i in row i, from the platform's centre: ``a_i`` of eq. 1."""
    limbs_mm: FloatArray
    """(n, 3, 3) limb i in row i, from base to platform: ``q_i w_i`` of eq. 1."""

    @property
    def limb_mm(self) -> FloatArray:
        """(n, 3) limb lengths, ``q_i``."""
        return np.linalg.norm(self.limbs_mm, axis=2)

    @property
    def hinge(self) -> FloatArray:
        """(n, 3) unit direction of the A joint: across w and the tool."""
        across = np.cross(self.frame[:, :, 2], self.axis)
        return across / np.linalg.norm(across, axis=1)[:, None]


def pose_of(robot: HybridRobot, tip_mm: FloatArray, axis: FloatArray) -> Pose:
    """Eq. 1, with ``q_i w_i`` on the left and the platform's own ``w`` on the right (misprinted there)."""
    tip, axis = require_poses(tip_mm, axis)
    geometry = geometry_of(robot)
    placed = solve_pose(robot, geometry, tip.T, axis.T)
    refuse_unreachable(robot, placed)
    parallel = placed.parallel
    frame = parallel.frame.transpose(2, 1, 0)
    platform = (parallel.length_mm * parallel.frame[2]).T
    joints = geometry.platform @ frame.transpose(0, 2, 1)
    limbs = np.einsum("kin,kjn->nji", parallel.frame, parallel.limbs_mm)
    return Pose(tip, axis, placed.tool.T, placed.wrist_mm.T, platform, geometry.outer, frame, joints, limbs)


def tip_compliance(robot: HybridRobot, pose: Pose) -> FloatArray:
    """(n, 6, 6) compliance at the tool tip: the platform's, carried to the tip, and the wrist's (eq. 13-15, 39)."""
    elastic = stiffnesses_of(robot)
    shift = np.broadcast_to(np.eye(6), (len(pose.tip_mm), 6, 6)).copy()
    shift[:, :3, 3:] = -_cross_matrix(pose.tip_mm - pose.platform_mm)
    total = shift @ np.linalg.inv(platform_stiffness(robot, pose)) @ shift.transpose(0, 2, 1)
    arm = pose.tip_mm - pose.wrist_mm
    for direction, stiffness in (
        (pose.frame[:, :, 2], elastic.c_n_mm_per_rad),
        (pose.hinge, elastic.a_n_mm_per_rad),
    ):
        twist = np.concatenate([np.cross(direction, arm), direction], axis=1)
        total = total + twist[:, :, None] * twist[:, None, :] / stiffness
    return np.asarray((total + total.transpose(0, 2, 1)) / 2, dtype=np.float64)


def platform_stiffness(robot: HybridRobot, pose: Pose) -> FloatArray:
    """(n, 6, 6) stiffness of the parallel section at the platform's centre: ``J_a' K_a J_a + J_c' C_c^-1 J_c``.

    Eq. 12 with ``C_c^-1 = S_c^-T K_c S_c^-1``, and `constraint_compliance` in place of its misprints.
    """
    active, passive = limb_jacobian(pose), constraint_jacobian(pose)
    stiff = limb_stiffness_n_per_mm(robot, pose.limb_mm)
    held = np.linalg.solve(constraint_compliance(robot, pose), passive)
    whole = active.transpose(0, 2, 1) @ (stiff[:, :, None] * active) + passive.transpose(0, 2, 1) @ held
    return np.asarray(whole, dtype=np.float64)


def limb_jacobian(pose: Pose) -> FloatArray:
    """(n, 3, 6) rows ``[w_i, a_i x w_i]``: rate of limb i's length with the platform's twist (eq. 2, ``J_a'``)."""
    direction = pose.limbs_mm / pose.limb_mm[:, :, None]
    return np.concatenate([direction, np.cross(pose.joints_mm, direction)], axis=2)


def constraint_jacobian(pose: Pose) -> FloatArray:
    """(n, 3, 6) rows ``[u, -L v]``, ``[v, L u]``, ``[0, n]`` (eq. 4, ``J_c'``): motions that the UP limb resists."""
    u, v = pose.frame[:, :, 0], pose.frame[:, :, 1]
    length = _beam_length(pose)[:, None]
    rows = np.zeros((len(u), 3, 6))
    rows[:, 0] = np.concatenate([u, -length * v], axis=1)
    rows[:, 1] = np.concatenate([v, length * u], axis=1)
    rows[:, 2, 3:] = np.cross(pose.outer, v)
    return rows


def constraint_compliance(robot: HybridRobot, pose: Pose) -> FloatArray:
    """(n, 3, 3) the UP limb's deflection in those motions per unit of its reactions: ``C_c``, see `BEAMS`."""
    beam, bending, torsion, _, _ = stiffnesses_of(robot)
    length = _beam_length(pose)
    n = np.cross(pose.outer, pose.frame[:, :, 1])  # perpendicular to v
    n_u, _, n_w = np.einsum("nij,ni->jn", pose.frame, n)
    matrix = np.zeros((len(length), 3, 3))
    matrix[:, 0, 0] = matrix[:, 1, 1] = beam.shear * length**3 / bending
    matrix[:, 1, 2] = matrix[:, 2, 1] = beam.cross * n_u * length**2 / bending
    matrix[:, 2, 2] = beam.turn * n_u**2 * length / bending + n_w**2 * length / torsion
    return matrix


def _beam_length(pose: Pose) -> FloatArray:
    """(n,) ``L = |r|``, mm."""
    return np.asarray(np.linalg.norm(pose.platform_mm, axis=1), dtype=np.float64)


def _cross_matrix(vector: FloatArray) -> FloatArray:
    """(n, 3, 3) matrices S with ``S x = vector cross x``."""
    x, y, z = vector.T
    zero = np.zeros_like(x)
    return np.stack([np.stack(row, axis=1) for row in ((zero, -z, y), (z, zero, -x), (-y, x, zero))], axis=1)
