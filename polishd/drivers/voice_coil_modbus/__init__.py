"""The voice coil's Modbus wire, RTU or TCP: docs/protocols/voice_coil_modbus.md."""

from polishd.api import ActuatorTimes
from polishd.drivers.transport.address import SerialLine, Tcp
from polishd.drivers.transport.voice_coil import VoiceCoil
from polishd.drivers.voice_coil_modbus.wire import ModbusWire

__all__ = ["ModbusWire", "voice_coil_modbus"]


def voice_coil_modbus(address: Tcp | SerialLine, times: ActuatorTimes | None = None, *, unit: int = 1) -> VoiceCoil:
    """The actuator at a Modbus address; opens nothing."""
    times = times or ActuatorTimes()
    return VoiceCoil(ModbusWire(address, unit, times.silence_s), times)
