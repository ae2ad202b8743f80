"""The voice-coil actuator: the device types ``voice_coil_modbus`` and ``voice_coil_serial``, as their profiles say."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

from pydantic import Field

from polishd.api import ActuatorTimes, DeviceContext, DeviceType, ForceActuator, Unpowered, hookimpl
from polishd.config.device_profile_checks import profile_of
from polishd.config.fields import ConfigSection
from polishd.drivers.profile_device import build

POLISHD_API = 1

_TIMES = ActuatorTimes()

Seconds = Annotated[float, Field(gt=0.0, le=60.0)]


class VoiceCoilOptions(ConfigSection):
    """Keys of ``[actuator]`` besides ``type``."""

    address: str
    """``serial:PATH?baud=115200`` or ``tcp://host:port``."""
    watchdog_ms: Annotated[int, Field(ge=100, le=5000)] = round(1000 * _TIMES.watchdog_s)
    """Time without a heartbeat after which the actuator retracts. Heartbeats come every 50 ms."""
    silence_s: Annotated[float, Field(ge=0.2, le=5.0)] = _TIMES.silence_s
    """No answer for so long: spindle off, and the robot takes the tool away."""
    landing_s: Seconds = _TIMES.landing_s
    """No contact after so long is a fault."""
    release_s: Seconds = _TIMES.release_s
    """Longest from the order to force off."""
    retract_s: Seconds = _TIMES.retract_s
    """Longest time from force off until the actuator reports the tool up. Motion continues until then."""
    stroke_mm: Annotated[float, Field(gt=0.0, le=500.0)] = _TIMES.stroke_mm
    """How far the tool can follow the part: a robot that lifts it off goes that far, and a margin."""
    unpowered: Unpowered = "lifts"
    """What its tool does without power: a spring or its weight `lifts` it, it `stays`, which needs a robot that takes
    the tool away, or it `presses`, which is refused."""

    @property
    def times(self) -> ActuatorTimes:
        """As the port wants them."""
        return ActuatorTimes(
            silence_s=self.silence_s,
            watchdog_s=self.watchdog_ms / 1000,
            landing_s=self.landing_s,
            release_s=self.release_s,
            retract_s=self.retract_s,
            stroke_mm=self.stroke_mm,
            unpowered=self.unpowered,
            keys={"watchdog_s": "watchdog_ms"},
        )


class ModbusOptions(VoiceCoilOptions):
    """With ``type = "voice_coil_modbus"``: RTU on a serial line, Modbus TCP on tcp://."""

    unit: Annotated[int, Field(ge=1, le=247)] = 1
    """Modbus unit number. [1]"""


def _build(name: str, options: VoiceCoilOptions, unit: int | None, context: DeviceContext) -> ForceActuator:
    profile = profile_of(name, context.base_dir)
    return build.actuator(
        profile, build.address_of(profile, options.address, context.base_dir), options.times, unit=unit
    )


def _build_modbus(options: ModbusOptions, context: DeviceContext) -> ForceActuator:
    return _build("voice_coil_modbus", options, options.unit, context)


def _build_serial(options: VoiceCoilOptions, context: DeviceContext) -> ForceActuator:
    return _build("voice_coil_serial", options, None, context)


@hookimpl
def polishd_device_types() -> Sequence[DeviceType]:
    """``voice_coil_modbus``, ``voice_coil_serial``."""
    return [
        DeviceType(
            "voice_coil_modbus",
            "actuator",
            ModbusOptions,
            _build_modbus,
            simulated_by="actuator",
            substitute={"silence_s": 1.0, "watchdog_ms": 2000},
        ),
        DeviceType("voice_coil_serial", "actuator", VoiceCoilOptions, _build_serial, simulated_by="actuator"),
    ]
