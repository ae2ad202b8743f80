"""Where the hybrid robot can be: poses placed, and judged one fault after the other."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from polishd.model.errors import ComputeError
from polishd.model.robot import HybridRobot
from polishd.model.surface import BoolArray, FloatArray
from polishd.process.robot.parallel import PARALLEL, Geometry, Parallel, dot, geometry_of, parallel_at
from polishd.process.robot.refusal import refuse_where, require_unit_vectors, require_vectors

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


def place(robot: HybridRobot, geometry: Geometry, tip: FloatArray, axis: FloatArray) -> RobotPoses:
    """The poses of (3, n) tool tips, mm, and unit tool axes, base frame; defined, if useless, wherever they lie."""
    wrist = tip + robot.tool_length_mm * axis
    distance = np.sqrt(dot(wrist, wrist))
    w = wrist / np.maximum(distance, np.finfo(np.float64).tiny)
    parallel = parallel_at(geometry, w, distance - robot.wrist_length_mm)
    return RobotPoses(tip, wrist, np.stack([dot(along, axis) for along in parallel.frame]), parallel)


def faults(robot: HybridRobot, placed: RobotPoses) -> Iterator[PoseFault]:
    """What can be wrong with each pose by itself, the plainest first."""
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


def flip(tool: FloatArray, axis: FloatArray) -> PoseFault:
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
    for fault in faults(robot, placed):
        refuse_where(*fault)


def hybrid_reachable(robot: HybridRobot, tip_mm: FloatArray, axis: FloatArray) -> BoolArray:
    """(n,) True where `hybrid_tip_compliance_mm_per_n` would accept the pose by itself; arguments as there."""
    tip, axis = require_poses(tip_mm, axis)
    placed = place(robot, geometry_of(robot), tip.T, axis.T)
    bad = np.zeros(len(tip), dtype=np.bool_)
    for fault in faults(robot, placed):
        bad |= fault.bad
    return ~bad
