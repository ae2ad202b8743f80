"""The hybrid robot: three UPS limbs and one UP limb carry a platform, a C and an A joint the tool.

The U joint's centre is the origin. Its outer axis e stays; from where the UP limb hangs along z the platform is turned
by an angle about its inner axis, then by one about e. Statics: the UPS limbs push along themselves only; the UP limb
slides, so it carries no force along itself, and its U joint carries no moment about its two axes, so what it does to
the platform is a force across itself through the origin and a couple about n = e x v. That makes six unknowns of six
equations: the load's path is determined, and the tip gives way by what the members store of it (unit loads).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from polishd.model.robot import HybridRobot
from polishd.model.surface import BoolArray, FloatArray

STRAIGHT_DEG = 0.1
"""With A nearer to 0 than this C turns anywhere: its controller refuses to go there."""
LOOSE = 1e-6
"""Of a volume of unit vectors: less does not hold the platform; and of a sine: the UP limb along its own outer axis."""
ROUNDING_MM = 1e-6
Z = np.array([0.0, 0.0, 1.0])
GAUSS = 0.5 + np.array([-0.5, 0.5]) / np.sqrt(3.0)
"""Of the UP limb: the square of a moment that grows evenly is integrated exactly from two places."""


@dataclass(frozen=True, slots=True)
class SimHybridPoses:
    """The robot at n poses, base frame."""

    reached: BoolArray
    """(n,)."""
    tip_mm: FloatArray
    axis: FloatArray
    along: FloatArray
    """(n, 3) w, from the U joint to the wrist."""
    up_mm: FloatArray
    """(n,) length of the UP limb."""
    ends_mm: FloatArray
    """(n, 3, 3) of the UPS limbs at the platform, one a row."""
    limbs: FloatArray
    """(n, 3, 3) unit, from base to platform, one a row."""
    limb_mm: FloatArray
    """(n, 3)."""
    outer: FloatArray
    """(3,) e."""
    inner: FloatArray
    """(n, 3) v, the U joint's inner axis."""
    carried: FloatArray
    """(n, 3, 3) by each limb (column) of unit push: force along w, moments about e and v."""


def solve_hybrid_poses(robot: HybridRobot, tip_mm: FloatArray, axis: FloatArray) -> SimHybridPoses:
    """Where its members are at tips (n, 3) and unit tool axes (n, 3)."""
    wrist = tip_mm + robot.tool_length_mm * axis
    distance = np.linalg.norm(wrist, axis=1)
    along = wrist / np.maximum(distance, 1e-300)[:, None]
    outer = np.array(robot.outer_axis) / np.linalg.norm(robot.outer_axis)
    up_mm = distance - robot.wrist_length_mm
    base, ends = _joints(robot)
    ends, inner = _turned(ends, along, outer)
    ends = ends + (up_mm[:, None] * along)[:, None]
    limb = ends - base
    limb_mm = np.linalg.norm(limb, axis=2)
    limbs = limb / np.maximum(limb_mm, 1e-300)[:, :, None]
    moments = np.cross(ends, limbs)
    carried = np.stack(
        [np.einsum("nki,ni->nk", limbs, along), moments @ outer, np.einsum("nki,ni->nk", moments, inner)], axis=1
    )
    can = _in_workspace(robot, tip_mm, wrist[:, 2], up_mm)
    can &= np.hypot(*_across(along, outer)) > LOOSE
    can &= np.abs(np.linalg.det(carried / np.linalg.norm(carried, axis=2)[:, :, None])) > LOOSE
    can &= np.linalg.norm(np.cross(along, axis), axis=1) > np.sin(np.radians(STRAIGHT_DEG))
    can &= ((limb_mm >= robot.stroke_mm[0]) & (limb_mm <= robot.stroke_mm[1])).all(axis=1)
    return SimHybridPoses(can, tip_mm, axis, along, up_mm, ends, limbs, limb_mm, outer, inner, carried)


def hybrid_compliance_mm_per_n(robot: HybridRobot, at: SimHybridPoses) -> FloatArray:
    """(n, 3, 3) displacement of the tip per force there, mm/N; 0 where the robot cannot be."""
    result = np.zeros((len(at.tip_mm), 3, 3))
    stored = _stored(robot, at)[at.reached]
    result[at.reached] = stored @ stored.transpose(0, 2, 1)
    return result


def _stored(robot: HybridRobot, at: SimHybridPoses) -> FloatArray:
    """(n, 3, members) what a unit force along each axis does in each member, over the root of its stiffness."""
    n = len(at.tip_mm)
    unit = np.broadcast_to(np.eye(3), (n, 3, 3))
    moment = np.cross(at.tip_mm[:, None], unit)  # of each unit force about the origin
    asked = np.stack([at.along, moment @ at.outer, np.einsum("nfi,ni->nf", moment, at.inner)], axis=1)
    safe = np.where(at.reached[:, None, None], at.carried, np.eye(3))
    push = -np.linalg.solve(safe, asked).transpose(0, 2, 1)  # (n, force, limb)
    across = -(push @ at.limbs) - unit  # (n, force, 3) of the UP limb on the platform, through the origin
    couple_axis = np.cross(at.outer, at.inner)
    couple = -np.einsum("nfi,ni->nf", push @ np.cross(at.ends_mm, at.limbs) + moment, couple_axis)
    twist = np.einsum("ni,ni->n", couple_axis, at.along)
    bent = couple[:, :, None] * (couple_axis - twist[:, None] * at.along)[:, None]
    lever = np.cross(at.along[:, None], across)
    per_place = np.sqrt(at.up_mm / (2.0 * robot.up_bending_n_mm2))[:, None, None]
    tool = np.cross(-robot.tool_length_mm * at.axis[:, None], unit)  # moment of each about the wrist
    tilt = np.cross(at.along, at.axis)
    tilt /= np.maximum(np.linalg.norm(tilt, axis=1), 1e-300)[:, None]
    members = [push * np.sqrt(_limb_softness(robot, at.limb_mm))[:, None]]
    members += [per_place * (bent - (share * at.up_mm)[:, None, None] * lever) for share in GAUSS]
    members += [
        (couple * (twist * np.sqrt(at.up_mm / robot.up_torsion_n_mm2))[:, None])[:, :, None],
        np.einsum("nfi,ni->nf", tool, at.along)[:, :, None] / np.sqrt(robot.c_stiffness_n_mm_per_rad),
        np.einsum("nfi,ni->nf", tool, tilt)[:, :, None] / np.sqrt(robot.a_stiffness_n_mm_per_rad),
    ]
    return np.concatenate(members, axis=2)


def _limb_softness(robot: HybridRobot, limb_mm: FloatArray) -> FloatArray:
    """mm/N of limbs of these lengths."""
    if robot.limb_ea_n is None:
        return np.full_like(limb_mm, 1.0 / robot.limb_stiffness_n_per_mm)
    return np.asarray(limb_mm / robot.limb_ea_n)


def _joints(robot: HybridRobot) -> tuple[FloatArray, FloatArray]:
    """(3, 3) the limbs' ends at the base, and at the platform from its centre where the UP limb hangs along z."""
    angle = np.radians(robot.first_limb_deg) + np.arange(3) * np.radians(120.0)
    circle = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(3)])
    base = robot.base_radius_mm * circle if robot.base_joints_mm is None else np.array(robot.base_joints_mm)
    own = robot.platform_joints_mm
    return base, robot.platform_radius_mm * circle if own is None else np.array(own)


def _across(along: FloatArray, outer: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(n,) what is perpendicular to e of (n, 3) directions: towards z, and towards e x z."""
    up = Z - outer[2] * outer
    up /= np.linalg.norm(up)
    return along @ up, along @ np.cross(outer, up)


def _turned(ends: FloatArray, along: FloatArray, outer: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(n, 3, 3) the rows of ``ends`` (3, 3) turned with the platform, and (n, 3) the inner axis."""
    hangs, inner = float(outer[2]), np.cross(Z, outer) / np.hypot(outer[0], outer[1])
    near, far = _across(along, outer)
    sine = np.hypot(near, far)
    cosine, level = along @ outer, np.hypot(outer[0], outer[1])
    # about the inner axis from z towards e, in their plane
    cos_in, sin_in = (hangs * cosine + level * sine), (level * cosine - hangs * sine)
    turned = _turn(ends, inner, cos_in[:, None, None], sin_in[:, None, None])
    safe = np.maximum(sine, 1e-300)
    cos_out, sin_out = near / safe, far / safe
    return (
        _turn(turned, outer, cos_out[:, None, None], sin_out[:, None, None]),
        _turn(inner, outer, cos_out[:, None], sin_out[:, None]),
    )


def _turn(vector: FloatArray, about: FloatArray, cosine: FloatArray, sine: FloatArray) -> FloatArray:
    """Rodrigues' formula: vectors (..., 3) turned about a unit axis (3,)."""
    own = (vector @ about)[..., None] * about
    return np.asarray(cosine * (vector - own) + sine * np.cross(about, vector) + own)


def _in_workspace(robot: HybridRobot, tip_mm: FloatArray, below_mm: FloatArray, up_mm: FloatArray) -> BoolArray:
    """(n,) within the cylinder that its maker states; ``below_mm`` the wrist's, below the U joint."""
    height = robot.joint_height_mm - tip_mm[:, 2]
    low, high = robot.workspace_height_mm
    inside = np.hypot(tip_mm[:, 0], tip_mm[:, 1]) <= robot.workspace_radius_mm + ROUNDING_MM
    inside &= (height >= low - ROUNDING_MM) & (height <= high + ROUNDING_MM)
    return np.asarray(inside & (below_mm > 0.0) & (up_mm > 0.0))
