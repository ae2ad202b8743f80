"""Compliance of the hybrid robot at the tool tip (paper eq. 2-15, exact beam for the UP limb).

Twists are ``[translation mm; rotation rad]`` and wrenches ``[force N; moment N mm]``, all in the base frame.
"""

from __future__ import annotations

import numpy as np

from polishd.model.process import HybridRobot
from polishd.model.surface import FloatArray
from polishd.process.robot.kinematics import Pose, inverse_kinematics
from polishd.process.robot.refusal import require_number

_E_X = np.array([1.0, 0.0, 0.0])


def tip_compliance_mm_per_n(robot: HybridRobot, tip_mm: FloatArray, axis: FloatArray) -> FloatArray:
    """(n, 3, 3) displacement of the tip per force at the tip, mm/N, base frame; symmetric positive definite.

    The translational block of eq. 39, with the moment of the force about the wrist (which eq. 41 drops).
    ``tip_mm`` (n, 3) mm and ``axis`` (n, 3) unit, from the tip into the spindle, base frame.
    Raises ComputeError that names the first pose which cannot be taken.
    """
    return tip_compliance(robot, inverse_kinematics(robot, tip_mm, axis))[:, :3, :3]


def tip_compliance(robot: HybridRobot, pose: Pose) -> FloatArray:
    """(n, 6, 6) compliance at the tool tip: the platform's, carried to the tip, and the wrist's (eq. 13-15)."""
    for name in ("a_stiffness_n_mm_per_rad", "c_stiffness_n_mm_per_rad"):
        require_number(f"the robot's {name}", getattr(robot, name), "N mm/rad", above=0.0)
    shift = np.broadcast_to(np.eye(6), (len(pose.tip_mm), 6, 6)).copy()
    shift[:, :3, 3:] = -_cross_matrix(pose.tip_mm - pose.platform_mm)
    total = shift @ np.linalg.inv(platform_stiffness(robot, pose)) @ shift.transpose(0, 2, 1)
    arm = pose.tip_mm - pose.wrist_mm
    drives = (
        (pose.frame[:, :, 2], robot.c_stiffness_n_mm_per_rad),
        (pose.hinge, robot.a_stiffness_n_mm_per_rad),
    )
    for direction, stiffness in drives:
        twist = np.concatenate([np.cross(direction, arm), direction], axis=1)
        total = total + twist[:, :, None] * twist[:, None, :] / stiffness
    return np.asarray((total + total.transpose(0, 2, 1)) / 2, dtype=np.float64)


def platform_stiffness(robot: HybridRobot, pose: Pose) -> FloatArray:
    """(n, 6, 6) stiffness of the parallel section at the platform's centre: ``J_a' K_a J_a + J_c' C_c^-1 J_c``.

    Departs from eq. 6-12: the UP limb is an Euler-Bernoulli beam whose U joint carries no moment about its axes.
    """
    require_number("the robot's limb_stiffness_n_per_mm", robot.limb_stiffness_n_per_mm, "N/mm", above=0.0)
    direction = pose.limbs_mm / pose.limb_mm[:, :, None]
    active = np.concatenate([direction, np.cross(pose.joints_mm, direction)], axis=2)
    passive = _constraint_rows(pose)
    stiffness = robot.limb_stiffness_n_per_mm * active.transpose(0, 2, 1) @ active
    return np.asarray(
        stiffness + passive.transpose(0, 2, 1) @ np.linalg.solve(_constraint_compliance(robot, pose), passive),
        dtype=np.float64,
    )


def _constraint_rows(pose: Pose) -> FloatArray:
    """(n, 3, 6) rows ``[u, -L v]``, ``[v, L u]``, ``[0, n]`` (eq. 4): motions that the UP limb resists."""
    u, v = pose.frame[:, :, 0], pose.frame[:, :, 1]
    length = _beam_length(pose)[:, None]
    rows = np.zeros((len(u), 3, 6))
    rows[:, 0] = np.concatenate([u, -length * v], axis=1)
    rows[:, 1] = np.concatenate([v, length * u], axis=1)
    rows[:, 2, 3:] = np.cross(_E_X, v)
    return rows


def _constraint_compliance(robot: HybridRobot, pose: Pose) -> FloatArray:
    """(n, 3, 3) the UP limb's deflection in those motions per unit of its reactions (the tip moment is -F L)."""
    for name in ("up_bending_n_mm2", "up_torsion_n_mm2"):
        require_number(f"the robot's {name}", getattr(robot, name), "N mm^2", above=0.0)
    bending, torsion = robot.up_bending_n_mm2, robot.up_torsion_n_mm2
    length = _beam_length(pose)
    n_u, _, n_w = np.einsum("nij,ni->jn", pose.frame, np.cross(_E_X, pose.frame[:, :, 1]))  # n is perpendicular to v
    matrix = np.zeros((len(length), 3, 3))
    matrix[:, 0, 0] = matrix[:, 1, 1] = length**3 / (3 * bending)
    matrix[:, 1, 2] = matrix[:, 2, 1] = n_u * length**2 / (2 * bending)
    matrix[:, 2, 2] = n_u**2 * length / bending + n_w**2 * length / torsion
    return matrix


def _beam_length(pose: Pose) -> FloatArray:
    """(n,) ``L = |r|``, mm."""
    return np.asarray(np.linalg.norm(pose.platform_mm, axis=1), dtype=np.float64)


def _cross_matrix(vector: FloatArray) -> FloatArray:
    """(n, 3, 3) matrices S with ``S x = vector cross x``."""
    x, y, z = vector.T
    zero = np.zeros_like(x)
    return np.stack([np.stack(row, axis=1) for row in ((zero, -z, y), (z, zero, -x), (-y, x, zero))], axis=1)
