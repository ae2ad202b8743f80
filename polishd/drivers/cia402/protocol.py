"""CANopen frames of one node (CiA 301): what we say and what it says. Sans-IO; frames that are not its own are None.

SDO transfers are expedited ones only: no object of a drive that is read or written here has more than four bytes.
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
from polishd.drivers.transport.can_bus import CanFrame

if TYPE_CHECKING:
    from canopen.objectdictionary import ObjectDictionary, ODVariable


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


# The objects of a drive that are used here, as CiA 301 and CiA 402 number them.

DEVICE_TYPE = Address(0x1000)
ERROR_REGISTER = Address(0x1001)
CONSUMER_HEARTBEAT = Address(0x1016, 1)
"""Whose heartbeat the drive listens for (bits 16 to 22), and how long it bears its absence, ms."""
PRODUCER_HEARTBEAT = Address(0x1017)
"""Period of the drive's own heartbeat, ms."""
VENDOR, PRODUCT, REVISION, SERIAL = (Address(0x1018, sub) for sub in (1, 2, 3, 4))

ABORT_CONNECTION = Address(0x6007)
"""What the drive does when it hears nothing more."""
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
"""Taken where bit 7 rises: DISABLE_VOLTAGE goes before it."""
FAULT_BIT = 0x08
"""Of the status word."""
MOVE_NOW = 0x3F
"""Profile position: operation enabled, a new set point, at once."""


class DriveState402(Enum):
    """Of the power stage; named as in CiA 402."""

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
        """The motor has current, and may move."""
        return self in {DriveState402.ENABLED, DriveState402.QUICK_STOP, DriveState402.FAULT_REACTION}

    @property
    def failed(self) -> bool:
        """Only a fault reset leads on."""
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
"""(mask, value) of the status word."""

_STEPS = ((SHUT_DOWN, DriveState402.READY), (SWITCH_ON, DriveState402.SWITCHED_ON), (ENABLE, DriveState402.ENABLED))


def state_of(status_word: int) -> DriveState402:
    """The state that a status word tells of; ProtocolError where it tells of none."""
    for mask, value, state in _BITS:
        if status_word & mask == value:
            return state
    raise ProtocolError(f"status word {status_word:#06x} is no state of CiA 402")


def power_up(state: DriveState402) -> tuple[tuple[int, DriveState402], ...]:
    """Control words that lead from there to operation enabled, each with the state to wait for before the next.

    A drive that is powered goes all the way: what it is enabled with is set first. None lead out of a fault.
    """
    if state is DriveState402.QUICK_STOP:
        return (DISABLE_VOLTAGE, DriveState402.SWITCH_ON_DISABLED), *_STEPS
    if state.failed:
        return ()
    return _STEPS


# A drive's objects as its EDS file (CiA 306) describes them. The only file that knows ``canopen``.

MOST_BYTES = 4
"""Of an object that an expedited transfer carries."""


@dataclass(frozen=True, slots=True)
class DictionaryEntry:
    """A number of the drive."""

    name: str
    size: int
    """Bytes."""
    signed: bool
    readable: bool
    writable: bool
    low: int
    high: int
    """What may be written: by its type, and by the file's limits."""
    default: int | None


class Dictionary:
    """The numbers that a drive has, from its EDS file."""

    def __init__(self, path: Path, entries: Mapping[Address, DictionaryEntry], lines: Mapping[int, int]) -> None:
        """``lines``: where in the file each index is."""
        self._path = path
        self._entries = entries
        self._lines = lines

    def __contains__(self, address: Address) -> bool:
        return address in self._entries

    def __getitem__(self, address: Address) -> DictionaryEntry:
        """ConfigError where the file has no such number."""
        if address not in self._entries:
            raise ConfigError(f"{self._place(address)}: it has no number {address}, which this drive is worked with")
        return self._entries[address]

    def require(self, *, read: Iterable[Address], write: Iterable[Address]) -> None:
        """ConfigError for the first that is missing, or that does not allow it."""
        for address in read:
            if not self[address].readable:
                raise ConfigError(f"{self._place(address)}: {address} ({self[address].name}) cannot be read")
        for address in write:
            if not self[address].writable:
                raise ConfigError(f"{self._place(address)}: {address} ({self[address].name}) cannot be written")

    def encode(self, address: Address, value: int) -> bytes:
        """The value as it is sent; DeviceRefused where the drive cannot hold it."""
        entry = self[address]
        if not entry.low <= value <= entry.high:
            raise DeviceRefused(f"{address} ({entry.name}) holds {entry.low} to {entry.high}, not {value}")
        return value.to_bytes(entry.size, "little", signed=entry.signed)

    def decode(self, address: Address, data: bytes, *, sized: bool) -> int:
        """The value of what came; ProtocolError where it has not the object's size."""
        entry = self[address]
        if len(data) != entry.size and (sized or len(data) < entry.size):
            raise ProtocolError(f"{address} ({entry.name}) came in {len(data)} bytes, its EDS file says {entry.size}")
        return int.from_bytes(data[: entry.size], "little", signed=entry.signed)

    def _place(self, address: Address) -> str:
        line = self._lines.get(address.index)
        return f"{self._path}:{line}" if line else str(self._path)


def read_dictionary(path: Path, node: int) -> Dictionary:
    """Read an EDS file; ConfigError says what is wrong with it, and where as far as that is known."""
    import canopen
    from canopen.objectdictionary import eds

    try:
        text = _decoded(path.read_bytes())
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from error
    if "[DeviceInfo]" not in text:
        raise ConfigError(f"{path}: is no EDS file of CiA 306: it has no section [DeviceInfo]")
    try:
        found = eds.import_eds(io.StringIO(text), node)  # type: ignore[no-untyped-call]
    except (configparser.Error, canopen.ObjectDictionaryError, ValueError, LookupError) as error:
        raise ConfigError(f"{path}: is no EDS file of CiA 306: {' '.join(str(error).split())}") from error
    return Dictionary(path, dict(_numbers(found)), _lines(text))


def emergency_text(code: int) -> str:
    """What an error code of a drive means, as far as CiA 301 says."""
    from canopen.emcy import EmcyError

    known = {
        0x8110: "messages were lost: CAN overrun",
        0x8120: "the bus is bad: CAN in error passive mode",
        0x8130: "watchdog ran out: no heartbeat of the controller",
        0x8140: "recovered from bus-off",
    }
    return known.get(code) or EmcyError(code, 0, b"", 0.0).get_desc().lower() or "unknown error"


def abort_text(code: int) -> str:
    """Why a transfer was refused."""
    from canopen.sdo.exceptions import SdoAbortedError

    return str(SdoAbortedError.CODES.get(code, "no reason that CiA 301 knows")).lower()


def _decoded(data: bytes) -> str:
    """Drives' makers write UTF-8 or, more often, Windows' Latin."""
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
    if least >= most:  # makers' tools leave both limits at 0 where there are none
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
