"""The robot: RNC programs in all dialects, and the device types ``robot_link`` and ``linuxcnc``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from polishd.api import DeviceType, ProgramFormat, hookimpl
from polishd.plugins.rnc_robot.dialect import dialect
from polishd.plugins.rnc_robot.formats import format_of, shipped_formats

POLISHD_API = 1


@hookimpl
def polishd_program_formats(profiles: Sequence[Path]) -> Sequence[ProgramFormat]:
    """One a shipped dialect, and one a profile of the user's."""
    return [*shipped_formats(), *map(format_of, map(dialect, profiles))]


@hookimpl
def polishd_device_types() -> Sequence[DeviceType]:
    """``robot_link`` and ``linuxcnc``. Imported late: the compute worker reads programs and needs no driver."""
    from polishd.drivers.linuxcnc.driver import LINUXCNC
    from polishd.drivers.robot_link.driver import ROBOT_LINK

    return [ROBOT_LINK, LINUXCNC]
