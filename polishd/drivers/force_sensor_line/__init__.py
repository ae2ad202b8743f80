"""A load cell's amplifier on numbered ASCII lines: docs/protocols/force_sensor.md."""

from polishd.drivers.force_sensor_line.driver import ForceSensorLine

__all__ = ["ForceSensorLine"]
