"""Compliance of the hybrid robot at the tool tip in closed form, for programs of any length (paper eq. 2-15, 39-41).

Three limbs, three motions that the UP limb resists and two wrist joints are eight springs in series: with all but one
rigid the mechanism has one freedom, in which the tip moves by m per unit of that spring's deflection, and the
compliance is the sum of m m' / k. Each m follows from a 3 x 3 inverse, since the UP limb leaves the platform three
motions only. The tests hold it to the paper's 6 x 6 matrices, equation by equation.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from polishd.model.process import Moment
from polishd.model.robot import HybridRobot
from polishd.model.surface import FloatArray
from polishd.process.robot.parallel import cross, dot, geometry_of
from polishd.process.robot.refusal import refuse_where
from polishd.process.robot.stiffness import Stiffnesses, limb_stiffness_n_per_mm, stiffnesses_of
from polishd.process.robot.workspace import RobotPoses, faults, flip, place, refuse_unreachable, require_poses

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
        placed = place(robot, geometry, np.ascontiguousarray(tip[part].T), np.ascontiguousarray(axis[part].T))
        if any(fault.bad.any() for fault in faults(robot, placed)):
            refuse_unreachable(robot, place(robot, geometry, tip.T, axis.T))  # its message counts over all points
        matrix[:, :, part] = _compliance(robot, elastic, placed, moment)
        tool[:, part] = placed.tool[:2]
    if path:
        refuse_where(*flip(tool, axis))
    return matrix.transpose(2, 0, 1)


def hybrid_compliance_at(
    robot: HybridRobot, tip_mm: FloatArray, axis: FloatArray
) -> Callable[[HybridRobot], FloatArray]:
    """The function from a robot with other stiffnesses to its (n, 3, 3) compliances there; poses are solved once."""
    tip, axis = require_poses(tip_mm, axis)
    placed = place(robot, geometry_of(robot), tip.T, axis.T)
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
