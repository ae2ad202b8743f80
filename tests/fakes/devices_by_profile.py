"""Drivers of shipped profiles, ready to be opened."""

from __future__ import annotations

from pathlib import Path

from polishd.api import ActuatorTimes
from polishd.config.device_profile import DeviceProfile
from polishd.drivers.profiled import make
from polishd.drivers.profiled.actuator import ProfiledActuator
from polishd.drivers.profiled.shelf import profile_of
from polishd.drivers.transport.address import SerialLine, Tcp


def shipped(name: str) -> DeviceProfile:
    """The profile of that name."""
    return profile_of(name, Path())


def voice_coil_modbus(
    address: Tcp | SerialLine, times: ActuatorTimes | None = None, *, unit: int = 1
) -> ProfiledActuator:
    """Polishd's actuator at a Modbus address."""
    return make.actuator(shipped("voice_coil_modbus"), address, times, unit=unit)


def voice_coil_serial(address: SerialLine | Tcp, times: ActuatorTimes | None = None) -> ProfiledActuator:
    """Polishd's actuator on lines of text."""
    return make.actuator(shipped("voice_coil_serial"), address, times)
