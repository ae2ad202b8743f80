"""One interface to the robots that a cell can have."""

from __future__ import annotations

from polishd.model.errors import ComputeError
from polishd.model.process import Moment
from polishd.model.robot import HybridRobot, RobotModel, SerialRobot
from polishd.model.surface import BoolArray, FloatArray
from polishd.process.robot.compliance import hybrid_tip_compliance_mm_per_n
from polishd.process.robot.measured import measured_reachable
from polishd.process.robot.serial import serial_reachable, serial_tip_compliance_mm_per_n
from polishd.process.robot.workspace import hybrid_reachable


def tip_compliance_mm_per_n(
    robot: HybridRobot | SerialRobot,
    tip_mm: FloatArray,
    axis: FloatArray,
    *,
    moment: Moment = "full",
    path: bool = False,
) -> FloatArray:
    """(n, 3, 3) displacement of the tip per force, mm/N, base frame.

    ``moment="full"``: the translational block of eq. 39 at the tip, with the moment of the force about the wrist (which
    eq. 41 drops); symmetric positive definite. ``"paper"`` (hybrid only): eq. 41 as printed, the force acting at the
    wrist centre; not symmetric, and without the wrist joints' share. ``tip_mm`` (n, 3) mm and ``axis`` (n, 3) unit,
    from the tip into the spindle, base frame. Raises ComputeError that names the first pose which cannot be taken;
    with ``path`` the poses follow one another, and a change of the wrist's or the arm's branch is refused too.
    """
    if isinstance(robot, HybridRobot):
        return hybrid_tip_compliance_mm_per_n(robot, tip_mm, axis, moment=moment, path=path)
    if moment == "paper":
        raise ComputeError('moment = "paper" is eq. 41 of the hybrid robot: for a serial arm it must be "full"')
    return serial_tip_compliance_mm_per_n(robot, tip_mm, axis, path=path)


def reachable(robot: RobotModel, tip_mm: FloatArray, axis: FloatArray) -> BoolArray:
    """(n,) True where the robot takes the pose by itself, or the table of a measured one covers it.

    Arguments as for `tip_compliance_mm_per_n`; raises ComputeError only for what is not a pose or not a robot.
    """
    if isinstance(robot, HybridRobot):
        return hybrid_reachable(robot, tip_mm, axis)
    if isinstance(robot, SerialRobot):
        return serial_reachable(robot, tip_mm, axis)
    return measured_reachable(robot, tip_mm)
