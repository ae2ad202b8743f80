"""CANopen frames of one node (CiA 301): what we say and what it says. Sans-IO; frames that are not its own are None.

SDO transfers are expedited ones only: no object of a drive that is read or written here has more than four bytes.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from enum import IntEnum

from polishd.drivers.transport.can_bus import CanFrame

NMT, EMERGENCY, SDO_ANSWER, SDO_REQUEST, HEARTBEAT = 0x000, 0x080, 0x580, 0x600, 0x700
_START_NODE, _RESET_COMMUNICATION = 0x01, 0x82
_UPLOAD, _DOWNLOAD = 0x40, 0x23
_WRITTEN, _ABORT = 0x60, 0x80
_EXPEDITED = {0x4F: 1, 0x4B: 2, 0x47: 3, 0x43: 4, 0x42: 4}
"""Answers to a read: their bytes of data; the last does not say how many of the four count."""
_SIZELESS = 0x42
_COMMUNICATION = 0x81
"""First byte of an error code."""
_SDO = struct.Struct("<BHB4s")
_EMERGENCY = struct.Struct("<HB5x")


@dataclass(frozen=True, slots=True)
class Address:
    """Of an object in a node's dictionary."""

    index: int
    sub: int = 0

    def __str__(self) -> str:
        return f"{self.index:04X}h:{self.sub}" if self.sub else f"{self.index:04X}h"


class NodeState(IntEnum):
    """What a heartbeat says; BOOT comes once after power-up or reset."""

    BOOT = 0x00
    STOPPED = 0x04
    OPERATIONAL = 0x05
    PRE_OPERATIONAL = 0x7F


@dataclass(frozen=True, slots=True)
class NodeHeartbeat:
    """A sign of life."""

    state: NodeState


@dataclass(frozen=True, slots=True)
class EmergencyMessage:
    """The node tells of an error; ``code`` 0x00xx: of its end."""

    code: int
    register: int

    @property
    def of_connection(self) -> bool:
        """It tells of the bus or of the controller's silence: over, once both are heard again."""
        return self.code >> 8 == _COMMUNICATION


@dataclass(frozen=True, slots=True)
class SdoValue:
    """A value; ``sized`` where the node says that all of it counts."""

    address: Address
    data: bytes
    sized: bool


@dataclass(frozen=True, slots=True)
class SdoWritten:
    """A value was taken."""

    address: Address


@dataclass(frozen=True, slots=True)
class SdoAborted:
    """A transfer was refused."""

    address: Address
    code: int


SdoAnswer = SdoValue | SdoWritten | SdoAborted
Message = NodeHeartbeat | EmergencyMessage | SdoAnswer


@dataclass(frozen=True, slots=True)
class Request:
    """Read an object, or with ``data`` (1 to 4 bytes) write it."""

    address: Address
    data: bytes | None = None

    def frame(self, node: int) -> CanFrame:
        """As it goes out."""
        specifier = _UPLOAD if self.data is None else _DOWNLOAD | (4 - len(self.data)) << 2
        payload = _SDO.pack(specifier, self.address.index, self.address.sub, (self.data or b"").ljust(4, b"\0"))
        return CanFrame(SDO_REQUEST + node, payload)

    def answered_by(self, answer: SdoAnswer) -> bool:
        """Whether it can be the answer to this: about the same object, and of the kind that was asked for."""
        wanted = SdoValue if self.data is None else SdoWritten
        return answer.address == self.address and isinstance(answer, wanted | SdoAborted)


def start_node(node: int) -> CanFrame:
    """Network management: be operational. Nobody answers that."""
    return CanFrame(NMT, bytes([_START_NODE, node]))


def reset_communication(node: int) -> CanFrame:
    """Network management: forget what 1000h to 1FFFh were told, and boot. Power stays as it is."""
    return CanFrame(NMT, bytes([_RESET_COMMUNICATION, node]))


def heartbeat(controller: int) -> CanFrame:
    """Our own sign of life, that the drive listens for."""
    return CanFrame(HEARTBEAT + controller, bytes([NodeState.OPERATIONAL]))


def decode(node: int, frame: CanFrame) -> Message | None:
    """What that node said; None for other nodes, and for data that CANopen does not have."""
    identifier, data = frame
    if identifier == SDO_ANSWER + node and len(data) == _SDO.size:
        return _sdo(data)
    if identifier == HEARTBEAT + node and len(data) == 1 and data[0] in tuple(NodeState):
        return NodeHeartbeat(NodeState(data[0]))
    if identifier == EMERGENCY + node and len(data) == _EMERGENCY.size:
        return EmergencyMessage(*_EMERGENCY.unpack(data))
    return None


def _sdo(data: bytes) -> SdoAnswer | None:
    specifier, index, sub, value = _SDO.unpack(data)
    address = Address(index, sub)
    if specifier in _EXPEDITED:
        return SdoValue(address, value[: _EXPEDITED[specifier]], sized=specifier != _SIZELESS)
    if specifier == _WRITTEN:
        return SdoWritten(address)
    if specifier == _ABORT:
        return SdoAborted(address, int.from_bytes(value, "little"))
    return None
