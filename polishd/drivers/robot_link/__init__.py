"""polishd's robot link: docs/protocols/robot_link.md."""

from polishd.drivers.robot_link.driver import RobotLink

__all__ = ["RobotLink"]
