"""The voice coil's ASCII wire: docs/protocols/voice_coil_serial.md."""

from polishd.drivers.transport.address import SerialLine, Tcp
from polishd.drivers.transport.voice_coil import VoiceCoil
from polishd.drivers.voice_coil_serial.wire import AsciiWire

__all__ = ["AsciiWire", "voice_coil_serial"]


def voice_coil_serial(address: SerialLine | Tcp, *, watchdog_ms: int = 500, landing_s: float = 10.0) -> VoiceCoil:
    """The actuator on a serial line (or behind a terminal server); opens nothing."""
    return VoiceCoil(AsciiWire(address), watchdog_ms=watchdog_ms, landing_s=landing_s)
