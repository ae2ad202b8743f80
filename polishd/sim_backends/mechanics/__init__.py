"""The simulated robots' own mechanics: where they can be, and how far their tip gives way under a force.

Written from statics, apart from the controller's (`process.robot`), which works from motions: here each unit force at
the tip is followed through the members that carry it, and what each of them stores is summed (virtual work). Tests hold
the two to each other. Units: mm, N, rad; the base frame is that of `model.robot`.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from polishd.model.robot import HybridRobot, SerialRobot
from polishd.model.surface import BoolArray, FloatArray
from polishd.sim_backends.mechanics import hybrid, serial


def reached(robot: HybridRobot | SerialRobot, tip_mm: FloatArray, axis: FloatArray) -> BoolArray:
    """(n,) whether the robot can be there: tips (n, 3) mm, unit tool axes (n, 3) from the tip into the spindle."""
    if isinstance(robot, HybridRobot):
        return hybrid.solve_hybrid_poses(robot, tip_mm, axis).reached
    return serial.solve_serial_poses(robot, tip_mm, axis).reached


KEPT = 16
"""Poses of the last ones that were reached."""


@dataclass(slots=True)
class Reaching:
    """A controller that is shown one part of a path after the other: it leads an arm on from where it was led last."""

    robot: HybridRobot | SerialRobot
    _known: serial.Known | None = field(default=None, init=False)

    def reached(self, tip_mm: FloatArray, axis: FloatArray) -> BoolArray:
        """As `reached`."""
        if isinstance(self.robot, HybridRobot) or not len(tip_mm):
            return reached(self.robot, tip_mm, axis)
        at = serial.solve_serial_poses(self.robot, tip_mm, axis, self._known)
        kept = at.reached.nonzero()[0][:: -max(len(tip_mm) // KEPT, 1)]
        if len(kept):
            self._known = serial.Known(tip_mm[kept], axis[kept], at.joints[kept])
        return at.reached


def tip_gives_mm_per_n(
    robot: HybridRobot | SerialRobot, tip_mm: FloatArray, axis: FloatArray
) -> tuple[BoolArray, FloatArray]:
    """Whether the robot can be there (n,), and displacement of the tip per force (n, 3, 3), mm/N; 0 where it cannot.

    Arguments as of `reached`.
    """
    if isinstance(robot, HybridRobot):
        at = hybrid.solve_hybrid_poses(robot, tip_mm, axis)
        return at.reached, hybrid.hybrid_compliance_mm_per_n(robot, at)
    arm = serial.solve_serial_poses(robot, tip_mm, axis)
    return arm.reached, serial.serial_compliance_mm_per_n(robot, arm)
