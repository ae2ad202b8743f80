"""The independent force sensor: the device type ``force_sensor_line``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

from pydantic import Field

from polishd.api import DeviceContext, DeviceType, ForceSensor, SensorTimes, hookimpl
from polishd.config.values import ConfigSection
from polishd.drivers.force_sensor_line import ForceSensorLine
from polishd.drivers.transport.address import line_address

POLISHD_API = 1

_TIMES = SensorTimes()


class ForceSensorLineOptions(ConfigSection):
    """Keys of ``[force_sensor]`` with ``type = "force_sensor_line"``."""

    address: str
    """``serial:PATH?baud=115200`` or ``tcp://host:port``."""
    silence_s: Annotated[float, Field(ge=0.15, le=5.0)] = _TIMES.silence_s
    """No new reading for so long: contact is left, as over a silent actuator."""
    delay_s: Annotated[float, Field(ge=0.0, le=5.0)] = _TIMES.delay_s
    """Longest from a force that acts to its reading: the amplifier's filter, and the link."""
    tare_s: Annotated[float, Field(gt=0.0, le=60.0)] = _TIMES.tare_s
    """Longest from the order until what it read then is 0."""


def _build(options: ForceSensorLineOptions, context: DeviceContext) -> ForceSensor:
    address = line_address(options.address, context.base_dir, "a force sensor")
    return ForceSensorLine(address, SensorTimes(options.silence_s, options.delay_s, options.tare_s))


@hookimpl
def polishd_device_types() -> Sequence[DeviceType]:
    """``force_sensor_line``."""
    return [DeviceType("force_sensor_line", "force_sensor", ForceSensorLineOptions, _build)]
