"""The stick figure has the lengths of the robot's parts at every pose, and ends at the tip."""

from __future__ import annotations

import numpy as np
import pytest

from polishd.model.errors import ComputeError
from polishd.model.process import MeasuredCompliance
from polishd.model.surface import FloatArray
from polishd.process.robot.hybrid import geometry_of, solve_pose
from polishd.process.robot.stick_figure import StickFigure, stick_figure, up_direction
from tests.unit.process.robot.arms import UR5, forward
from tests.unit.process.robot.hybrid_poses import CROOKED, ROBOT, inward

TIPS = np.array([[300.0, 220.0, 2315.0], [280.0, 168.0, 2315.0], [-150.0, 90.0, 2100.0]])


def length_mm(figure: StickFigure, a: str, b: str) -> FloatArray:
    places = [figure.joints_mm[:, figure.names.index(name)] for name in (a, b)]
    return np.asarray(np.linalg.norm(places[0] - places[1], axis=1))


@pytest.mark.parametrize("robot", [ROBOT, CROOKED])
def test_the_hybrid_robots_limbs_are_as_long_as_its_kinematics_say(robot: object) -> None:
    axis = inward(TIPS)
    figure = stick_figure(robot, TIPS, axis)  # type: ignore[arg-type]
    pose = solve_pose(robot, geometry_of(robot), TIPS.T, axis.T).parallel  # type: ignore[arg-type]
    for limb in range(3):
        assert length_mm(figure, f"base {limb + 1}", f"platform {limb + 1}") == pytest.approx(pose.limb_mm[limb])
    assert length_mm(figure, "U joint", "platform") == pytest.approx(pose.length_mm)
    assert length_mm(figure, "platform", "wrist") == pytest.approx(np.full(3, ROBOT.wrist_length_mm))
    assert length_mm(figure, "wrist", "tip") == pytest.approx(np.full(3, ROBOT.tool_length_mm))
    assert figure.joints_mm[:, -1] == pytest.approx(TIPS)
    assert {index for _, *ends in figure.links for index in ends} == set(range(len(figure.names)))
    assert up_direction(ROBOT) == (0.0, 0.0, -1.0), "it hangs"


def test_an_arms_links_keep_their_lengths() -> None:
    tip, axis = forward(
        UR5, np.radians([[0.0, -110.0, 110.0, -90.0, -90.0, 0.0], [10.0, -100.0, 105.0, -95.0, -85.0, 5.0]])
    )
    figure = stick_figure(UR5, tip, axis)
    assert figure.joints_mm[:, -1] == pytest.approx(tip, abs=1e-6)
    assert length_mm(figure, "flange", "tip") == pytest.approx([150.0, 150.0])
    assert length_mm(figure, "J2", "J3") == pytest.approx([425.0, 425.0])
    assert length_mm(figure, "J3", "J4") == pytest.approx([392.25, 392.25])
    assert up_direction(UR5) == (0.0, 0.0, 1.0)


def test_a_pose_out_of_reach_and_a_robot_without_kinematics_are_named() -> None:
    down = np.array([[0.0, 0.0, 1.0]])
    with pytest.raises(ComputeError, match="out of the workspace"):
        stick_figure(ROBOT, np.array([[300.0, 200.0, 9000.0]]), -down)
    with pytest.raises(ComputeError, match="no kinematics"):
        stick_figure(MeasuredCompliance(TIPS, np.ones(3)), TIPS, np.tile(down, (3, 1)))
