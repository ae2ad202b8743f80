"""Compliance of the hybrid robot at the tool tip in closed form, for programs of any length (paper eq. 2-15, 39-41).

Three limbs, three motions that the UP limb resists and two wrist joints are eight springs in series: with all but one
rigid the mechanism has one freedom, in which the tip moves by m per unit of that spring's deflection, and the
compliance is the sum of m m' / k. Each m follows from a 3 x 3 inverse, since the UP limb leaves the platform three
motions only. The tests hold it to the paper's 6 x 6 matrices, equation by equation.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from polishd.model.errors import ComputeError
from polishd.model.process import HybridRobot, Moment, Vector
from polishd.model.surface import BoolArray, FloatArray
from polishd.process.checks import refuse_where, require_number, require_unit_vectors, require_vectors

# The parallel section of the hybrid robot, with the arrays' components first: what every pose is computed from.

PARALLEL = 1e-6
"""Below this sine two axes count as parallel."""

_TINY = 1e-300
_Z = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, slots=True)
class Geometry:
    """Geometry that does not depend on the pose."""

    base: FloatArray
    """(3, 3) mm, base end of limb i in row i: ``b_i`` of eq. 1."""
    platform: FloatArray
    """(3, 3) mm, platform end of limb i in row i, from the platform's centre, along u, v, w: ``a_i`` of eq. 1."""
    outer: FloatArray
    """(3,) unit outer axis of the U joint, e."""


@dataclass(frozen=True, slots=True)
class Parallel:
    """The parallel section at n poses."""

    frame: FloatArray
    """(3, 3, n) axis (u, v, w), component in the base frame."""
    length_mm: FloatArray
    """(n,) L of the UP limb, from O to the platform's centre."""
    sine: FloatArray
    """(n,) e . u: sine of the angle between e and w."""
    cosine: FloatArray
    """(n,) e . w."""
    limbs_mm: FloatArray
    """(3, 3, n) component (u, v, w), limb, from base to platform: ``q_i w_i`` of eq. 1."""
    limb_mm: FloatArray
    """(3, n) lengths ``q_i``."""
    turns: FloatArray
    """(3, 3, n) axis (u, v, w), limb: growth of ``q_i^2 / 2`` with a turn of the platform about the axis at O, mm^2."""
    motions: FloatArray
    """(3, 3, n) the same with each motion that the UP limb leaves free: turn about e, turn about v, slide along w."""
    cofactors: FloatArray
    """(3, 3, n) motion, limb: over `determinant` the inverse of `motions`, from limbs to motions."""
    determinant: FloatArray
    """(n,) of `motions`; at 0 locked limbs do not hold the platform."""

    @property
    def independence(self) -> FloatArray:
        """(n,) volume spanned by the directions of `motions`' rows, 0 to 1."""
        e, v, w = self.motions
        scale = np.sqrt(dot(e, e) * dot(v, v) * dot(w, w))
        return np.asarray(np.abs(self.determinant) / np.maximum(scale, _TINY), dtype=np.float64)


def geometry_of(robot: HybridRobot) -> Geometry:
    """The geometry as numbers; raises ComputeError where a parameter is out of range, with its value and unit."""
    _require_robot(robot)
    outer = _vectors("outer_axis", (robot.outer_axis,))[0]
    size = float(np.linalg.norm(outer))
    if not np.linalg.norm(np.cross(outer, _Z)) > PARALLEL * size:
        raise ComputeError(f"the robot's outer_axis is {robot.outer_axis}, it must not be parallel to z, nor 0")
    outer = outer / size
    home = axes(_Z[:, None], outer)[0][:, :, 0]
    base = _joints(robot, "base_joints_mm", "base_radius_mm")
    return Geometry(base, _joints(robot, "platform_joints_mm", "platform_radius_mm") @ home.T, outer)


def parallel_at(geometry: Geometry, w: FloatArray, length_mm: FloatArray) -> Parallel:
    """The section for (3, n) unit directions of the UP limb and its (n,) lengths, mm."""
    frame, sine = axes(w, geometry.outer)
    end = geometry.platform[:, :, None]
    reach = length_mm + end[:, 2]
    u, v, along = (side - geometry.base @ axis for side, axis in zip((end[:, 0], end[:, 1], reach), frame, strict=True))
    turns = np.empty((3, *u.shape))
    turns[0] = end[:, 1] * along - reach * v
    turns[1] = reach * u - end[:, 0] * along
    turns[2] = end[:, 0] * v - end[:, 1] * u
    cosine = geometry.outer @ w
    motions = np.stack([sine * turns[0] + cosine * turns[2], turns[1], along])
    cofactors = np.stack([cross(motions[k - 2], motions[k - 1]) for k in range(3)])
    limbs = np.stack([u, v, along])
    limb_mm = np.sqrt(u * u + v * v + along * along)
    determinant = dot(motions[0], cofactors[0])
    return Parallel(frame, length_mm, sine, cosine, limbs, limb_mm, turns, motions, cofactors, determinant)


def axes(w: FloatArray, outer: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(3, 3, n) axes u, v, w of the platform from (3, n) unit w, and the (n,) sine between w and the outer axis."""
    frame = np.empty((3, *w.shape))
    across = cross(w, outer[:, None])
    sine = np.sqrt(dot(across, across))
    frame[1] = across / np.maximum(sine, _TINY)
    frame[0] = cross(frame[1], w)
    frame[2] = w
    return frame, sine


def dot(a: FloatArray, b: FloatArray) -> FloatArray:
    """Scalar products of vectors with components first."""
    return np.asarray(a[0] * b[0] + a[1] * b[1] + a[2] * b[2], dtype=np.float64)


def cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Vector products ``a x b`` of vectors with components first."""
    result = np.empty(np.broadcast_shapes(a.shape, b.shape))
    for k in range(3):
        i, j = (k + 1) % 3, (k + 2) % 3
        result[k] = a[i] * b[j] - a[j] * b[i]
    return result


def _joints(robot: HybridRobot, name: str, radius: str) -> FloatArray:
    """(3, 3) three joints, one a row, mm, base directions: as given, or 120 deg apart on their circle."""
    given: tuple[Vector, ...] | None = getattr(robot, name)
    if given is not None:
        return _vectors(name, given, 3)
    require_number(f"the robot's {radius}", getattr(robot, radius), "mm", above=0.0)
    angle = np.radians(robot.first_limb_deg + np.array([0.0, 120.0, 240.0]))
    return np.asarray(getattr(robot, radius) * np.stack([np.cos(angle), np.sin(angle), np.zeros(3)], axis=1))


def _vectors(name: str, value: tuple[Vector, ...], count: int = 1) -> FloatArray:
    array = np.asarray(value, dtype=np.float64)
    if array.shape != (count, 3) or not np.isfinite(array).all():
        raise ComputeError(f"the robot's {name} is {value}, it must be {count} x 3 finite numbers")
    return array


def _require_robot(robot: HybridRobot) -> None:
    for name in ("wrist_length_mm", "tool_length_mm", "workspace_radius_mm"):
        require_number(f"the robot's {name}", getattr(robot, name), "mm", above=0.0)
    shortest, longest = robot.stroke_mm
    require_number("the shortest limb allowed", shortest, "mm", above=0.0)
    require_number("the longest limb allowed", longest, "mm", above=shortest)
    lowest, highest = robot.workspace_height_mm
    require_number("the workspace's least height", lowest, "mm", above=-np.inf)
    require_number("the workspace's greatest height", highest, "mm", above=lowest)
    require_number("the robot's joint_height_mm", robot.joint_height_mm, "mm", above=-np.inf)
    for name in ("first_limb_deg", "c_zero_deg", "a_zero_deg"):
        require_number(f"the robot's {name}", getattr(robot, name), "deg", above=-np.inf)


# The hybrid robot's elastic numbers: the stiffness of each member alone (paper eq. 2-15).


class Beam(NamedTuple):
    """Compliance of the UP limb's end in the motions that it resists, ``C_c``, as multiples: see `BEAMS`."""

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


ELASTIC = (
    ("up_bending_n_mm2", "N mm^2"),
    ("up_torsion_n_mm2", "N mm^2"),
    ("a_stiffness_n_mm_per_rad", "N mm/rad"),
    ("c_stiffness_n_mm_per_rad", "N mm/rad"),
)
"""Keys and units of a robot's stiffnesses beside its limbs'."""


class Stiffnesses(NamedTuple):
    """The robot's elastic numbers, found positive; those of `ELASTIC` in their order."""

    beam: Beam
    bending_n_mm2: float
    torsion_n_mm2: float
    a_n_mm_per_rad: float
    c_n_mm_per_rad: float


def stiffnesses_of(robot: HybridRobot) -> Stiffnesses:
    """Raises ComputeError that names the first stiffness which is not above 0, with its value and unit."""
    return Stiffnesses(BEAMS[robot.beam], *(_positive(robot, name, unit) for name, unit in ELASTIC))


def limb_stiffness_n_per_mm(robot: HybridRobot, limb_mm: FloatArray) -> FloatArray:
    """Axial stiffness of limbs of these lengths, mm: constant, or EA / length (eq. 12: K_a); N/mm."""
    stiffness = _positive(robot, *limb_key(robot))
    return np.full_like(limb_mm, stiffness) if robot.limb_ea_n is None else np.asarray(stiffness / limb_mm)


def limb_key(robot: HybridRobot) -> tuple[str, str]:
    """Key and unit of what makes the limbs stiff."""
    return ("limb_stiffness_n_per_mm", "N/mm") if robot.limb_ea_n is None else ("limb_ea_n", "N")


def _positive(robot: HybridRobot, name: str, unit: str) -> float:
    value = getattr(robot, name)
    require_number(f"the robot's {name}", value, unit, above=0.0)
    return float(value)


# Where the hybrid robot can be: poses placed, and judged one fault after the other.

SINGULAR_DEG = 0.1
"""Nearer than this to A = 0 or 180 deg the wrist is singular: C is not defined, and neither is the A joint's line."""
DEPENDENT = 1e-6
"""Below this `Parallel.independence` locked limbs leave the platform loose."""
FLIP_DEG = 45.0
"""C turns by more than this between neighbours, and ..."""
HARDLY_DEG = 5.0
"""... the tool axis by less than this: then the wrist flips."""
SLACK_MM = 1e-6
"""A point on the workspace's rim is in it, however it was rounded."""


@dataclass(frozen=True, slots=True)
class RobotPoses:
    """The robot at n poses, components first; not judged yet."""

    tip_mm: FloatArray
    """(3, n) tool tip, base frame."""
    wrist_mm: FloatArray
    """(3, n) wrist centre P, base frame."""
    tool: FloatArray
    """(3, n) unit tool axis, from the tip into the spindle, along the platform's u, v, w."""
    parallel: Parallel

    @property
    def sine(self) -> FloatArray:
        """(n,) |sin A|."""
        return np.asarray(np.hypot(self.tool[0], self.tool[1]), dtype=np.float64)


class PoseFault(NamedTuple):
    """One way in which a pose cannot be taken: `refusal.refuse_where` takes it as it is."""

    bad: BoolArray
    value: FloatArray
    what: str
    unit: str
    limit: str


def require_poses(tip_mm: FloatArray, axis: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Both as (n, 3) float64; raises ComputeError where one is not finite, an axis not unit, or their counts differ."""
    tip, axis = require_vectors("tool tip", tip_mm, "mm"), require_unit_vectors("tool axis", axis)
    if tip.shape != axis.shape:
        raise ComputeError(f"{len(tip)} tool tips come with {len(axis)} tool axes")
    return tip, axis


def solve_pose(robot: HybridRobot, geometry: Geometry, tip: FloatArray, axis: FloatArray) -> RobotPoses:
    """The poses of (3, n) tool tips, mm, and unit tool axes, base frame; defined, if useless, wherever they lie."""
    wrist = tip + robot.tool_length_mm * axis
    distance = np.sqrt(dot(wrist, wrist))
    w = wrist / np.maximum(distance, np.finfo(np.float64).tiny)
    parallel = parallel_at(geometry, w, distance - robot.wrist_length_mm)
    return RobotPoses(tip, wrist, np.stack([dot(along, axis) for along in parallel.frame]), parallel)


def pose_faults(robot: HybridRobot, placed: RobotPoses) -> Iterator[PoseFault]:
    """Yield the faults of each single pose, the most basic first."""
    parallel, below = placed.parallel, placed.wrist_mm[2]
    yield PoseFault(
        below <= 0, below, "the wrist's height below the U joint", "mm", "out of the workspace: not above 0"
    )
    distance = parallel.length_mm + robot.wrist_length_mm
    limit = f"out of the workspace: nearer than the wrist is long ({robot.wrist_length_mm:g} mm)"
    yield PoseFault(parallel.length_mm <= 0, distance, "the wrist's distance from the U joint", "mm", limit)
    radius, height = np.hypot(placed.tip_mm[0], placed.tip_mm[1]), robot.joint_height_mm - placed.tip_mm[2]
    limit = f"out of the workspace: at most {robot.workspace_radius_mm:g} mm"
    yield PoseFault(radius > robot.workspace_radius_mm + SLACK_MM, radius, "the tip's radius", "mm", limit)
    low, high = robot.workspace_height_mm
    outside = (height < low - SLACK_MM) | (height > high + SLACK_MM)
    yield PoseFault(outside, height, "the tip's height", "mm", f"out of the workspace: {low:g} to {high:g} mm")
    sine, limit = parallel.sine, f"the U joint is singular below {PARALLEL:g}"
    yield PoseFault(sine < PARALLEL, sine, "the sine between the UP limb and the outer U axis", "", limit)
    spread, limit = parallel.independence, f"the parallel section is singular below {DEPENDENT:g}"
    yield PoseFault(spread < DEPENDENT, spread, "the independence of the limbs", "", limit)
    bend = np.degrees(np.arctan2(placed.sine, -placed.tool[2]))
    limit = f"singular within {SINGULAR_DEG:g} deg of 0 and 180"
    yield PoseFault(placed.sine < np.sin(np.radians(SINGULAR_DEG)), bend, "wrist |A|", "deg", limit)
    low, high = robot.stroke_mm
    shortest, longest = parallel.limb_mm.min(axis=0), parallel.limb_mm.max(axis=0)
    yield PoseFault(shortest < low, shortest, "the shortest limb", "mm", f"out of stroke {low:g} to {high:g} mm")
    yield PoseFault(longest > high, longest, "the longest limb", "mm", f"out of stroke {low:g} to {high:g} mm")


def wrist_flips(tool: FloatArray, axis: FloatArray) -> PoseFault:
    """Where the wrist flips on its way: C turns by over 45 deg from the point before, and the tool hardly turns.

    ``tool`` (2, n) or (3, n) is `Placed.tool`, ``axis`` (n, 3) the same in the base frame. Of the two wrist solutions
    C is taken to the nearer one, so a path straight through A = 0 is no flip.
    """
    u, v = tool[0], tool[1]
    sine, cosine = np.zeros((2, len(u)))
    sine[1:] = np.abs(u[:-1] * v[1:] - v[:-1] * u[1:])
    cosine[1:] = np.abs(u[:-1] * u[1:] + v[:-1] * v[1:])
    still = np.einsum("ni,ni->n", axis[1:], axis[:-1]) > np.cos(np.radians(HARDLY_DEG))
    bad = sine > np.tan(np.radians(FLIP_DEG)) * cosine
    bad[1:] &= still
    limit = f"a wrist flip: the tool axis turns by less than {HARDLY_DEG:g} deg"
    return PoseFault(bad, np.degrees(np.arctan2(sine, cosine)), "the turn of C from the point before", "deg", limit)


def refuse_unreachable(robot: HybridRobot, placed: RobotPoses) -> None:
    """Raise ComputeError for the first point that has the plainest fault found."""
    for fault in pose_faults(robot, placed):
        refuse_where(*fault)


def hybrid_reachable(robot: HybridRobot, tip_mm: FloatArray, axis: FloatArray) -> BoolArray:
    """(n,) True where `hybrid_tip_compliance_mm_per_n` accepts the single pose; arguments as there."""
    tip, axis = require_poses(tip_mm, axis)
    placed = solve_pose(robot, geometry_of(robot), tip.T, axis.T)
    bad = np.zeros(len(tip), dtype=np.bool_)
    for fault in pose_faults(robot, placed):
        bad |= fault.bad
    return ~bad


CHUNK = 4096
"""Poses worked on at once: what they need stays in the cache."""
SPRINGS = 8
"""Three limbs, the UP limb's three, C and A."""


def hybrid_tip_compliance_mm_per_n(
    robot: HybridRobot, tip_mm: FloatArray, axis: FloatArray, *, moment: Moment, path: bool
) -> FloatArray:
    """(n, 3, 3) mm/N, see `interface.tip_compliance_mm_per_n`; in memory the components come first."""
    tip, axis = require_poses(tip_mm, axis)
    geometry, elastic = geometry_of(robot), stiffnesses_of(robot)
    matrix, tool = np.empty((3, 3, len(tip))), np.empty((2, len(tip)))
    for start in range(0, len(tip), CHUNK):
        part = slice(start, start + CHUNK)
        placed = solve_pose(robot, geometry, np.ascontiguousarray(tip[part].T), np.ascontiguousarray(axis[part].T))
        if any(fault.bad.any() for fault in pose_faults(robot, placed)):
            refuse_unreachable(robot, solve_pose(robot, geometry, tip.T, axis.T))  # its message counts over all points
        matrix[:, :, part] = _compliance(robot, elastic, placed, moment)
        tool[:, part] = placed.tool[:2]
    if path:
        refuse_where(*wrist_flips(tool, axis))
    return matrix.transpose(2, 0, 1)


def hybrid_compliance_at(
    robot: HybridRobot, tip_mm: FloatArray, axis: FloatArray
) -> Callable[[HybridRobot], FloatArray]:
    """The function from a robot with other stiffnesses to its (n, 3, 3) compliances there; poses are solved once."""
    tip, axis = require_poses(tip_mm, axis)
    placed = solve_pose(robot, geometry_of(robot), tip.T, axis.T)
    refuse_unreachable(robot, placed)
    return lambda other: _compliance(other, stiffnesses_of(other), placed, "full").transpose(2, 0, 1)


def _compliance(robot: HybridRobot, elastic: Stiffnesses, placed: RobotPoses, moment: Moment) -> FloatArray:
    """(3, 3, n) in the base frame, mm/N."""
    turn, wrist = _screws(robot, elastic, placed)
    soft = _softness(robot, elastic, placed)
    tip = wrist - robot.tool_length_mm * cross(turn, placed.tool[:, None])
    pushed = tip if moment == "full" else wrist
    local = np.empty((3, 3, soft.shape[1]))
    for i, row in enumerate(soft * tip):
        for j, column in enumerate(pushed):
            local[i, j] = (row * column).sum(axis=0) if moment == "paper" or j >= i else local[j, i]
    matrix = _in_base(placed.parallel.frame, local)
    if moment == "full":  # to the last bit
        for i, j in ((1, 0), (2, 0), (2, 1)):
            matrix[i, j] = matrix[j, i]
    return matrix


def _screws(robot: HybridRobot, elastic: Stiffnesses, placed: RobotPoses) -> tuple[FloatArray, FloatArray]:
    """Turn, rad, and displacement of the wrist centre, mm: (3, 8, n), in the platform's frame, per unit of each spring.

    Springs 0 to 2: limbs (unit: growth of ``q^2 / 2``); 3 to 5: the UP limb (shear along u; along v, with the turn that
    it brings; torsion); 6 and 7: C and A (unit of A: 1 / sin A). In the UP limb's own frame n is (-e.w, 0, e.u): a
    constraint n.Omega = 1 is a turn about w by 1 / e.u, and the compliance C_c ties it to shear along v. Its square
    completed, the two are independent springs.
    """
    parallel = placed.parallel
    turn, wrist = np.zeros((2, 3, SPRINGS, parallel.limb_mm.shape[1]))
    twist = parallel.turns[2] / parallel.sine
    brought = -elastic.beam.cross / elastic.beam.shear * parallel.cosine / parallel.length_mm
    held = (parallel.limbs_mm[0], parallel.limbs_mm[1] + brought * twist, twist)
    free = np.empty((3, 6, turn.shape[2]))  # turn about e, turn about v, slide along w
    free[:, :3] = parallel.cofactors / parallel.determinant
    for k, growth in enumerate(held, start=3):
        for motion in free:
            motion[k] = -dot(motion, growth)
    turn[0, :6] = parallel.sine * free[0]
    turn[1, :6] = free[1]
    turn[2, :6] = parallel.cosine * free[0]
    turn[2, 4] += brought / parallel.sine
    turn[2, 5] += 1 / parallel.sine
    turn[2, 6] = 1
    turn[0, 7], turn[1, 7] = -placed.tool[1], placed.tool[0]
    distance = parallel.length_mm + robot.wrist_length_mm
    wrist[0, :6] = distance * turn[1, :6]
    wrist[1, :6] = -distance * turn[0, :6]
    wrist[2, :6] = free[2]
    wrist[0, 3] += 1
    wrist[1, 4] += 1
    return turn, wrist


def _softness(robot: HybridRobot, elastic: Stiffnesses, placed: RobotPoses) -> FloatArray:
    """(8, n) deflection of each spring per unit of its load: their units are those of `_screws`."""
    parallel, beam = placed.parallel, elastic.beam
    length, limb = parallel.length_mm, parallel.limb_mm
    soft = np.empty((SPRINGS, len(length)))
    soft[:3] = limb * limb / limb_stiffness_n_per_mm(robot, limb)
    soft[3] = soft[4] = beam.shear * length**3 / elastic.bending_n_mm2
    bending = (beam.turn - beam.cross**2 / beam.shear) / elastic.bending_n_mm2
    soft[5] = length * (bending * parallel.cosine**2 + parallel.sine**2 / elastic.torsion_n_mm2)
    soft[6] = 1 / elastic.c_n_mm_per_rad
    soft[7] = 1 / (elastic.a_n_mm_per_rad * placed.sine**2)
    return soft


def _in_base(frame: FloatArray, local: FloatArray) -> FloatArray:
    """(3, 3, n) matrices turned from the platform's frame, (3, 3, n) axis and component, into the base's."""
    half = [sum(local[i, j] * frame[j] for j in range(3)) for i in range(3)]
    return np.stack([sum(frame[i, k] * half[i] for i in range(3)) for k in range(3)])
