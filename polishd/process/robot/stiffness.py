"""Stiffness of the hybrid robot, equation by equation: 6 x 6 matrices (paper eq. 2-15).

Twists are ``[translation mm; rotation rad]`` and wrenches ``[force N; moment N mm]``, all in the base frame. For a
program's tens of thousands of points, where only the tip's translations count, `compliance` has the closed form.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from polishd.model.robot import HybridRobot
from polishd.model.surface import FloatArray
from polishd.process.robot.kinematics import Pose
from polishd.process.robot.refusal import require_number


class Beam(NamedTuple):
    """What the UP limb's end gives way, as multiples: see `constraint_compliance`."""

    shear: float
    cross: float
    turn: float


BEAMS = {"exact": Beam(1 / 3, 1 / 2, 1.0), "paper": Beam(1 / 12, 1 / 4, 3 / 4)}
"""Of ``L^3/EI``, ``n_u L^2/EI`` and ``n_u^2 L/EI``.

"exact": Euler-Bernoulli beam whose U joint carries no moment about its axes, so that the moment at its end is -F L.
"paper": eq. 6-8, ``C_c = S_c K_c^-1 S_c'`` with the cantilever under a force alone, ``W = [[0, -3/(2L)], [3/(2L), 0]]``
and ``K_c = diag(3EI/L^3, 3EI/L^3, GJ/L)``, and S_c corrected: its rows are ``[1 - L W21, -L W22, 0]``,
``[L W11, 1 + L W12, 0]`` and ``[n.u W11 + n.v W21, n.u W12 + n.v W22, n.w]``. Four times too stiff in bending.
"""


class Stiffnesses(NamedTuple):
    """The robot's elastic numbers, found positive."""

    beam: Beam
    bending_n_mm2: float
    torsion_n_mm2: float
    a_n_mm_per_rad: float
    c_n_mm_per_rad: float


def stiffnesses_of(robot: HybridRobot) -> Stiffnesses:
    """Raises ComputeError that names the first stiffness which is not above 0, with its value and unit."""
    numbers = [
        _positive(robot, name, unit)
        for name, unit in (
            ("up_bending_n_mm2", "N mm^2"),
            ("up_torsion_n_mm2", "N mm^2"),
            ("a_stiffness_n_mm_per_rad", "N mm/rad"),
            ("c_stiffness_n_mm_per_rad", "N mm/rad"),
        )
    ]
    return Stiffnesses(BEAMS[robot.beam], *numbers)


def limb_stiffness_n_per_mm(robot: HybridRobot, limb_mm: FloatArray) -> FloatArray:
    """Axial stiffness of limbs of these lengths, mm: constant, or EA / length (eq. 12: K_a); N/mm."""
    if robot.limb_ea_n is None:
        return np.full_like(limb_mm, _positive(robot, "limb_stiffness_n_per_mm", "N/mm"))
    return np.asarray(_positive(robot, "limb_ea_n", "N") / limb_mm, dtype=np.float64)


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


def _positive(robot: HybridRobot, name: str, unit: str) -> float:
    value = getattr(robot, name)
    require_number(f"the robot's {name}", value, unit, above=0.0)
    return float(value)


def _beam_length(pose: Pose) -> FloatArray:
    """(n,) ``L = |r|``, mm."""
    return np.asarray(np.linalg.norm(pose.platform_mm, axis=1), dtype=np.float64)


def _cross_matrix(vector: FloatArray) -> FloatArray:
    """(n, 3, 3) matrices S with ``S x = vector cross x``."""
    x, y, z = vector.T
    zero = np.zeros_like(x)
    return np.stack([np.stack(row, axis=1) for row in ((zero, -z, y), (z, zero, -x), (-y, x, zero))], axis=1)
