"""One call for every kind of robot: each answers with its own module's figures."""

from __future__ import annotations

import numpy as np
import pytest

from polishd.model.errors import ComputeError
from polishd.model.process import HybridRobot, MeasuredCompliance, SerialRobot
from polishd.process.robot.compliance import measured_compliance, reachable, tip_compliance_mm_per_n
from polishd.process.robot.serial import serial_tip_compliance_mm_per_n
from tests.unit.process.robot.arms import forward
from tests.unit.process.robot.hybrid_poses import random_poses

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
