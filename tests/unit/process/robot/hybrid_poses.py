"""Poses of the hybrid robot for the tests, and robots of other geometry than the default one's."""

from __future__ import annotations

import dataclasses

import numpy as np

from polishd.model.process import HybridRobot
from polishd.model.surface import FloatArray
from polishd.process.robot.compliance import reachable

ROBOT = HybridRobot()
DIP = np.radians(15.0)

CROOKED = dataclasses.replace(
    ROBOT,
    base_joints_mm=((20.0, 260.0, -15.0), (-230.0, -110.0, 30.0), (200.0, -150.0, 5.0)),
    platform_joints_mm=((-10.0, 125.0, 12.0), (-100.0, -70.0, -20.0), (110.0, -55.0, 8.0)),
    outer_axis=(0.9, 0.5, -0.3),
)
"""No symmetry at all: oblique outer axis, joints in no plane."""
SLANTED = dataclasses.replace(ROBOT, outer_axis=(0.0, 1.0, 1.0))
"""The outer axis at 45 deg to z."""
PAPER = dataclasses.replace(CROOKED, beam="paper", limb_ea_n=2.7e7)
ROBOTS = (ROBOT, CROOKED, SLANTED, PAPER)


def inward(tip_mm: FloatArray) -> FloatArray:
    """(n, 3) axes with the spindle leaning by 15 degrees towards the base's z axis."""
    radius = np.hypot(tip_mm[:, 0], tip_mm[:, 1])
    lean = -tip_mm[:, :2] / radius[:, None] * np.sin(DIP)
    return np.column_stack([lean, np.full(len(tip_mm), -np.cos(DIP))])


def cylinder(n: int) -> tuple[FloatArray, FloatArray]:
    """Tips in Table I's cylinder with the spindle leaning inward, as (tips, axes), in reach or not."""
    grid, height = np.linspace(-660, 660, n), np.linspace(200, 910, n)
    x, y, h = (a.ravel() for a in np.meshgrid(grid, grid, height))
    radius = np.hypot(x, y)
    x[radius < 1] = 1e-3  # inward is not defined on the base's z axis itself
    tip = np.stack([x, y, 2535 - h], axis=1)[radius <= 660]
    return tip, inward(tip)


def workspace(n: int, robot: HybridRobot = ROBOT) -> tuple[FloatArray, FloatArray]:
    """Return the poses in reach of the robot."""
    tip, axis = cylinder(n)
    reach = reachable(robot, tip, axis)
    return tip[reach], axis[reach]


def random_poses(n: int, robot: HybridRobot = ROBOT, seed: int = 1) -> tuple[FloatArray, FloatArray]:
    """About n tips in reach, all over the cylinder, with the spindle leaning any way by 1 to 30 degrees."""
    rng = np.random.default_rng(seed)
    radius, around = 660 * np.sqrt(rng.random(2 * n)), 2 * np.pi * rng.random(2 * n)
    z = 2535 - rng.uniform(200, 910, 2 * n)
    tip = np.stack([radius * np.cos(around), radius * np.sin(around), z], axis=1)
    lean, way = np.radians(rng.uniform(1, 30, 2 * n)), 2 * np.pi * rng.random(2 * n)
    axis = np.stack([np.sin(lean) * np.cos(way), np.sin(lean) * np.sin(way), -np.cos(lean)], axis=1)
    reach = np.flatnonzero(reachable(robot, tip, axis))[:n]
    return tip[reach], axis[reach]
