"""The robot: the program format ``rs274``, and the device type ``robot_link``."""

from __future__ import annotations

from collections.abc import Sequence

from polishd.api import DeviceType, ProgramFormat, hookimpl
from polishd.plugins.rnc_robot.rs274 import RS274

POLISHD_API = 1


@hookimpl
def polishd_program_formats() -> Sequence[ProgramFormat]:
    """``rs274``."""
    return [RS274]


@hookimpl
def polishd_device_types() -> Sequence[DeviceType]:
    """``robot_link``. Imported late: the compute worker reads programs and needs no driver."""
    from polishd.plugins.rnc_robot.link import ROBOT_LINK

    return [ROBOT_LINK]
