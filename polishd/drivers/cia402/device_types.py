"""Drives off the shelf on CANopen: the device types ``cia402_spindle`` and ``cia402_actuator``."""

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

SIMULATED_EDS = Path(__file__).with_name("simulated_drive.eds")
"""EDS file of the simulated drive (polishd/sim_backends/cia402)."""
SIMULATED_SPINDLE: Mapping[str, Any] = {"node": 5, "rpm_per_unit": 0.1}
"""Keys of ``[spindle]`` that the simulated drive needs, besides its type, its address and its EDS file."""

_ACTUATOR, _SPINDLE = ActuatorTimes(), SpindleTimes()

T = TypeVar("T")

LEAST_BITRATE = 125_000
"""Polling takes about 20 kbit/s."""

Node = Annotated[int, Field(ge=1, le=127)]
Seconds = Annotated[float, Field(gt=0.0, le=60.0)]
Positive = Annotated[float, Field(gt=0.0, le=1e6)]
Scale = Annotated[float, Field(ge=-1e6, le=1e6)]


class DriveOptions(ConfigSection):
    """Keys that both kinds of drive have besides ``type``."""

    address: str
    """``slcan:PATH?bitrate=500000`` or ``socketcand://host:port/channel``."""
    eds: str
    """The drive's EDS file, from its maker; relative to the config file's folder."""
    node: Node
    """CANopen node number of the drive. [1]"""
    controller_node: Node | None = None
    """Node number of our own heartbeat, no other's on the bus; None: `node` + 64, or - 64 above 63. [1]"""

    @property
    def controller(self) -> int:
        """Whose heartbeat the drive is to listen for."""
        if self.controller_node is not None:
            return self.controller_node
        return self.node + 64 if self.node < 64 else max(self.node - 64, 1)


class Cia402SpindleOptions(DriveOptions):
    """Keys of ``[spindle]`` with ``type = "cia402_spindle"``."""

    rpm_per_unit: Scale = 1.0
    """What 606Ch and 60FFh count in, as the drive is parametrised; negative: it turns the other way round. [rpm]"""
    max_rpm: Positive = 3000.0
    """Fastest that it may turn; the drive's own 6080h counts too, where it has one."""
    acceleration_rpm_s: Positive = 1000.0
    """Ramp up: 6083h. [rpm/s]"""
    deceleration_rpm_s: Positive = 1000.0
    """Ramp to a lower speed: 6084h. [rpm/s]"""
    quick_stop_rpm_s: Positive = 3000.0
    """Ramp of a stop, also of that by itself: 6085h. [rpm/s]"""
    silence_s: Annotated[float, Field(ge=0.3, le=60.0)] = _SPINDLE.silence_s
    """No answer, or no heartbeat, for so long: the link is lost. The drive's heartbeat comes every 0.1 s."""
    watchdog_s: Annotated[float, Field(ge=0.3, le=60.0)] = _SPINDLE.watchdog_s
    """It hears no heartbeat of ours for so long (1016h): it stops by itself."""
    spin_s: Annotated[float, Field(gt=0.0, le=120.0)] = _SPINDLE.spin_s
    """Longest from standstill to any speed, or back."""


class Cia402ActuatorOptions(DriveOptions):
    """Keys of ``[actuator]`` with ``type = "cia402_actuator"``."""

    n_per_permille: Scale
    """Force of 1 permille of rated torque (6071h, 6077h); negative: a positive torque lifts. [N]"""
    mm_per_increment: Scale
    """Of 6064h; negative: it counts down while the tool goes out. [mm]"""
    rest_increments: int = 0
    """6064h with the tool up. [1]"""
    rest_mm: Annotated[float, Field(gt=0.0, le=10.0)] = 0.1
    """So near to that the tool counts as up."""
    balance_n: Annotated[float, Field(ge=0.0, le=1000.0)]
    """What lifts the tool without current, spring or counterweight: the motor presses so much more."""
    max_n: Annotated[float, Field(gt=0.0, le=1000.0)] = 50.0
    """More is refused."""
    landing_n: Annotated[float, Field(gt=0.0, le=1000.0)] = 1.0
    """It lands with that at most."""
    slope_n_s: Positive = 500.0
    """How fast the force changes: 6087h. [N/s]"""
    travel_mm_s: Positive = 1.0
    """Going out slower than that, the tool is on the part; faster, in the air. Below the speed of landing."""
    max_speed: Annotated[int, Field(gt=0)] | None = None
    """6080h, in the drive's own unit: no faster does it land. None: left as the drive has it. [1]"""
    lift: Literal["spring", "torque", "position"] = "spring"
    """How it is lifted: by what lifts it without current; that and `lift_n`; or in profile position, at `lift_mm_s`."""
    lift_n: Annotated[float, Field(gt=0.0, le=1000.0)] = 1.0
    """What the motor adds, with `torque`."""
    lift_mm_s: Positive = 10.0
    """With `position`: 6081h."""
    silence_s: Annotated[float, Field(ge=0.3, le=5.0)] = 0.5
    """No answer, or no heartbeat, for so long: spindle off, and the robot takes the tool away."""
    watchdog_s: Annotated[float, Field(ge=0.2, le=5.0)] = _ACTUATOR.watchdog_s
    """It hears no heartbeat of ours for so long (1016h): current off, and the tool is lifted without it."""
    landing_s: Seconds = _ACTUATOR.landing_s
    """No contact after so long is a fault."""
    release_s: Seconds = _ACTUATOR.release_s
    """Longest from the order to force off."""
    retract_s: Seconds = _ACTUATOR.retract_s
    """Longest from force off until it tells that the tool is up. Motion goes on until then."""
    stroke_mm: Annotated[float, Field(gt=0.0, le=500.0)] = _ACTUATOR.stroke_mm
    """How far the tool can follow the part: a robot that lifts it off goes that far, and a margin."""
    unpowered: Unpowered = "lifts"
    """What its tool does without power: what balances it `lifts` it, or it `stays`; one that `presses` is refused."""


def _place(options: Cia402SpindleOptions | Cia402ActuatorOptions, context: DeviceContext) -> CanNodeAddress:
    address = can_address(options.address, context.base_dir, "CANopen")
    if isinstance(address, SlcanAddress) and address.bitrate < LEAST_BITRATE:
        raise ConfigError(f"address {options.address!r}: at least {LEAST_BITRATE} bit/s are needed to ask often enough")
    if options.controller == options.node:
        raise ConfigError(f"controller_node {options.controller} is the drive's own: give our heartbeat another number")
    return CanNodeAddress(address, options.node, options.controller, options.silence_s, options.watchdog_s)


def _of(record: type[T], options: DriveOptions) -> T:
    """A record of the options that have the names of its fields."""
    known = {field.name for field in fields(cast("Any", record))} & set(type(options).model_fields)
    return record(**{name: getattr(options, name) for name in known})


def _build_spindle(options: Cia402SpindleOptions, context: DeviceContext) -> Spindle:
    if not options.rpm_per_unit:
        raise ConfigError("rpm_per_unit is 0: say what the drive's unit of velocity is")
    dictionary = read_dictionary(context.base_dir / options.eds, options.node)
    return Cia402Spindle(_place(options, context), dictionary, _of(SpindleScale, options), _of(SpindleTimes, options))


def _build_actuator(options: Cia402ActuatorOptions, context: DeviceContext) -> ForceActuator:
    if not (options.n_per_permille and options.mm_per_increment):
        raise ConfigError("n_per_permille or mm_per_increment is 0: say what the drive counts in")
    dictionary = read_dictionary(context.base_dir / options.eds, options.node)
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
