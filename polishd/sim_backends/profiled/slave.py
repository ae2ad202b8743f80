"""What answers for a profile's device, by its link."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Protocol

from polishd.sim_backends.actuator.modbus import RtuSlave, TcpSlave
from polishd.sim_backends.profiled.lines import LineSlave
from polishd.sim_backends.profiled.machine import ProfileDeviceModel
from polishd.sim_backends.profiled.registers import ProfileRegisters
from polishd.sim_backends.profiled.sheet import SimDeviceProfile


class Slave(Protocol):
    """Takes bytes, gives answers."""

    def feed(self, data: bytes, now_s: float, /) -> Iterable[tuple[int, bytes]]:
        """(bytes of the request, answer) for each whole request."""
        ...


def by_profile(sheet: SimDeviceProfile, machine: ProfileDeviceModel, unit: int, *, tcp: bool) -> Slave:
    """For one connection."""
    if "lines" in sheet.raw:
        return LineSlave(sheet, machine)
    answer = ProfileRegisters(sheet, machine).answer
    return TcpSlave(unit, answer) if tcp else RtuSlave(unit, answer)
