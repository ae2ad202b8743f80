"""The device type ``robot_link``: a robot that speaks docs/protocols/robot_link.md."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from polishd.api import DeviceContext, DeviceType, RobotTimes
from polishd.config.values import ConfigSection
from polishd.drivers.robot_link import REPORT_S, RobotLink
from polishd.drivers.transport.address import tcp_address

_TIMES = RobotTimes()


class RobotLinkOptions(ConfigSection):
    """Keys of ``[robot]`` with ``type = "robot_link"``."""

    address: str
    """Where the controller listens: ``tcp://host:port``."""
    watchdog_s: Annotated[float, Field(gt=0.0, le=600.0)] = _TIMES.watchdog_s
    """The controller's own: so long without a word from us it stops. A shorter one of the controller is refused."""
    silence_s: Annotated[float, Field(ge=0.3, le=60.0)] = _TIMES.silence_s
    """No word from it for so long: the link is lost, and contact is left. It speaks every 50 ms."""
    stop_s: Annotated[float, Field(gt=0.0, le=60.0)] = _TIMES.stop_s
    """Longest that it takes to stop, or to lift the tool off."""


def _build(options: RobotLinkOptions, context: DeviceContext) -> RobotLink:
    address = tcp_address(options.address, context.base_dir, "robot_link")
    times = RobotTimes(options.silence_s, options.watchdog_s, options.stop_s, report_s=REPORT_S)
    return RobotLink(address, times)


ROBOT_LINK = DeviceType("robot_link", "robot", RobotLinkOptions, _build)
