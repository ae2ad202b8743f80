"""The device type ``linuxcnc``: a robot behind LinuxCNC's linuxcncrsh (docs/protocols/linuxcnc.md)."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Annotated

from pydantic import Field

from polishd.api import DeviceContext, DeviceType, OwnLines
from polishd.config.values import ConfigSection
from polishd.drivers.linuxcnc.driver import TIMES, LinuxCnc
from polishd.drivers.transport.address import tcp_address


class LinuxCncOptions(ConfigSection):
    """Keys of ``[robot]`` with ``type = "linuxcnc"``."""

    address: str
    """``tcp://host:port`` of linuxcncrsh."""
    program_dir: str
    """Folder that programs are written to, and that LinuxCNC can read."""
    controller_dir: str = ""
    """How LinuxCNC calls that folder, where it lies on another machine."""
    password: str = Field("EMC", pattern=r"^\S+$")
    """linuxcncrsh's `--connectpw`; no blanks."""
    enable_password: str = Field("EMCTOO", pattern=r"^\S+$")
    """linuxcncrsh's `--enablepw`; no blanks."""
    silence_s: Annotated[float, Field(ge=0.3, le=60.0)] = 0.6
    """No answer for so long: the link is lost, and contact is left. On an idle computer it answers within 0.1 s."""
    watchdog_s: Annotated[float, Field(gt=0.0, le=600.0)] | None = None
    """Of a watchdog in HAL that pauses the program when nobody talks to it; without one it runs to the end."""
    stop_s: Annotated[float, Field(gt=0.0, le=60.0)] = 2.0
    """Longest that it takes to stop."""


def _build(options: LinuxCncOptions, context: DeviceContext) -> LinuxCnc:
    address = tcp_address(options.address, context.base_dir, "linuxcnc")
    watchdog_s = options.watchdog_s or math.inf
    return LinuxCnc(
        address,
        (context.base_dir / options.program_dir).absolute(),
        replace(TIMES, silence_s=options.silence_s, watchdog_s=watchdog_s, stop_s=options.stop_s),
        controller_dir=options.controller_dir,
        passwords=(options.password, options.enable_password),
    )


def _own_lines(_options: LinuxCncOptions, _context: DeviceContext) -> OwnLines:
    """The pauses before landings, and the end that the driver adds."""
    return OwnLines("LinuxCNC, which runs RS274", {}, ("M0", "M2"))


LINUXCNC = DeviceType("linuxcnc", "robot", LinuxCncOptions, _build, own_lines=_own_lines)
