"""From a section about a robot to the robot."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from polishd.config.process import HybridSection, KinematicsSection, SerialSection
from polishd.config.tables import read_compliance_table
from polishd.model.robot import HybridRobot, RobotModel, SerialRobot


def robot_of(section: KinematicsSection, resolve: Callable[[str], Path]) -> RobotModel:
    """Its geometry and stiffness; ``resolve`` finds its table. ConfigError where that cannot be read."""
    values = {name: value for name, value in section if name != "type"}
    if isinstance(section, HybridSection):
        return HybridRobot(**values)
    if isinstance(section, SerialSection):
        return SerialRobot(**values)
    return read_compliance_table(resolve(section.table))
