"""Kinematics of the hybrid robot in closed form, for a batch of poses (paper eq. 1, solved for the limbs).

Geometry: the C axis lies on the line from the U joint O to the wrist centre P, the A axis meets it at P, and the
tool axis meets A at P without offset. Without that there is no closed form, and `HybridRobot` cannot state it.

Base frame: origin O, z down. With the outer U axis x, ``R = Rx(alpha) Ry(beta)`` has the platform's axes u, v (inner U
axis) and w (from O to P) as its columns.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from polishd.model.errors import ComputeError
from polishd.model.robot import HybridRobot
from polishd.model.surface import FloatArray
from polishd.process.robot.parallel import Geometry, Parallel, cross, dot, geometry_of, parallel_at
from polishd.process.robot.refusal import refuse_where, require_vectors
from polishd.process.robot.workspace import Placed, flip, place, refuse_unreachable, require_poses

NEWTON_STEPS = 30
SOLVED_MM = 1e-11
"""Forward kinematics stops when all limbs have their lengths within this ..."""
UNSOLVED_MM = 1e-8
"""... and refuses a pose in which one is further off than this."""


@dataclass(frozen=True, slots=True)
class Pose:
    """Where every member of the robot is, for n poses; mm and rad, vectors in the base frame."""

    tip_mm: FloatArray
    """(n, 3) tool tip."""
    axis: FloatArray
    """(n, 3) unit tool axis, from the tip into the spindle."""
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
    c_rad: FloatArray
    """(n,) turn of the A joint about w, from u; continuous from pose to pose."""
    a_rad: FloatArray
    """(n,) turn of the tool about the A joint, from w; its sign belongs to C's branch."""

    @property
    def limb_mm(self) -> FloatArray:
        """(n, 3) limb lengths, ``q_i``."""
        return np.asarray(np.linalg.norm(self.limbs_mm, axis=2), dtype=np.float64)

    @property
    def hinge(self) -> FloatArray:
        """(n, 3) unit direction of the A joint: u turned by C about w."""
        u, v = self.frame[:, :, 0], self.frame[:, :, 1]
        return np.asarray(np.cos(self.c_rad)[:, None] * u + np.sin(self.c_rad)[:, None] * v, dtype=np.float64)

    def readings_deg(self, robot: HybridRobot) -> tuple[FloatArray, FloatArray]:
        """What the machine's C and A read, (n,) deg each: the zero angles are the robot's."""
        return np.degrees(self.c_rad) + robot.c_zero_deg, np.degrees(self.a_rad) + robot.a_zero_deg


def inverse_kinematics(robot: HybridRobot, tip_mm: FloatArray, axis: FloatArray, *, path: bool = False) -> Pose:
    """Pose for each (n, 3) tool tip (mm, base frame) and (n, 3) unit tool axis (from the tip into the spindle).

    Paper eq. 1, with ``q_i w_i`` on the left and the platform's own ``w`` on the right (misprinted there). C is
    continuous from the branch that the robot has at the first pose. Raises ComputeError that names the first point out
    of the workspace, singular or out of stroke; with ``path`` also the first one at which the wrist flips.
    """
    tip, axis = require_poses(tip_mm, axis)
    geometry = geometry_of(robot)
    placed = place(robot, geometry, tip.T, axis.T)
    refuse_unreachable(robot, placed)
    if path:
        refuse_where(*flip(placed.tool, axis))
    parallel = placed.parallel
    frame = parallel.frame.transpose(2, 1, 0)
    return Pose(
        tip,
        axis,
        placed.wrist_mm.T,
        (parallel.length_mm * parallel.frame[2]).T,
        geometry.outer,
        frame,
        geometry.platform @ frame.transpose(0, 2, 1),
        np.einsum("kin,kjn->nji", parallel.frame, parallel.limbs_mm),
        *_wrist_angles(placed, 1.0 if robot.a_branch == "positive" else -1.0),
    )


def forward_kinematics(
    robot: HybridRobot, limb_mm: FloatArray, c_rad: FloatArray, a_rad: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Tool tips (n, 3) mm and unit axes (n, 3) from limb lengths (n, 3) mm and wrist angles (n,) rad, as in `Pose`.

    The parallel section is solved by Newton's method from the limbs' mean length along z. Raises ComputeError where
    no platform pose has the lengths.
    """
    c, a = np.asarray(c_rad, dtype=np.float64), np.asarray(a_rad, dtype=np.float64)
    lengths = require_vectors("limb length", limb_mm, "mm")
    if not c.shape == a.shape == (len(lengths),):
        raise ComputeError(f"{len(lengths)} x 3 limb lengths come with {c.shape} C and {a.shape} A angles")
    parallel = _solve_parallel(geometry_of(robot), lengths.T)
    u, v, w = parallel.frame
    pointing = np.sin(a) * (np.sin(c) * u - np.cos(c) * v) + np.cos(a) * w
    wrist = (parallel.length_mm + robot.wrist_length_mm) * w
    return (wrist + robot.tool_length_mm * pointing).T, -pointing.T


def _wrist_angles(placed: Placed, branch: float) -> tuple[FloatArray, FloatArray]:
    """(C, A) rad: the tool points ``(sin C sin A, -cos C sin A, cos A)`` in the platform's frame.

    Of (C, A) and (C + pi, -A) the first pose takes the one whose A has the sign of ``branch``, each other pose the
    one whose C is nearer to that of the pose before.
    """
    x, y, z = -branch * placed.tool
    a = np.arctan2(branch * placed.sine, branch * z)
    c = np.arctan2(x, -y)
    continuous = np.unwrap(c, period=np.pi)
    crossed = np.round((continuous - c) / np.pi) % 2 == 1
    return np.asarray(continuous, dtype=np.float64), np.where(crossed, -a, a)


def _solve_parallel(geometry: Geometry, limb_mm: FloatArray) -> Parallel:
    """The section whose limbs have the (3, n) lengths given, mm."""
    centre, outer = np.zeros_like(limb_mm), geometry.outer[:, None]
    centre[2] = limb_mm.mean(axis=0)
    with np.errstate(all="ignore"):  # a step from a singular pose ends in nan, which is refused
        parallel = _parallel_about(geometry, centre)
        for _ in range(NEWTON_STEPS):
            miss = limb_mm - parallel.limb_mm
            if np.abs(miss).max(initial=0.0) < SOLVED_MM:
                break
            growth = parallel.limb_mm * miss / parallel.determinant
            about_e, about_v, along_w = (dot(motion, growth) for motion in parallel.cofactors)
            _, v, w = parallel.frame
            centre = centre + about_e * cross(outer, centre) + about_v * cross(v, centre) + along_w * w
            parallel = _parallel_about(geometry, centre)
        worst = np.abs(limb_mm - parallel.limb_mm).max(axis=0)
    limit = "no platform pose found that has these limb lengths"
    refuse_where(~(worst < UNSOLVED_MM), worst, "the limb lengths' misfit", "mm", limit)
    return parallel


def _parallel_about(geometry: Geometry, centre: FloatArray) -> Parallel:
    """The section with the platform's centre at the (3, n) points, mm."""
    length = np.sqrt(dot(centre, centre))
    return parallel_at(geometry, centre / length, length)
