"""The robot as a stick figure: positions of its joints at poses, and the links between them, for pictures."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from polishd.model.errors import ComputeError
from polishd.model.process import HybridRobot, RobotModel, SerialRobot
from polishd.model.surface import FloatArray
from polishd.process.robot.hybrid import geometry_of, refuse_unreachable, require_poses, solve_pose
from polishd.process.robot.serial import JOINTS, chain, serial_inverse_kinematics

LinkKind = Literal["base", "arm", "limb", "platform", "tool"]
"""``base`` stands still; ``limb`` changes its length; ``tool`` ends at the tip."""


@dataclass(frozen=True, slots=True)
class StickFigure:
    """A robot at n poses, base frame."""

    names: tuple[str, ...]
    """(k,) of the joints."""
    links: tuple[tuple[LinkKind, int, int], ...]
    """Kind, and the joints at both ends."""
    joints_mm: FloatArray
    """(n, k, 3); the last joint is the tool's tip."""


def up_direction(robot: RobotModel) -> tuple[float, float, float]:
    """Unit vector, base frame, that points up in the hall. The hybrid robot hangs: its limbs extend along its z."""
    return (0.0, 0.0, -1.0) if isinstance(robot, HybridRobot) else (0.0, 0.0, 1.0)


def stick_figure(robot: RobotModel, tip_mm: FloatArray, axis: FloatArray) -> StickFigure:
    """Return the figure at (n, 3) tool tips (mm, base frame) with (n, 3) unit tool axes, from the tip into the spindle.

    Raises:
        ComputeError: names the first pose that the robot cannot take, or the robot has no kinematics.
    """
    if isinstance(robot, SerialRobot):
        return _serial_figure(robot, tip_mm, axis)
    if isinstance(robot, HybridRobot):
        return _hybrid_figure(robot, tip_mm, axis)
    raise ComputeError("the cell has a table of measured compliance (kinematics.type) and no kinematics")


def _serial_figure(robot: SerialRobot, tip_mm: FloatArray, axis: FloatArray) -> StickFigure:
    """The frames' origins of the Denavit-Hartenberg rows from the base to the flange, and the tip."""
    at = chain(robot, serial_inverse_kinematics(robot, tip_mm, axis))
    base = np.zeros((len(tip_mm), 1, 3))
    flange = at.tip_mm - robot.tool_length_mm * at.flange[:, :, 2]
    joints = np.concatenate([base, at.places, flange[:, None], at.tip_mm[:, None]], axis=1)
    names = ("base", *(f"J{number}" for number in range(1, JOINTS + 1)), "flange", "tip")
    arm: list[tuple[LinkKind, int, int]] = [("arm", k, k + 1) for k in range(JOINTS + 1)]
    return StickFigure(names, (*arm, ("tool", JOINTS + 1, JOINTS + 2)), joints)


def _hybrid_figure(robot: HybridRobot, tip_mm: FloatArray, axis: FloatArray) -> StickFigure:
    """Both ends of the three limbs, the UP limb from the U joint to the platform's center, the wrist, and the tip."""
    tip, axis = require_poses(tip_mm, axis)
    geometry = geometry_of(robot)
    placed = solve_pose(robot, geometry, tip.T, axis.T)
    refuse_unreachable(robot, placed)
    frame = placed.parallel.frame
    center = placed.parallel.length_mm * frame[2]
    base = np.broadcast_to(geometry.base, (len(tip), 3, 3))
    ends = np.einsum("ik,kcn->nic", geometry.platform, frame) + center.T[:, None]
    single = [point.T[:, None] for point in (np.zeros_like(center), center, placed.wrist_mm, placed.tip_mm)]
    names = ("U joint", *(f"base {i}" for i in "123"), *(f"platform {i}" for i in "123"), "platform", "wrist", "tip")
    links: list[tuple[LinkKind, int, int]] = []
    for i in range(3):
        links += [("base", 1 + i, 1 + (i + 1) % 3), ("base", 0, 1 + i), ("limb", 1 + i, 4 + i)]
        links += [("platform", 4 + i, 4 + (i + 1) % 3), ("platform", 7, 4 + i)]
    links += [("arm", 0, 7), ("arm", 7, 8), ("tool", 8, 9)]
    return StickFigure(names, tuple(links), np.concatenate([single[0], base, ends, *single[1:]], axis=1))
