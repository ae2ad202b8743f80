"""A closed device from a profile and an address."""

from __future__ import annotations

from pathlib import Path

from polishd.api import ActuatorTimes, SensorTimes, SpindleTimes
from polishd.config.device_profile import DeviceProfile
from polishd.drivers.profiled.actuator import ProfiledActuator
from polishd.drivers.profiled.force_sensor import ProfiledForceSensor
from polishd.drivers.profiled.lines import LineWire
from polishd.drivers.profiled.modbus import ModbusWire
from polishd.drivers.profiled.spindle import ProfiledSpindle
from polishd.drivers.profiled.wire import ProfileTransport
from polishd.drivers.transport.address import SerialLine, Tcp, line_address


def usual_line(profile: DeviceProfile) -> SerialLine:
    """A serial line as the profile says, nowhere yet."""
    return SerialLine(Path(), profile.serial.baud, profile.serial.parity, profile.serial.stop_bits)


def address_of(profile: DeviceProfile, text: str, base_dir: Path) -> SerialLine | Tcp:
    """The address; what a serial one leaves out is as the profile says. ConfigError names it."""
    return line_address(text, base_dir, f"a device on {profile.link}", usual_line(profile))


def wire_of(
    profile: DeviceProfile, address: SerialLine | Tcp, silence_s: float, *, unit: int | None = None, pole_pairs: int = 1
) -> ProfileTransport:
    """The wire; opens nothing."""
    if profile.modbus:
        return ModbusWire(profile, address, silence_s, unit=unit, pole_pairs=pole_pairs)
    return LineWire(profile, address, silence_s, pole_pairs=pole_pairs)


def actuator(
    profile: DeviceProfile, address: SerialLine | Tcp, times: ActuatorTimes | None = None, *, unit: int | None = None
) -> ProfiledActuator:
    """A force actuator; opens nothing."""
    times = times or ActuatorTimes()
    return ProfiledActuator(wire_of(profile, address, times.silence_s, unit=unit), times)


def spindle(
    profile: DeviceProfile,
    address: SerialLine | Tcp,
    times: SpindleTimes | None = None,
    *,
    unit: int | None = None,
    pole_pairs: int = 1,
) -> ProfiledSpindle:
    """A spindle; opens nothing."""
    times = times or SpindleTimes()
    return ProfiledSpindle(wire_of(profile, address, times.silence_s, unit=unit, pole_pairs=pole_pairs), times)


def force_sensor(
    profile: DeviceProfile, address: SerialLine | Tcp, times: SensorTimes | None = None, *, unit: int | None = None
) -> ProfiledForceSensor:
    """A force sensor; opens nothing."""
    times = times or SensorTimes()
    return ProfiledForceSensor(wire_of(profile, address, times.silence_s, unit=unit), times)
