"""Frames of the spindle drive: identifiers and data, both ways. Sans-IO; frames that are not the drive's are None."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from enum import IntEnum

from polishd.drivers.transport.can_bus import CanFrame

COMMAND, STATUS, HEARTBEAT, SDO_REQUEST, SDO_ANSWER = 0x200, 0x180, 0x700, 0x600, 0x580
OPERATIONAL, BOOT = 0x05, 0x00
MAX_RPM = 0x7FFF
FAULTS = {1: "command silence", 2: "over-speed request", 4: "drive"}

_COMMAND = struct.Struct("<BBh4x")
_STATUS = struct.Struct("<BBiBx")
_SDO = struct.Struct("<BHBI")
_UPLOAD, _EXPEDITED, _ABORT = 0x40, 0x43, 0x80


class DriveState(IntEnum):
    """What the drive is doing."""

    STOPPED = 0
    RAMPING = 1
    AT_SPEED = 2
    FAULT = 3


@dataclass(frozen=True, slots=True)
class DriveObject:
    """An entry of the drive's object dictionary."""

    index: int
    sub: int


VENDOR_ID = DriveObject(0x1018, 1)
PRODUCT_CODE = DriveObject(0x1018, 2)
REVISION = DriveObject(0x1018, 3)
SERIAL_NUMBER = DriveObject(0x1018, 4)
BOOT_COUNT = DriveObject(0x2000, 0)
MAXIMUM_SPEED = DriveObject(0x6080, 0)


@dataclass(frozen=True, slots=True)
class DriveStatus:
    """Process data of the drive; ``counter`` is that of the last command it took."""

    state: DriveState
    counter: int
    rpm: float
    fault: int


@dataclass(frozen=True, slots=True)
class Heartbeat:
    """Sign of life; ``boot`` once after power-up."""

    boot: bool


@dataclass(frozen=True, slots=True)
class SdoAnswer:
    """The value of an object, or the drive's abort code."""

    what: DriveObject
    value: int
    aborted: bool


def encode_command(node: int, *, run: bool, counter: int, rpm: int) -> CanFrame:
    """Run at a speed, or stop."""
    return CanFrame(COMMAND + node, _COMMAND.pack(run, counter, rpm))


def encode_upload(node: int, what: DriveObject) -> CanFrame:
    """Ask for an object."""
    return CanFrame(SDO_REQUEST + node, _SDO.pack(_UPLOAD, what.index, what.sub, 0))


def decode(node: int, frame: CanFrame) -> DriveStatus | Heartbeat | SdoAnswer | None:
    """What that node said; None for other nodes, and for data that the protocol does not have."""
    identifier, data = frame
    if identifier == STATUS + node and len(data) == _STATUS.size:
        state, counter, tenths, fault = _STATUS.unpack(data)
        known = state in tuple(DriveState)
        return DriveStatus(DriveState(state), counter, tenths / 10.0, fault) if known else None
    if identifier == HEARTBEAT + node and data in (bytes([BOOT]), bytes([OPERATIONAL])):
        return Heartbeat(boot=data[0] == BOOT)
    if identifier == SDO_ANSWER + node and len(data) == _SDO.size:
        specifier, index, sub, value = _SDO.unpack(data)
        if specifier in (_EXPEDITED, _ABORT):
            return SdoAnswer(DriveObject(index, sub), value, aborted=specifier == _ABORT)
    return None
