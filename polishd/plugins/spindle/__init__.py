"""The bonnet spindle: the device type ``spindle_can``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

from pydantic import Field

from polishd.api import DeviceContext, DeviceType, Spindle, SpindleTimes, hookimpl
from polishd.config.values import ConfigSection
from polishd.drivers.spindle_can import SpindleCan
from polishd.drivers.transport.address import can_address

POLISHD_API = 1

_TIMES = SpindleTimes()


class SpindleCanOptions(ConfigSection):
    """Keys of ``[spindle]`` with ``type = "spindle_can"``."""

    address: str
    """``slcan:PATH?bitrate=500000`` or ``socketcand://host:port/channel``."""
    node: Annotated[int, Field(ge=1, le=127)] = 5
    """CANopen node number. [1]"""
    silence_s: Annotated[float, Field(ge=0.3, le=60.0)] = _TIMES.silence_s
    """No heartbeat or process data for so long: the link is lost. They come every 100 and 50 ms."""
    watchdog_s: Annotated[float, Field(ge=0.5, le=60.0)] = _TIMES.watchdog_s
    """The drive's own: so long without a command it stops. Commands come every 100 ms."""
    spin_s: Annotated[float, Field(gt=0.0, le=120.0)] = _TIMES.spin_s
    """Longest from standstill to any speed, or back."""


def _build(options: SpindleCanOptions, context: DeviceContext) -> Spindle:
    address = can_address(options.address, context.base_dir, "spindle_can")
    times = SpindleTimes(silence_s=options.silence_s, watchdog_s=options.watchdog_s, spin_s=options.spin_s)
    return SpindleCan(address, times, node=options.node)


@hookimpl
def polishd_device_types() -> Sequence[DeviceType]:
    """``spindle_can``."""
    return [DeviceType("spindle_can", "spindle", SpindleCanOptions, _build)]
