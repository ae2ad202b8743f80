"""What the hybrid robot refuses: each fault by its point, value and unit, alike wherever the poses are asked about."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from polishd.model.errors import ComputeError
from polishd.model.process import HybridRobot
from polishd.model.surface import FloatArray
from polishd.process.robot import hybrid
from polishd.process.robot.compliance import reachable, tip_compliance_mm_per_n
from tests.unit.process.robot.hybrid_poses import CROOKED, DIP, ROBOT, inward, random_poses

LEAN = [0.0, -np.sin(DIP), -np.cos(DIP)]
STRAIGHT = [0.0, 0.0, -1.0]
SHORT = dataclasses.replace(ROBOT, stroke_mm=(1200.0, 1750.0))
LOW = dataclasses.replace(ROBOT, joint_height_mm=2500.0)
STEEP = dataclasses.replace(ROBOT, outer_axis=(0.0, 1.0, 4.0))
LOOSE = dataclasses.replace(ROBOT, base_joints_mm=((200.0, 0.0, 0.0), (100.0, 0.0, 0.0), (-150.0, 0.0, 0.0)))
"""No limb can turn the platform about the outer axis."""

FAULTS = [
    (ROBOT, [0.0, 640.0, 2330.0], LEAN, "longest limb is .* mm, out of stroke 950 to 1750 mm"),
    (SHORT, [0.0, 640.0, 1630.0], LEAN, "shortest limb is .* mm, out of stroke 1200 to 1750 mm"),
    (ROBOT, [0.0, 661.0, 1700.0], LEAN, "tip's radius is 661 mm, out of the workspace: at most 660 mm"),
    (ROBOT, [0.0, 100.0, 2336.0], LEAN, "tip's height is 199 mm, out of the workspace: 200 to 910 mm"),
    (ROBOT, [0.0, 100.0, 1624.5], LEAN, "tip's height is 910.5 mm, out of the workspace: 200 to 910 mm"),
    (LOW, [0.0, 100.0, 2320.0], LEAN, "tip's height is 180 mm, out of the workspace: 200 to 910 mm"),
    (ROBOT, [0.0, 0.0, 2000.0], STRAIGHT, r"wrist \|A\| is 0 deg, singular within 0.1 deg of 0 and 180"),
    (ROBOT, [0.0, 0.0, 2000.0], [0.0, 1e-3, -np.sqrt(1 - 1e-6)], r"wrist \|A\| is 0.0\d+ deg, singular"),
    (ROBOT, [0.0, 0.0, 1625.0], [0.0, 0.0, 1.0], r"wrist \|A\| is 180 deg, singular"),
    (ROBOT, [0.0, 0.0, -500.0], STRAIGHT, "height below the U joint is -920 mm, out of the workspace"),
    (ROBOT, [0.0, 0.0, 600.0], STRAIGHT, "distance from the U joint is 180 mm, out of the workspace"),
    (ROBOT, [0.0, 0.0, 420.0], STRAIGHT, "height below the U joint is 0 mm, out of the workspace"),
    (STEEP, [0.0, 450.0, 2220.0], STRAIGHT, "outer U axis is .*, the U joint is singular below 1e-06"),
    (LOOSE, [0.0, 100.0, 2300.0], LEAN, "independence of the limbs is .*, the parallel section is singular"),
    (ROBOT, [np.nan, 0.0, 2000.0], STRAIGHT, "tool tip is nan mm, it must be finite"),
    (ROBOT, [0.0, 0.0, np.inf], STRAIGHT, "tool tip is inf mm, it must be finite"),
    (ROBOT, [0.0, 0.0, 2000.0], [0.0, 0.0, -1.1], "length of tool axis is 1.1"),
]


@pytest.mark.parametrize(("robot", "tip", "axis", "says"), FAULTS)
def test_a_refusal_names_the_point_the_value_and_the_unit(
    robot: HybridRobot, tip: list[float], axis: list[float], says: str
) -> None:
    tips, axes = random_poses(2, robot)
    with pytest.raises(ComputeError, match=f"point {len(tips)}: .*{says}"):
        tip_compliance_mm_per_n(robot, np.vstack([tips, [tip]]), np.vstack([axes, [axis]]))


def test_reachable_says_no_where_the_inverse_refuses() -> None:
    for robot, tip, axis, _ in FAULTS[:14]:
        tips, axes = random_poses(2, robot)
        answer = reachable(robot, np.vstack([tips, [tip]]), np.vstack([axes, [axis]]))
        assert answer.tolist() == [True] * len(tips) + [False]


@pytest.mark.full
@pytest.mark.parametrize("robot", [ROBOT, CROOKED, SHORT])
def test_reachable_and_inverse_never_differ(robot: HybridRobot) -> None:
    rng = np.random.default_rng(3)
    tip = rng.uniform([-800, -800, 1500], [800, 800, 2450], (300, 3))
    axis = inward(tip)
    reach = reachable(robot, tip, axis)
    assert 50 < reach.sum() < 250
    for k, can in enumerate(reach):
        try:
            tip_compliance_mm_per_n(robot, tip[k : k + 1], axis[k : k + 1])
        except ComputeError:
            assert not can
        else:
            assert can


def test_the_rim_of_the_workspace_belongs_to_it() -> None:
    angle = np.linspace(0, 2 * np.pi, 1000)
    for height in (700.0, 910.0):
        tip = np.stack([660 * np.cos(angle), 660 * np.sin(angle), np.full(1000, 2535 - height)], axis=1)
        assert reachable(ROBOT, tip, inward(tip)).all()
        assert not reachable(ROBOT, tip - np.array([0, 0, 211]), inward(tip)).any()
        assert not reachable(ROBOT, tip * [1.0001, 1.0001, 1], inward(tip)).any()


def swing(lean_deg: float, way_deg: FloatArray) -> tuple[FloatArray, FloatArray]:
    """A tool that stands on the base's z axis and leans the ways given."""
    lean, way = np.radians(lean_deg), np.radians(way_deg)
    axis = np.stack([np.sin(lean) * np.cos(way), np.sin(lean) * np.sin(way), -np.cos(lean) + 0 * way], axis=1)
    return np.tile([0.0, 0.0, 2000.0], (len(way), 1)), axis


@pytest.mark.parametrize("chunk", [2, 3, 4096])
def test_a_wrist_flip_is_refused_along_a_path_only(chunk: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(hybrid, "CHUNK", chunk)
    tip, axis = swing(1.0, np.array([0.0, 40.0, 80.0, 126.0, 130.0]))
    tip_compliance_mm_per_n(ROBOT, tip, axis)
    says = r"point 3: the turn of C from the point before is 45.999\d deg, a wrist flip: the tool axis turns by less"
    with pytest.raises(ComputeError, match=says):
        tip_compliance_mm_per_n(ROBOT, tip, axis, path=True)


def test_c_may_turn_with_the_tool() -> None:
    for path in (
        swing(15.0, np.array([0.0, 90.0, 0.0])),  # a raster line that passes the base's z axis, leaning inward
        swing(1.0, np.arange(0.0, 720.0, 44.0)),
        swing(1.0, np.array([0.0, 180.0, 0.0])),  # straight through A = 0
        swing(1.0, np.array([0.0, 170.0, 0.0])),  # as good as straight
    ):
        tip_compliance_mm_per_n(ROBOT, *path, path=True)


def test_but_standing_at_zero_is_singular() -> None:
    tip, axis = swing(1.0, np.array([0.0, 0.0, 180.0]))
    axis[1] = [0.0, 0.0, -1.0]
    with pytest.raises(ComputeError, match=r"point 1: wrist \|A\| is 0 deg"):
        tip_compliance_mm_per_n(ROBOT, tip, axis, path=True)


def test_shapes_that_cannot_be_are_refused() -> None:
    tip, axis = random_poses(1)
    for ask in (reachable, tip_compliance_mm_per_n):
        with pytest.raises(ComputeError, match=r"shape \(3,\), it must be \(n, 3\) in mm"):
            ask(ROBOT, tip[0], axis)
        with pytest.raises(ComputeError, match="1 tool tips come with 2 tool axes"):
            ask(ROBOT, tip, np.vstack([axis, axis]))


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"stroke_mm": (950.0, 900.0)}, "longest limb allowed is 900 mm, it must be above 950"),
        ({"stroke_mm": (-1.0, 900.0)}, "shortest limb allowed is -1 mm, it must be above 0"),
        ({"tool_length_mm": -1.0}, "tool_length_mm is -1 mm, it must be above 0"),
        ({"wrist_length_mm": 0.0}, "wrist_length_mm is 0 mm, it must be above 0"),
        ({"base_radius_mm": -250.0}, "base_radius_mm is -250 mm, it must be above 0"),
        ({"platform_radius_mm": np.nan}, "platform_radius_mm is nan mm, it must be above 0"),
        ({"workspace_radius_mm": 0.0}, "workspace_radius_mm is 0 mm, it must be above 0"),
        ({"workspace_height_mm": (910.0, 200.0)}, "greatest height is 200 mm, it must be above 910"),
        ({"workspace_height_mm": (np.nan, 200.0)}, "least height is nan mm, it must be finite"),
        ({"joint_height_mm": np.inf}, "joint_height_mm is inf mm, it must be finite"),
        ({"first_limb_deg": np.nan}, "first_limb_deg is nan deg, it must be finite"),
        ({"c_zero_deg": np.inf}, "c_zero_deg is inf deg, it must be finite"),
        ({"outer_axis": (0.0, 0.0, -2.0)}, r"outer_axis is \(0.0, 0.0, -2.0\), it must not be parallel to z, nor 0"),
        ({"outer_axis": (0.0, 0.0, 0.0)}, "it must not be parallel to z, nor 0"),
        ({"outer_axis": (np.nan, 0.0, 0.0)}, "outer_axis is .*, it must be 1 x 3 finite numbers"),
        ({"base_joints_mm": ((1.0, 2.0, 3.0), (1.0, 2.0, 3.0))}, "base_joints_mm is .*, it must be 3 x 3 finite"),
        ({"platform_joints_mm": ((1.0, 2.0, np.inf),) * 3}, "platform_joints_mm is .*, it must be 3 x 3 finite"),
    ],
)
def test_robots_that_cannot_be_are_refused(changes: dict[str, Any], says: str) -> None:
    tip, axis = random_poses(1)
    for ask in (reachable, tip_compliance_mm_per_n):
        with pytest.raises(ComputeError, match=says):
            ask(dataclasses.replace(ROBOT, **changes), tip, axis)
