"""Kinematics of the hybrid robot in closed form, for a batch of poses (paper eq. 1, solved for the limbs).

Geometry: the C axis lies on the line from the U joint O to the wrist centre P, the A axis meets it at P, and the
tool axis meets A at P without offset. Without that there is no closed form.

Base frame: origin O, z down, x along the outer U axis (fixed to the base). With R = Rx(alpha) Ry(beta) the platform's
axes are ``u = R e_x``, ``v = R e_y`` (inner U axis) and ``w = R e_z`` (from O to P).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from polishd.model.errors import ComputeError
from polishd.model.process import HybridRobot
from polishd.model.surface import BoolArray, FloatArray
from polishd.process.robot.refusal import refuse_where, require_number, require_unit_vectors, require_vectors

SINGULAR_DEG = 0.1
"""Below this |A| the wrist counts as singular: C is not defined, and neither is the direction of the A joint."""

_E_X = np.array([1.0, 0.0, 0.0])


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
    frame: FloatArray
    """(n, 3, 3) platform axes u, v, w as columns."""
    joints_mm: FloatArray
    """(n, 3, 3) platform end of limb i in row i, from the platform's centre: ``a_i`` of eq. 1."""
    limbs_mm: FloatArray
    """(n, 3, 3) limb i in row i, from base to platform: ``q_i w_i`` of eq. 1."""
    c_rad: FloatArray
    """(n,) wrist C, continuous from pose to pose."""
    a_rad: FloatArray
    """(n,) wrist A; its sign belongs to C's branch, positive at the first pose."""

    @property
    def limb_mm(self) -> FloatArray:
        """(n, 3) limb lengths, ``q_i``."""
        return np.asarray(np.linalg.norm(self.limbs_mm, axis=2), dtype=np.float64)

    @property
    def hinge(self) -> FloatArray:
        """(n, 3) unit direction of the A joint: u turned by C about w."""
        u, v = self.frame[:, :, 0], self.frame[:, :, 1]
        return np.asarray(np.cos(self.c_rad)[:, None] * u + np.sin(self.c_rad)[:, None] * v, dtype=np.float64)


def inverse_kinematics(robot: HybridRobot, tip_mm: FloatArray, axis: FloatArray) -> Pose:
    """Pose for each (n, 3) tool tip (mm, base frame) and (n, 3) unit tool axis (from the tip into the spindle).

    Paper eq. 1, with ``q_i w_i`` on the left and the platform's own ``w`` on the right (misprinted there).
    Raises ComputeError that names the first point which is behind the base, singular or out of stroke.
    """
    pose = _pose(robot, tip_mm, axis)
    _refuse_workspace(robot, pose)
    angle = np.degrees(np.abs(pose.a_rad))
    refuse_where(angle < SINGULAR_DEG, angle, "wrist |A|", "deg", f"singular below {SINGULAR_DEG:g} deg")
    length = pose.limb_mm
    low, high = robot.stroke_mm
    shortest, longest = length.min(axis=1), length.max(axis=1)
    refuse_where(shortest < low, shortest, "the shortest limb", "mm", f"out of stroke {low:g} to {high:g} mm")
    refuse_where(longest > high, longest, "the longest limb", "mm", f"out of stroke {low:g} to {high:g} mm")
    return pose


def reachable(robot: HybridRobot, tip_mm: FloatArray, axis: FloatArray) -> BoolArray:
    """(n,) True where `inverse_kinematics` would accept the pose; arguments as there."""
    pose = _pose(robot, tip_mm, axis)
    length = pose.limb_mm
    low, high = robot.stroke_mm
    in_stroke = (length.min(axis=1) >= low) & (length.max(axis=1) <= high)
    regular = np.degrees(np.abs(pose.a_rad)) >= SINGULAR_DEG
    return np.asarray(_in_front(robot, pose) & in_stroke & regular, dtype=np.bool_)


def limb_lengths_mm(robot: HybridRobot, tip_mm: FloatArray, axis: FloatArray) -> FloatArray:
    """(n, 3) limb lengths, mm, also where they are out of stroke; arguments as for `inverse_kinematics`."""
    pose = _pose(robot, tip_mm, axis)
    _refuse_workspace(robot, pose)
    return pose.limb_mm


def forward_kinematics(
    robot: HybridRobot, limb_mm: FloatArray, c_rad: FloatArray, a_rad: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Tool tips (n, 3) mm and unit axes (n, 3) from limb lengths (n, 3) mm and wrist angles (n,) rad.

    The parallel section is solved by Newton's method for (alpha, beta, L) from the middle of the workspace.
    """
    state = _solve_platform(robot, require_vectors("limb length", limb_mm, "mm"))
    frame = _rotation(state[:, 0], state[:, 1])
    sin_a = np.sin(a_rad)
    local = np.stack([np.sin(c_rad) * sin_a, -np.cos(c_rad) * sin_a, np.cos(a_rad)], axis=1)
    pointing = np.einsum("nij,nj->ni", frame, local)
    wrist = (state[:, 2] + robot.wrist_length_mm)[:, None] * frame[:, :, 2]
    return wrist + robot.tool_length_mm * pointing, -pointing


def _pose(robot: HybridRobot, tip_mm: FloatArray, axis: FloatArray) -> Pose:
    """The pose without judging it: only what is not a number or not a robot is refused."""
    _require_robot(robot)
    tip = require_vectors("tool tip", tip_mm, "mm")
    axis = require_unit_vectors("tool axis", axis)
    if tip.shape != axis.shape:
        raise ComputeError(f"{len(tip)} tool tips come with {len(axis)} tool axes")
    wrist = tip + robot.tool_length_mm * axis
    distance = np.linalg.norm(wrist, axis=1)
    refuse_where(distance == 0, distance, "the wrist's distance from the U joint", "mm", "it must be above 0")
    w = wrist / distance[:, None]
    frame = _platform_frame(w)
    platform = wrist - robot.wrist_length_mm * w
    joints = np.einsum("nij,kj->nki", frame, _circle(robot, robot.platform_radius_mm))
    limbs = platform[:, None, :] + joints - _circle(robot, robot.base_radius_mm)
    c_rad, a_rad = _wrist_angles(np.einsum("nji,nj->ni", frame, -axis))
    return Pose(tip, axis, wrist, platform, frame, joints, limbs, c_rad, a_rad)


def _require_robot(robot: HybridRobot) -> None:
    low, high = robot.stroke_mm
    require_number("the shortest limb allowed", low, "mm", above=0.0)
    require_number("the longest limb allowed", high, "mm", above=low)
    for name in ("base_radius_mm", "platform_radius_mm", "wrist_length_mm", "tool_length_mm"):
        require_number(f"the robot's {name}", getattr(robot, name), "mm", above=0.0)


def _in_front(robot: HybridRobot, pose: Pose) -> BoolArray:
    deep = np.linalg.norm(pose.wrist_mm, axis=1) > robot.wrist_length_mm
    return np.asarray(deep & (pose.wrist_mm[:, 2] > 0), dtype=np.bool_)


def _refuse_workspace(robot: HybridRobot, pose: Pose) -> None:
    z = pose.wrist_mm[:, 2]
    refuse_where(z <= 0, z, "the wrist's height below the U joint", "mm", "out of the workspace: it must be above 0")
    limit = f"out of the workspace: nearer than the wrist is long ({robot.wrist_length_mm:g} mm)"
    distance = np.linalg.norm(pose.wrist_mm, axis=1)
    refuse_where(~_in_front(robot, pose), distance, "the wrist's distance from the U joint", "mm", limit)


def _circle(robot: HybridRobot, radius_mm: float) -> FloatArray:
    """(3, 3) three joints on a circle in the x-y plane, one a row, mm."""
    angle = np.radians(robot.first_limb_deg + np.array([0.0, 120.0, 240.0]))
    return radius_mm * np.stack([np.cos(angle), np.sin(angle), np.zeros(3)], axis=1)


def _platform_frame(w: FloatArray) -> FloatArray:
    """(n, 3, 3) columns u, v, w from (n, 3) unit w: v is perpendicular to w and to the outer U axis."""
    v = np.cross(w, _E_X)
    norm = np.linalg.norm(v, axis=1)
    refuse_where(norm < 1e-9, norm, "the sine between the limb and the outer U axis", "", "the U joint is singular")
    v = v / norm[:, None]
    return np.stack([np.cross(v, w), v, w], axis=2)


def _wrist_angles(pointing: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(C, A) rad from the (n, 3) tool direction in the platform's frame, ``(sin C sin A, -cos C sin A, cos A)``.

    Of (C, A) and (C + pi, -A) each pose takes the one whose C is nearer to that of the pose before.
    """
    a = np.arctan2(np.hypot(pointing[:, 0], pointing[:, 1]), pointing[:, 2])
    c = np.arctan2(pointing[:, 0], -pointing[:, 1])
    continuous = np.unwrap(c, period=np.pi)
    flipped = np.round((continuous - c) / np.pi) % 2 == 1
    return np.asarray(continuous, dtype=np.float64), np.where(flipped, -a, a)


def _rotation(alpha: FloatArray, beta: FloatArray) -> FloatArray:
    """(n, 3, 3) ``Rx(alpha) Ry(beta)``; its columns are u, v, w."""
    sa, ca, sb, cb = np.sin(alpha), np.cos(alpha), np.sin(beta), np.cos(beta)
    u = np.stack([cb, sa * sb, -ca * sb], axis=1)
    v = np.stack([np.zeros_like(sa), ca, sa], axis=1)
    return np.stack([u, v, np.stack([sb, -sa * cb, ca * cb], axis=1)], axis=2)


def _solve_platform(robot: HybridRobot, limb_mm: FloatArray) -> FloatArray:
    """(n, 3) alpha rad, beta rad and L mm at which the limbs have the (n, 3) lengths given."""
    base, local = _circle(robot, robot.base_radius_mm), _circle(robot, robot.platform_radius_mm)
    state = np.zeros_like(limb_mm)
    state[:, 2] = limb_mm.mean(axis=1)
    miss = np.full(len(limb_mm), np.inf)
    for _ in range(30):
        frame = _rotation(state[:, 0], state[:, 1])
        joint = state[:, 2, None, None] * frame[:, None, :, 2] + np.einsum("nij,kj->nki", frame, local)
        limb = joint - base
        length = np.linalg.norm(limb, axis=2)
        miss = np.abs(length - limb_mm).max(axis=1)
        if miss.max(initial=0.0) < 1e-11:
            break
        turns = [np.cross(_E_X, joint), np.cross(frame[:, None, :, 1], joint), frame[:, None, :, 2] + 0 * joint]
        slope = np.stack([np.einsum("nki,nki->nk", limb, turn) for turn in turns], axis=2) / length[:, :, None]
        state = state - np.linalg.solve(slope, (length - limb_mm)[:, :, None])[:, :, 0]
    refuse_where(~(miss < 1e-8), miss, "the limb lengths' misfit", "mm", "no platform pose has these limb lengths")
    return state
