"""A six-axis arm for tests, and where its joints bring its tool."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from polishd.model.process import DhConvention, SerialRobot
from polishd.model.surface import FloatArray
from polishd.process.robot.serial import chain, twist_scale

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


@dataclass(frozen=True, slots=True)
class ArmCell:
    """An arm, and the poses of a part that lies before it."""

    robot: SerialRobot
    tip_mm: FloatArray
    axis: FloatArray
    origin_mm: tuple[float, float, float]
    """Position of the part's center, as in ``[part]``."""
    rotation_rpy_deg: tuple[float, float, float]


def arm_cell(seed: int) -> ArmCell:
    """Draw an arm, its home, limits and ``flange_x``, and 144 poses over a part near its home pose.

    The arms are of three kinds: three parallel joints as Universal Robots builds them, a shoulder that stands off the
    first joint, and a PUMA by Craig's rows. One seed in three lies partly or wholly out of reach.
    """
    rng = np.random.default_rng(seed)
    size = rng.uniform(0.7, 1.5)
    kind = rng.integers(3)
    rows = np.array(KINDS[kind][0]) * [size, 1.0, size, 1.0]
    rows[:, [0, 2]] *= rng.uniform(0.9, 1.1, (6, 2))
    home = np.array(KINDS[kind][1]) + rng.uniform(-25.0, 25.0, 6)
    home[[0, 5]] = rng.uniform(-180.0, 180.0, 2)
    convention: DhConvention = "modified" if kind == PUMA_BY_CRAIG else "standard"
    limits = np.tile([-360.0, 360.0], (6, 1))
    if rng.random() < 0.5:
        limits = home[:, None] + np.column_stack([-rng.uniform(40, 200, 6), rng.uniform(40, 200, 6)])
    flange_x = (1.0, 0.0, 0.0) if rng.random() < 0.6 else tuple((rng.normal(size=3) * [1.0, 1.0, 0.2]).tolist())
    robot = SerialRobot(
        dh=tuple(map(tuple, rows.tolist())),
        joint_stiffness_n_mm_per_rad=UR5.joint_stiffness_n_mm_per_rad,
        joint_limits_deg=tuple(map(tuple, limits.tolist())),
        home_deg=tuple(home.tolist()),
        tool_length_mm=float(rng.uniform(80.0, 300.0)),
        convention=convention,
        flange_x=flange_x,
    )
    home_at = chain(robot, np.radians([robot.home_deg]))
    singular = np.linalg.svd(home_at.twists[0] / twist_scale(robot), compute_uv=False)
    if singular[-1] < REGULAR_HOME * singular[0]:
        return arm_cell(seed + MANY)
    tip, axis = home_at.tip_mm, home_at.axis
    lie = (
        Rotation.from_rotvec(rng.normal(size=3) * np.radians(8.0)) * Rotation.align_vectors(axis, [[0.0, 0.0, 1.0]])[0]
    )
    at = np.linspace(-1.0, 1.0, 12) * rng.uniform(20.0, 200.0)
    points = np.column_stack([np.stack(np.meshgrid(at, at), axis=-1).reshape(-1, 2), np.zeros(144)])
    dip, way = np.radians(rng.uniform(5.0, 30.0)), rng.uniform(0.0, 2.0 * np.pi)
    leaning = [np.sin(dip) * np.cos(way), np.sin(dip) * np.sin(way), np.cos(dip)]
    origin = (tip + rng.uniform(-150.0, 150.0, 3))[0]
    return ArmCell(
        robot,
        lie.apply(points) + origin,
        np.tile(lie.apply(leaning), (144, 1)),
        tuple(origin.tolist()),
        tuple(lie.as_euler("XYZ", degrees=True).tolist()),
    )


REGULAR_HOME = 0.01
"""Least ratio of the Jacobian's singular values at a sensible home pose."""
MANY = 1_000_000
PUMA_BY_CRAIG = 2
KINDS = (
    (UR5.dh, (0.0, -110.0, 110.0, -90.0, -90.0, 0.0)),
    (
        (
            (260.0, -90.0, 675.0, 0.0),
            (680.0, 0.0, 0.0, 0.0),
            (35.0, -90.0, 0.0, 0.0),
            (0.0, 90.0, 670.0, 0.0),
            (0.0, -90.0, 0.0, 0.0),
            (0.0, 0.0, 115.0, 0.0),
        ),
        (0.0, -60.0, 70.0, 0.0, 60.0, 0.0),
    ),
    (
        (
            (0.0, 0.0, 0.0, 0.0),
            (0.0, -90.0, 0.0, 0.0),
            (431.8, 0.0, 149.1, 0.0),
            (20.3, -90.0, 433.1, 0.0),
            (0.0, 90.0, 0.0, 0.0),
            (0.0, -90.0, 60.0, 0.0),
        ),
        (0.0, -60.0, 150.0, 0.0, -60.0, 0.0),
    ),
)
"""Rows and a home away from singular poses."""
