"""Arms of the example cells: their rows bring the flange to where a public model of the arm does."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from polishd.config.cell import load_config
from polishd.model.process import SerialRobot
from tests.system.sim_rig import ROOT
from tests.unit.process.robot.arms import forward

IRB_4600 = (
    ((0.0, 0.0, 495.0), "z"),
    ((175.0, 0.0, 0.0), "y"),
    ((0.0, 0.0, 1095.0), "y"),
    ((0.0, 0.0, 175.0), "x"),
    ((1270.0, 0.0, 0.0), "y"),
    ((135.0, 0.0, 0.0), "x"),
)
"""Origin, mm, and axis of each joint in the frame before: irb4600_40_255_macro.xacro of ros-industrial/abb."""
LIMITS_DEG = ((-180, 180), (-90, 150), (-180, 75), (-400, 400), (-125, 120), (-400, 400))


def flange(joints_deg: np.ndarray) -> tuple[np.ndarray, Rotation]:
    """Position, mm, and orientation of ``tool0``, whose z leaves the flange."""
    at, turned = np.zeros(3), Rotation.identity()
    for (origin, axis), angle in zip(IRB_4600, joints_deg, strict=True):
        at = at + turned.apply(origin)
        turned *= Rotation.from_euler(axis, angle, degrees=True)
    return at, turned * Rotation.from_euler("y", 90, degrees=True)


def test_the_abb_example_has_the_rows_and_limits_of_its_arm() -> None:
    robot = load_config(ROOT / "examples/abb_cell.toml").robot_model()
    assert isinstance(robot, SerialRobot)
    assert tuple(tuple(limit) for limit in robot.joint_limits_deg) == LIMITS_DEG
    for joints in np.random.default_rng(4).uniform(-60.0, 60.0, (20, 6)):
        at, turned = flange(joints)
        (tip,), (axis,) = forward(robot, np.radians(joints[None]))
        out = turned.apply([0.0, 0.0, 1.0])
        assert tip == pytest.approx(at + robot.tool_length_mm * out, abs=1e-6)
        assert axis == pytest.approx(-out, abs=1e-9), "from the tip into the spindle"
