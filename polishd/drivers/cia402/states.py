"""The power state machine of a drive (CiA 402): status word in, control words out. Pure."""

from __future__ import annotations

from enum import Enum

from polishd.api import ProtocolError

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
