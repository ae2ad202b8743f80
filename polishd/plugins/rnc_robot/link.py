"""The device type ``robot_link``: a robot that speaks docs/protocols/robot_link.md."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict

from polishd.api import ConfigError, DeviceContext, DeviceType
from polishd.drivers.robot_link import RobotLink
from polishd.drivers.transport.address import Tcp, parse_address


class RobotLinkOptions(BaseModel):
    """Keys of ``[robot]`` with ``type = "robot_link"``."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)

    address: str
    """``tcp://host:port``."""


def _build(options: RobotLinkOptions, context: DeviceContext) -> RobotLink:
    address = parse_address(options.address, context.base_dir)
    if not isinstance(address, Tcp):
        raise ConfigError(f"[robot] address {options.address!r}: robot_link runs over tcp:// only")
    return RobotLink(address)


ROBOT_LINK = DeviceType("robot_link", "robot", RobotLinkOptions, _build)
