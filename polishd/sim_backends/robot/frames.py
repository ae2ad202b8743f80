"""The robot link's frames, the robot's side (docs/protocols/robot_link.md)."""

from __future__ import annotations

import json
import struct
import zlib
from collections.abc import Iterable, Sequence
from typing import Any

HELLO, LOAD, BLOCKS, RESUME, HOLD, ABORT, PING, LIFT = range(0x01, 0x09)
WELCOME, ACK, NAK, ACCEPTED, EXECUTED, STATUS, RESEND = range(0x81, 0x88)

MAGIC = b"PL"
MAX_PAYLOAD = 1 << 20
_HEAD = struct.Struct(">2sBBI")

Frame = tuple[int, bytes]


def pack(kind: int, payload: bytes = b"") -> bytes:
    """A frame."""
    body = _HEAD.pack(MAGIC, kind, _check(kind, len(payload)), len(payload)) + payload
    return body + struct.pack(">I", zlib.crc32(body))


def _check(kind: int, length: int) -> int:
    return zlib.crc32(struct.pack(">BI", kind, length)) & 0xFF


def pack_json(kind: int, message: dict[str, Any]) -> bytes:
    """A frame with a JSON payload."""
    return pack(kind, json.dumps(message, separators=(",", ":")).encode())


def pack_executed(blocks: Sequence[tuple[int, float, float]]) -> bytes:
    """An EXECUTED frame; at most 65,535 blocks."""
    return pack(EXECUTED, struct.pack(">H", len(blocks)) + b"".join(struct.pack(">Idd", *block) for block in blocks))


def pack_blocks(first: int, lines: Sequence[bytes]) -> bytes:
    """A BLOCKS frame, as a client sends it."""
    body = struct.pack(">IH", first, len(lines))
    return pack(BLOCKS, body + b"".join(struct.pack(">H", len(line)) + line for line in lines))


def unpack_blocks(payload: bytes) -> tuple[int, list[bytes]] | None:
    """(first seq, lines) of a BLOCKS payload, or None if it is malformed."""
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
    """(seq, start_s, end_s) of an EXECUTED payload, as a client reads it."""
    (count,) = struct.unpack_from(">H", payload)
    return [struct.unpack_from(">Idd", payload, 2 + 20 * k) for k in range(count)]


def unpack_json(payload: bytes) -> dict[str, Any] | None:
    """The object of a JSON payload, or None if it is none."""
    try:
        message = json.loads(payload)
    except ValueError:
        return None
    return message if isinstance(message, dict) else None


class Splitter:
    """Cuts a byte stream into frames; broken ones are skipped up to the next magic and counted."""

    def __init__(self) -> None:
        self._buffer = bytearray()
        self.broken = 0

    def feed(self, data: bytes) -> Iterable[Frame]:
        """Take bytes, give the whole frames."""
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
