"""The mechanics of the simulated robots: their reach, and the deflection of the tip under a force.

Written from statics, apart from the controller's model (`process.robot`), which works from motions: here each unit
force at the tip is followed through the members that carry it, and the energy stored in each is summed (virtual work).
Tests compare the two. Units: mm, N, rad; the base frame is that of `model.robot`.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from polishd.model.process import HybridRobot, SerialRobot
from polishd.model.surface import BoolArray, FloatArray

# The hybrid robot: three UPS limbs and one UP limb carry a platform; a C and an A joint carry the tool.

STRAIGHT_DEG = 0.1
"""With A nearer to 0 than this, C may turn to any angle: the robot's controller refuses such a pose."""
LOOSE = 1e-6
"""Limits of a volume of unit vectors (below it the limbs do not hold the platform) and of a sine (UP limb along its
outer axis).
"""
ROUNDING_MM = 1e-6
Z = np.array([0.0, 0.0, 1.0])
GAUSS = 0.5 + np.array([-0.5, 0.5]) / np.sqrt(3.0)
"""Of the UP limb: two points integrate the square of a moment that grows linearly exactly."""


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
    """Return the positions of the members at tips (n, 3) and unit tool axes (n, 3)."""
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
    """(n, 3, 3) displacement of the tip per force there, mm/N; 0 out of reach."""
    result = np.zeros((len(at.tip_mm), 3, 3))
    stored = _stored(robot, at)[at.reached]
    result[at.reached] = stored @ stored.transpose(0, 2, 1)
    return result


def _stored(robot: HybridRobot, at: SimHybridPoses) -> FloatArray:
    """(n, 3, members) load of each member from a unit force along each axis, over the root of its stiffness."""
    n = len(at.tip_mm)
    unit = np.broadcast_to(np.eye(3), (n, 3, 3))
    moment = np.cross(at.tip_mm[:, None], unit)  # of each unit force about the origin
    load = np.stack([at.along, moment @ at.outer, np.einsum("nfi,ni->nf", moment, at.inner)], axis=1)
    safe = np.where(at.reached[:, None, None], at.carried, np.eye(3))
    push = -np.linalg.solve(safe, load).transpose(0, 2, 1)  # (n, force, limb)
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
    """Return mm/N of limbs of these lengths."""
    if robot.limb_ea_n is None:
        return np.full_like(limb_mm, 1.0 / robot.limb_stiffness_n_per_mm)
    return np.asarray(limb_mm / robot.limb_ea_n)


def _joints(robot: HybridRobot) -> tuple[FloatArray, FloatArray]:
    """(3, 3) ends of the limbs at the base, and at the platform from its center where the UP limb hangs along z."""
    angle = np.radians(robot.first_limb_deg) + np.arange(3) * np.radians(120.0)
    circle = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(3)])
    base = robot.base_radius_mm * circle if robot.base_joints_mm is None else np.array(robot.base_joints_mm)
    own = robot.platform_joints_mm
    return base, robot.platform_radius_mm * circle if own is None else np.array(own)


def _across(along: FloatArray, outer: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(n,) component of (n, 3) directions perpendicular to e: towards z, and towards e x z."""
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
    """Turn vectors (..., 3) about a unit axis (3,) (Rodrigues' formula)."""
    own = (vector @ about)[..., None] * about
    return np.asarray(cosine * (vector - own) + sine * np.cross(about, vector) + own)


def _in_workspace(robot: HybridRobot, tip_mm: FloatArray, below_mm: FloatArray, up_mm: FloatArray) -> BoolArray:
    """(n,) within the cylinder that the maker states; ``below_mm`` is the wrist's, below the U joint."""
    height = robot.joint_height_mm - tip_mm[:, 2]
    low, high = robot.workspace_height_mm
    inside = np.hypot(tip_mm[:, 0], tip_mm[:, 1]) <= robot.workspace_radius_mm + ROUNDING_MM
    inside &= (height >= low - ROUNDING_MM) & (height <= high + ROUNDING_MM)
    return np.asarray(inside & (below_mm > 0.0) & (up_mm > 0.0))


# A six-axis arm by its screws: the axis of each joint at home, and how a turn of a joint moves all that follows.

IntArray = NDArray[np.intp]

SINGULAR = 1e-3
"""Ratio of the smallest to the largest singular value of the joint motions, lengths over the arm's: the robot's
controller refuses poses below it.
"""
FEW = 256
"""Poses that are solved all the way from home; the others start from poses that were found."""
STARTS = 6
"""Start angles of the last joint at home, equal parts of a turn: that turn passes no singular pose, as with the first,
...
"""
SIDES = 4
"""... which is turned, too, where home leads to none of the poses."""
NEAREST = 4
"""Found poses from which a remaining pose is tried, the nearest first, ..."""
ROUNDS = 6
"""... one in each round."""
STEPS = 80
STEP = 0.1
"""Longest step towards a pose: rad, or parts of the arm's length."""
MOST_TURN = 0.3
"""Longest turn of a joint in a step, rad: near a singular pose."""
FOUND = 1e-10
"""Largest residual, in the same measure."""


@dataclass(frozen=True, slots=True)
class Screws:
    """The arm at home: lines (6, 3) directions and positions of its joints, tip (3,), flange (3, 3) axes as columns."""

    direction: FloatArray
    place_mm: FloatArray
    tip_mm: FloatArray
    flange: FloatArray
    length_mm: float

    @classmethod
    def of(cls, robot: SerialRobot) -> Screws:
        """Read the rows with all joints at home."""
        at, lines = np.eye(4), []
        for (a, alpha, d, zero), home in zip(robot.dh, robot.home_deg, strict=True):
            link, joint = _moved(np.radians(alpha), a, 0), _moved(np.radians(home + zero), d, 2)
            if robot.convention == "modified":
                at = at @ link
            lines.append((at[:3, 2], at[:3, 3]))
            at = at @ joint if robot.convention == "modified" else at @ joint @ link
        direction, place = (np.array(column) for column in zip(*lines, strict=True))
        tip = at[:3, 3] + robot.tool_length_mm * at[:3, 2]
        length = sum(float(np.hypot(a, d)) for a, _, d, _ in robot.dh) + robot.tool_length_mm
        return cls(direction, place, tip, at[:3, :3], length)


@dataclass(frozen=True, slots=True)
class SimSerialPoses:
    """The arm at n poses."""

    reached: BoolArray
    """(n,)."""
    joints: FloatArray
    """(n, 6) turns from home, rad."""
    motion: FloatArray
    """(n, 6, 6) column j: the tip's translation over the arm's length, and its turn, for a turn of joint j."""


@dataclass(frozen=True, slots=True)
class Known:
    """Poses that the solver found before."""

    tip_mm: FloatArray
    """(n, 3)."""
    axis: FloatArray
    """(n, 3)."""
    joints: FloatArray
    """(n, 6) turns from home, rad."""


def solve_serial_poses(
    robot: SerialRobot, tip_mm: FloatArray, axis: FloatArray, known: Known | None = None
) -> SimSerialPoses:
    """Solve the joints for tips (n, 3) mm and unit tool axes (n, 3), without a singular pose on the way.

    Start from ``known`` poses where there are any, which is faster, and from home where that fails.
    """
    if known is not None and len(known.tip_mm):
        count = len(known.tip_mm)
        at = _posed(robot, np.vstack([known.tip_mm, tip_mm]), np.vstack([known.axis, axis]), known.joints)
        if at.reached[count:].all():
            return SimSerialPoses(at.reached[count:], at.joints[count:], at.motion[count:])
    return _posed(robot, tip_mm, axis, np.zeros((0, 6)))


def _posed(robot: SerialRobot, tip_mm: FloatArray, axis: FloatArray, known: FloatArray) -> SimSerialPoses:
    """The joints (k, 6) for the first k poses are known."""
    screws = Screws.of(robot)
    flange, wanted = _flange(robot, axis)
    joints, found = np.zeros((len(tip_mm), 6)), np.zeros(len(tip_mm), dtype=np.bool_)
    motion = np.zeros((len(tip_mm), 6, 6))
    joints[: len(known)], found[: len(known)] = known, True
    motion[: len(known)] = _motion(screws, known)[1]

    def lead(going: IntArray, start: FloatArray) -> None:
        to, along, miss = _lead(screws, start, tip_mm[going], flange[going])
        there = miss < FOUND
        joints[going[there]], motion[going[there]], found[going[there]] = to[there], along[there], True

    few = np.flatnonzero(wanted)[:: max(1, len(tip_mm) // FEW)]
    for side in range(SIDES if not len(known) else 0):
        for start in range(STARTS):
            going = few[~found[few]]
            turned = np.zeros((len(going), 6))
            turned[:, [0, 5]] = 2.0 * np.pi * side / SIDES, 2.0 * np.pi * start / STARTS
            lead(going, turned)
        if found.any():
            break
        few = few[::SIDES] if side == 0 else few
    place = np.column_stack([tip_mm / screws.length_mm, axis])
    led_from: list[set[int]] = [set() for _ in place]
    for _ in range(ROUNDS):
        there = np.flatnonzero(found)
        if not len(there):
            break
        near = cKDTree(place[there])
        pairs = []
        for pose in np.flatnonzero(wanted & ~found):
            nearest = there[near.query(place[pose], k=range(1, min(NEAREST, len(there)) + 1))[1]].tolist()
            new = [one for one in nearest if one not in led_from[pose]]
            if new:
                led_from[pose].add(new[0])
                pairs.append((pose, new[0]))
        if not pairs:
            break
        going, start_at = np.array(pairs).T
        lead(going, joints[start_at])
    spread = np.linalg.svd(motion, compute_uv=False)
    regular = spread[:, 5] > SINGULAR * spread[:, 0]
    return SimSerialPoses(found & regular & _within(robot, joints), joints, motion)


def serial_compliance_mm_per_n(robot: SerialRobot, at: SimSerialPoses) -> FloatArray:
    """(n, 3, 3) displacement of the tip per force there, mm/N; 0 out of reach.

    The moment of a force about a joint is the force times the motion of the tip for a turn of the joint.
    """
    lever = at.motion[:, :3] * Screws.of(robot).length_mm * at.reached[:, None, None]
    stored = lever / np.sqrt(np.array(robot.joint_stiffness_n_mm_per_rad))
    return np.asarray(stored @ stored.transpose(0, 2, 1))


def _moved(angle: float, by: float, about: int) -> FloatArray:
    """(4, 4) turn about x (0) or z (2), and shift along it."""
    c, s = np.cos(angle), np.sin(angle)
    i, j = ((about + 1) % 3, (about + 2) % 3)
    result = np.eye(4)
    result[i, i], result[i, j], result[j, i], result[j, j] = c, -s, s, c
    result[about, 3] = by
    return result


def _motion(screws: Screws, joints: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(n, 3, 4) the flange's axes and the tip, as columns, and `Posed.motion`, at turns (n, 6) from home."""
    turn = np.broadcast_to(np.eye(3), (len(joints), 3, 3))
    shift = np.zeros((len(joints), 3))
    axes, places = np.empty((2, len(joints), 6, 3))
    for j in range(6):
        axes[:, j] = turn @ screws.direction[j]
        places[:, j] = turn @ screws.place_mm[j] + shift
        turn = turn @ _about(screws.direction[j], joints[:, j])
        shift = places[:, j] - turn @ screws.place_mm[j]
    tip = turn @ screws.tip_mm + shift
    arm = np.cross(axes, tip[:, None] - places) / screws.length_mm
    motion = np.concatenate([arm, axes], axis=2).transpose(0, 2, 1)
    return np.concatenate([turn @ screws.flange, tip[:, :, None]], axis=2), motion


def _about(axis: FloatArray, angle: FloatArray) -> FloatArray:
    """(n, 3, 3) turns about a unit axis (3,) by angles (n,)."""
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    s, c = np.sin(angle)[:, None, None], np.cos(angle)[:, None, None]
    return np.asarray(np.eye(3) + s * cross + (1.0 - c) * (cross @ cross))


def _lead(
    screws: Screws, joints: FloatArray, tip_mm: FloatArray, flange: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Take Newton's steps from turns (n, 6), none longer than `STEP`. Return turns, `Posed.motion` and residuals (n,).

    Where the determinant of the motions changes its sign the arm has passed a singular pose: that solution is dropped.
    """
    joints, motion, miss = joints.copy(), np.zeros((len(joints), 6, 6)), np.full(len(joints), np.inf)
    home = np.linalg.det(_motion(screws, np.zeros((1, 6)))[1][0])
    going = np.arange(len(joints))
    for _ in range(STEPS):
        at, motion[going] = _motion(screws, joints[going])
        passed = np.linalg.det(motion[going]) * home <= 0.0
        miss[going[passed]] = np.inf
        going, at = going[~passed], at[~passed]
        if not len(going):
            break
        turn = Rotation.from_matrix(flange[going] @ at[:, :, :3].transpose(0, 2, 1)).as_rotvec()
        left = np.concatenate([(tip_mm[going] - at[:, :, 3]) / screws.length_mm, turn], axis=1)
        miss[going] = np.linalg.norm(left, axis=1)
        more = miss[going] > FOUND
        going, left = going[more], left[more]
        if not len(going):
            break
        left *= np.minimum(1.0, STEP / miss[going])[:, None]
        damped = motion[going] + 1e-12 * np.eye(6)
        step = np.linalg.solve(damped, left[:, :, None])[:, :, 0]
        joints[going] += step * np.minimum(1.0, MOST_TURN / np.maximum(np.abs(step).max(axis=1), 1e-300))[:, None]
    return joints, motion, miss


def _flange(robot: SerialRobot, axis: FloatArray) -> tuple[FloatArray, BoolArray]:
    """(n, 3, 3) wanted axes of the flange, as columns, and (n,) True where ``flange_x`` determines them."""
    z = -axis
    x = np.array(robot.flange_x) / np.linalg.norm(robot.flange_x)
    x = x - (z @ x)[:, None] * z
    size = np.linalg.norm(x, axis=1)
    x = x / np.maximum(size, 1e-300)[:, None]
    return np.stack([x, np.cross(z, x), z], axis=2), size > SINGULAR


def _within(robot: SerialRobot, joints: FloatArray) -> BoolArray:
    """(n,) True where turns from home (n, 6), or those plus a full turn, are within the limits."""
    low, high = np.radians(robot.joint_limits_deg).T
    angle = np.radians(robot.home_deg) + (joints + np.pi) % (2.0 * np.pi) - np.pi
    fits = [((angle + turn >= low) & (angle + turn <= high)) for turn in (0.0, 2.0 * np.pi, -2.0 * np.pi)]
    return np.asarray((fits[0] | fits[1] | fits[2]).all(axis=1))


def reached(robot: HybridRobot | SerialRobot, tip_mm: FloatArray, axis: FloatArray) -> BoolArray:
    """(n,) True where the robot reaches: tips (n, 3) mm, unit tool axes (n, 3) from the tip into the spindle."""
    if isinstance(robot, HybridRobot):
        return solve_hybrid_poses(robot, tip_mm, axis).reached
    return solve_serial_poses(robot, tip_mm, axis).reached


KEPT = 16
"""Poses of the last reached points."""


@dataclass(slots=True)
class Reaching:
    """A controller that gets a path in parts: each part starts from the pose where the last one ended."""

    robot: HybridRobot | SerialRobot
    _known: Known | None = field(default=None, init=False)

    def reached(self, tip_mm: FloatArray, axis: FloatArray) -> BoolArray:
        """As `reached`."""
        if isinstance(self.robot, HybridRobot) or not len(tip_mm):
            return reached(self.robot, tip_mm, axis)
        at = solve_serial_poses(self.robot, tip_mm, axis, self._known)
        kept = at.reached.nonzero()[0][:: -max(len(tip_mm) // KEPT, 1)]
        if len(kept):
            self._known = Known(tip_mm[kept], axis[kept], at.joints[kept])
        return at.reached


def tip_gives_mm_per_n(
    robot: HybridRobot | SerialRobot, tip_mm: FloatArray, axis: FloatArray
) -> tuple[BoolArray, FloatArray]:
    """(n,) True within reach, and (n, 3, 3) displacement of the tip per force, mm/N; 0 out of reach.

    Arguments as of `reached`.
    """
    if isinstance(robot, HybridRobot):
        at = solve_hybrid_poses(robot, tip_mm, axis)
        return at.reached, hybrid_compliance_mm_per_n(robot, at)
    arm = solve_serial_poses(robot, tip_mm, axis)
    return arm.reached, serial_compliance_mm_per_n(robot, arm)
