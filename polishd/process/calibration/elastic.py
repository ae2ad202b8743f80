"""The elastic numbers of a robot as one vector, and its compliance at fixed poses as a function of them."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar

from polishd.model.process import Projection
from polishd.model.robot import HybridRobot, SerialRobot
from polishd.model.surface import FloatArray
from polishd.process.calibration.loading import LoadingTests
from polishd.process.compliance import equivalent_compliance
from polishd.process.robot.compliance import hybrid_compliance_at
from polishd.process.robot.serial import serial_inverse_kinematics, serial_joint_compliance_mm_per_n
from polishd.process.robot.stiffness import ELASTIC, limb_key

Elastic = TypeVar("Elastic", HybridRobot, SerialRobot)
"""Robots that have stiffnesses to fit."""


class Number(NamedTuple):
    """One elastic number."""

    name: str
    unit: str
    value: float


def elastic_numbers(robot: HybridRobot | SerialRobot) -> tuple[Number, ...]:
    """The numbers that a fit may change, in the order that `with_elastic` takes them."""
    if isinstance(robot, SerialRobot):
        stiffness = robot.joint_stiffness_n_mm_per_rad
        return tuple(Number(f"stiffness of joint {j}", "N mm/rad", float(k)) for j, k in enumerate(stiffness, 1))
    names = (limb_key(robot), *ELASTIC)
    return tuple(Number(name, unit, float(getattr(robot, name))) for name, unit in names)


def with_elastic(robot: Elastic, values: FloatArray) -> Elastic:
    """The robot with these (p,) numbers instead of its own."""
    numbers = [float(value) for value in values]
    if isinstance(robot, SerialRobot):
        return dataclasses.replace(robot, joint_stiffness_n_mm_per_rad=tuple(numbers))
    names = [number.name for number in elastic_numbers(robot)]
    changed: dict[str, Any] = dict(zip(names, numbers, strict=True))
    return dataclasses.replace(robot, **changed)


def compliance_of(
    robot: HybridRobot | SerialRobot, tests: LoadingTests, projection: Projection
) -> Callable[[FloatArray], FloatArray]:
    """The function from (p,) elastic numbers to the (n,) compliances, um/N, that the tests should have found.

    The poses are solved once: they do not depend on the stiffnesses. Raises ComputeError for one out of reach.
    """
    matrix = _serial_matrix(robot, tests) if isinstance(robot, SerialRobot) else _hybrid_matrix(robot, tests)

    def compliance(values: FloatArray) -> FloatArray:
        return 1e3 * equivalent_compliance(matrix(values), tests.axis, tests.direction, projection)

    return compliance


def _serial_matrix(robot: SerialRobot, tests: LoadingTests) -> Callable[[FloatArray], FloatArray]:
    joints = serial_inverse_kinematics(robot, tests.tip_mm, tests.axis)
    return lambda values: serial_joint_compliance_mm_per_n(with_elastic(robot, values), joints)


def _hybrid_matrix(robot: HybridRobot, tests: LoadingTests) -> Callable[[FloatArray], FloatArray]:
    matrix = hybrid_compliance_at(robot, tests.tip_mm, tests.axis)
    return lambda values: matrix(with_elastic(robot, values))
