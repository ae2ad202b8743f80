"""The voice coil's Modbus wire, RTU or TCP: docs/protocols/voice_coil_modbus.md."""

from polishd.drivers.transport.address import SerialLine, Tcp
from polishd.drivers.transport.voice_coil import VoiceCoil
from polishd.drivers.voice_coil_modbus.wire import ModbusWire

__all__ = ["ModbusWire", "voice_coil_modbus"]


def voice_coil_modbus(
    address: Tcp | SerialLine, *, unit: int = 1, watchdog_ms: int = 500, landing_s: float = 10.0
) -> VoiceCoil:
    """The actuator at a Modbus address; opens nothing."""
    return VoiceCoil(ModbusWire(address, unit), watchdog_ms=watchdog_ms, landing_s=landing_s)
