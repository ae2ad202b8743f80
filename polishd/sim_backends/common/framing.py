"""The actuator on a serial line of text (docs/protocols/voice_coil_serial.md)."""

from __future__ import annotations

import json
import struct
import zlib
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import reduce
from operator import xor
from typing import Any

from polishd.sim_backends.common.voice_coil import VoiceCoil

MAX_LINE = 120
_TEXTS = {"range": "value out of range", "fault": "a fault is set", "unknown": "no such request"}


def line(body: str) -> bytes:
    """Format a line of the protocol."""
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
    """Answer each intact line by one line."""

    coil: VoiceCoil
    identity: str
    """``vendor,model,serial,firmware,boot_count``."""
    _buffer: bytes = b""

    def feed(self, data: bytes, _now_s: float) -> Iterable[tuple[int, bytes]]:
        """Return (bytes of the request, answer) for each whole request."""
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


# The actuator on Modbus: the register table and the RTU and TCP frames (docs/protocols/voice_coil_modbus.md).

ILLEGAL_FUNCTION, ILLEGAL_ADDRESS, ILLEGAL_VALUE, DEVICE_FAILURE = 1, 2, 3, 4
_CODES = {"": 0, "range": ILLEGAL_VALUE, "fault": DEVICE_FAILURE}
_LONG = {15, 16}
"""Functions whose requests contain their length; all others have 8 bytes."""


def crc16(data: bytes) -> int:
    """Return the CRC of Modbus RTU."""
    crc = 0xFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = (crc >> 1) ^ (0xA001 if crc & 1 else 0)
    return crc


def rtu(unit: int, pdu: bytes) -> bytes:
    """Return an RTU frame."""
    body = bytes([unit]) + pdu
    return body + struct.pack("<H", crc16(body))


@dataclass(slots=True)
class CoilRegisters:
    """The register table over a voice coil."""

    coil: VoiceCoil
    vendor: str
    model: str
    serial: str
    firmware: str
    boot_count: int

    def answer(self, pdu: bytes) -> bytes:
        """Return the answer to a request PDU."""
        function = pdu[0]
        if function in {3, 4} and len(pdu) == 5:
            result = self._read(function, *struct.unpack(">HH", pdu[1:]))
        elif function == 6 and len(pdu) == 5:
            address, value = struct.unpack(">HH", pdu[1:])
            result = self._write(address, [value]) or pdu
        elif function == 16 and len(pdu) >= 6 and len(pdu) == 6 + pdu[5] and pdu[5] == 2 * (pdu[3] << 8 | pdu[4]):
            address, count = struct.unpack(">HH", pdu[1:5])
            result = self._write(address, list(struct.unpack(f">{count}H", pdu[6:]))) or pdu[:5]
        else:
            result = ILLEGAL_FUNCTION if function not in {3, 4, 6, 16} else ILLEGAL_VALUE
        return bytes([function | 0x80, result]) if isinstance(result, int) else result

    def _read(self, function: int, address: int, count: int) -> bytes | int:
        if not 1 <= count <= 125:
            return ILLEGAL_VALUE
        table = self._inputs() if function == 4 else self._holding()
        values = [table.get(address + k) for k in range(count)]
        if any(value is None for value in values):
            return ILLEGAL_ADDRESS
        words = [(value or 0) & 0xFFFF for value in values]
        return bytes([function, 2 * count]) + struct.pack(f">{count}H", *words)

    def _write(self, address: int, values: list[int]) -> int:
        """Write in order. Return 0, or the exception code of the first refusal."""
        if not values or address < 0 or address + len(values) > 4:
            return ILLEGAL_ADDRESS
        for k, value in enumerate(values):
            code = _CODES[self._write_one(address + k, value)]
            if code:
                return code
        return 0

    def _write_one(self, address: int, value: int) -> str:
        if address == 0:
            return {0: self.coil.retract, 1: self.coil.engage}.get(value, lambda: "range")()
        if address == 1:
            return self.coil.set_force(value / 100.0)
        return self.coil.set_watchdog(value) if address == 2 else self.coil.feed(value)

    def _holding(self) -> dict[int, int]:
        coil = self.coil
        return {0: int(coil.engaged), 1: round(coil.setpoint_n * 100), 2: coil.watchdog_ms, 3: coil.heartbeat}

    def _inputs(self) -> dict[int, int]:
        coil = self.coil
        force = round(coil.measured_n * 100)
        setpoint = round(coil.setpoint_n * 100) if coil.engaged else 0
        live = [coil.state, force, setpoint, round(coil.position_um), coil.faults, coil.heartbeat]
        table = dict(enumerate(live))
        for start, size, text in (
            (100, 8, self.vendor),
            (108, 8, self.model),
            (116, 8, self.serial),
            (124, 4, self.firmware),
        ):
            words = struct.unpack(f">{size}H", text.encode()[: 2 * size].ljust(2 * size, b"\0"))
            table.update(zip(range(start, start + size), words, strict=True))
        return {**table, 128: self.boot_count >> 16, 129: self.boot_count}


@dataclass(slots=True)
class RtuSlave:
    """Cut a serial stream into requests for one unit. Damaged frames and frames of other units get no answer."""

    unit: int
    answer: Callable[[bytes], bytes]
    _buffer: bytes = b""
    _last_s: float = 0.0

    def feed(self, data: bytes, now_s: float) -> Iterable[tuple[int, bytes]]:
        """Return (bytes of the request, answer) for each whole request."""
        if now_s - self._last_s > 0.05:
            self._buffer = b""
        self._last_s = now_s
        self._buffer += data
        while len(self._buffer) >= 8:
            size = 9 + self._buffer[6] if self._buffer[1] in _LONG else 8
            if len(self._buffer) < size:
                return
            frame, rest = self._buffer[:size], self._buffer[size:]
            if crc16(frame[:-2]) != struct.unpack("<H", frame[-2:])[0]:
                self._buffer = b""
                return
            self._buffer = rest
            if frame[0] == self.unit:
                yield size, rtu(self.unit, self.answer(frame[1:-2]))


@dataclass(slots=True)
class TcpSlave:
    """Cut a TCP stream into Modbus requests."""

    unit: int
    answer: Callable[[bytes], bytes]
    _buffer: bytes = b""

    def feed(self, data: bytes, _now_s: float) -> Iterable[tuple[int, bytes]]:
        """Return (bytes of the request, answer) for each whole request; a bad protocol id empties the buffer."""
        self._buffer += data
        while len(self._buffer) >= 8:
            transaction, protocol, length, unit = struct.unpack_from(">HHHB", self._buffer)
            if protocol or not 2 <= length <= 254:
                self._buffer = b""
                return
            if len(self._buffer) < 6 + length:
                return
            pdu, self._buffer = self._buffer[7 : 6 + length], self._buffer[6 + length :]
            if unit == self.unit:
                reply = self.answer(pdu)
                yield 6 + length, struct.pack(">HHHB", transaction, 0, len(reply) + 1, unit) + reply


# The frames of the robot link, on the robot's side (docs/protocols/robot_link.md).

HELLO, LOAD, BLOCKS, RESUME, HOLD, ABORT, PING, LIFT = range(0x01, 0x09)
WELCOME, ACK, NAK, ACCEPTED, EXECUTED, STATUS, RESEND = range(0x81, 0x88)

MAGIC = b"PL"
MAX_PAYLOAD = 1 << 20
_HEAD = struct.Struct(">2sBBI")

Frame = tuple[int, bytes]


def pack(kind: int, payload: bytes = b"") -> bytes:
    """Return a frame."""
    body = _HEAD.pack(MAGIC, kind, _check(kind, len(payload)), len(payload)) + payload
    return body + struct.pack(">I", zlib.crc32(body))


def _check(kind: int, length: int) -> int:
    return zlib.crc32(struct.pack(">BI", kind, length)) & 0xFF


def pack_json(kind: int, message: dict[str, Any]) -> bytes:
    """Return a frame with a JSON payload."""
    return pack(kind, json.dumps(message, separators=(",", ":")).encode())


def pack_executed(blocks: Sequence[tuple[int, float, float]]) -> bytes:
    """Return an EXECUTED frame; at most 65,535 blocks."""
    return pack(EXECUTED, struct.pack(">H", len(blocks)) + b"".join(struct.pack(">Idd", *block) for block in blocks))


def pack_blocks(first: int, lines: Sequence[bytes]) -> bytes:
    """Return a BLOCKS frame, as a client sends it."""
    body = struct.pack(">IH", first, len(lines))
    return pack(BLOCKS, body + b"".join(struct.pack(">H", len(line)) + line for line in lines))


def unpack_blocks(payload: bytes) -> tuple[int, list[bytes]] | None:
    """Return (first seq, lines) of a BLOCKS payload, or None if it is malformed."""
    try:
        first, count = struct.unpack_from(">IH", payload)
        at, lines = 6, []
        for _ in range(count):
            (size,) = struct.unpack_from(">H", payload, at)
            lines.append(payload[at + 2 : at + 2 + size])
            at += 2 + size
    except struct.error:
        return None
    return (first, lines) if at == len(payload) else None


def unpack_executed(payload: bytes) -> list[tuple[int, float, float]]:
    """Return (seq, start_s, end_s) of an EXECUTED payload, as a client reads it."""
    (count,) = struct.unpack_from(">H", payload)
    return [struct.unpack_from(">Idd", payload, 2 + 20 * k) for k in range(count)]


def unpack_json(payload: bytes) -> dict[str, Any] | None:
    """Return the object of a JSON payload, or None if it is no object."""
    try:
        message = json.loads(payload)
    except ValueError:
        return None
    return message if isinstance(message, dict) else None


class Splitter:
    """Cut a byte stream into frames; broken ones are skipped up to the next magic and counted."""

    def __init__(self) -> None:
        self._buffer = bytearray()
        self.broken = 0

    def feed(self, data: bytes) -> Iterable[Frame]:
        """Take bytes; return the whole frames."""
        self._buffer += data
        while True:
            start = self._buffer.find(MAGIC)
            if start < 0:
                del self._buffer[: max(len(self._buffer) - 1, 0)]
                return
            del self._buffer[:start]
            if len(self._buffer) < _HEAD.size:
                return
            _, kind, check, length = _HEAD.unpack_from(self._buffer)
            whole = _HEAD.size + length + 4
            if length > MAX_PAYLOAD or check != _check(kind, length):
                self._skip()
                continue
            if len(self._buffer) < whole:
                return
            body = bytes(self._buffer[: whole - 4])
            if zlib.crc32(body) != struct.unpack_from(">I", self._buffer, whole - 4)[0]:
                self._skip()
                continue
            del self._buffer[:whole]
            yield kind, body[_HEAD.size :]

    def _skip(self) -> None:
        del self._buffer[:2]
        self.broken += 1
