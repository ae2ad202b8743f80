"""Equivalent compliance and depth ratio on matrices whose answer can be seen."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from polishd.model.errors import ComputeError
from polishd.model.process import HybridRobot, ToolProcess
from polishd.process.compliance import depth_ratio, equivalent_compliance, jumps
from polishd.process.robot import tip_compliance_mm_per_n

DIP = np.radians(15.0)
AXIS = np.array([[0.0, 0.0, 1.0]])
SOFT = np.diag([1e-3, 3e-3, 2e-3])[None]


def test_the_direction_of_the_tool_axis_does_not_count() -> None:
    normal = np.array([[0.6, 0.0, 0.8]])
    assert equivalent_compliance(SOFT, AXIS, normal)[0] == pytest.approx(0.6e-3)
    assert equivalent_compliance(SOFT, AXIS, normal, "quadratic")[0] == pytest.approx(0.36e-3)
    assert equivalent_compliance(SOFT, AXIS, normal, "normal")[0] == pytest.approx(0.36e-3 + 0.64 * 2e-3)


def test_linear_adds_magnitudes_whatever_the_sign_of_an_eigenvector() -> None:
    for signs in ([1, 1], [-1, 1], [-1, -1]):
        normal = np.array([[0.48 * signs[0], 0.36 * signs[1], 0.8]])
        assert equivalent_compliance(SOFT, AXIS, normal)[0] == pytest.approx(0.48e-3 + 3 * 0.36e-3)


@pytest.mark.parametrize("projection", ["linear", "quadratic", "normal"])
def test_turning_everything_together_changes_nothing(projection: str) -> None:
    turns = Rotation.random(50, random_state=1).as_matrix()
    axis, normal = np.array([0.1, -0.2, np.sqrt(0.95)]), np.array([0.48, 0.36, 0.8])
    want = equivalent_compliance(SOFT, axis[None], normal[None], projection)[0]
    got = equivalent_compliance(turns @ SOFT[0] @ turns.transpose(0, 2, 1), turns @ axis, turns @ normal, projection)
    np.testing.assert_allclose(got, want, rtol=1e-12)


def test_a_softest_direction_along_the_axis_is_left_out_too() -> None:
    matrix = np.diag([1e-3, 2e-3, 9e-3])[None]
    assert equivalent_compliance(matrix, AXIS, np.array([[0.6, 0.0, 0.8]]))[0] == pytest.approx(0.6e-3)


def test_where_two_eigenvalues_meet_linear_jumps_and_says_so() -> None:
    normal = np.tile([np.sin(DIP), 0.0, np.cos(DIP)], (4, 1))
    axis = np.tile(AXIS, (4, 1))
    near = np.stack([np.diag([2.0, 2.01, 5.0])] * 4)
    quarter = Rotation.from_euler("Z", 45, degrees=True).as_matrix()
    near[2:] = quarter @ near[2:] @ quarter.T
    linear = equivalent_compliance(near, axis, normal)
    assert linear[2] / linear[1] == pytest.approx(np.sqrt(2), abs=0.01)
    assert jumps(linear, near).tolist() == [False, True, False]
    assert not jumps(equivalent_compliance(near, axis, normal, "quadratic"), near).any()


def test_a_robot_that_changes_as_much_is_no_jump() -> None:
    matrix = np.stack([SOFT[0], 1.5 * SOFT[0], SOFT[0]])
    assert not jumps(np.array([1.0, 1.5, 1.0]), matrix).any()
    assert jumps(np.array([1.0, 1.6, 1.0]), matrix).all()
    assert jumps(np.array([1.0]), matrix[:1]).shape == (0,)


def test_depth_ratio_at_the_figures_of_the_paper() -> None:
    gamma = depth_ratio(np.array([1.04e-3, 1.97e-3]), ToolProcess(), 0.14835)
    np.testing.assert_allclose(gamma, [0.913, 0.835], atol=5e-4)


def test_depth_ratio_of_the_shipped_robot_over_its_workspace() -> None:
    angle = np.linspace(0, 2 * np.pi, 12, endpoint=False)
    ratios = []
    for radius, height in ((0.001, 500.0), (200.0, 300.0), (400.0, 550.0), (640.0, 550.0)):
        tip = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.full(12, 2535 - height)], axis=1)
        lean = -tip[:, :2] / radius * np.sin(DIP)
        axis = np.column_stack([lean, np.full(12, -np.cos(DIP))])
        matrix = tip_compliance_mm_per_n(HybridRobot(), tip, axis)
        ratios.append(depth_ratio(equivalent_compliance(matrix, axis, np.tile(-AXIS, (12, 1))), ToolProcess(), 0.14835))
    assert 0.83 < np.min(ratios) < 0.86
    assert 0.90 < np.max(ratios) < 0.92


def test_the_offset_grows_with_force_and_with_the_dip() -> None:
    process = ToolProcess()
    lost = 1 - depth_ratio(np.array([1e-3]), process, 0.15)
    twice = 1 - depth_ratio(np.array([1e-3]), dataclasses.replace(process, force_n=24.0), 0.15)
    steep = 1 - depth_ratio(np.array([1e-3]), dataclasses.replace(process, dip_deg=60.0), 0.15)
    assert twice[0] / lost[0] == pytest.approx(2.0)
    assert steep[0] / lost[0] == pytest.approx(2 * np.cos(DIP))
    assert depth_ratio(np.zeros(1), process, 0.15)[0] == 1.0


@pytest.mark.parametrize("soft", [0.012, np.nan])
def test_nothing_left_of_the_depth_is_refused_with_the_point_and_the_values(soft: float) -> None:
    with pytest.raises(ComputeError, match=r"point 1: .*compliance is (12|nan) um/N, at 12 N takes all .*0.14835 mm"):
        depth_ratio(np.array([1e-3, soft]), ToolProcess(), 0.14835)
