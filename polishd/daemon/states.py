"""The states of a daemon, and every way from one to another. The daemon runs from this table; docs/cycle.md shows it.

What happens in a state ends with a trigger, and the table says which state is next. One that does not stand in it is a
fault of polishd: it is raised, and the cell is left safe.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum


class State(StrEnum):
    """What a daemon is doing."""

    STARTING = "starting"
    IDLE = "idle"
    CHANGING = "changing"
    POLISHING = "polishing"
    HELD = "held"
    FINISHED = "finished"


DOES: Mapping[State, str] = {
    State.STARTING: "all devices are opened and made safe; a pass that an earlier run left open is settled",
    State.IDLE: "of a queue: the next job is made ready, or waited for",
    State.CHANGING: "of a queue: the part of the job is put in, by the loader or by a person",
    State.POLISHING: "the phases of the cycle, one after another",
    State.HELD: "safe; a person has the word",
    State.FINISHED: "safe, and all devices are closed",
}
"""What happens in each state."""


class Trigger(StrEnum):
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
    BETWEEN = "a queue is worked, and every device is safe"
    NEXT = "a job is next"
    CHANGED = "its part is in"
    ENDED = "the job of a queue has its verdict"
    STOPS = "the job of a queue has its verdict, and the queue stops over it"
    EMPTY = "no job waits, with `--until-empty`"


ORDERS = (Trigger.HOLD, Trigger.RESUME, Trigger.STOP, Trigger.ESTOP)
"""Verbs of the socket that change something."""


@dataclass(frozen=True, slots=True)
class Transition:
    """One row of the table."""

    source: State
    trigger: Trigger
    target: State
    note: str
    unattended: State | None = None
    """Where ``--no-hold`` leads instead; None: to the same."""


_START, _POLISH, _HELD, _END = State.STARTING, State.POLISHING, State.HELD, State.FINISHED
_IDLE, _CHANGE = State.IDLE, State.CHANGING

TRANSITIONS: tuple[Transition, ...] = (
    Transition(_START, Trigger.BUSY, _START, "it is asked again until its own watchdog must have let go"),
    Transition(_START, Trigger.READY, _POLISH, "the job is a new one"),
    Transition(_START, Trigger.BETWEEN, _IDLE, "no job of the queue was under way"),
    Transition(_START, Trigger.INTERRUPTED, _HELD, "nothing moves until `resume`", _END),
    Transition(_START, Trigger.UNSAFE, _HELD, "nothing is measured or moved before it does", _END),
    Transition(_START, Trigger.UNFIT, _HELD, "no room on a disk, say", _END),
    Transition(_START, Trigger.STOP, _END, "also while a device is waited for"),
    Transition(_START, Trigger.ERROR, _END, "a device that cannot be opened, too"),
    Transition(_IDLE, Trigger.NEXT, _CHANGE, "also one over which the cell was held"),
    Transition(_IDLE, Trigger.ENDED, _IDLE, "it could not begin, and nothing moved"),
    Transition(_IDLE, Trigger.STOPS, _HELD, "`resume` goes on with the next job", _END),
    Transition(_IDLE, Trigger.EMPTY, _END, "else it waits for `polishd job add`"),
    Transition(_IDLE, Trigger.HOLD, _HELD, "no job begins until `resume`"),
    Transition(_IDLE, Trigger.ESTOP, _HELD, "the same"),
    Transition(_IDLE, Trigger.MENDABLE, _HELD, "the instrument does not answer, say", _END),
    Transition(_IDLE, Trigger.STOP, _END, ""),
    Transition(_IDLE, Trigger.ERROR, _END, ""),
    Transition(_CHANGE, Trigger.CHANGED, _POLISH, "by the loader, or it was in already"),
    Transition(_CHANGE, Trigger.RESUME, _POLISH, "a person has put it in"),
    Transition(_CHANGE, Trigger.ENDED, _IDLE, "the loader has no such part, or brought another one"),
    Transition(_CHANGE, Trigger.STOPS, _HELD, "`resume` goes on with the next job", _END),
    Transition(_CHANGE, Trigger.HOLD, _HELD, "the loader stops where it is"),
    Transition(_CHANGE, Trigger.ESTOP, _HELD, "the same"),
    Transition(_CHANGE, Trigger.MENDABLE, _HELD, "the loader is jammed, say", _END),
    Transition(_CHANGE, Trigger.UNSAFE, _HELD, "no loader moves before every device is safe", _END),
    Transition(_CHANGE, Trigger.STOP, _END, "the loader stops where it is; the job stays open"),
    Transition(_CHANGE, Trigger.ERROR, _END, "the same"),
    Transition(_POLISH, Trigger.ENDED, _IDLE, "the queue goes on"),
    Transition(_POLISH, Trigger.STOPS, _HELD, "`resume` goes on with the next job", _END),
    Transition(_POLISH, Trigger.DONE, _END, "in tolerance, diverged, or all passes used"),
    Transition(_POLISH, Trigger.HOLD, _HELD, "once contact is left; what it cut off is settled"),
    Transition(_POLISH, Trigger.ESTOP, _HELD, "as `hold`, and motion stops first"),
    Transition(_POLISH, Trigger.UNFIT, _HELD, "once contact is left; what it cut off is settled", _END),
    Transition(_POLISH, Trigger.MENDABLE, _HELD, "only where it cuts off no pass", _END),
    Transition(_POLISH, Trigger.STOP, _END, "once contact is left; the job stays open"),
    Transition(_POLISH, Trigger.ERROR, _END, "once contact is left; the job stays open"),
    Transition(_HELD, Trigger.RESUME, _POLISH, "once lost links are open again and every device is safe"),
    Transition(_HELD, Trigger.BETWEEN, _IDLE, "`resume`, where a queue is worked"),
    Transition(_HELD, Trigger.ENDED, _IDLE, "`polishd job remove` puts the job aside over which it is held"),
    Transition(_HELD, Trigger.STOPS, _HELD, "the same, with a queue that stops over it", _END),
    Transition(_HELD, Trigger.UNSAFE, _HELD, "`resume` is refused, and tries again the next time", _END),
    Transition(_HELD, Trigger.UNFIT, _HELD, "the same", _END),
    Transition(_HELD, Trigger.MENDABLE, _HELD, "the same: the cause is not mended yet", _END),
    Transition(_HELD, Trigger.INTERRUPTED, _HELD, "the same, once: it is told before it goes on", _END),
    Transition(_HELD, Trigger.HOLD, _HELD, "its reason is added"),
    Transition(_HELD, Trigger.ESTOP, _HELD, "its reason is added"),
    Transition(_HELD, Trigger.STOP, _END, "over an error, the daemon ends with that error"),
    Transition(_HELD, Trigger.ERROR, _END, "the journal is lost, say"),
)

_TABLE = {(row.source, row.trigger): row for row in TRANSITIONS}


def following(state: State, trigger: Trigger, *, unattended: bool = False) -> State:
    """The next state. RuntimeError where the table has no such way: a fault of polishd."""
    row = _TABLE.get((state, trigger))
    if row is None:
        raise RuntimeError(f"a fault of polishd: no way leads on from {state} when: {trigger}; please report it")
    return row.unattended if unattended and row.unattended is not None else row.target


def obeyed(order: Trigger) -> frozenset[State]:
    """The states in which an order is obeyed: those to which it leads, and the end."""
    between = {row.target for row in TRANSITIONS if order is Trigger.RESUME and row.trigger is Trigger.BETWEEN}
    return frozenset({row.target for row in TRANSITIONS if row.trigger is order} | between | {State.FINISHED})
