"""CiA 402 drives on CANopen: the device types ``cia402_spindle`` and ``cia402_actuator``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar, cast

from pydantic import Field

from polishd.api import (
    ActuatorTimes,
    ConfigError,
    DeviceContext,
    DeviceType,
    ForceActuator,
    Spindle,
    SpindleTimes,
    Unpowered,
)
from polishd.config.fields import ConfigSection
from polishd.drivers.cia402.actuator import ActuatorScale, Cia402Actuator
from polishd.drivers.cia402.drive import CanNodeAddress
from polishd.drivers.cia402.protocol import read_dictionary
from polishd.drivers.cia402.spindle import Cia402Spindle, SpindleScale
from polishd.drivers.transport.address import SlcanAddress, can_address
from polishd.util.files import named_path

LEAST_UNIT = 1e-9
"""Smallest size of a drive's unit: below it the numbers sent to the drive exceed any register."""
SIMULATED_EDS = Path(__file__).with_name("simulated_drive.eds")
"""EDS file of the simulated drive (polishd/sim_backends/cia402)."""
SIMULATED_SPINDLE: Mapping[str, Any] = {"node": 5, "rpm_per_unit": 0.1}
"""Keys of ``[spindle]`` for the simulated drive, besides type, address and EDS file."""

_ACTUATOR, _SPINDLE = ActuatorTimes(), SpindleTimes()

T = TypeVar("T")

LEAST_BITRATE = 125_000
"""Polling takes about 20 kbit/s."""

Node = Annotated[int, Field(ge=1, le=127)]
Seconds = Annotated[float, Field(gt=0.0, le=60.0)]
Positive = Annotated[float, Field(gt=0.0, le=1e6)]
Scale = Annotated[float, Field(ge=-1e6, le=1e6)]


class DriveOptions(ConfigSection):
    """Common keys of both kinds of drive besides ``type``."""

    address: str
    """``slcan:PATH?bitrate=500000`` or ``socketcand://host:port/channel``."""
    eds: str
    """EDS file of the drive, from its manufacturer; relative to the config file's folder."""
    node: Node
    """CANopen node number of the drive. [1]"""
    controller_node: Node | None = None
    """Node number of polishd's heartbeat, unique on the bus; None: `node` + 64, or - 64 above 63. [1]"""

    @property
    def controller(self) -> int:
        """Node number of the heartbeat that the drive monitors."""
        if self.controller_node is not None:
            return self.controller_node
        return self.node + 64 if self.node < 64 else max(self.node - 64, 1)


class Cia402SpindleOptions(DriveOptions):
    """Keys of ``[spindle]`` with ``type = "cia402_spindle"``."""

    rpm_per_unit: Scale = 1.0
    """Unit of 606Ch and 60FFh, as the drive is configured; negative: reversed direction. [rpm]"""
    max_rpm: Positive = 3000.0
    """Speed limit; the drive's 6080h also applies if it has one."""
    acceleration_rpm_s: Positive = 1000.0
    """Acceleration ramp: 6083h. [rpm/s]"""
    deceleration_rpm_s: Positive = 1000.0
    """Deceleration ramp: 6084h. [rpm/s]"""
    quick_stop_rpm_s: Positive = 3000.0
    """Ramp of a stop, also of the watchdog's: 6085h. [rpm/s]"""
    silence_s: Annotated[float, Field(ge=0.3, le=60.0)] = _SPINDLE.silence_s
    """Longest time without an answer or a heartbeat; then the link is lost. The drive sends a heartbeat every 0.1 s."""
    watchdog_s: Annotated[float, Field(ge=0.3, le=60.0)] = _SPINDLE.watchdog_s
    """The drive's watchdog (1016h): after this time without polishd's heartbeat it stops."""
    spin_s: Annotated[float, Field(gt=0.0, le=120.0)] = _SPINDLE.spin_s
    """Longest time from standstill to any speed, or back."""


class Cia402ActuatorOptions(DriveOptions):
    """Keys of ``[actuator]`` with ``type = "cia402_actuator"``."""

    n_per_permille: Scale
    """Force of 1 permille of rated torque (6071h, 6077h); negative: a positive torque lifts. [N]"""
    mm_per_increment: Scale
    """Unit of 6064h; negative: it counts down while the tool moves outward. [mm]"""
    rest_increments: int = 0
    """6064h with the tool up. [1]"""
    rest_mm: Annotated[float, Field(gt=0.0, le=10.0)] = 0.1
    """Distance from there within which the tool is up."""
    balance_n: Annotated[float, Field(ge=0.0, le=1000.0)]
    """Lifting force of the spring or counterweight without current; the motor adds it to the pressing force."""
    max_n: Annotated[float, Field(gt=0.0, le=1000.0)] = 50.0
    """Force limit; a larger force is refused."""
    landing_n: Annotated[float, Field(gt=0.0, le=1000.0)] = 1.0
    """Largest force of landing."""
    slope_n_s: Positive = 500.0
    """Slope of the force: 6087h. [N/s]"""
    travel_mm_s: Positive = 1.0
    """A tool that moves outward slower is on the part; faster, in the air. Below the landing speed."""
    max_speed: Annotated[int, Field(gt=0)] | None = None
    """6080h, the speed limit of landing, in the drive's unit. None: unchanged. [1]"""
    lift: Literal["spring", "torque", "position"] = "spring"
    """Lifting: by the spring or counterweight; by that and `lift_n`; or in profile position mode at `lift_mm_s`."""
    lift_n: Annotated[float, Field(gt=0.0, le=1000.0)] = 1.0
    """Lifting force of the motor, with `torque`."""
    lift_mm_s: Positive = 10.0
    """Lifting speed, with `position`: 6081h."""
    silence_s: Annotated[float, Field(ge=0.3, le=5.0)] = 0.5
    """Longest time without an answer or a heartbeat; then the spindle stops and the robot lifts the tool."""
    watchdog_s: Annotated[float, Field(ge=0.2, le=5.0)] = _ACTUATOR.watchdog_s
    """The drive's watchdog (1016h): after this time without polishd's heartbeat its current is off, the tool lifts."""
    landing_s: Seconds = _ACTUATOR.landing_s
    """Longest time of landing; no contact by then is a fault."""
    release_s: Seconds = _ACTUATOR.release_s
    """Longest time from the command to force off."""
    retract_s: Seconds = _ACTUATOR.retract_s
    """Longest time from force off until the actuator reports that the tool is up. Motion goes on until then."""
    stroke_mm: Annotated[float, Field(gt=0.0, le=500.0)] = _ACTUATOR.stroke_mm
    """Distance that the tool can follow the part: a robot that lifts the tool goes that far, and a margin."""
    unpowered: Unpowered = "lifts"
    """Motion of the tool without power: the counterbalance `lifts` it, or it `stays`; one that `presses` is refused."""


def _place(options: Cia402SpindleOptions | Cia402ActuatorOptions, context: DeviceContext) -> CanNodeAddress:
    address = can_address(options.address, context.base_dir, "CANopen")
    if isinstance(address, SlcanAddress) and address.bitrate < LEAST_BITRATE:
        raise ConfigError(f"address {options.address!r}: at least {LEAST_BITRATE} bit/s are needed for polling")
    if options.controller == options.node:
        raise ConfigError(f"controller_node {options.controller} is the drive's node number. Set another number.")
    return CanNodeAddress(address, options.node, options.controller, options.silence_s, options.watchdog_s)


def _of(record: type[T], options: DriveOptions) -> T:
    """Build a record from the options with the names of its fields."""
    known = {field.name for field in fields(cast("Any", record))} & set(type(options).model_fields)
    return record(**{name: getattr(options, name) for name in known})


def _build_spindle(options: Cia402SpindleOptions, context: DeviceContext) -> Spindle:
    if abs(options.rpm_per_unit) < LEAST_UNIT:
        raise ConfigError(f"rpm_per_unit is {options.rpm_per_unit:g}. Set the drive's unit of velocity.")
    dictionary = read_dictionary(named_path(context.base_dir, options.eds), options.node)
    return Cia402Spindle(_place(options, context), dictionary, _of(SpindleScale, options), _of(SpindleTimes, options))


def _build_actuator(options: Cia402ActuatorOptions, context: DeviceContext) -> ForceActuator:
    if min(abs(options.n_per_permille), abs(options.mm_per_increment)) < LEAST_UNIT:
        raise ConfigError("n_per_permille or mm_per_increment is 0, or nearly. Set the drive's units.")
    dictionary = read_dictionary(named_path(context.base_dir, options.eds), options.node)
    place, scale = _place(options, context), _of(ActuatorScale, options)
    return Cia402Actuator(place, dictionary, scale, _of(ActuatorTimes, options))


USUAL_ADDRESS = "slcan:/dev/ttyACM0?bitrate=500000"
DEVICE_TYPES = [
    DeviceType(
        "cia402_spindle",
        "spindle",
        Cia402SpindleOptions,
        _build_spindle,
        simulated_by="cia402",
        substitute={**SIMULATED_SPINDLE, "eds": str(SIMULATED_EDS), "silence_s": 1.5},
        usual_address=USUAL_ADDRESS,
    ),
    DeviceType(
        "cia402_actuator",
        "actuator",
        Cia402ActuatorOptions,
        _build_actuator,
        simulated_by="cia402",
        usual_address=USUAL_ADDRESS,
    ),
]
