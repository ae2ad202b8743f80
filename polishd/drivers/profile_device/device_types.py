"""Device types ``actuator_profile``, ``spindle_profile``, ``force_sensor_profile`` (docs/how-to/devices.md)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any

from pydantic import BaseModel, Field

from polishd.api import (
    ActuatorTimes,
    ConfigError,
    DeviceContext,
    DeviceType,
    ForceActuator,
    ForceSensor,
    SensorTimes,
    Spindle,
    SpindleTimes,
)
from polishd.config.device_profile import DeviceProfile, Kind
from polishd.config.device_profile_checks import profile_of
from polishd.config.fields import ConfigSection

A: dict[Kind, str] = {"actuator": "an actuator", "spindle": "a spindle", "force_sensor": "a force sensor"}
Seconds = Annotated[float, Field(gt=0.0, le=120.0)]


class ProfileOptions(ConfigSection):
    """Keys of each section whose device uses a profile."""

    profile: str
    """Name of a profile that polishd has (``polishd device list``), or your own profile file ``NAME.toml``."""
    address: str
    """``serial:PATH?baud=9600&parity=even&stop_bits=1`` or ``tcp://host:port``; default settings: the profile's."""
    unit: Annotated[int, Field(ge=0, le=247)] | None = None
    """Modbus unit number; default: the profile's. [1]"""


class ProfileActuatorOptions(ProfileOptions):
    """Keys of ``[actuator]`` with ``type = "actuator_profile"``. Omitted times are the profile's."""

    silence_s: Annotated[float, Field(ge=0.2, le=5.0)] = ActuatorTimes().silence_s
    """Longest time without an answer; then the spindle is switched off and the robot lifts the tool."""
    watchdog_s: Annotated[float, Field(ge=0.1, le=60.0)] | None = None
    """The actuator's watchdog: after this time without a request it takes the force off and lifts the tool."""
    landing_s: Seconds | None = None
    """Longest time of landing; no contact by then is a fault."""
    release_s: Seconds | None = None
    """Longest time from the command to force off."""
    retract_s: Seconds | None = None
    """Longest time from force off until the actuator reports that the tool is up. Motion goes on until then."""
    stroke_mm: Annotated[float, Field(gt=0.0, le=500.0)] | None = None
    """Distance that the tool can follow the part: a robot that lifts the tool goes that far, and a margin."""


class ProfileSpindleOptions(ProfileOptions):
    """Keys of ``[spindle]`` with ``type = "spindle_profile"``. Omitted times are the profile's."""

    pole_pairs: Annotated[int, Field(ge=1, le=24)] = 1
    """Pole pairs of the motor, for drives that count in Hz: 50 Hz are 3000 rpm with one, 1500 rpm with two. [1]"""
    silence_s: Annotated[float, Field(ge=0.2, le=60.0)] = SpindleTimes().silence_s
    """Longest time without an answer; then the link is lost."""
    watchdog_s: Annotated[float, Field(ge=0.1, le=60.0)] | None = None
    """The drive's watchdog: after this time without a request it stops. The driver sends requests every 100 ms."""
    spin_s: Seconds | None = None
    """Longest time from standstill to any speed, or back."""


class ForceSensorOptions(ProfileOptions):
    """Keys of ``[force_sensor]`` with ``type = "force_sensor_profile"``. Omitted times are the profile's."""

    silence_s: Annotated[float, Field(ge=0.15, le=5.0)] = SensorTimes().silence_s
    """Longest time without a new reading; then contact is left, as with a silent actuator."""
    delay_s: Annotated[float, Field(ge=0.0, le=5.0)] | None = None
    """Longest delay from a force to its reading: the amplifier's filter and the link."""
    tare_s: Annotated[float, Field(gt=0.0, le=60.0)] | None = None
    """Longest time from the tare command until the sensor reads 0."""


def _profile(options: ProfileOptions, context: DeviceContext, kind: Kind) -> DeviceProfile:
    profile = profile_of(options.profile, context.base_dir)
    if profile.kind != kind:
        raise ConfigError(f"profile {options.profile!r} is of {A[profile.kind]}, not of {A[kind]}. Name another.")
    if options.unit is not None and profile.link != "modbus":
        raise ConfigError(
            f"unit {options.unit}: profile {options.profile!r} uses lines, which have no unit number. Remove the key."
        )
    return profile


def _times(options: BaseModel, table: Any, names: Sequence[str]) -> dict[str, Any]:
    """Values of the section, completed from the profile."""
    given = {name: getattr(options, name) for name in names}
    return {name: getattr(table, name) if value is None else value for name, value in given.items()}


def _actuator(options: ProfileActuatorOptions, context: DeviceContext) -> ForceActuator:
    from polishd.drivers.profile_device import build  # imports pymodbus, which is slow

    profile = _profile(options, context, "actuator")
    names = ("watchdog_s", "landing_s", "release_s", "retract_s", "stroke_mm")
    table: Any = profile.actuator  # as its kind says
    times = ActuatorTimes(options.silence_s, unpowered=table.unpowered, **_times(options, table, names))
    address = build.address_of(profile, options.address, context.base_dir)
    return build.actuator(profile, address, times, unit=options.unit)


def _spindle(options: ProfileSpindleOptions, context: DeviceContext) -> Spindle:
    from polishd.drivers.profile_device import build

    profile = _profile(options, context, "spindle")
    times = SpindleTimes(options.silence_s, **_times(options, profile.spindle, ("watchdog_s", "spin_s")))
    address = build.address_of(profile, options.address, context.base_dir)
    return build.spindle(profile, address, times, unit=options.unit, pole_pairs=options.pole_pairs)


def _force_sensor(options: ForceSensorOptions, context: DeviceContext) -> ForceSensor:
    from polishd.drivers.profile_device import build

    profile = _profile(options, context, "force_sensor")
    times = SensorTimes(options.silence_s, **_times(options, profile.force_sensor, ("delay_s", "tare_s")))
    address = build.address_of(profile, options.address, context.base_dir)
    return build.force_sensor(profile, address, times, unit=options.unit)


DEVICE_TYPES = [
    DeviceType("actuator_profile", "actuator", ProfileActuatorOptions, _actuator, simulated_by="actuator"),
    DeviceType("spindle_profile", "spindle", ProfileSpindleOptions, _spindle, simulated_by="profile_device"),
    DeviceType(
        "force_sensor_profile",
        "force_sensor",
        ForceSensorOptions,
        _force_sensor,
        simulated_by="force_sensor",
        substitute={"profile": "force_sensor_line"},
    ),
]
