"""The serial arm against data-sheet poses, Craig's closed form of a PUMA, an assembly with scipy, and strain energy."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from polishd.model.errors import ComputeError
from polishd.model.process import SerialRobot
from polishd.model.surface import FloatArray
from polishd.process.robot.serial import (
    serial_inverse_kinematics,
    serial_joint_compliance_mm_per_n,
    serial_reachable,
    serial_tip_compliance_mm_per_n,
)
from tests.unit.process.robot.arms import UR5, forward

TURNS = UR5.joint_limits_deg
UR5_MODIFIED = dataclasses.replace(
    UR5,
    convention="modified",
    dh=(
        (0.0, 0.0, 89.159, 0.0),
        (0.0, 90.0, 0.0, 0.0),
        (-425.0, 0.0, 0.0, 0.0),
        (-392.25, 0.0, 109.15, 0.0),
        (0.0, 90.0, 94.65, 0.0),
        (0.0, -90.0, 82.3, 0.0),
    ),
)
A2, A3, D3, D4 = 431.8, 20.32, 149.09, 433.07
PUMA = SerialRobot(
    dh=(
        (0.0, 0.0, 0.0, 0.0),
        (0.0, -90.0, 0.0, 0.0),
        (A2, 0.0, D3, 0.0),
        (A3, -90.0, D4, 0.0),
        (0.0, 90.0, 0.0, 0.0),
        (0.0, -90.0, 0.0, 0.0),
    ),
    joint_stiffness_n_mm_per_rad=(2e7, 2e7, 2e7, 5e6, 5e6, 5e6),
    joint_limits_deg=TURNS,
    home_deg=(0.0, -60.0, 150.0, 0.0, -60.0, 0.0),
    tool_length_mm=100.0,
    convention="modified",
)
"""The PUMA 560 as in Craig, Introduction to Robotics, section 3.7."""


def near(robot: SerialRobot, n: int, spread_deg: float = 20.0, seed: int = 1) -> FloatArray:
    """(n, 6) joint angles around home, rad."""
    return np.radians(robot.home_deg + np.random.default_rng(seed).uniform(-spread_deg, spread_deg, (n, 6)))


def assemble(robot: SerialRobot, joints: FloatArray) -> tuple[FloatArray, Rotation]:
    """Tip, mm, and flange of one pose: every screw along z and along x as scipy turns it."""
    place, frame = np.zeros(3), Rotation.identity()
    for (a, alpha, d, zero), joint in zip(robot.dh, joints, strict=True):
        screw_z = (np.array([0, 0, d]), Rotation.from_rotvec([0, 0, joint + np.radians(zero)]))
        screw_x = (np.array([a, 0, 0]), Rotation.from_rotvec([np.radians(alpha), 0, 0]))
        for shift, turn in (screw_z, screw_x) if robot.convention == "standard" else (screw_x, screw_z):
            place, frame = place + frame.apply(shift), frame * turn
    return place + frame.apply([0, 0, robot.tool_length_mm]), frame


def tilted(n: int, seed: int = 2) -> tuple[FloatArray, FloatArray]:
    """Tips over a part in front of the UR5, and axes up to 17 degrees off the vertical."""
    rng = np.random.default_rng(seed)
    tip = np.column_stack([rng.uniform(-550, -250, n), rng.uniform(-300, 100, n), rng.uniform(50, 250, n)])
    axis = np.column_stack([rng.uniform(-0.3, 0.3, (n, 2)), np.ones(n)])
    return tip, axis / np.linalg.norm(axis, axis=1)[:, None]


def test_the_ur5_stretched_out_is_where_its_data_sheet_has_it() -> None:
    tip, axis = forward(UR5, np.zeros((1, 6)))
    np.testing.assert_allclose(tip[0], [-425 - 392.25, -109.15 - 82.3 - 150, 89.159 - 94.65], atol=1e-9)
    np.testing.assert_allclose(axis[0], [0, 1, 0], atol=1e-15)


def test_the_ur5_upright_is_as_high_as_its_links_are_long() -> None:
    tip, axis = forward(UR5, np.radians([[0.0, -90.0, 0.0, -90.0, 0.0, 0.0]]))
    np.testing.assert_allclose(tip[0], [0, -109.15 - 82.3 - 150, 89.159 + 425 + 392.25 + 94.65], atol=1e-9)
    np.testing.assert_allclose(axis[0], [0, 1, 0], atol=1e-12)


def test_the_puma_follows_craigs_closed_form() -> None:
    joints = np.random.default_rng(3).uniform(-np.pi, np.pi, (200, 6))
    t1, t2, t3, t4, t5, _ = joints.T
    s1, c1, s4, c4, s5, c5 = np.sin(t1), np.cos(t1), np.sin(t4), np.cos(t4), np.sin(t5), np.cos(t5)
    s23, c23 = np.sin(t2 + t3), np.cos(t2 + t3)
    out = A2 * np.cos(t2) + A3 * c23 - D4 * s23
    wrist = np.stack([c1 * out - D3 * s1, s1 * out + D3 * c1, -A3 * s23 - A2 * np.sin(t2) - D4 * c23], axis=1)
    bent = c23 * c4 * s5 + s23 * c5
    pointing = np.stack([-c1 * bent - s1 * s4 * s5, -s1 * bent + c1 * s4 * s5, s23 * c4 * s5 - c23 * c5], axis=1)
    tip, axis = forward(PUMA, joints)
    np.testing.assert_allclose(axis, -pointing, atol=1e-13)
    np.testing.assert_allclose(tip, wrist + 100.0 * pointing, rtol=0, atol=1e-10)


@pytest.mark.parametrize("convention", ["standard", "modified"])
def test_any_rows_go_together_as_screws(convention: str) -> None:
    rng = np.random.default_rng(4)
    rows = tuple(map(tuple, rng.uniform(-180, 180, (6, 4))))
    robot = dataclasses.replace(UR5, dh=rows, convention=convention)
    for joints in rng.uniform(-3, 3, (20, 6)):
        tip, flange = assemble(robot, joints)
        got_tip, got_axis = forward(robot, joints[None])
        np.testing.assert_allclose(got_tip[0], tip, rtol=0, atol=1e-10)
        np.testing.assert_allclose(got_axis[0], -flange.as_matrix()[:, 2], rtol=0, atol=1e-13)


def test_one_arm_in_both_conventions_is_one_arm() -> None:
    joints = np.random.default_rng(5).uniform(-3, 3, (50, 6))
    for standard, modified in zip(forward(UR5, joints), forward(UR5_MODIFIED, joints), strict=True):
        np.testing.assert_allclose(modified, standard, rtol=0, atol=1e-10)
    np.testing.assert_allclose(
        serial_joint_compliance_mm_per_n(UR5_MODIFIED, joints),
        serial_joint_compliance_mm_per_n(UR5, joints),
        atol=1e-15,
    )
    tip, axis = tilted(20)
    np.testing.assert_allclose(
        serial_inverse_kinematics(UR5_MODIFIED, tip, axis), serial_inverse_kinematics(UR5, tip, axis), rtol=0, atol=1e-9
    )


turn = st.floats(-20.0, 20.0)


@pytest.mark.full
@given(st.tuples(turn, turn, turn, turn, turn, turn), st.sampled_from([UR5, UR5_MODIFIED, PUMA]))
def test_inverse_finds_the_joints_again(turns: tuple[float, ...], robot: SerialRobot) -> None:
    joints = np.radians(np.add(robot.home_deg, turns))
    tip, flange = assemble(robot, joints)
    x, _, z = flange.as_matrix().T
    got = serial_inverse_kinematics(dataclasses.replace(robot, flange_x=tuple(x)), tip[None], -z[None])
    np.testing.assert_allclose(got[0], joints, rtol=0, atol=1e-9)


@pytest.mark.full
def test_round_trip_over_random_poses() -> None:
    tip, axis = tilted(30_000)
    joints = serial_inverse_kinematics(UR5, tip, axis)
    got_tip, got_axis = forward(UR5, joints)
    assert np.abs(got_tip - tip).max() < 1e-9
    assert np.abs(got_axis - axis).max() < 1e-12


@pytest.mark.full
def test_the_flange_x_is_as_near_as_it_goes() -> None:
    tip, axis = tilted(30)
    robot = dataclasses.replace(UR5, flange_x=(0.6, -0.8, 0.0))
    for joints, a in zip(serial_inverse_kinematics(robot, tip, axis), axis, strict=True):
        x = assemble(robot, joints)[1].as_matrix()[:, 0]
        best = max(Rotation.from_rotvec(np.radians(t) * a).apply(x) @ robot.flange_x for t in range(-180, 180))
        assert x @ robot.flange_x == pytest.approx(best, abs=1e-9)


def test_a_pose_has_the_same_joints_alone_and_in_company() -> None:
    tip, axis = tilted(1500)
    together = serial_inverse_kinematics(UR5, tip, axis)
    for k in (0, 7, 744, 1499):
        alone = serial_inverse_kinematics(UR5, tip[k : k + 1], axis[k : k + 1])
        np.testing.assert_allclose(together[k], alone[0], rtol=0, atol=1e-9)


def test_the_branch_is_that_of_home() -> None:
    tip, axis = tilted(50)
    elbow_up = serial_inverse_kinematics(UR5, tip, axis)
    other = dataclasses.replace(UR5, home_deg=(0.0, 0.0, -110.0, 20.0, -90.0, 0.0))
    elbow_down = serial_inverse_kinematics(other, tip, axis)
    assert (elbow_up[:, 2] > 0).all()
    assert (elbow_down[:, 2] < 0).all()
    for joints in (elbow_up, elbow_down):
        np.testing.assert_allclose(forward(UR5, joints)[0], tip, rtol=0, atol=1e-9)


def test_neighbours_on_a_path_stay_neighbours() -> None:
    t = np.linspace(0, 2 * np.pi, 400)
    tip = np.column_stack([-400 + 120 * np.cos(t), -100 + 120 * np.sin(t), np.full(400, 150.0)])
    axis = np.column_stack([0.2 * np.cos(t), 0.2 * np.sin(t), np.full(400, np.sqrt(0.96))])
    joints = serial_inverse_kinematics(UR5, tip, axis, path=True)
    assert np.degrees(np.abs(np.diff(joints, axis=0)).max()) < 2.0
    np.testing.assert_allclose(joints[0], joints[-1], rtol=0, atol=1e-9)


@pytest.mark.full
def test_a_path_around_the_base_turns_on_where_single_poses_go_the_shorter_way() -> None:
    t = np.radians(np.linspace(0, 270, 200))
    tip = np.column_stack([-450 * np.cos(t), -450 * np.sin(t), np.full(200, 150.0)])
    axis = np.tile(UP, (200, 1))
    single = serial_inverse_kinematics(UR5, tip, axis)
    path = serial_inverse_kinematics(UR5, tip, axis, path=True)
    assert np.abs(single[:, 0]).max() < np.pi
    assert np.degrees(np.abs(np.diff(single[:, 0])).max()) > 350
    assert np.degrees(path[-1, 0] - path[0, 0]) == pytest.approx(270, abs=1e-6)
    np.testing.assert_allclose(forward(UR5, path)[0], tip, rtol=0, atol=1e-9)
    limited = dataclasses.replace(UR5, joint_limits_deg=((-180.0, 180.0), *TURNS[1:]))
    serial_inverse_kinematics(limited, tip, axis)
    with pytest.raises(ComputeError, match=r"joint 1 is 181.[\d]+ deg, out of its limits -180 to 180 deg"):
        serial_inverse_kinematics(limited, tip, axis, path=True)


def test_a_turn_that_the_limits_ask_for_is_taken() -> None:
    tip, axis = np.array([[80.0, -450.0, 150.0]]), np.array([UP])
    near_home = serial_inverse_kinematics(UR5, tip, axis)[0, 0]
    assert np.radians(60) < near_home < np.radians(120)
    other = dataclasses.replace(UR5, joint_limits_deg=((-350.0, 60.0), *TURNS[1:]))
    assert serial_reachable(other, tip, axis)[0]
    assert serial_inverse_kinematics(other, tip, axis)[0, 0] == pytest.approx(near_home - 2 * np.pi, abs=1e-9)


@pytest.mark.full
def test_homes_branch_is_followed_far() -> None:
    """The flange turned by 120 degrees from home, over a field that goes to the wrist's singular poses."""
    robot = dataclasses.replace(PUMA, flange_x=(-0.5, np.sqrt(0.75), 0.0))
    assert serial_reachable(robot, *forward(PUMA, near(PUMA, 1000, 35.0))).mean() > 0.93


@pytest.mark.parametrize("robot", [UR5, PUMA])
def test_compliance_is_that_of_the_tip_moved_joint_by_joint(robot: SerialRobot) -> None:
    joints, h = near(robot, 10), 1e-5
    columns = []
    for j in range(6):
        step = h * np.eye(6)[j]
        ahead, behind = (forward(robot, joints + sign * step)[0] for sign in (1, -1))
        columns.append((ahead - behind) / (2 * h))
    expected = sum(
        column[:, :, None] * column[:, None, :] / stiffness
        for column, stiffness in zip(columns, robot.joint_stiffness_n_mm_per_rad, strict=True)
    )
    np.testing.assert_allclose(serial_joint_compliance_mm_per_n(robot, joints), expected, rtol=0, atol=1e-11)


def test_a_force_does_twice_the_work_that_the_springs_take_up() -> None:
    """The springs' least potential energy under a force, found by Newton on the energy alone, and the tip's way."""
    force, stiffness = np.array([3.0, -5.0, 12.0]), np.array(UR5.joint_stiffness_n_mm_per_rad)
    joints = near(UR5, 1)
    tip = forward(UR5, joints)[0]
    sag = np.zeros(6)
    for _ in range(20):
        ahead, behind = (forward(UR5, joints + sag + sign * 1e-5 * np.eye(6))[0] @ force for sign in (1, -1))
        sag = (ahead - behind) / 2e-5 / stiffness
    moved = (forward(UR5, joints + sag)[0] - tip)[0]
    matrix = serial_joint_compliance_mm_per_n(UR5, joints)[0]
    np.testing.assert_allclose(moved, matrix @ force, rtol=0, atol=1e-3 * np.linalg.norm(moved))
    assert force @ matrix @ force == pytest.approx((stiffness * sag**2).sum(), rel=1e-3)


def test_compliance_is_symmetric_and_not_negative() -> None:
    tip, axis = tilted(200)
    matrix = serial_tip_compliance_mm_per_n(UR5, tip, axis)
    assert (matrix == matrix.transpose(0, 2, 1)).all()
    assert np.linalg.eigvalsh(matrix).min() > 0
    soft = dataclasses.replace(UR5, joint_stiffness_n_mm_per_rad=tuple(np.array(UR5.joint_stiffness_n_mm_per_rad) / 2))
    np.testing.assert_allclose(serial_tip_compliance_mm_per_n(soft, tip, axis), 2 * matrix, rtol=1e-9)


def test_one_springy_joint_lets_the_tip_go_one_way_only() -> None:
    stiff = (1e30, 1e30, 1e30, 1e30, 1e7, 1e30)
    matrix = serial_joint_compliance_mm_per_n(
        dataclasses.replace(UR5, joint_stiffness_n_mm_per_rad=stiff), np.zeros((1, 6))
    )[0]
    # Stretched out, joint 5 turns about z through (-817.25, -109.15): the tip is 232.3 mm from it, along -y.
    np.testing.assert_allclose(matrix, np.diag([232.3**2 / 1e7, 0, 0]), rtol=0, atol=1e-12)


@pytest.mark.full
def test_reachable_agrees_with_the_inverse() -> None:
    tip, axis = tilted(60)
    tip[::3] *= 1.9
    limited = dataclasses.replace(UR5, joint_limits_deg=((-30.0, 30.0), *TURNS[1:]))
    reach = serial_reachable(limited, tip, axis)
    assert 5 < reach.sum() < 50
    for k, inside in enumerate(reach):
        if inside:
            serial_inverse_kinematics(limited, tip[k : k + 1], axis[k : k + 1])
        else:
            with pytest.raises(ComputeError, match="point 0: "):
                serial_inverse_kinematics(limited, tip[k : k + 1], axis[k : k + 1])


def test_no_points_are_no_points() -> None:
    nothing = np.empty((0, 3))
    assert serial_inverse_kinematics(UR5, nothing, nothing, path=True).shape == (0, 6)
    assert serial_tip_compliance_mm_per_n(UR5, nothing, nothing).shape == (0, 3, 3)
    assert serial_reachable(UR5, nothing, nothing).shape == (0,)


UP = [0.0, 0.0, 1.0]


@pytest.mark.parametrize(
    ("robot", "tip", "axis", "says"),
    [
        (UR5, [-1500.0, 0.0, 100.0], UP, r"tip is out of reach: the least miss found is [\d.]+ mm, it must be 0"),
        (UR5, [-400.0, 0.0, 100.0], [1.0, 0.0, 0.0], r"sine between the tool axis and flange_x is 0 , parallel below"),
        (UR5, [np.nan, 0.0, 100.0], UP, r"tool tip is nan mm"),
        (UR5, [-400.0, 0.0, 100.0], [0.0, 0.0, 2.0], r"length of tool axis is 2"),
        (
            dataclasses.replace(UR5, joint_limits_deg=((-10.0, 10.0), *TURNS[1:])),
            [-300.0, -300.0, 100.0],
            UP,
            r"joint 1 is [\d.]+ deg, out of its limits -10 to 10 deg",
        ),
    ],
)
def test_a_refusal_names_the_point_the_value_and_the_unit(
    robot: SerialRobot, tip: list[float], axis: list[float], says: str
) -> None:
    tips = np.array([[-400.0, -110.0, 150.0], [-410.0, -110.0, 150.0], tip])
    with pytest.raises(ComputeError, match="point 2: .*" + says):
        serial_inverse_kinematics(robot, tips, np.array([UP, UP, axis]))


def test_a_wrist_that_is_nearly_stretched_is_refused() -> None:
    joints = np.radians([[0.0, -60.0, 150.0, 0.0, -0.05, 0.0]])
    tip, flange = assemble(PUMA, joints[0])
    x, _, z = flange.as_matrix().T
    with pytest.raises(ComputeError, match=r"point 0: the Jacobian's ratio .* near-singular below 0.001"):
        serial_inverse_kinematics(dataclasses.replace(PUMA, flange_x=tuple(x)), tip[None], -z[None])


def test_a_pose_beyond_a_singular_one_is_taken_by_homes_branch_or_not_at_all() -> None:
    """The wrist bent the other way round. With home's wrist the same pose needs joint 4 half a turn on."""
    joints = np.radians([0.0, -60.0, 150.0, 0.0, 60.0, 0.0])
    tip, flange = assemble(PUMA, joints)
    robot = dataclasses.replace(PUMA, flange_x=tuple(flange.as_matrix()[:, 0]))
    axis = -flange.as_matrix()[:, 2]
    turned = np.degrees(serial_inverse_kinematics(robot, tip[None], axis[None])[0])
    np.testing.assert_allclose(np.abs(turned), [0.0, 60.0, 150.0, 180.0, 60.0, 180.0], rtol=0, atol=1e-9)
    assert turned[4] == pytest.approx(-60.0)
    short = dataclasses.replace(robot, joint_limits_deg=(*TURNS[:3], (-90.0, 90.0), *TURNS[4:]))
    with pytest.raises(ComputeError, match=r"joint 4 is -?180 deg, out of its limits -90 to 90 deg"):
        serial_inverse_kinematics(short, tip[None], axis[None])
    assert not serial_reachable(short, tip[None], axis[None])[0]
    own = dataclasses.replace(short, home_deg=(0.0, -60.0, 150.0, 0.0, 50.0, 0.0))
    np.testing.assert_allclose(serial_inverse_kinematics(own, tip[None], axis[None])[0], joints, rtol=0, atol=1e-9)


@pytest.mark.full
def test_elbow_and_wrist_bend_as_at_home_wherever_the_arm_goes() -> None:
    """Two singular poses on the way leave the determinant's sign unchanged: the sign does not determine the branch."""
    rng = np.random.default_rng(4)
    robot = dataclasses.replace(UR5, home_deg=(27.0, -109.0, 139.0, -115.0, -84.0, -7.0))
    tip = forward(robot, np.radians([robot.home_deg]))[0] + rng.uniform(-250, 250, (400, 3))
    axis = np.column_stack([rng.uniform(-0.6, 0.6, (400, 2)), np.ones(400)])
    axis /= np.linalg.norm(axis, axis=1)[:, None]
    reached = serial_reachable(robot, tip, axis)
    assert 300 < reached.sum() < 400
    joints = serial_inverse_kinematics(robot, tip[reached], axis[reached])
    assert (np.sin(joints[:, 2]) > 0).all()
    assert (np.sin(joints[:, 4]) < 0).all()


def test_a_joint_that_jumps_between_neighbours_is_a_flip() -> None:
    tip = np.array([[-400.0, -110.0, 150.0], [-401.0, -110.0, 150.0], [150.0, -420.0, 150.0]])
    axis = np.tile(UP, (3, 1))
    serial_inverse_kinematics(UR5, tip, axis)
    with pytest.raises(ComputeError, match=r"point 2: the turn of joint 1 from the point before is [\d.]+ deg"):
        serial_inverse_kinematics(UR5, tip, axis, path=True)
    with pytest.raises(ComputeError, match="point 2: the turn of joint 1"):
        serial_tip_compliance_mm_per_n(UR5, tip, axis, path=True)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"dh": UR5.dh[:5]}, "dh must be 6 rows of 4 finite numbers"),
        ({"dh": (*UR5.dh[:5], (0.0, np.inf, 0.0, 0.0))}, "dh must be 6 rows of 4 finite numbers"),
        ({"joint_limits_deg": TURNS[:5]}, "joint_limits_deg must be 6 rows of 2 finite numbers"),
        ({"joint_limits_deg": (*TURNS[:5], (10.0, -10.0))}, "upper limit of joint 6 is -10 deg, it must be above 10"),
        ({"joint_limits_deg": ((5.0, 90.0), *TURNS[1:])}, "home of joint 1 is 0 deg, out of its limits 5 to 90 deg"),
        ({"home_deg": (0.0,) * 5}, "home_deg has 5 angles"),
        ({"home_deg": (0.0, -90.0, 0.0, -90.0, -90.0, 0.0)}, "home is near-singular: .* it must be above 0.001"),
        ({"tool_length_mm": -3.0}, "tool_length_mm is -3 mm"),
        ({"flange_x": (0.0, 0.0, 0.0)}, "flange_x is 0"),
        ({"joint_stiffness_n_mm_per_rad": (1e7, 1e7, 0.0, 1e7, 1e7, 1e7)}, "stiffness of joint 3 is 0 N mm/rad"),
        ({"joint_stiffness_n_mm_per_rad": (1e7, -2e7, 1e7, 1e7, 1e7, 1e7)}, "stiffness of joint 2 is -2e.07 N mm/rad"),
        ({"joint_stiffness_n_mm_per_rad": (1e7,) * 4}, "4 joint stiffnesses, it must have 6"),
    ],
)
def test_an_arm_that_cannot_be_is_refused(change: dict[str, object], says: str) -> None:
    tip, axis = tilted(3)
    with pytest.raises(ComputeError, match=says):
        serial_tip_compliance_mm_per_n(dataclasses.replace(UR5, **change), tip, axis)


def test_shapes_that_do_not_fit_are_refused() -> None:
    tip, axis = tilted(3)
    with pytest.raises(ComputeError, match="3 tool tips come with 2 tool axes"):
        serial_inverse_kinematics(UR5, tip, axis[:2])
