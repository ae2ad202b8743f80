"""What faults must know of a link's protocol: where a frame ends, and what a reply to be feared looks like."""

from __future__ import annotations

import re
import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from polishd.sim_backends.actuator import ascii as numbered
from polishd.sim_backends.actuator.modbus import crc16
from polishd.sim_backends.robot import frames

Cut = Callable[[bytes], int]
"""Bytes of the first frame; 0 where it is not all there."""
Forge = Callable[[bytes], bytes]
"""Another reply made of one; empty where none can be made of it."""

DEVICE_FAILURE = 4
ADS_BUSY = 0x708
SDO_ABORT, HARDWARE = 0x80, 0x06060000
_SLCAN = re.compile(rb"t([0-9A-F]{3})(\d)([0-9A-Fa-f]*)\r")
_SOCKETCAND = re.compile(rb"< frame ([0-9A-F]{3}) (\S+) ([0-9A-F]*) >")


@dataclass(frozen=True, slots=True)
class Protocol:
    """One protocol."""

    cut: Cut = len
    wrong_unit: Forge | None = None
    """As if another unit, or another node, had answered."""
    exception: Forge | None = None
    """As if the device had refused."""


def _ended(ends: bytes) -> Cut:
    """A frame that ends with one of these bytes."""
    return lambda data: next((place for place, byte in enumerate(data, 1) if byte in ends), 0)


def _sized(form: str, at: int, more: int) -> Cut:
    """A frame that says its own length at a place; ``more`` bytes are not counted by it."""
    size = struct.Struct(form)

    def cut(data: bytes) -> int:
        if len(data) < at + size.size:
            return 0
        whole = int(size.unpack_from(data, at)[0]) + more
        return whole if at + size.size <= whole <= len(data) else 0 if whole > len(data) else len(data)

    return cut


def _rtu(unit: int, pdu: bytes) -> bytes:
    body = bytes([unit]) + pdu
    return body + struct.pack("<H", crc16(body))


def _tcp(frame: bytes, unit: int, pdu: bytes) -> bytes:
    return frame[:4] + struct.pack(">HB", 1 + len(pdu), unit) + pdu


def _refused(function: int) -> bytes:
    return bytes([function | 0x80, DEVICE_FAILURE])


def _line_refused(frame: bytes) -> bytes:
    number, _, said = (numbered.body(frame.rstrip(b"\r\n")) or "").partition(",")
    return numbered.line(f"{number},ERR,fault,a fault is set") if said else b""


def _robot_refused(frame: bytes) -> bytes:
    """An ACK becomes a NAK of the same request."""
    kind, payload = next(iter(frames.Splitter().feed(frame)), (0, b""))
    message = frames.unpack_json(payload) if kind == frames.ACK else None
    return frames.pack_json(frames.NAK, {"of": message["of"], "code": "fault", "text": "a fault"}) if message else b""


def _ads_refused(frame: bytes) -> bytes:
    return frame[:30] + struct.pack("<I", ADS_BUSY) + frame[34:] if len(frame) >= 38 else b""


def _abort(identifier: int, data: bytes) -> bytes:
    """The data of an SDO's refusal in the place of its answer; empty of any other frame."""
    answers = 0x580 < identifier < 0x600 and len(data) == 8
    return bytes([SDO_ABORT]) + data[1:4] + struct.pack("<I", HARDWARE) if answers else b""


def _slcan(frame: bytes, *, refused: bool) -> bytes:
    found = _SLCAN.fullmatch(frame)
    if found is None:
        return b""
    identifier, data = int(found[1], 16), bytes.fromhex(found[3].decode())
    if not refused:
        return b"t%03X%b%b\r" % ((identifier + 1) & 0x7FF, found[2], found[3])
    abort = _abort(identifier, data)
    return b"t%b8%b\r" % (found[1], abort.hex().encode()) if abort else b""


def _socketcand(frame: bytes, *, refused: bool) -> bytes:
    found = _SOCKETCAND.fullmatch(frame.strip())
    if found is None:
        return b""
    identifier, data = int(found[1], 16), bytes.fromhex(found[3].decode())
    if not refused:
        return b"< frame %03X %b %b >" % ((identifier + 1) & 0x7FF, found[2], found[3])
    abort = _abort(identifier, data)
    return b"< frame %b %b %b >" % (found[1], found[2], abort.hex().upper().encode()) if abort else b""


PROTOCOLS: Mapping[str, Protocol] = {
    "modbus_rtu": Protocol(
        wrong_unit=lambda frame: _rtu(frame[0] + 1, frame[1:-2]),
        exception=lambda frame: _rtu(frame[0], _refused(frame[1])),
    ),
    "modbus_tcp": Protocol(
        _sized(">H", 4, 6),
        wrong_unit=lambda frame: _tcp(frame, (frame[6] + 1) & 0xFF, frame[7:]),
        exception=lambda frame: _tcp(frame, frame[6], _refused(frame[7])),
    ),
    "numbered lines": Protocol(_ended(b"\n"), exception=_line_refused),
    "lines": Protocol(_ended(b"\n")),
    "slcan": Protocol(
        _ended(b"\r\a"),
        wrong_unit=lambda frame: _slcan(frame, refused=False),
        exception=lambda frame: _slcan(frame, refused=True),
    ),
    "socketcand": Protocol(
        _ended(b">"),
        wrong_unit=lambda frame: _socketcand(frame, refused=False),
        exception=lambda frame: _socketcand(frame, refused=True),
    ),
    "robot_link": Protocol(_sized(">I", 4, 12), exception=_robot_refused),
    "opcua": Protocol(_sized("<I", 4, 0)),
    "ads": Protocol(_sized("<I", 2, 6), exception=_ads_refused),
    "rtde": Protocol(_sized(">H", 0, 0)),
    "dashboard": Protocol(_ended(b"\n")),
    "primary": Protocol(),
}
"""By name, as errors and the log say it."""
