"""The chain of joints that Denavit-Hartenberg rows describe.

A standard row is ``Rz(theta) Tz(d) Tx(a) Rx(alpha)``: the link follows its joint. A modified row (Craig) is
``Rx(alpha) Tx(a) Rz(theta) Tz(d)``: the link comes before. The base frame is that of the rows.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from polishd.model.errors import ComputeError
from polishd.model.robot import SerialRobot
from polishd.model.surface import FloatArray
from polishd.process.robot.refusal import require_number

JOINTS = 6


@dataclass(frozen=True, slots=True)
class Chain:
    """Where the arm's joints and its tip are, base frame, mm."""

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
