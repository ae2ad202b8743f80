"""Requests to the proxy on the controller: KUKAVARPROXY's format with the messages of C3 Bridge."""

from __future__ import annotations

import struct
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum

from polishd.api import DeviceRefused, LinkError, ProtocolError
from polishd.drivers.transport.address import Tcp
from polishd.drivers.transport.streams import open_stream
from polishd.interfaces import ByteStream

CONNECT_S = 2.0
_HEAD = struct.Struct(">HHB")
_FOOT = struct.Struct(">HB")
MOST_BYTES = 1 << 15
"""Longest answer that is believable."""


class KvpMessage(IntEnum):
    """Message types that polishd uses; KUKAVARPROXY knows the first two."""

    READ = 0
    WRITE = 1
    READ_MANY = 6
    CONTROL = 10


class ProgramOrder(IntEnum):
    """Commands of a CONTROL message."""

    RESET = 1
    START = 2
    STOP = 3
    CANCEL = 4
    SELECT = 5


_ROBOT_INTERPRETER = 1
ERRORS = {
    0: "general error", 2: "no access", 3: "wrong argument", 4: "no memory", 5: "bad pointer", 6: "unexpected",
    7: "not implemented", 8: "no interface", 9: "protocol error", 10: "the answer is too long",
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class KvpAnswer:
    """Answer to a request."""

    kind: int
    payload: bytes
    code: int
    succeeded: bool

    @property
    def problem(self) -> str:
        """The error, for messages."""
        return ERRORS.get(self.code, f"error {self.code}")


def encode_request(number: int, kind: KvpMessage, payload: bytes) -> bytes:
    """Return a request."""
    return _HEAD.pack(number, 1 + len(payload), kind) + payload


def encode_read(names: Sequence[str]) -> bytes:
    """Return the payload of READ_MANY."""
    return bytes([len(names)]) + b"".join(_wide(name) for name in names)


def encode_control(order: ProgramOrder, module: str = "") -> bytes:
    """Return the payload of CONTROL."""
    head = struct.pack(">BH", order, _ROBOT_INTERPRETER)
    return head + (_wide(module) + _wide("") + b"\1" if order == ProgramOrder.SELECT else b"")


def encode_texts(*texts: str) -> bytes:
    """Return the payload of READ and WRITE: texts with their lengths, one byte for each character."""
    return b"".join(struct.pack(">H", len(raw)) + raw for raw in (text.encode("latin-1") for text in texts))


def _wide(text: str) -> bytes:
    return struct.pack(">H", len(text)) + text.encode("utf-16-le")


def decode_answer(frame: bytes) -> tuple[int, KvpAnswer]:
    """Return the number of the request and its answer. ProtocolError if the frame is too short."""
    if len(frame) < _HEAD.size + _FOOT.size:
        raise ProtocolError(f"proxy: an answer of {len(frame)} bytes")
    number, _, kind = _HEAD.unpack_from(frame)
    code, succeeded = _FOOT.unpack_from(frame, len(frame) - _FOOT.size)
    return number, KvpAnswer(kind, frame[_HEAD.size : -_FOOT.size], code, bool(succeeded))


def decode_values(names: Sequence[str], answer: KvpAnswer) -> dict[str, str]:
    """Return the values of READ_MANY by name. DeviceRefused names the variables that the controller does not have.

    ProtocolError for an answer that breaks off, or that reports an error and names no variable.
    """
    data, at, found, missing = answer.payload, 1, dict[str, str](), []
    try:
        if data[0] != len(names):
            raise ProtocolError(f"proxy: {data[0]} values for {len(names)} variables")
        for name in names:
            code, size = struct.unpack_from(">BH", data, at)
            at += 3 + 2 * size
            if at > len(data):
                raise ProtocolError(f"proxy: the value of {name} breaks off")
            found[name] = data[at - 2 * size : at].decode("utf-16-le", "replace")
            if code != 1:
                missing.append(name)
    except (struct.error, IndexError):
        raise ProtocolError(f"proxy: {len(data)} bytes for {len(names)} values") from None
    if at != len(data):
        raise ProtocolError(f"proxy: {len(data) - at} bytes after the last value")
    if missing:
        raise DeviceRefused(
            f"the controller has no variable {', '.join(missing)}. Install polishd_watch (docs/protocols/kuka_kvp.md)."
        )
    if not answer.succeeded:
        raise ProtocolError(f"proxy: {answer.problem} in reading {len(names)} variables, and none is named")
    return found


class KvpLink:
    """One connection to the proxy: one request at a time. A request without an answer in time ends it."""

    def __init__(self, address: Tcp, stream: ByteStream, answer_s: float) -> None:
        self._address, self._stream, self._answer_s = address, stream, answer_s
        self._number = 0
        self._received = bytearray()

    @classmethod
    async def connect(cls, address: Tcp, answer_s: float) -> KvpLink:
        """Connect."""
        return cls(address, await open_stream(address, CONNECT_S), answer_s)

    async def close(self) -> None:
        """Disconnect; idempotent."""
        await self._stream.close()

    async def read(self, names: Sequence[str]) -> Mapping[str, str]:
        """Read variables in one request."""
        answer = await self._ask(KvpMessage.READ_MANY, encode_read(names))
        try:
            return decode_values(names, answer)
        except DeviceRefused as refusal:
            raise DeviceRefused(f"{self._address}: {refusal}") from None

    async def text(self, name: str) -> str:
        """Read a variable that a controller may not have: then empty."""
        answer = await self._ask(KvpMessage.READ, encode_texts(name))
        return answer.payload[2:].decode("latin-1").strip('"') if answer.succeeded else ""

    async def write(self, name: str, value: str) -> None:
        """Write a variable. DeviceRefused if the controller does not have it."""
        answer = await self._ask(KvpMessage.WRITE, encode_texts(name, value))
        if not answer.succeeded:
            raise DeviceRefused(
                f"{self._address}: the controller does not take {name}={value}: {answer.problem}. "
                "Install polishd_watch (docs/protocols/kuka_kvp.md)."
            )

    async def control(self, order: ProgramOrder, module: str = "", within_s: float | None = None) -> KvpAnswer:
        """Send a command; return the answer, which may be a refusal."""
        return await self._ask(KvpMessage.CONTROL, encode_control(order, module), within_s)

    async def _ask(self, kind: KvpMessage, payload: bytes, within_s: float | None = None) -> KvpAnswer:
        self._number = (self._number + 1) & 0xFFFF
        await self._stream.write(encode_request(self._number, kind, payload))
        deadline = time.monotonic() + (self._answer_s if within_s is None else within_s)
        number, answer = decode_answer(await self._frame(deadline))
        if number != self._number or answer.kind != kind:
            raise ProtocolError(
                f"{self._address}: answer {number} of type {answer.kind} to request {self._number} of type {int(kind)}"
            )
        return answer

    async def _frame(self, deadline: float) -> bytes:
        while True:
            if len(self._received) >= _HEAD.size:
                size = 4 + int.from_bytes(self._received[2:4])
                if size > MOST_BYTES:
                    raise ProtocolError(f"{self._address}: an answer of {size} bytes")
                if len(self._received) >= size:
                    frame = bytes(self._received[:size])
                    del self._received[:size]
                    return frame
            left_s = deadline - time.monotonic()
            if left_s <= 0.0:
                raise LinkError(f"{self._address}: no complete answer in time")
            self._received += await self._stream.read(1 << 14, left_s)
