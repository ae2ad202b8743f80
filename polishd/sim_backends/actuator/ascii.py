"""The actuator on a serial line of text (docs/protocols/voice_coil_serial.md)."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import reduce
from operator import xor

from polishd.sim_backends.actuator.coil import VoiceCoil

MAX_LINE = 120
_TEXTS = {"range": "value out of range", "fault": "a fault is set", "unknown": "no such request"}


def line(body: str) -> bytes:
    """A line of the protocol."""
    data = body.encode("ascii")
    return b"$%s*%02X\r\n" % (data, reduce(xor, data, 0))


def body(data: bytes) -> str | None:
    """The body of a line without its end, or None if it is broken."""
    star = len(data) - 3
    if not data.startswith(b"$") or star < 1 or data[star : star + 1] != b"*" or len(data) > MAX_LINE:
        return None
    text = data[1:star]
    if data[star + 1 :] != b"%02X" % reduce(xor, text, 0) or not text.isascii():
        return None
    return text.decode("ascii")


@dataclass(slots=True)
class AsciiSlave:
    """Answers each intact line by one line."""

    coil: VoiceCoil
    identity: str
    """``vendor,model,serial,firmware,boot_count``."""
    _buffer: bytes = b""

    def feed(self, data: bytes, _now_s: float) -> Iterable[tuple[int, bytes]]:
        """(bytes of the request, answer) for each whole request."""
        self._buffer += data
        while b"\n" in self._buffer:
            raw, self._buffer = self._buffer.split(b"\n", 1)
            text = body(raw.rstrip(b"\r"))
            number, _, request = (text or "").partition(",")
            if number.isdigit() and int(number) <= 65535:
                yield len(raw) + 1, line(f"{number},{self._answer(request)}")
        self._buffer = self._buffer[-MAX_LINE:]

    def _answer(self, request: str) -> str:
        coil = self.coil
        if request == "ID?":
            return f"ID,{self.identity}"
        if request == "ST?":
            setpoint = coil.setpoint_n if coil.engaged else 0.0
            return f"ST,{coil.state},{coil.measured_n:.2f},{setpoint:.2f},{round(coil.position_um)},{coil.faults}"
        refusal = self._command(request)
        return f"ERR,{refusal},{_TEXTS[refusal]}" if refusal else "OK"

    def _command(self, request: str) -> str:
        coil = self.coil
        name, _, value = request.partition(",")
        try:
            if name == "F":
                return coil.set_force(float(value))
            if name == "WD":
                return coil.set_watchdog(int(value))
        except ValueError:
            return "range"
        if request == "HB":
            return coil.feed(coil.heartbeat + 1)
        commands = {"ENG": coil.engage, "RET": coil.retract}
        return commands[request]() if request in commands else "unknown"
