"""The bonnet spindle's drive on CAN: docs/protocols/spindle_can.md."""

from polishd.drivers.spindle_can.driver import SpindleCan

__all__ = ["SpindleCan"]
