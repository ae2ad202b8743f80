"""The voice-coil actuator, over Modbus or ASCII lines: docs/protocols/voice_coil_modbus.md, voice_coil_serial.md."""

from polishd.api import ActuatorTimes
from polishd.drivers.transport.address import SerialLine, Tcp
from polishd.drivers.voice_coil.ascii import AsciiWire
from polishd.drivers.voice_coil.device import VoiceCoil
from polishd.drivers.voice_coil.modbus import ModbusWire

__all__ = ["voice_coil_modbus", "voice_coil_serial"]


def voice_coil_modbus(address: Tcp | SerialLine, times: ActuatorTimes | None = None, *, unit: int = 1) -> VoiceCoil:
    """The actuator at a Modbus address, RTU or TCP; opens nothing."""
    times = times or ActuatorTimes()
    return VoiceCoil(ModbusWire(address, unit, times.silence_s), times)


def voice_coil_serial(address: SerialLine | Tcp, times: ActuatorTimes | None = None) -> VoiceCoil:
    """The actuator on a serial line of text (or behind a terminal server); opens nothing."""
    times = times or ActuatorTimes()
    return VoiceCoil(AsciiWire(address, times.silence_s), times)
