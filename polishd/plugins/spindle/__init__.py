"""The bonnet spindle: the device type ``spindle_can``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

from polishd.api import ConfigError, DeviceContext, DeviceType, Spindle, hookimpl
from polishd.drivers.spindle_can import SpindleCan
from polishd.drivers.transport.address import Slcan, Socketcand, parse_address

POLISHD_API = 1


class SpindleCanOptions(BaseModel):
    """Keys of ``[spindle]`` with ``type = "spindle_can"``."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)

    address: str
    """``slcan:PATH?bitrate=500000`` or ``socketcand://host:port/channel``."""
    node: Annotated[int, Field(ge=1, le=127)] = 5
    """CANopen node number."""


def _build(options: SpindleCanOptions, context: DeviceContext) -> Spindle:
    address = parse_address(options.address, context.base_dir)
    if not isinstance(address, Slcan | Socketcand):
        raise ConfigError(f"[spindle] address {options.address!r}: spindle_can runs over slcan: or socketcand:// only")
    return SpindleCan(address, node=options.node)


@hookimpl
def polishd_device_types() -> Sequence[DeviceType]:
    """``spindle_can``."""
    return [DeviceType("spindle_can", "spindle", SpindleCanOptions, _build)]
