"""States of the daemon of a cell and all transitions between them. docs/reference/daemon.md shows this table."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum

from polishd.model.states import DaemonState

DOES: Mapping[DaemonState, str] = {
    DaemonState.STARTING: "all devices are opened and made safe; a pass that an earlier run left open is settled",
    DaemonState.IDLE: "the daemon prepares the next job or waits for one; skipped if a job is ready",
    DaemonState.CHANGING: "the loader or an operator puts in the part of the job; skipped if it is in",
    DaemonState.POLISHING: "the phases of the cycle, one after another",
    DaemonState.HELD: "safe; the daemon waits for an operator",
    DaemonState.FINISHED: "safe, and all devices are closed",
}
"""What happens in each state."""


class StateEvent(StrEnum):
    """Event that ends the work of a state; an operator's command has its name as value."""

    HOLD = "hold"
    RESUME = "resume"
    STOP = "stop"
    ESTOP = "estop"
    BUSY = "a device still serves its last client"
    READY = "every device confirmed that it is safe"
    UNSAFE = "a device did not confirm that it is safe"
    INTERRUPTED = "an earlier run or a command left a pass or the job open"
    UNFIT = "the computer is near a limit, or a signal is wrong"
    MENDABLE = "an error that the operator can correct"
    ERROR = "any other error"
    DONE = "the job has its outcome"
    NEXT = "a job is next"
    CHANGED = "its part is in"
    ENDED = "the job of a queue has its verdict"
    STOPS = "the job of a queue has its verdict, and the queue stops because of it"
    EMPTY = "no job waits, with `--until-empty`"


ORDERS = (StateEvent.HOLD, StateEvent.RESUME, StateEvent.STOP, StateEvent.ESTOP)
"""Commands of the socket that change the state."""


@dataclass(frozen=True, slots=True)
class StateTransition:
    """One row of the table."""

    source: DaemonState
    trigger: StateEvent
    target: DaemonState
    note: str
    unattended: DaemonState | None = None
    """Target with ``--no-hold``; None: the same."""


_START, _POLISH, _HELD, _END = DaemonState.STARTING, DaemonState.POLISHING, DaemonState.HELD, DaemonState.FINISHED
_IDLE, _CHANGE = DaemonState.IDLE, DaemonState.CHANGING

TRANSITIONS: tuple[StateTransition, ...] = (
    StateTransition(_START, StateEvent.BUSY, _START, "the daemon tries again until the device's watchdog has run out"),
    StateTransition(_START, StateEvent.READY, _IDLE, "the job is a new one, or none of the queue was under way"),
    StateTransition(_START, StateEvent.INTERRUPTED, _HELD, "nothing moves until `resume`", _END),
    StateTransition(_START, StateEvent.UNSAFE, _HELD, "nothing is measured or moved before it confirms", _END),
    StateTransition(_START, StateEvent.UNFIT, _HELD, "for example no room on a disk", _END),
    StateTransition(_START, StateEvent.STOP, _END, "also while the daemon waits for a device"),
    StateTransition(_START, StateEvent.ERROR, _END, "also a device that cannot be opened"),
    StateTransition(_IDLE, StateEvent.NEXT, _CHANGE, "also a job that held the cell"),
    StateTransition(_IDLE, StateEvent.ENDED, _IDLE, "it could not begin, and nothing moved"),
    StateTransition(_IDLE, StateEvent.STOPS, _HELD, "`resume` goes on with the next job", _END),
    StateTransition(_IDLE, StateEvent.EMPTY, _END, "without it the daemon waits for `polishd queue add`"),
    StateTransition(_IDLE, StateEvent.HOLD, _HELD, "no job begins until `resume`"),
    StateTransition(_IDLE, StateEvent.ESTOP, _HELD, "the same"),
    StateTransition(_IDLE, StateEvent.MENDABLE, _HELD, "for example an instrument that does not answer", _END),
    StateTransition(_IDLE, StateEvent.STOP, _END, ""),
    StateTransition(_IDLE, StateEvent.ERROR, _END, ""),
    StateTransition(_CHANGE, StateEvent.CHANGED, _POLISH, "by the loader, or it was in"),
    StateTransition(_CHANGE, StateEvent.RESUME, _POLISH, "an operator has put it in"),
    StateTransition(_CHANGE, StateEvent.ENDED, _IDLE, "the loader has no such part or loaded another one"),
    StateTransition(_CHANGE, StateEvent.STOPS, _HELD, "`resume` goes on with the next job", _END),
    StateTransition(_CHANGE, StateEvent.HOLD, _HELD, "the loader stops where it is"),
    StateTransition(_CHANGE, StateEvent.ESTOP, _HELD, "the same"),
    StateTransition(_CHANGE, StateEvent.MENDABLE, _HELD, "for example a jammed loader", _END),
    StateTransition(_CHANGE, StateEvent.UNSAFE, _HELD, "no loader moves before every device is safe", _END),
    StateTransition(_CHANGE, StateEvent.STOP, _END, "the loader stops where it is; the job stays open"),
    StateTransition(_CHANGE, StateEvent.ERROR, _END, "the same"),
    StateTransition(_POLISH, StateEvent.ENDED, _IDLE, "the queue goes on"),
    StateTransition(_POLISH, StateEvent.STOPS, _HELD, "`resume` goes on with the next job", _END),
    StateTransition(
        _POLISH,
        StateEvent.DONE,
        _END,
        "of the one job of `cell.toml`: in tolerance, diverged, stalled, or all passes used",
    ),
    StateTransition(_POLISH, StateEvent.HOLD, _HELD, "once contact is left and the interrupted pass is closed"),
    StateTransition(_POLISH, StateEvent.ESTOP, _HELD, "as `hold`, and motion stops first"),
    StateTransition(_POLISH, StateEvent.UNFIT, _HELD, "once contact is left and the interrupted pass is closed", _END),
    StateTransition(_POLISH, StateEvent.MENDABLE, _HELD, "only if it interrupts no pass", _END),
    StateTransition(_POLISH, StateEvent.STOP, _END, "once contact is left; the job stays open"),
    StateTransition(_POLISH, StateEvent.ERROR, _END, "once contact is left; the job stays open"),
    StateTransition(_HELD, StateEvent.RESUME, _IDLE, "once lost links are open again and every device is safe"),
    StateTransition(_HELD, StateEvent.ENDED, _IDLE, "`polishd queue remove` sets the job aside that holds the cell"),
    StateTransition(_HELD, StateEvent.STOPS, _HELD, "the same, and the queue stops because of it", _END),
    StateTransition(_HELD, StateEvent.UNSAFE, _HELD, "`resume` is refused; the next one tries again", _END),
    StateTransition(_HELD, StateEvent.UNFIT, _HELD, "the same", _END),
    StateTransition(_HELD, StateEvent.MENDABLE, _HELD, "the same: the cause remains", _END),
    StateTransition(_HELD, StateEvent.INTERRUPTED, _HELD, "the same, once: `status` shows it first", _END),
    StateTransition(_HELD, StateEvent.HOLD, _HELD, "its reason is added"),
    StateTransition(_HELD, StateEvent.ESTOP, _HELD, "its reason is added"),
    StateTransition(_HELD, StateEvent.STOP, _END, "if an error holds the cell, the daemon ends with that error"),
    StateTransition(_HELD, StateEvent.ERROR, _END, "for example a lost journal"),
)

_TABLE = {(row.source, row.trigger): row for row in TRANSITIONS}


def following(state: DaemonState, trigger: StateEvent, *, unattended: bool = False) -> DaemonState:
    """Return the next state. RuntimeError, a fault of polishd, if the table has no such transition."""
    row = _TABLE.get((state, trigger))
    if row is None:
        raise RuntimeError(f"a fault of polishd: no transition from {state} for: {trigger}. Please report it")
    return row.unattended if unattended and row.unattended is not None else row.target


def obeyed(order: StateEvent) -> frozenset[DaemonState]:
    """Return the states in which a command is obeyed: its targets, and the end."""
    return frozenset({row.target for row in TRANSITIONS if row.trigger is order} | {DaemonState.FINISHED})
