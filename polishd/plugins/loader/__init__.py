"""The part loader: the device type ``loader_line``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

from pydantic import Field

from polishd.api import DeviceContext, DeviceType, LoaderTimes, PartLoader, hookimpl
from polishd.config.values import ConfigSection
from polishd.drivers.loader_line import LoaderLine
from polishd.drivers.transport.address import line_address

POLISHD_API = 1

_TIMES = LoaderTimes()


class LoaderLineOptions(ConfigSection):
    """Keys of ``[loader]`` with ``type = "loader_line"``."""

    address: str
    """``serial:PATH?baud=115200`` or ``tcp://host:port``."""
    silence_s: Annotated[float, Field(ge=0.2, le=60.0)] = _TIMES.silence_s
    """No answer for so long: the link is lost."""
    change_s: Annotated[float, Field(gt=0.0, le=3600.0)] = _TIMES.change_s
    """Longest from the order to take a part off, or to put one on, until it is clear of the cell."""
    stop_s: Annotated[float, Field(gt=0.0, le=120.0)] = _TIMES.stop_s
    """Longest from the order to standstill."""


def _build(options: LoaderLineOptions, context: DeviceContext) -> PartLoader:
    address = line_address(options.address, context.base_dir, "a loader")
    return LoaderLine(address, LoaderTimes(options.silence_s, options.change_s, options.stop_s))


@hookimpl
def polishd_device_types() -> Sequence[DeviceType]:
    """``loader_line``."""
    return [DeviceType("loader_line", "loader", LoaderLineOptions, _build)]
