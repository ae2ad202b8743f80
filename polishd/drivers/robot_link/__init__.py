"""polishd's robot link: docs/protocols/robot_link.md."""

from polishd.drivers.robot_link.driver import REPORT_S, RobotLink

__all__ = ["REPORT_S", "RobotLink"]
