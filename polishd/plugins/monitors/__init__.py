"""Monitors of the cell's signals: the device type ``monitor_line``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

from pydantic import Field

from polishd.api import DeviceContext, DeviceType, Monitor, MonitorTimes, hookimpl
from polishd.config.values import ConfigSection
from polishd.drivers.monitor_line import MonitorLine
from polishd.drivers.transport.address import line_address

POLISHD_API = 1


class MonitorLineOptions(ConfigSection):
    """Keys of ``[monitor]`` with ``type = "monitor_line"``."""

    address: str
    """``serial:PATH?baud=115200`` or ``tcp://host:port``."""
    silence_s: Annotated[float, Field(ge=0.2, le=60.0)] = MonitorTimes().silence_s
    """No answer for so long: its signals are not known any more."""


def _build(options: MonitorLineOptions, context: DeviceContext) -> Monitor:
    address = line_address(options.address, context.base_dir, "a monitor")
    return MonitorLine(address, MonitorTimes(options.silence_s))


@hookimpl
def polishd_device_types() -> Sequence[DeviceType]:
    """``monitor_line``."""
    return [DeviceType("monitor_line", "monitor", MonitorLineOptions, _build)]
