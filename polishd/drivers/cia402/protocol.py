"""CANopen frames of one node (CiA 301), sent and received. Sans-IO; frames of other nodes decode to None.

Only expedited SDO transfers: no object that is read or written here has more than four bytes.
"""

from __future__ import annotations

import configparser
import io
import re
import struct
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from enum import Enum, IntEnum
from pathlib import Path
from typing import TYPE_CHECKING

from polishd.api import ConfigError, DeviceRefused, ProtocolError
from polishd.drivers.transport.can_frames import CanFrame
from polishd.util.files import read_input

if TYPE_CHECKING:
    from canopen.objectdictionary import ObjectDictionary, ODVariable


NMT, EMERGENCY, SDO_ANSWER, SDO_REQUEST, HEARTBEAT = 0x000, 0x080, 0x580, 0x600, 0x700
_START_NODE, _RESET_COMMUNICATION = 0x01, 0x82
_UPLOAD, _DOWNLOAD = 0x40, 0x23
_WRITTEN, _ABORT = 0x60, 0x80
_EXPEDITED = {0x4F: 1, 0x4B: 2, 0x47: 3, 0x43: 4, 0x42: 4}
"""Data bytes of the answers to a read; the last one does not give the number of valid bytes."""
_SIZELESS = 0x42
_COMMUNICATION = 0x81
"""First byte of an error code."""
_SDO = struct.Struct("<BHB4s")
_EMERGENCY = struct.Struct("<HB5x")


@dataclass(frozen=True, slots=True)
class Address:
    """Address of an object in a node's dictionary."""

    index: int
    sub: int = 0

    def __str__(self) -> str:
        return f"{self.index:04X}h:{self.sub}" if self.sub else f"{self.index:04X}h"


class NodeState(IntEnum):
    """State in a heartbeat; BOOT is sent once after power-up or reset."""

    BOOT = 0x00
    STOPPED = 0x04
    OPERATIONAL = 0x05
    PRE_OPERATIONAL = 0x7F


@dataclass(frozen=True, slots=True)
class NodeHeartbeat:
    """Heartbeat of a node."""

    state: NodeState


@dataclass(frozen=True, slots=True)
class EmergencyMessage:
    """Error of the node; ``code`` 0x00xx: the end of the error."""

    code: int
    register: int

    @property
    def of_connection(self) -> bool:
        """Whether the error is a bus error or a lost heartbeat: it ends when both return."""
        return self.code >> 8 == _COMMUNICATION


@dataclass(frozen=True, slots=True)
class SdoValue:
    """Value of an object; ``sized``: the node gives its size."""

    address: Address
    data: bytes
    sized: bool


@dataclass(frozen=True, slots=True)
class SdoWritten:
    """Confirmation of a write."""

    address: Address


@dataclass(frozen=True, slots=True)
class SdoAborted:
    """Refusal of a transfer."""

    address: Address
    code: int


SdoAnswer = SdoValue | SdoWritten | SdoAborted
Message = NodeHeartbeat | EmergencyMessage | SdoAnswer


@dataclass(frozen=True, slots=True)
class Request:
    """Request to read an object, or with ``data`` (1 to 4 bytes) to write it."""

    address: Address
    data: bytes | None = None

    def frame(self, node: int) -> CanFrame:
        """Return the CAN frame of the request."""
        specifier = _UPLOAD if self.data is None else _DOWNLOAD | (4 - len(self.data)) << 2
        payload = _SDO.pack(specifier, self.address.index, self.address.sub, (self.data or b"").ljust(4, b"\0"))
        return CanFrame(SDO_REQUEST + node, payload)

    def answered_by(self, answer: SdoAnswer) -> bool:
        """Whether this can be the answer: the same object and the requested kind."""
        wanted = SdoValue if self.data is None else SdoWritten
        return answer.address == self.address and isinstance(answer, wanted | SdoAborted)


def start_node(node: int) -> CanFrame:
    """Return the network management frame to become operational. It has no answer."""
    return CanFrame(NMT, bytes([_START_NODE, node]))


def reset_communication(node: int) -> CanFrame:
    """Return the frame to reset 1000h to 1FFFh and boot. The power stage keeps its state."""
    return CanFrame(NMT, bytes([_RESET_COMMUNICATION, node]))


def heartbeat(controller: int) -> CanFrame:
    """Return our heartbeat frame, which the drive monitors."""
    return CanFrame(HEARTBEAT + controller, bytes([NodeState.OPERATIONAL]))


def decode(node: int, frame: CanFrame) -> Message | None:
    """Decode a frame of that node; None for other nodes and for invalid data."""
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


# Objects of a drive that are used here, with their addresses in CiA 301 and CiA 402.

DEVICE_TYPE = Address(0x1000)
ERROR_REGISTER = Address(0x1001)
CONSUMER_HEARTBEAT = Address(0x1016, 1)
"""Node of the monitored heartbeat (bits 16 to 22), and its timeout, ms."""
PRODUCER_HEARTBEAT = Address(0x1017)
"""Period of the drive's heartbeat, ms."""
VENDOR, PRODUCT, REVISION, SERIAL = (Address(0x1018, sub) for sub in (1, 2, 3, 4))

ABORT_CONNECTION = Address(0x6007)
"""Reaction of the drive to a lost heartbeat."""
ERROR_CODE = Address(0x603F)
CONTROL_WORD = Address(0x6040)
STATUS_WORD = Address(0x6041)
QUICK_STOP_OPTION = Address(0x605A)
MODE = Address(0x6060)
MODE_NOW = Address(0x6061)
POSITION = Address(0x6064)
VELOCITY = Address(0x606C)
TARGET_TORQUE = Address(0x6071)
MAX_TORQUE = Address(0x6072)
TORQUE = Address(0x6077)
TARGET_POSITION = Address(0x607A)
MAX_MOTOR_SPEED = Address(0x6080)
PROFILE_VELOCITY = Address(0x6081)
ACCELERATION = Address(0x6083)
DECELERATION = Address(0x6084)
QUICK_STOP_DECELERATION = Address(0x6085)
TORQUE_SLOPE = Address(0x6087)
TARGET_VELOCITY = Address(0x60FF)
SUPPORTED_MODES = Address(0x6502)

PROFILE_402 = 402
"""Low half of DEVICE_TYPE."""
POSITION_MODE, VELOCITY_MODE, TORQUE_MODE = 1, 3, 4
ABORT_DISABLES, ABORT_QUICK_STOPS = 2, 3
STOP_AND_DISABLE = 2
"""QUICK_STOP_OPTION: decelerate on the quick stop ramp, then switch on disabled."""


# The power state machine of a drive (CiA 402): status word in, control words out. Pure.

DISABLE_VOLTAGE, QUICK_STOP, SHUT_DOWN, SWITCH_ON, ENABLE = 0x00, 0x02, 0x06, 0x07, 0x0F
FAULT_RESET = 0x80
"""Takes effect on a rising bit 7: send DISABLE_VOLTAGE first."""
FAULT_BIT = 0x08
"""Bit of the status word."""
MOVE_NOW = 0x3F
"""Profile position: operation enabled, a new set point, at once."""


class DriveState402(Enum):
    """State of the power stage, named as in CiA 402."""

    NOT_READY = "not ready to switch on"
    SWITCH_ON_DISABLED = "switch on disabled"
    READY = "ready to switch on"
    SWITCHED_ON = "switched on"
    ENABLED = "operation enabled"
    QUICK_STOP = "quick stop active"
    FAULT_REACTION = "fault reaction active"
    FAULT = "fault"

    @property
    def drives(self) -> bool:
        """Whether the motor has current and may move."""
        return self in {DriveState402.ENABLED, DriveState402.QUICK_STOP, DriveState402.FAULT_REACTION}

    @property
    def failed(self) -> bool:
        """Whether only a fault reset leaves the state."""
        return self in {DriveState402.FAULT_REACTION, DriveState402.FAULT}


_BITS = (
    (0x4F, 0x00, DriveState402.NOT_READY),
    (0x4F, 0x40, DriveState402.SWITCH_ON_DISABLED),
    (0x6F, 0x21, DriveState402.READY),
    (0x6F, 0x23, DriveState402.SWITCHED_ON),
    (0x6F, 0x27, DriveState402.ENABLED),
    (0x6F, 0x07, DriveState402.QUICK_STOP),
    (0x4F, 0x0F, DriveState402.FAULT_REACTION),
    (0x4F, 0x08, DriveState402.FAULT),
)
"""(mask, value) of the status word for each state."""

_STEPS = ((SHUT_DOWN, DriveState402.READY), (SWITCH_ON, DriveState402.SWITCHED_ON), (ENABLE, DriveState402.ENABLED))


def state_of(status_word: int) -> DriveState402:
    """Return the state of a status word; ProtocolError if it has none."""
    for mask, value, state in _BITS:
        if status_word & mask == value:
            return state
    raise ProtocolError(f"status word {status_word:#06x} is no state of CiA 402")


def power_up(state: DriveState402) -> tuple[tuple[int, DriveState402], ...]:
    """Return the control words to operation enabled, each with the state to wait for before the next.

    Set the target before: the drive becomes enabled. A fault has no such control words.
    """
    if state is DriveState402.QUICK_STOP:
        return (DISABLE_VOLTAGE, DriveState402.SWITCH_ON_DISABLED), *_STEPS
    if state.failed:
        return ()
    return _STEPS


# Objects of a drive from its EDS file (CiA 306). The only file that imports ``canopen``.

MOST_BYTES = 4
"""Data type of an object that an expedited transfer can carry."""


@dataclass(frozen=True, slots=True)
class DictionaryEntry:
    """A numeric object of the drive."""

    name: str
    size: int
    """Size, bytes."""
    signed: bool
    readable: bool
    writable: bool
    low: int
    high: int
    """Range for writing, by type and by the file's limits."""
    default: int | None


class Dictionary:
    """Numeric objects of a drive, from its EDS file."""

    def __init__(self, path: Path, entries: Mapping[Address, DictionaryEntry], lines: Mapping[int, int]) -> None:
        """``lines``: line of each index in the file."""
        self._path = path
        self._entries = entries
        self._lines = lines

    def __contains__(self, address: Address) -> bool:
        return address in self._entries

    def __getitem__(self, address: Address) -> DictionaryEntry:
        """ConfigError if the file has no such object."""
        if address not in self._entries:
            raise ConfigError(f"{self._place(address)}: object {address} is missing; polishd needs it for this drive")
        return self._entries[address]

    def require(self, *, read: Iterable[Address], write: Iterable[Address]) -> None:
        """Raise ConfigError for the first object that is missing or does not allow the access."""
        for address in read:
            if not self[address].readable:
                raise ConfigError(f"{self._place(address)}: {address} ({self[address].name}) cannot be read")
        for address in write:
            if not self[address].writable:
                raise ConfigError(f"{self._place(address)}: {address} ({self[address].name}) cannot be written")

    def encode(self, address: Address, value: int) -> bytes:
        """Encode a value; DeviceRefused if it is out of the object's range."""
        entry = self[address]
        if not entry.low <= value <= entry.high:
            raise DeviceRefused(f"{address} ({entry.name}) holds {entry.low} to {entry.high}, not {value}")
        return value.to_bytes(entry.size, "little", signed=entry.signed)

    def decode(self, address: Address, data: bytes, *, sized: bool) -> int:
        """Decode received data; ProtocolError if it does not have the object's size."""
        entry = self[address]
        if len(data) != entry.size and (sized or len(data) < entry.size):
            raise ProtocolError(f"{address} ({entry.name}) has {len(data)} bytes, its EDS file says {entry.size}")
        return int.from_bytes(data[: entry.size], "little", signed=entry.signed)

    def _place(self, address: Address) -> str:
        line = self._lines.get(address.index)
        return f"{self._path}:{line}" if line else str(self._path)


def read_dictionary(path: Path, node: int) -> Dictionary:
    """Read an EDS file; ConfigError names the fault and, if known, the line."""
    import canopen
    from canopen.objectdictionary import eds

    try:
        text = _decoded(read_input(path))
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from error
    if "[DeviceInfo]" not in text:
        raise ConfigError(f"{path}: is not an EDS file of CiA 306: section [DeviceInfo] is missing")
    try:
        found = eds.import_eds(io.StringIO(text), node)  # type: ignore[no-untyped-call]
    except (configparser.Error, canopen.ObjectDictionaryError, ValueError, LookupError) as error:
        raise ConfigError(f"{path}: is not an EDS file of CiA 306: {' '.join(str(error).split())}") from error
    return Dictionary(path, dict(_numbers(found)), _lines(text))


def emergency_text(code: int) -> str:
    """Return the meaning of a drive's error code in CiA 301."""
    from canopen.emcy import EmcyError

    known = {
        0x8110: "messages were lost: CAN overrun",
        0x8120: "bus errors: CAN in error passive mode",
        0x8130: "watchdog: no heartbeat of the controller",
        0x8140: "recovered from bus-off",
    }
    return known.get(code) or EmcyError(code, 0, b"", 0.0).get_desc().lower() or "unknown error"


def abort_text(code: int) -> str:
    """Return the reason of a refused transfer."""
    from canopen.sdo.exceptions import SdoAbortedError

    return str(SdoAbortedError.CODES.get(code, "unknown reason")).lower()


def _decoded(data: bytes) -> str:
    """Decode a text: manufacturers write UTF-8 or, more often, Windows-1252."""
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("cp1252", errors="replace")


def _lines(text: str) -> dict[int, int]:
    heads = (re.fullmatch(r"\[([0-9A-Fa-f]{4})\]\s*", line) for line in text.splitlines())
    return {int(head[1], 16): at for at, head in enumerate(heads, start=1) if head}


def _numbers(found: ObjectDictionary) -> Iterator[tuple[Address, DictionaryEntry]]:
    from canopen.objectdictionary import ODVariable
    from canopen.objectdictionary.datatypes import INTEGER_TYPES

    for index in found:
        node = found[index]
        for variable in [node] if isinstance(node, ODVariable) else [node[sub] for sub in node]:
            if variable.data_type in INTEGER_TYPES and len(variable) <= 8 * MOST_BYTES:
                yield Address(index, variable.subindex), _entry(variable)


def _entry(variable: ODVariable) -> DictionaryEntry:
    from canopen.objectdictionary.datatypes import SIGNED_TYPES

    bits, signed = len(variable), variable.data_type in SIGNED_TYPES
    low, high = (-(1 << bits - 1), (1 << bits - 1) - 1) if signed else (0, (1 << bits) - 1)
    least = low if variable.min is None else max(low, variable.min)
    most = high if variable.max is None else min(high, variable.max)
    if least >= most:  # tools of manufacturers write 0 for both limits if there are none
        least, most = low, high
    return DictionaryEntry(
        name=variable.name,
        size=bits // 8,
        signed=signed,
        readable=variable.readable,
        writable=variable.writable,
        low=least,
        high=most,
        default=variable.default if isinstance(variable.default, int) else None,
    )
