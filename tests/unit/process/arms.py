"""A six-axis arm for tests."""

from __future__ import annotations

from polishd.model.robot import SerialRobot

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
