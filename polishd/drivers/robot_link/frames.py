"""Frames on the wire: magic, type, length, payload, CRC. Sans-IO; a broken frame is skipped and never acted on."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from enum import IntEnum
from zlib import crc32

MAGIC = b"PL"
MAX_PAYLOAD = 1 << 20
_HEADER = struct.Struct(">2sBBI")
_CHECKED = struct.Struct(">BI")
_CRC = struct.Struct(">I")
_OVERHEAD = _HEADER.size + _CRC.size


class FrameType(IntEnum):
    """Frame types: below 0x80 to the robot, from 0x80 on from it."""

    HELLO = 0x01
    LOAD = 0x02
    BLOCKS = 0x03
    RESUME = 0x04
    HOLD = 0x05
    ABORT = 0x06
    PING = 0x07
    LIFT = 0x08
    WELCOME = 0x81
    ACK = 0x82
    NAK = 0x83
    ACCEPTED = 0x84
    EXECUTED = 0x85
    STATUS = 0x86
    RESEND = 0x87


@dataclass(frozen=True, slots=True)
class Frame:
    """A frame whose CRC was right. Its type may be one that we do not know."""

    kind: int
    payload: bytes


def header_check(kind: int, length: int) -> int:
    """A header's check: with a wrong length a receiver would wait for what never comes."""
    return crc32(_CHECKED.pack(kind, length)) & 0xFF


def encode(kind: FrameType, payload: bytes = b"{}") -> bytes:
    """A frame's bytes."""
    body = _HEADER.pack(MAGIC, kind, header_check(kind, len(payload)), len(payload)) + payload
    return body + _CRC.pack(crc32(body))


class FrameReader:
    """Cuts a byte stream into frames, however it is dribbled; after nonsense it looks for the next magic."""

    def __init__(self) -> None:
        self._bytes = bytearray()
        self.skipped = 0
        """Bytes that belonged to no sound frame."""

    def feed(self, data: bytes) -> list[Frame]:
        """Frames that are complete now."""
        self._bytes += data
        frames, at = [], 0
        while (start := self._bytes.find(MAGIC, at)) >= 0:
            self.skipped += start - at
            at = start
            try:
                frame = self._frame(start)
            except ValueError:
                self.skipped += len(MAGIC)
                at += len(MAGIC)
                continue
            if frame is None:
                break
            frames.append(frame)
            at += _OVERHEAD + len(frame.payload)
        else:
            # no magic in the rest, but its last byte may begin one
            rest = len(self._bytes) - self._bytes[at:].endswith(MAGIC[:1])
            self.skipped += rest - at
            at = rest
        del self._bytes[:at]
        return frames

    def _frame(self, start: int) -> Frame | None:
        """The frame that begins there; None while it is incomplete, ValueError where it is broken."""
        if len(self._bytes) - start < _HEADER.size:
            return None
        _, kind, check, length = _HEADER.unpack_from(self._bytes, start)
        if length > MAX_PAYLOAD or check != header_check(kind, length):
            raise ValueError("header")
        end = start + _HEADER.size + length
        if len(self._bytes) < end + _CRC.size:
            return None
        body = bytes(self._bytes[start:end])
        if _CRC.unpack_from(self._bytes, end) != (crc32(body),):
            raise ValueError("crc")
        return Frame(kind, body[_HEADER.size :])
