"""Frames of the robot link: magic, type, length, payload, CRC. Sans-IO; broken frames are skipped."""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, TypeGuard, cast, get_args
from zlib import crc32

from polishd.api import DeviceIdentity, ExecutedBlock, ProtocolError, RobotProgress
from polishd.model.devices import RobotState

MAGIC = b"PL"
MAX_PAYLOAD = 1 << 20
_HEADER = struct.Struct(">2sBBI")
_CHECKED = struct.Struct(">BI")
_CRC = struct.Struct(">I")
_OVERHEAD = _HEADER.size + _CRC.size


class FrameType(IntEnum):
    """Frame types: below 0x80 to the robot, from 0x80 on from the robot."""

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
    """A frame with a correct CRC. Its type may be unknown."""

    kind: int
    payload: bytes


def header_check(kind: int, length: int) -> int:
    """Return the checksum of a header: with a wrong length a receiver would wait for missing bytes."""
    return crc32(_CHECKED.pack(kind, length)) & 0xFF


def encode(kind: FrameType, payload: bytes = b"{}") -> bytes:
    """Return the bytes of a frame."""
    body = _HEADER.pack(MAGIC, kind, header_check(kind, len(payload)), len(payload)) + payload
    return body + _CRC.pack(crc32(body))


class FrameReader:
    """Split a byte stream into frames; after invalid bytes continue at the next magic."""

    def __init__(self) -> None:
        self._bytes = bytearray()
        self.skipped = 0
        """Bytes that belonged to no valid frame."""

    def feed(self, data: bytes) -> list[Frame]:
        """Add bytes; return the frames that are complete now."""
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
        """Return the frame at ``start``; None while it is incomplete, ValueError if it is broken."""
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


# Content of the payloads. ProtocolError for a valid frame whose content is not the protocol's.

PROTOCOL = 1
LONGEST_LINE = 0xFFFF

LONGEST_S = 1e9
"""Longest possible time: 30 years."""
MOST_OVERRIDE = 10.0
"""Largest possible override: ten times the programmed speed."""
_BLOCKS = struct.Struct(">IH")
_LENGTH = struct.Struct(">H")
_ACCEPTED = struct.Struct(">IId")
_RECORD = struct.Struct(">Idd")
_SEQ = struct.Struct(">I")


@dataclass(frozen=True, slots=True)
class RobotLinkStatus(RobotProgress):
    """Progress of the robot, with the fields that only this link has."""

    stops: int = 0
    """Number of stops (HOLD, ABORT, watchdog) counted by the robot; RESUME names the last one that its sender knows."""


@dataclass(frozen=True, slots=True)
class Welcome:
    """Identity and state of the robot."""

    identity: DeviceIdentity
    watchdog_s: float
    window: int
    lease: str
    """Identifier of the write lease, to regain it on the next connection. Empty for readers."""
    progress: RobotLinkStatus


@dataclass(frozen=True, slots=True)
class Ack:
    """The robot executed the command."""

    of: int
    progress: RobotLinkStatus


@dataclass(frozen=True, slots=True)
class Nak:
    """The robot refused the command."""

    of: int
    code: str
    text: str


def command(kind: FrameType, content: Mapping[str, Any]) -> bytes:
    """Return a frame with a JSON payload."""
    return encode(kind, json.dumps(content, separators=(",", ":")).encode())


def blocks(first_seq: int, lines: Sequence[bytes]) -> bytes:
    """Return a BLOCKS frame."""
    parts = [_BLOCKS.pack(first_seq, len(lines))]
    for line in lines:
        parts += _LENGTH.pack(len(line)), line
    return encode(FrameType.BLOCKS, b"".join(parts))


def welcome(payload: bytes) -> Welcome:
    """Parse WELCOME."""
    content = _object(payload)
    if content.get("protocol") != PROTOCOL:
        raise ProtocolError(f"the robot speaks protocol {content.get('protocol')!r}, not {PROTOCOL}")
    texts = {key: _text(content, key) for key in ("vendor", "model", "serial", "firmware", "boot_id")}
    window, watchdog_s = content.get("window"), content.get("watchdog_s")
    if not _is_count(window) or not _is_time(watchdog_s) or window < 1 or watchdog_s <= 0:
        raise ProtocolError(f"WELCOME with window {window!r}, watchdog_s {watchdog_s!r}")
    lease = _text(content, "lease")
    return Welcome(DeviceIdentity(**texts), float(watchdog_s), window, lease, _progress(content.get("status")))


def ack(payload: bytes) -> Ack:
    """Parse ACK."""
    content = _object(payload)
    return Ack(_of(content), _progress(content.get("status")))


def nak(payload: bytes) -> Nak:
    """Parse NAK."""
    content = _object(payload)
    return Nak(_of(content), _text(content, "code"), _text(content, "text"))


def status(payload: bytes) -> RobotLinkStatus:
    """Parse STATUS."""
    return _progress(_object(payload))


def accepted(payload: bytes) -> tuple[int, int, float]:
    """Parse ACCEPTED: next sequence number, credit, seconds of motion that the robot buffers."""
    next_seq, credit, buffer_s = _unpack(_ACCEPTED, payload)
    if not _is_time(buffer_s):
        raise ProtocolError(f"ACCEPTED with buffer_s {buffer_s!r}")
    return next_seq, credit, buffer_s


def executed(payload: bytes) -> list[ExecutedBlock]:
    """Parse EXECUTED."""
    if len(payload) < _LENGTH.size or len(payload) != _LENGTH.size + _LENGTH.unpack_from(payload)[0] * _RECORD.size:
        raise ProtocolError(f"EXECUTED of {len(payload)} bytes does not match its count")
    records = [ExecutedBlock(*record) for record in _RECORD.iter_unpack(payload[_LENGTH.size :])]
    for one in records:
        if not (math.isfinite(one.start_s) and one.start_s <= one.end_s < math.inf):
            raise ProtocolError(f"block {one.seq} executed from {one.start_s!r} to {one.end_s!r} s")
    return records


def resend(payload: bytes) -> int:
    """Parse RESEND: the sequence number to send again from."""
    seq: int = _unpack(_SEQ, payload)[0]
    return seq


def _unpack(form: struct.Struct, payload: bytes) -> tuple[Any, ...]:
    if len(payload) != form.size:
        raise ProtocolError(f"{len(payload)} bytes where {form.size} are due")
    return form.unpack(payload)


def _object(payload: bytes) -> dict[str, Any]:
    try:
        content = json.loads(payload)
    except (ValueError, RecursionError) as error:
        raise ProtocolError(f"not JSON: {payload[:80]!r}") from error
    if not isinstance(content, dict):
        raise ProtocolError(f"no JSON object: {payload[:80]!r}")
    return content


def _is_count(value: object) -> TypeGuard[int]:
    return isinstance(value, int) and not isinstance(value, bool) and value >= 0


def _is_time(value: object) -> TypeGuard[float]:
    """Whether this is a possible time in s: JSON may contain NaN, infinities, and integers of any length."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    return 0 <= value <= LONGEST_S


def _text(content: Mapping[str, Any], key: str) -> str:
    value = content.get(key, "")
    if not isinstance(value, str):
        raise ProtocolError(f"{key} is no text: {value!r}")
    return value


def _of(content: Mapping[str, Any]) -> int:
    of = content.get("of")
    if not _is_count(of):
        raise ProtocolError(f"an answer to nothing: {content!r}")
    return of


def _progress(content: Any) -> RobotLinkStatus:
    if not isinstance(content, dict):
        raise ProtocolError(f"no status: {content!r}")
    state, buffer_s = content.get("state"), content.get("buffer_s")
    counts = content.get("accepted"), content.get("executed"), content.get("stops")
    if state not in get_args(RobotState) or not _is_time(buffer_s):
        raise ProtocolError(f"status with state {state!r}, buffer_s {buffer_s!r}")
    if not all(map(_is_count, counts)):
        raise ProtocolError(f"status with accepted, executed, stops {counts!r}")
    return RobotLinkStatus(
        state=cast("RobotState", state),
        program_sha256=_text(content, "program_sha256"),
        accepted=cast("int", counts[0]),
        executed=cast("int", counts[1]),
        buffer_s=float(buffer_s),
        boot_id=_text(content, "boot_id"),
        detail=_text(content, "detail"),
        override=_override(content),
        stops=cast("int", counts[2]),
    )


def _override(content: Mapping[str, Any]) -> float | None:
    """Return the speed override as a fraction; None if the robot does not report it."""
    value = content.get("override")
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value <= MOST_OVERRIDE:
        raise ProtocolError(f"status with override {value!r}, not a fraction of 0 to {MOST_OVERRIDE:g}")
    return float(value)
