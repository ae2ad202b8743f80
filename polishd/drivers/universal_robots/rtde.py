"""RTDE packages, protocol version 2. Sans-IO: bytes in, packages out; what is malformed is never taken for a value."""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum

from polishd.api import DeviceBusy, DeviceRefused, ProtocolError

PROTOCOL = 2
_HEAD = struct.Struct(">HB")
FORMATS = {
    "BOOL": "?", "UINT8": "B", "UINT32": "I", "UINT64": "Q", "INT32": "i", "DOUBLE": "d",
    "VECTOR3D": "3d", "VECTOR6D": "6d", "VECTOR6INT32": "6i", "VECTOR6UINT32": "6I",
}  # fmt: skip
"""How the values of each type are packed, big endian."""

Value = tuple[float, ...]


class PackageType(IntEnum):
    """What a package is."""

    VERSION = ord("V")
    CONTROLLER = ord("v")
    TEXT = ord("M")
    DATA = ord("U")
    OUTPUTS = ord("O")
    INPUTS = ord("I")
    START = ord("S")
    PAUSE = ord("P")


@dataclass(frozen=True, slots=True)
class Package:
    """One package. Its kind may be one that we do not know."""

    kind: int
    payload: bytes


def encode(kind: PackageType, payload: bytes = b"") -> bytes:
    """A package's bytes."""
    return _HEAD.pack(_HEAD.size + len(payload), kind) + payload


def ask_outputs(rate_hz: float, names: Sequence[str]) -> bytes:
    """Ask for these outputs, so often."""
    return encode(PackageType.OUTPUTS, struct.pack(">d", rate_hz) + ",".join(names).encode("ascii"))


def ask_inputs(names: Sequence[str]) -> bytes:
    """Ask to write these inputs."""
    return encode(PackageType.INPUTS, ",".join(names).encode("ascii"))


class PackageReader:
    """Cuts a stream into packages, however it is dribbled.

    There is no check and no mark to begin again at: a length that cannot be is the end of the link.
    """

    def __init__(self) -> None:
        self._bytes = bytearray()

    def feed(self, data: bytes) -> Iterator[Package]:
        """The packages that are complete. ProtocolError where a length is shorter than its own header."""
        self._bytes += data
        while len(self._bytes) >= _HEAD.size:
            size, kind = _HEAD.unpack_from(self._bytes)
            if size < _HEAD.size:
                raise ProtocolError(f"RTDE: a package of {size} bytes")
            if len(self._bytes) < size:
                return
            payload = bytes(self._bytes[_HEAD.size : size])
            del self._bytes[:size]
            yield Package(kind, payload)


@dataclass(frozen=True, slots=True)
class RtdeRecipe:
    """What a data package holds: the names that were asked for, and their types."""

    number: int
    names: tuple[str, ...]
    types: tuple[str, ...]

    @classmethod
    def answered(cls, names: Sequence[str], payload: bytes, what: str) -> RtdeRecipe:
        """Read the answer to a setup.

        DeviceRefused where a name is not known, DeviceBusy where somebody else writes one, ProtocolError for nonsense.
        """
        types = _text(payload[1:]).rstrip(",").split(",")
        if not payload or len(types) != len(names):
            raise ProtocolError(f"RTDE: {len(names)} {what} were asked for, {len(types)} answered")
        for name, kind in zip(names, types, strict=True):
            if kind == "IN_USE":
                raise DeviceBusy(f"RTDE: {name} is written by another client. To do: stop that, or set first_register")
            if kind == "NOT_FOUND":
                raise DeviceRefused(f"RTDE: the controller has no {name}. To do: update its software")
            if kind not in FORMATS:
                raise ProtocolError(f"RTDE: {name} is of the unknown type {kind!r}")
        if payload[0] == 0:
            raise DeviceRefused(f"RTDE: the controller takes no setup of {what}")
        return cls(payload[0], tuple(names), tuple(types))

    def pack(self, values: Mapping[str, int]) -> bytes:
        """A data package with a number for each name."""
        body = struct.pack(">" + self._format, *(values[name] for name in self.names))
        return encode(PackageType.DATA, bytes([self.number]) + body)

    def unpack(self, payload: bytes) -> dict[str, Value] | None:
        """The values of a data package by name; None for another recipe's.

        ProtocolError for one of another length, or with a number that is none.
        """
        if payload[:1] != bytes([self.number]):
            return None
        form = struct.Struct(">" + self._format)
        if len(payload) != 1 + form.size:
            raise ProtocolError(f"RTDE: a data package of {len(payload)} bytes, not {1 + form.size}")
        flat = form.unpack(payload[1:])
        if not all(map(math.isfinite, flat)):
            raise ProtocolError("RTDE: a value that is no number")
        values, at = {}, 0
        for name, kind in zip(self.names, self.types, strict=True):
            count = int(FORMATS[kind][:-1] or 1)
            values[name] = flat[at : at + count]
            at += count
        return values

    @property
    def _format(self) -> str:
        return "".join(FORMATS[kind] for kind in self.types)


def accepted(payload: bytes) -> bool:
    """The answer to a version, a start or a pause. ProtocolError for nonsense."""
    if payload not in (b"\0", b"\1"):
        raise ProtocolError(f"RTDE: an answer of {payload[:8]!r}")
    return payload == b"\1"


def controller_of(payload: bytes) -> str:
    """The controller's software, ``5.11.0.0``. ProtocolError for nonsense."""
    if len(payload) != 16:
        raise ProtocolError(f"RTDE: a version of {len(payload)} bytes")
    return ".".join(map(str, struct.unpack(">4I", payload)))


def _text(data: bytes) -> str:
    return data.decode("ascii", "replace")
