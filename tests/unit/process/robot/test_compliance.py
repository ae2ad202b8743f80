"""Equivalent compliance and depth ratio on matrices whose answer can be seen.

One call for every kind of robot: each answers with its own module's figures.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from polishd.model.errors import ComputeError
from polishd.model.process import HybridRobot, MeasuredCompliance, SerialRobot, ToolProcess
from polishd.model.surface import FloatArray
from polishd.process.robot.compliance import (
    complex_eigenvalues,
    compliance_jumps,
    depth_ratio,
    equivalent_compliance,
    measured_compliance,
    reachable,
    tip_compliance_mm_per_n,
)
from polishd.process.robot.serial import serial_tip_compliance_mm_per_n
from tests.unit.process.robot.arms import forward
from tests.unit.process.robot.hybrid_poses import random_poses

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
    assert compliance_jumps(linear, near).tolist() == [False, True, False]
    assert not compliance_jumps(equivalent_compliance(near, axis, normal, "quadratic"), near).any()


def test_a_robot_that_changes_as_much_is_no_jump() -> None:
    matrix = np.stack([SOFT[0], 1.5 * SOFT[0], SOFT[0]])
    assert not compliance_jumps(np.array([1.0, 1.5, 1.0]), matrix).any()
    assert compliance_jumps(np.array([1.0, 1.6, 1.0]), matrix).all()
    assert compliance_jumps(np.array([1.0]), matrix[:1]).shape == (0,)


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


@pytest.mark.parametrize(("soft", "by"), [(0.012, "0.149"), (np.nan, "nan")])
def test_nothing_left_of_the_depth_is_refused_with_the_point_and_the_values(soft: float, by: str) -> None:
    says = rf"point 1: the way that the robot gives is {by}\d* mm, the contact is only 0.14835 .*(12|nan) um/N at 12 N"
    with pytest.raises(ComputeError, match=says):
        depth_ratio(np.array([1e-3, soft]), ToolProcess(), 0.14835)


def test_a_dip_of_90_deg_is_refused() -> None:
    with pytest.raises(ComputeError, match="dip_deg is 90 deg"):
        depth_ratio(np.array([1e-3]), dataclasses.replace(ToolProcess(), dip_deg=90.0), 0.14835)


def by_lapack(matrix: FloatArray, axis: FloatArray, normal: FloatArray, squared: bool) -> FloatArray:
    """Eq. 43 as it reads, from LAPACK's eigenvectors."""
    values, vectors = np.linalg.eigh(matrix)
    skipped = np.abs(np.einsum("nij,ni->nj", vectors, axis)).argmax(axis=1)
    share = np.abs(np.einsum("nij,ni->nj", vectors, normal))
    kept = values * (share**2 if squared else share)
    kept[np.arange(len(kept)), skipped] = 0.0
    return np.asarray(kept.sum(axis=1))


def unit(vectors: FloatArray) -> FloatArray:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1)[:, None])


def random_case(seed: int, spread: FloatArray, lean: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Symmetric matrices with eigenvalues 1 + spread (n, 3), axes about an eigenvector, normals about the axes."""
    rng = np.random.default_rng(seed)
    n = len(spread)
    turn = Rotation.random(n, random_state=seed).as_matrix()
    matrix = (turn * (1 + spread)[:, None, :]) @ turn.transpose(0, 2, 1)
    axis = unit(turn[:, :, 0] + lean * rng.standard_normal((n, 3)))
    return (matrix + matrix.transpose(0, 2, 1)) / 2, axis, unit(axis + 0.25 * rng.standard_normal((n, 3)))


@pytest.mark.parametrize("lean", [0.05, 0.3, 10.0])
def test_the_closed_form_agrees_with_lapack(lean: float) -> None:
    spread = np.random.default_rng(5).uniform(0, 5, (20000, 3))
    matrix, axis, normal = random_case(2, spread, lean)
    np.testing.assert_allclose(
        equivalent_compliance(matrix, axis, normal, "quadratic"), by_lapack(matrix, axis, normal, True), atol=1e-10
    )
    np.testing.assert_allclose(
        equivalent_compliance(matrix, axis, normal), by_lapack(matrix, axis, normal, False), atol=1e-7
    )


def test_near_degenerate_matrices_lose_no_digits() -> None:
    """Squares of the cosines do not depend on how LAPACK turns a pair, unless the axis is in it."""
    spread = 10 ** np.random.default_rng(6).uniform(-14, 0, (20000, 3))
    matrix, axis, normal = random_case(3, spread, 0.05)
    got = equivalent_compliance(matrix, axis, normal, "quadratic")
    np.testing.assert_allclose(got, by_lapack(matrix, axis, normal, True), atol=1e-9)


def test_what_lies_along_the_axis_gives_nothing() -> None:
    np.testing.assert_array_equal(equivalent_compliance(SOFT, AXIS, AXIS), [0.0])
    np.testing.assert_array_equal(equivalent_compliance(np.eye(3)[None], AXIS, AXIS), [0.0])
    assert equivalent_compliance(np.zeros((0, 3, 3)), np.zeros((0, 3)), np.zeros((0, 3))).shape == (0,)


def test_a_matrix_that_is_not_symmetric_is_projected_by_its_own_eigenvectors() -> None:
    oblique = unit(np.array([[1.0, 0.0, 0.0], [0.6, 0.8, 0.0], [0.1, 0.0, 1.0]])).T
    matrix = (oblique @ np.diag([3.0, 2.0, 1.0]) @ np.linalg.inv(oblique))[None]
    normal = unit(np.array([[0.3, 0.2, 1.0]]))
    want = 3 * abs(oblique[:, 0] @ normal[0]) + 2 * abs(oblique[:, 1] @ normal[0])
    assert equivalent_compliance(matrix, AXIS, normal)[0] == pytest.approx(want)
    assert not complex_eigenvalues(matrix)[0]


def test_complex_eigenvalues_are_refused_and_counted() -> None:
    spiral = np.array([[1.0, -0.5, 0.0], [0.5, 1.0, 0.0], [0.0, 0.0, 2.0]])
    matrix = np.stack([SOFT[0], spiral, SOFT[0], spiral])
    np.testing.assert_array_equal(complex_eigenvalues(matrix), [False, True, False, True])
    with pytest.raises(ComputeError, match=r'point 1: with moment = "paper" .* 500 um/N, .*\(so at 2 of 4 points'):
        equivalent_compliance(matrix, np.tile(AXIS, (4, 1)), np.tile(AXIS, (4, 1)))


ARM = SerialRobot(
    dh=(
        (0.0, 90.0, 400.0, 0.0),
        (600.0, 0.0, 0.0, 0.0),
        (500.0, 0.0, 0.0, 0.0),
        (0.0, 90.0, 120.0, 0.0),
        (0.0, -90.0, 110.0, 0.0),
        (0.0, 0.0, 90.0, 0.0),
    ),
    joint_stiffness_n_mm_per_rad=(4e8, 4e8, 3e8, 1e8, 1e8, 1e8),
    joint_limits_deg=((-180.0, 180.0),) * 6,
    home_deg=(10.0, 60.0, -90.0, -60.0, -90.0, 20.0),
    tool_length_mm=150.0,
)
TABLE = MeasuredCompliance(
    np.array([[0.0, 0.0, 2000.0], [100.0, 0.0, 2000.0], [0.0, 100.0, 2000.0]]), np.array([1.2, 1.4, 1.3])
)


def test_a_serial_arm_answers_as_a_hybrid_robot_does() -> None:
    tip, axis = forward(ARM, np.radians([ARM.home_deg]))
    assert reachable(ARM, tip, axis).tolist() == [True]
    assert reachable(ARM, tip + 5000.0, axis).tolist() == [False]
    got = tip_compliance_mm_per_n(ARM, tip, axis, path=True)
    np.testing.assert_array_equal(got, serial_tip_compliance_mm_per_n(ARM, tip, axis, path=True))
    assert got.shape == (1, 3, 3)
    assert np.linalg.eigvalsh(got[0]).min() > 0


def test_equation_41_is_of_the_hybrid_robot_only() -> None:
    tip, axis = forward(ARM, np.radians([ARM.home_deg]))
    with pytest.raises(ComputeError, match=r'moment = "paper" is eq\. 41 of the hybrid robot'):
        tip_compliance_mm_per_n(ARM, tip, axis, moment="paper")


def test_a_table_reaches_what_it_covers() -> None:
    inside, outside = [20.0, 30.0, 2000.0], [80.0, 80.0, 2000.0]
    axis = np.tile([0.0, 0.0, -1.0], (2, 1))
    assert reachable(TABLE, np.array([inside, outside]), axis).tolist() == [True, False]
    np.testing.assert_allclose(measured_compliance(TABLE, np.array([inside])), [1.27e-3], rtol=1e-12)


def test_the_hybrid_robot_answers_for_many_points_in_one_layout() -> None:
    tip, axis = random_poses(50)
    matrix = tip_compliance_mm_per_n(HybridRobot(), tip, axis)
    assert matrix.shape == (50, 3, 3)
    assert matrix.dtype == np.float64
    assert matrix[:, 0, 0].flags.c_contiguous  # what follows works on components
