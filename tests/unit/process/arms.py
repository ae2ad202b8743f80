"""A six-axis arm for tests, and where its joints bring its tool."""

from __future__ import annotations

import numpy as np

from polishd.model.robot import SerialRobot
from polishd.model.surface import FloatArray
from polishd.process.robot.dh_chain import chain

UR5 = SerialRobot(
    dh=(
        (0.0, 90.0, 89.159, 0.0),
        (-425.0, 0.0, 0.0, 0.0),
        (-392.25, 0.0, 0.0, 0.0),
        (0.0, 90.0, 109.15, 0.0),
        (0.0, -90.0, 94.65, 0.0),
        (0.0, 0.0, 82.3, 0.0),
    ),
    joint_stiffness_n_mm_per_rad=(4.1e7, 3.8e7, 2.9e7, 1.1e7, 1.0e7, 0.9e7),
    joint_limits_deg=((-360.0, 360.0),) * 6,
    home_deg=(0.0, -110.0, 110.0, -90.0, -90.0, 0.0),
    tool_length_mm=150.0,
)
"""Rows as Universal Robots publishes them; the flange points down at home."""


def forward(robot: SerialRobot, joints_rad: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Tool tips (n, 3) mm and unit tool axes (n, 3) of (n, 6) joint angles."""
    at = chain(robot, np.asarray(joints_rad))
    return at.tip_mm, at.axis
