"""The device type ``universal_robots``: a robot on a Universal Robots controller (docs/universal-robots.md)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Literal

from pydantic import Field

from polishd.api import DeviceContext, DeviceRefused, DeviceType, RobotTimes, hookimpl
from polishd.config.values import ConfigSection
from polishd.drivers.transport.address import tcp_address
from polishd.drivers.universal_robots.driver import Addresses, UniversalRobot
from polishd.drivers.universal_robots.sample import UrRegisters
from polishd.drivers.universal_robots.script import Settings, blocks_of

POLISHD_API = 1

WAY_S = 0.02
"""Longest that a sample is under way."""
Port = Annotated[int, Field(ge=1, le=65535)]


class UniversalRobotsOptions(ConfigSection):
    """Keys of ``[robot]`` with ``type = "universal_robots"``."""

    address: str
    """RTDE of the controller: ``tcp://host:30004``."""
    dashboard_port: Port = 29999
    """TCP port of its dashboard server. [1]"""
    primary_port: Port = 30001
    """TCP port of its primary client interface, which takes scripts. [1]"""
    rate_hz: Annotated[float, Field(ge=10.0, le=500.0)] = 125.0
    """How often the controller tells where it is: a block's end is known to one period. e-Series: up to 500. [Hz]"""
    first_register: Annotated[int, Field(ge=0, le=43)] = 24
    """Of the controller's integer registers, five inputs and four outputs from here on are polishd's. [1]"""
    tool_z: Literal["into_part", "out_of_part"] = "into_part"
    """Where the tool frame's z points: a lift goes the other way. As in the program's dialect."""
    watchdog_s: Annotated[float, Field(gt=0.0, le=600.0)] = 8.0
    """So long without a word from us the controller stops the program."""
    silence_s: Annotated[float, Field(ge=0.3, le=60.0)] = 1.0
    """No sample for so long: the link is lost, and contact is left."""
    stop_s: Annotated[float, Field(gt=0.0, le=60.0)] = 5.0
    """Longest that it takes to stop, or to lift the tool off."""


def _build(options: UniversalRobotsOptions, context: DeviceContext) -> UniversalRobot:
    address = tcp_address(options.address, context.base_dir, "universal_robots")
    report_s = 2.0 / options.rate_hz + WAY_S
    times = RobotTimes(options.silence_s, options.watchdog_s, options.stop_s, report_s=report_s)
    addresses = Addresses.of(address.host, address.port, options.dashboard_port, options.primary_port)
    settings = Settings(UrRegisters(options.first_register), options.watchdog_s, options.tool_z == "into_part")
    return UniversalRobot(addresses, settings, times, options.rate_hz)


def _takes(blocks: Sequence[bytes]) -> str:
    """URScript is its only language."""
    try:
        blocks_of(blocks)
    except DeviceRefused as refusal:
        return str(refusal)
    return ""


@hookimpl
def polishd_device_types() -> Sequence[DeviceType]:
    """One."""
    return [DeviceType("universal_robots", "robot", UniversalRobotsOptions, _build, _takes)]
