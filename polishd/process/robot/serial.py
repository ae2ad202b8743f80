"""A six-axis arm: inverse kinematics by damped Gauss-Newton, and compliance at the tool tip."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from polishd.model.errors import ComputeError
from polishd.model.process import SerialRobot
from polishd.model.surface import BoolArray, FloatArray
from polishd.process.checks import refuse_where, require_number
from polishd.process.frames import rotation_vectors
from polishd.process.robot.hybrid import require_poses

# The chain of joints that Denavit-Hartenberg rows describe.

JOINTS = 6


@dataclass(frozen=True, slots=True)
class Chain:
    """Joints and tip of the arm, base frame, mm."""

    turns: FloatArray
    """(n, 6, 3) unit joint axes."""
    places: FloatArray
    """(n, 6, 3) a point of each joint axis."""
    flange: FloatArray
    """(n, 3, 3) flange axes as columns."""
    tip_mm: FloatArray
    """(n, 3)."""

    @property
    def axis(self) -> FloatArray:
        """(n, 3) unit tool axes, from the tip into the spindle."""
        return -self.flange[:, :, 2]

    @property
    def twists(self) -> FloatArray:
        """(n, 6, 6) row j: the tip's translation, mm/rad, and rotation per turn of joint j."""
        arm = np.cross(self.turns, self.tip_mm[:, None] - self.places)
        return np.concatenate([arm, self.turns], axis=2)


def chain(robot: SerialRobot, joints: FloatArray) -> Chain:
    """Forward kinematics of (n, 6) joint angles, rad: the frame's columns (n, 3) are carried from joint to joint."""
    x, y, z = (np.broadcast_to(column, (len(joints), 3)) for column in np.eye(3))
    place = np.zeros((len(joints), 3))
    turns, places = [], []
    for j, (a, alpha_deg, d, zero_deg) in enumerate(robot.dh):
        sin_alpha, cos_alpha = np.sin(np.radians(alpha_deg)), np.cos(np.radians(alpha_deg))
        if robot.convention == "modified":
            place, y, z = place + a * x, cos_alpha * y + sin_alpha * z, cos_alpha * z - sin_alpha * y
        turns.append(z)
        places.append(place)
        angle = (joints[:, j] + np.radians(zero_deg))[:, None]
        x, y = np.cos(angle) * x + np.sin(angle) * y, np.cos(angle) * y - np.sin(angle) * x
        place = place + d * z
        if robot.convention == "standard":
            place, y, z = place + a * x, cos_alpha * y + sin_alpha * z, cos_alpha * z - sin_alpha * y
    tip = place + robot.tool_length_mm * z
    return Chain(np.stack(turns, axis=1), np.stack(places, axis=1), np.stack([x, y, z], axis=2), tip)


def reach_mm(robot: SerialRobot) -> float:
    """Length of the arm stretched out, mm: the scale that makes translations and rotations comparable."""
    return float(sum(np.hypot(a, d) for a, _, d, _ in robot.dh) + robot.tool_length_mm)


def twist_scale(robot: SerialRobot) -> FloatArray:
    """(6,) what a twist is divided by: the reach for translations, 1 for rotations."""
    return np.repeat([reach_mm(robot), 1.0], 3)


def require_arm(robot: SerialRobot) -> None:
    """Raise ComputeError unless the rows, limits, home and tool are those of a six-axis arm."""
    for name, rows, width in (("dh", robot.dh, 4), ("joint_limits_deg", robot.joint_limits_deg, 2)):
        if np.shape(rows) != (JOINTS, width) or not np.isfinite(rows).all():
            raise ComputeError(f"the arm's {name} must be 6 rows of {width} finite numbers")
    if np.shape(robot.home_deg) != (JOINTS,):
        raise ComputeError(f"the arm's home_deg has {len(robot.home_deg)} angles, it must have 6")
    require_number("the robot's tool_length_mm", robot.tool_length_mm, "mm", above=0.0)
    require_number("the length of the robot's flange_x", float(np.linalg.norm(robot.flange_x)), "", above=0.0)
    for j, ((low, high), home) in enumerate(zip(robot.joint_limits_deg, robot.home_deg, strict=True), 1):
        require_number(f"the upper limit of joint {j}", high, "deg", above=low)
        if not low <= home <= high:
            raise ComputeError(f"home of joint {j} is {home:g} deg, out of its limits {low:g} to {high:g} deg")


IntArray = NDArray[np.intp]

SINGULAR = 1e-3
"""Ratio of the Jacobian's smallest to its largest singular value, lengths over reach, below which it is singular."""
FLIP_DEG = 45.0
"""A joint that turns by more than this between neighbours of a path has taken another branch."""
MISS_MM = 1e-7
MISS_RAD = 1e-9
"""A pose counts as reached within these."""

_RATIO = "the Jacobian's ratio of smallest to largest singular value"
_EXACT = 1e-13
"""Residual, relative to the reach, below which another step only stirs the rounding errors."""
_STEP = 0.1
"""Longest step towards the pose, rad or parts of the reach: short enough to stay on the branch."""
_STEPS = 100
_PATIENCE = 20
_STALLED = 0.98
"""A pose is given up where so many steps leave more than this of what was left."""
_SEEDS = 400
"""Poses led from home; the others start from their nearest neighbor that is solved."""
_LAST_TURNS_DEG = (0.0, 60.0, -60.0, 120.0, -120.0, 180.0)
"""Starts at home differ by these turns of the last joint, ..."""
_FIRST_TURNS_DEG = (0.0, 90.0, -90.0, 180.0)
"""... and of the first, as long as no pose is found: no turn of these two joints changes the Jacobian's determinant."""
_FEWER = 8
"""One of so many seeds is led from home with the first joint turned."""
_NEIGHBORS = 4
"""Nearest solved neighbors from which a pose is tried, one a round."""
_ROUNDS = 12
_SAMPLE_RAD = 0.05
"""Longest turn of a joint between two looks for a singular pose."""


@dataclass(frozen=True, slots=True)
class _Solution:
    """Joint angles for n poses, and all that can be wrong with them."""

    joints: FloatArray
    """(n, 6) rad."""
    miss_mm: FloatArray
    miss_rad: FloatArray
    regular: FloatArray
    """(n,) ratio of the Jacobian's smallest to its largest singular value."""
    turned_over: FloatArray
    """(n,) the Jacobian's determinant over that at home: negative beyond a singular pose."""
    connected: BoolArray
    """(n,) whether joint angles lead there from home without a singular pose between."""

    @property
    def reached(self) -> BoolArray:
        """(n,) True where the pose is reached."""
        return np.asarray((self.miss_mm < MISS_MM) & (self.miss_rad < MISS_RAD), dtype=np.bool_)


def serial_inverse_kinematics(
    robot: SerialRobot, tip_mm: FloatArray, axis: FloatArray, *, path: bool = False
) -> FloatArray:
    """(n, 6) joint angles, rad, for (n, 3) tool tips (mm, base frame) and (n, 3) unit tool axes.

    The flange's z is opposite to the tool axis and its x as near to ``robot.flange_x`` as it goes. Every pose is
    followed from home without passing a singular one, so that all are on home's branch.

    Args:
        robot: the arm; its joint stiffnesses are not used.
        tip_mm: (n, 3) mm.
        axis: (n, 3) unit, from the tip into the spindle.
        path: whether the poses are neighbours, between which no joint may jump: a joint then turns on past half a turn
            from home, if its limits let it.

    Raises:
        ComputeError: names the first pose which is out of reach, near-singular, on another branch than home or out of
            a joint's limits, or (``path``) to which a joint jumps.
    """
    require_arm(robot)
    tip, axis = require_poses(tip_mm, axis)
    solution = _solve(robot, tip, _flange(robot, axis))
    if path:
        solution = dataclasses.replace(solution, joints=np.unwrap(solution.joints, axis=0))
    _refuse(robot, solution)
    if path:
        _refuse_flips(solution.joints)
    return solution.joints


def serial_reachable(robot: SerialRobot, tip_mm: FloatArray, axis: FloatArray) -> BoolArray:
    """(n,) True where `serial_inverse_kinematics` would accept the pose; arguments as there."""
    require_arm(robot)
    tip, axis = require_poses(tip_mm, axis)
    reach = _flange_sine(robot, axis) > SINGULAR
    solution = _solve(robot, tip[reach], _flange(robot, axis[reach]))
    low, high = np.radians(robot.joint_limits_deg).T
    inside = ((solution.joints >= low) & (solution.joints <= high)).all(axis=1)
    reach[reach] = solution.reached & (solution.regular > SINGULAR) & solution.connected & inside
    return reach


def posture_margins(robot: SerialRobot, joints_rad: FloatArray) -> tuple[float, float]:
    """Least distance of a joint from its limits, deg, and least ratio of the Jacobian's singular values.

    ``joints_rad`` (n, 6). Near-singular is a ratio below 1e-3.
    """
    low, high = np.asarray(robot.joint_limits_deg).T
    angle = np.degrees(joints_rad)
    ratio = _regular(chain(robot, joints_rad).twists / twist_scale(robot))
    return float(np.minimum(angle - low, high - angle).min()), float(ratio.min())


def serial_tip_compliance_mm_per_n(
    robot: SerialRobot, tip_mm: FloatArray, axis: FloatArray, *, path: bool = False
) -> FloatArray:
    """(n, 3, 3) displacement of the tip per force at the tip, mm/N, base frame; symmetric positive semidefinite.

    ``J_v diag(1/k) J_v'`` of the joints' stiffnesses k; links and bearings count as rigid. Arguments and refusals as
    for `serial_inverse_kinematics`, and ComputeError for a stiffness that is not above 0.
    """
    return serial_joint_compliance_mm_per_n(robot, serial_inverse_kinematics(robot, tip_mm, axis, path=path))


def serial_joint_compliance_mm_per_n(robot: SerialRobot, joints_rad: FloatArray) -> FloatArray:
    """(n, 3, 3) the same from (n, 6) joint angles, rad."""
    require_arm(robot)
    if len(robot.joint_stiffness_n_mm_per_rad) != JOINTS:
        raise ComputeError(f"the arm has {len(robot.joint_stiffness_n_mm_per_rad)} joint stiffnesses, it must have 6")
    for j, stiffness in enumerate(robot.joint_stiffness_n_mm_per_rad, 1):
        require_number(f"the stiffness of joint {j}", stiffness, "N mm/rad", above=0.0)
    arm = chain(robot, joints_rad).twists[:, :, :3]
    softened = arm / np.asarray(robot.joint_stiffness_n_mm_per_rad)[:, None]
    matrix = arm.transpose(0, 2, 1) @ softened
    return np.asarray((matrix + matrix.transpose(0, 2, 1)) / 2, dtype=np.float64)


def _solve(robot: SerialRobot, tip: FloatArray, flange: FloatArray) -> _Solution:
    """Joint angles for every pose: a few are led from home, the others from their nearest solved neighbors."""
    joints = np.tile(np.radians(robot.home_deg), (len(tip), 1))
    good = np.zeros(len(tip), dtype=np.bool_)

    def lead(trying: IntArray, start: FloatArray) -> None:
        """Keep what is found on home's branch, and of the others the last try, for the refusal's words."""
        led = _follow(robot, start, tip[trying], flange[trying])
        found = _judge(robot, led, tip[trying], flange[trying])
        fine = found.reached & (found.turned_over > 0)
        fine[fine] = _stays_regular(robot, start[fine], led[fine])
        keeps = fine | ~reached[trying]
        joints[trying[keeps]], reached[trying[keeps]] = led[keeps], found.reached[keeps]
        good[trying[fine]] = True

    reached = good.copy()
    seeds = np.arange(0, len(tip), max(1, len(tip) // _SEEDS))
    for first, last in itertools.product(_FIRST_TURNS_DEG, _LAST_TURNS_DEG):
        if first and good.any():
            break
        trying = seeds[~good[seeds]][:: _FEWER if first else 1]
        start = np.radians(np.add(robot.home_deg, [first, *(0.0,) * (JOINTS - 2), last]))
        lead(trying, np.tile(start, (len(trying), 1)))
    _spread(np.concatenate([tip / reach_mm(robot), flange[:, :, 0], flange[:, :, 2]], axis=1), joints, good, lead)
    solution = _judge(robot, joints, tip, flange)
    return dataclasses.replace(solution, joints=_wound(robot, joints), connected=good)


def _spread(
    place: FloatArray, joints: FloatArray, good: BoolArray, lead: Callable[[IntArray, FloatArray], None]
) -> None:
    """Lead the poses that are left from solved ones, the nearest first, and none twice from the same."""
    tried = np.full((len(place), _ROUNDS), -1)
    for turn in range(_ROUNDS):
        solved, open_ = np.flatnonzero(good), np.flatnonzero(~good)
        if not len(solved) or not len(open_):
            return
        many = min(_NEIGHBORS, len(solved))
        near = solved[scipy.spatial.cKDTree(place[solved]).query(place[open_], k=[*range(1, many + 1)])[1]]
        new = ~(near[:, :, None] == tried[open_][:, None, :]).any(axis=2)
        trying, start = open_[new.any(axis=1)], near[np.arange(len(near)), new.argmax(axis=1)][new.any(axis=1)]
        if not len(trying):
            return
        tried[trying, turn] = start
        lead(trying, joints[start])


def _stays_regular(robot: SerialRobot, start: FloatArray, end: FloatArray) -> BoolArray:
    """(n,) whether the arm passes no singular pose while its joints turn evenly from (n, 6) start to (n, 6) end."""
    way = (end - start + np.pi) % (2 * np.pi) - np.pi
    looks = np.ceil(np.abs(way).max(axis=1, initial=0.0) / _SAMPLE_RAD).astype(np.intp) + 1
    whose = np.repeat(np.arange(len(way)), looks)
    part = (np.arange(len(whose)) - np.repeat(np.cumsum(looks) - looks, looks) + 1) / looks[whose]
    over = _determinants(robot, start[whose] + part[:, None] * way[whose]) / _home_determinant(robot)
    stays = np.ones(len(way), dtype=np.bool_)
    np.logical_and.at(stays, whose, over > 0)
    return stays


def _wound(robot: SerialRobot, joints: FloatArray) -> FloatArray:
    """(n, 6) the same angles within half a turn of home, or one turn on where only that is in the joint's limits."""
    home, (low, high) = np.radians(robot.home_deg), np.radians(robot.joint_limits_deg).T
    near = home + (joints - home + np.pi) % (2 * np.pi) - np.pi
    other = near + np.where(near < low, 2 * np.pi, -2 * np.pi)
    outside = (near < low) | (near > high)
    return np.where(outside & (low <= other) & (other <= high), other, near)


def _follow(robot: SerialRobot, start: FloatArray, tip: FloatArray, flange: FloatArray) -> FloatArray:
    """(n, 6) joints that were led from (n, 6) ``start`` straight towards the poses in short damped Gauss-Newton steps.

    The damping goes with the square of what is left (Sugihara), so that the last steps are Newton's, and a pose out of
    reach is approached rather than overshot.
    """
    joints = start.copy()
    left, best = np.arange(len(joints)), np.full(len(joints), np.inf)
    for step in range(_STEPS):
        at = chain(robot, joints[left])
        error = _error(robot, at, tip[left], flange[left])
        size = np.linalg.norm(error, axis=1)
        going = size > _EXACT
        if step % _PATIENCE == 0:
            going &= size < _STALLED * best[left]
            best[left] = size
        if not going.any():
            break
        left, error, size = left[going], error[going], size[going]
        error = error * np.minimum(1.0, _STEP / size)[:, None]
        twists = at.twists[going] / twist_scale(robot)
        damping = (1e-14 + np.minimum(size, _STEP) ** 2 * 0.1)[:, None, None] * np.eye(JOINTS)
        normal = twists @ twists.transpose(0, 2, 1) + damping
        joints[left] += np.linalg.solve(normal, twists @ error[:, :, None])[:, :, 0]
    return joints


def _error(robot: SerialRobot, at: Chain, tip: FloatArray, flange: FloatArray) -> FloatArray:
    """(n, 6) twist that is left to the pose: translation over the reach, and rotation vector, rad."""
    turn = rotation_vectors(flange @ at.flange.transpose(0, 2, 1))
    return np.concatenate([(tip - at.tip_mm) / reach_mm(robot), turn], axis=1)


def _judge(robot: SerialRobot, joints: FloatArray, tip: FloatArray, flange: FloatArray) -> _Solution:
    at = chain(robot, joints)
    error = _error(robot, at, tip, flange)
    twists = at.twists / twist_scale(robot)
    miss = np.linalg.norm(error.reshape(-1, 2, 3), axis=2)
    return _Solution(
        joints=joints,
        miss_mm=miss[:, 0] * reach_mm(robot),
        miss_rad=miss[:, 1],
        regular=_regular(twists),
        turned_over=np.linalg.det(twists) / _home_determinant(robot),
        connected=np.ones(len(joints), dtype=np.bool_),
    )


def _determinants(robot: SerialRobot, joints: FloatArray) -> FloatArray:
    """(n,) the Jacobian's, lengths over the reach."""
    return np.asarray(np.linalg.det(chain(robot, joints).twists / twist_scale(robot)))


def _regular(twists: FloatArray) -> FloatArray:
    """(n,) ratio of the smallest to the largest singular value."""
    singular = np.linalg.svd(twists, compute_uv=False)
    return np.asarray(singular[:, -1] / singular[:, 0], dtype=np.float64)


def _home_determinant(robot: SerialRobot) -> float:
    twists = chain(robot, np.radians([robot.home_deg])).twists / twist_scale(robot)
    ratio = float(_regular(twists)[0])
    require_number(f"home is near-singular: {_RATIO}", ratio, "", above=SINGULAR)
    return float(np.linalg.det(twists[0]))


def _refuse(robot: SerialRobot, solution: _Solution) -> None:
    """Raise ComputeError for the first pose that is not reached, not regular, not on home's branch or not in limits."""
    miss = solution.miss_mm
    refuse_where(~(miss < MISS_MM), miss, "the tool tip is out of reach: the least miss found", "mm", "it must be 0")
    turn = np.degrees(solution.miss_rad)
    refuse_where(~solution.reached, turn, "the tool axis is out of reach: the least miss found", "deg", "it must be 0")
    refuse_where(solution.regular < SINGULAR, solution.regular, _RATIO, "", f"near-singular below {SINGULAR:g}")
    what = "the Jacobian's determinant over that at home"
    says = "below 0 the arm has turned over on the way from home: choose home_deg on the branch wanted"
    refuse_where(solution.turned_over < 0, solution.turned_over, what, "", says)
    says = "on the way there from home lies a singular pose: choose home_deg on the branch wanted"
    refuse_where(~solution.connected, solution.regular, _RATIO, "", says)
    for j, (low, high) in enumerate(robot.joint_limits_deg):
        angle = np.degrees(solution.joints[:, j])
        says = f"out of its limits {low:g} to {high:g} deg"
        refuse_where((angle < low) | (angle > high), angle, f"joint {j + 1}", "deg", says)


def _refuse_flips(joints: FloatArray) -> None:
    leap = np.degrees(np.abs(np.diff(joints, axis=0, prepend=joints[:1])))
    for j in range(JOINTS):
        what, says = f"the turn of joint {j + 1} from the point before", f"beyond {FLIP_DEG:g} deg it is a flip"
        refuse_where(leap[:, j] > FLIP_DEG, leap[:, j], what, "deg", says)


def _flange(robot: SerialRobot, axis: FloatArray) -> FloatArray:
    """(n, 3, 3) the flange wanted, as columns x, y, z, for (n, 3) unit tool axes."""
    sine = _flange_sine(robot, axis)
    what, says = "the sine between the tool axis and flange_x", f"parallel below {SINGULAR:g}: choose another flange_x"
    refuse_where(~(sine > SINGULAR), sine, what, "", says)
    wanted = np.asarray(robot.flange_x) / np.linalg.norm(robot.flange_x)
    x = wanted - (axis @ wanted)[:, None] * axis
    x = x / np.linalg.norm(x, axis=1)[:, None]
    return np.stack([x, np.cross(-axis, x), -axis], axis=2)


def _flange_sine(robot: SerialRobot, axis: FloatArray) -> FloatArray:
    wanted = np.asarray(robot.flange_x) / np.linalg.norm(robot.flange_x)
    return np.asarray(np.linalg.norm(np.cross(axis, wanted), axis=1), dtype=np.float64)
