"""The voice coil's ASCII wire: docs/protocols/voice_coil_serial.md."""

from polishd.api import ActuatorTimes
from polishd.drivers.transport.address import SerialLine, Tcp
from polishd.drivers.transport.voice_coil import VoiceCoil
from polishd.drivers.voice_coil_serial.wire import AsciiWire

__all__ = ["AsciiWire", "voice_coil_serial"]


def voice_coil_serial(address: SerialLine | Tcp, times: ActuatorTimes | None = None) -> VoiceCoil:
    """The actuator on a serial line (or behind a terminal server); opens nothing."""
    times = times or ActuatorTimes()
    return VoiceCoil(AsciiWire(address, times.silence_s), times)
