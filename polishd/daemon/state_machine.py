"""States of the daemon of a cell, and every transition from one to another. docs/cycle.md shows this table."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum

from polishd.model.states import DaemonState

DOES: Mapping[DaemonState, str] = {
    DaemonState.STARTING: "all devices are opened and made safe; a pass that an earlier run left open is settled",
    DaemonState.IDLE: "the next job is made ready, or waited for; passed through where a job is ready",
    DaemonState.CHANGING: "the part of the job is put in, by the loader or by a person; passed through where it is in",
    DaemonState.POLISHING: "the phases of the cycle, one after another",
    DaemonState.HELD: "safe; a person has the word",
    DaemonState.FINISHED: "safe, and all devices are closed",
}
"""What happens in each state."""


class StateEvent(StrEnum):
    """What ends a state's work; orders have the names of their verbs."""

    HOLD = "hold"
    RESUME = "resume"
    STOP = "stop"
    ESTOP = "estop"
    BUSY = "a device still serves its last client"
    READY = "every device confirmed that it is safe"
    UNSAFE = "a device did not confirm that it is safe"
    INTERRUPTED = "an earlier run, or an order, left a pass or the job open"
    UNFIT = "the computer nears a limit, or a signal is wrong"
    MENDABLE = "an error that a person can mend"
    ERROR = "any other error"
    DONE = "the job has its outcome"
    NEXT = "a job is next"
    CHANGED = "its part is in"
    ENDED = "the job of a queue has its verdict"
    STOPS = "the job of a queue has its verdict, and the queue stops over it"
    EMPTY = "no job waits, with `--until-empty`"


ORDERS = (StateEvent.HOLD, StateEvent.RESUME, StateEvent.STOP, StateEvent.ESTOP)
"""Verbs of the socket that change something."""


@dataclass(frozen=True, slots=True)
class StateTransition:
    """One row of the table."""

    source: DaemonState
    trigger: StateEvent
    target: DaemonState
    note: str
    unattended: DaemonState | None = None
    """Where ``--no-hold`` leads instead; None: to the same."""


_START, _POLISH, _HELD, _END = DaemonState.STARTING, DaemonState.POLISHING, DaemonState.HELD, DaemonState.FINISHED
_IDLE, _CHANGE = DaemonState.IDLE, DaemonState.CHANGING

TRANSITIONS: tuple[StateTransition, ...] = (
    StateTransition(_START, StateEvent.BUSY, _START, "it is asked again until its own watchdog must have let go"),
    StateTransition(_START, StateEvent.READY, _IDLE, "the job is a new one, or none of the queue was under way"),
    StateTransition(_START, StateEvent.INTERRUPTED, _HELD, "nothing moves until `resume`", _END),
    StateTransition(_START, StateEvent.UNSAFE, _HELD, "nothing is measured or moved before it does", _END),
    StateTransition(_START, StateEvent.UNFIT, _HELD, "no room on a disk, say", _END),
    StateTransition(_START, StateEvent.STOP, _END, "also while a device is waited for"),
    StateTransition(_START, StateEvent.ERROR, _END, "a device that cannot be opened, too"),
    StateTransition(_IDLE, StateEvent.NEXT, _CHANGE, "also one over which the cell was held"),
    StateTransition(_IDLE, StateEvent.ENDED, _IDLE, "it could not begin, and nothing moved"),
    StateTransition(_IDLE, StateEvent.STOPS, _HELD, "`resume` goes on with the next job", _END),
    StateTransition(_IDLE, StateEvent.EMPTY, _END, "else it waits for `polishd queue add`"),
    StateTransition(_IDLE, StateEvent.HOLD, _HELD, "no job begins until `resume`"),
    StateTransition(_IDLE, StateEvent.ESTOP, _HELD, "the same"),
    StateTransition(_IDLE, StateEvent.MENDABLE, _HELD, "the instrument does not answer, say", _END),
    StateTransition(_IDLE, StateEvent.STOP, _END, ""),
    StateTransition(_IDLE, StateEvent.ERROR, _END, ""),
    StateTransition(_CHANGE, StateEvent.CHANGED, _POLISH, "by the loader, or it was in"),
    StateTransition(_CHANGE, StateEvent.RESUME, _POLISH, "a person has put it in"),
    StateTransition(_CHANGE, StateEvent.ENDED, _IDLE, "the loader has no such part, or brought another one"),
    StateTransition(_CHANGE, StateEvent.STOPS, _HELD, "`resume` goes on with the next job", _END),
    StateTransition(_CHANGE, StateEvent.HOLD, _HELD, "the loader stops where it is"),
    StateTransition(_CHANGE, StateEvent.ESTOP, _HELD, "the same"),
    StateTransition(_CHANGE, StateEvent.MENDABLE, _HELD, "the loader is jammed, say", _END),
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
    StateTransition(_POLISH, StateEvent.HOLD, _HELD, "once contact is left; what it cut off is settled"),
    StateTransition(_POLISH, StateEvent.ESTOP, _HELD, "as `hold`, and motion stops first"),
    StateTransition(_POLISH, StateEvent.UNFIT, _HELD, "once contact is left; what it cut off is settled", _END),
    StateTransition(_POLISH, StateEvent.MENDABLE, _HELD, "only where it cuts off no pass", _END),
    StateTransition(_POLISH, StateEvent.STOP, _END, "once contact is left; the job stays open"),
    StateTransition(_POLISH, StateEvent.ERROR, _END, "once contact is left; the job stays open"),
    StateTransition(_HELD, StateEvent.RESUME, _IDLE, "once lost links are open again and every device is safe"),
    StateTransition(_HELD, StateEvent.ENDED, _IDLE, "`polishd queue remove` puts the job aside over which it is held"),
    StateTransition(_HELD, StateEvent.STOPS, _HELD, "the same, with a queue that stops over it", _END),
    StateTransition(_HELD, StateEvent.UNSAFE, _HELD, "`resume` is refused, and tries again the next time", _END),
    StateTransition(_HELD, StateEvent.UNFIT, _HELD, "the same", _END),
    StateTransition(_HELD, StateEvent.MENDABLE, _HELD, "the same: the cause is not mended yet", _END),
    StateTransition(_HELD, StateEvent.INTERRUPTED, _HELD, "the same, once: `status` shows it first", _END),
    StateTransition(_HELD, StateEvent.HOLD, _HELD, "its reason is added"),
    StateTransition(_HELD, StateEvent.ESTOP, _HELD, "its reason is added"),
    StateTransition(_HELD, StateEvent.STOP, _END, "over an error, the daemon ends with that error"),
    StateTransition(_HELD, StateEvent.ERROR, _END, "the journal is lost, say"),
)

_TABLE = {(row.source, row.trigger): row for row in TRANSITIONS}


def following(state: DaemonState, trigger: StateEvent, *, unattended: bool = False) -> DaemonState:
    """The next state. RuntimeError where the table has no such way: a fault of polishd."""
    row = _TABLE.get((state, trigger))
    if row is None:
        raise RuntimeError(f"a fault of polishd: no way leads on from {state} when: {trigger}; please report it")
    return row.unattended if unattended and row.unattended is not None else row.target


def obeyed(order: StateEvent) -> frozenset[DaemonState]:
    """The states in which an order is obeyed: those to which it leads, and the end."""
    return frozenset({row.target for row in TRANSITIONS if row.trigger is order} | {DaemonState.FINISHED})
