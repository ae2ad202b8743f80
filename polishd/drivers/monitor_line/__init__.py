"""A box of inputs that have names, on numbered ASCII lines: docs/protocols/monitor.md."""

from polishd.drivers.monitor_line.driver import MonitorLine

__all__ = ["MonitorLine"]
