"""Create drivers of shipped profiles."""

from __future__ import annotations

from pathlib import Path

from polishd.api import ActuatorTimes
from polishd.config.device_profile import DeviceProfile
from polishd.config.device_profile_checks import DEVICE_PROFILE_DIR, profile_of
from polishd.drivers.profile_device import build
from polishd.drivers.profile_device.drives import ProfiledActuator
from polishd.drivers.transport.address import SerialLine, Tcp

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"


def shipped(name: str) -> DeviceProfile:
    """Return the profile of that name, or of a file among the examples."""
    return profile_of(name, EXAMPLES)


def file_of(name: str) -> Path:
    """Return the path of a shipped profile or example."""
    return EXAMPLES / name if name.endswith(".toml") else DEVICE_PROFILE_DIR / f"{name}.toml"


def voice_coil_modbus(
    address: Tcp | SerialLine, times: ActuatorTimes | None = None, *, unit: int = 1
) -> ProfiledActuator:
    """Return the driver of the shipped actuator profile at a Modbus address."""
    return build.actuator(shipped("voice_coil_modbus"), address, times, unit=unit)


def voice_coil_serial(address: SerialLine | Tcp, times: ActuatorTimes | None = None) -> ProfiledActuator:
    """Return the driver of the shipped actuator profile on text lines."""
    return build.actuator(shipped("voice_coil_serial"), address, times)
