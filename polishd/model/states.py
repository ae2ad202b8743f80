"""Phases and outcomes of a job."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from enum import StrEnum
from typing import Any, Self


class CyclePhase(StrEnum):
    """The phases of a cycle, in time order; those beside measuring and polishing only where the cell asks for them."""

    CLEAN = "clean"
    MEASURE = "measure"
    SETTLE = "settle"
    LEARN = "learn"
    SOLVE = "solve"
    PLAN = "plan"
    CHANGE = "change"
    CONDITION = "condition"
    TOUCH_OFF = "touch_off"
    RUN = "run"


class Outcome(StrEnum):
    """Outcome of a job."""

    IN_TOLERANCE = "in_tolerance"
    CYCLES_USED = "cycles_used"
    AS_PROGRAMMED = "as_programmed"
    DIVERGED = "diverged"
    STALLED = "stalled"
    STOPPED = "stopped"


EXIT_CODES: Mapping[Outcome, int] = {
    Outcome.IN_TOLERANCE: 0,
    Outcome.AS_PROGRAMMED: 0,
    Outcome.CYCLES_USED: 1,
    Outcome.STALLED: 1,
    Outcome.STOPPED: 1,
    Outcome.DIVERGED: 6,
}


# What concerns a person: how severe it is, how a cell stands, and the words for both.

AT_THE_MACHINE: Mapping[str, str] = {  # by port
    "actuator": "the tool may press on the part: switch the actuator off, and see it lifted, before anything moves",
    "robot": "it may still move: stop it at its own controller, and keep out of its reach",
    "spindle": "it may still turn: switch its drive off before you reach in",
    "loader": "it may still move, or hold a part: stop it at its own controller, and keep out of its reach",
}


class Severity(StrEnum):
    """Urgency for the operator."""

    INFO = "info"
    """Information only; no action is needed."""
    WARNING = "warning"
    """The cell is safe and waits for the operator."""
    ALARM = "alarm"
    """Now: the daemon is gone, or a device did not confirm that it is safe."""

    @property
    def rank(self) -> int:
        """0 is the least."""
        return list(Severity).index(self)


@dataclass(frozen=True, slots=True)
class OperatorNotice:
    """Message of an event for the operator on call; commands in it name ``CELL.toml``."""

    severity: Severity
    what: str
    """The event."""
    now: str
    """The cell's reaction."""
    todo: str
    """Actions for the operator."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CellSafety:
    """Safety of a cell as its devices confirmed it, and the next action."""

    tool_off: str
    """``yes``, ``not confirmed`` or ``not asked``."""
    robot_at_rest: str
    """As ``tool_off``, for the robot."""
    unsafe: Sequence[str]
    """Each device that did not confirm being safe: ``name: why``."""
    next: str
    """Actions for the operator."""

    @classmethod
    def of(cls, facts: Mapping[str, Any]) -> Self:
        """Return the safety from a record with these field names."""
        return cls(**{item.name: facts[item.name] for item in fields(cls)})

    def rows(self) -> list[tuple[str, str]]:
        """Names and texts; who did not confirm with what to do at the machine."""
        rows = [("tool off the part", self.tool_off), ("robot at rest", self.robot_at_rest)]
        for entry in self.unsafe:
            device, _, why = entry.partition(": ")
            advice = AT_THE_MACHINE.get(device.partition(".")[0], "look at it")
            rows.append((f"{device} did not confirm", f"{why}; {advice}"))
        return rows

    def concern(self, severity: Severity, what: str, does: str) -> OperatorNotice:
        """Return the operator's notice; an alarm where a device did not confirm."""
        now = [does, *(f"{name}: {text}" for name, text in self.rows())]
        return OperatorNotice(Severity.ALARM if self.unsafe else severity, what, "; ".join(now), self.next)


NOT_ASKED = CellSafety(tool_off="not asked", robot_at_rest="not asked", unsafe=(), next="")
"""Nothing is known of its devices."""


# The states of a daemon, and every way from one to another. The daemon runs from this table; docs/cycle.md shows it.


class DaemonState(StrEnum):
    """Activity of a daemon."""

    STARTING = "starting"
    IDLE = "idle"
    CHANGING = "changing"
    POLISHING = "polishing"
    HELD = "held"
    FINISHED = "finished"


DOES: Mapping[DaemonState, str] = {
    DaemonState.STARTING: "all devices are opened and made safe; a pass that an earlier run left open is settled",
    DaemonState.IDLE: "of a queue: the next job is made ready, or waited for",
    DaemonState.CHANGING: "of a queue: the part of the job is put in, by the loader or by a person",
    DaemonState.POLISHING: "the phases of the cycle, one after another",
    DaemonState.HELD: "safe; a person has the word",
    DaemonState.FINISHED: "safe, and all devices are closed",
}
"""Meaning of each state."""


class StateEvent(StrEnum):
    """Trigger of a transition; commands have the names of their verbs."""

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
    """Target state with ``--no-hold``; None: the same."""


_START, _POLISH, _HELD, _END = DaemonState.STARTING, DaemonState.POLISHING, DaemonState.HELD, DaemonState.FINISHED
_IDLE, _CHANGE = DaemonState.IDLE, DaemonState.CHANGING

TRANSITIONS: tuple[StateTransition, ...] = (
    StateTransition(_START, StateEvent.BUSY, _START, "it is asked again until its own watchdog must have let go"),
    StateTransition(_START, StateEvent.READY, _POLISH, "the job is a new one"),
    StateTransition(_START, StateEvent.BETWEEN, _IDLE, "no job of the queue was under way"),
    StateTransition(_START, StateEvent.INTERRUPTED, _HELD, "nothing moves until `resume`", _END),
    StateTransition(_START, StateEvent.UNSAFE, _HELD, "nothing is measured or moved before it does", _END),
    StateTransition(_START, StateEvent.UNFIT, _HELD, "no room on a disk, say", _END),
    StateTransition(_START, StateEvent.STOP, _END, "also while a device is waited for"),
    StateTransition(_START, StateEvent.ERROR, _END, "a device that cannot be opened, too"),
    StateTransition(_IDLE, StateEvent.NEXT, _CHANGE, "also one over which the cell was held"),
    StateTransition(_IDLE, StateEvent.ENDED, _IDLE, "it could not begin, and nothing moved"),
    StateTransition(_IDLE, StateEvent.STOPS, _HELD, "`resume` goes on with the next job", _END),
    StateTransition(_IDLE, StateEvent.EMPTY, _END, "else it waits for `polishd job add`"),
    StateTransition(_IDLE, StateEvent.HOLD, _HELD, "no job begins until `resume`"),
    StateTransition(_IDLE, StateEvent.ESTOP, _HELD, "the same"),
    StateTransition(_IDLE, StateEvent.MENDABLE, _HELD, "the instrument does not answer, say", _END),
    StateTransition(_IDLE, StateEvent.STOP, _END, ""),
    StateTransition(_IDLE, StateEvent.ERROR, _END, ""),
    StateTransition(_CHANGE, StateEvent.CHANGED, _POLISH, "by the loader, or it was in already"),
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
    StateTransition(_POLISH, StateEvent.DONE, _END, "in tolerance, diverged, or all passes used"),
    StateTransition(_POLISH, StateEvent.HOLD, _HELD, "once contact is left; what it cut off is settled"),
    StateTransition(_POLISH, StateEvent.ESTOP, _HELD, "as `hold`, and motion stops first"),
    StateTransition(_POLISH, StateEvent.UNFIT, _HELD, "once contact is left; what it cut off is settled", _END),
    StateTransition(_POLISH, StateEvent.MENDABLE, _HELD, "only where it cuts off no pass", _END),
    StateTransition(_POLISH, StateEvent.STOP, _END, "once contact is left; the job stays open"),
    StateTransition(_POLISH, StateEvent.ERROR, _END, "once contact is left; the job stays open"),
    StateTransition(_HELD, StateEvent.RESUME, _POLISH, "once lost links are open again and every device is safe"),
    StateTransition(_HELD, StateEvent.BETWEEN, _IDLE, "`resume`, where a queue is worked"),
    StateTransition(_HELD, StateEvent.ENDED, _IDLE, "`polishd job remove` puts the job aside over which it is held"),
    StateTransition(_HELD, StateEvent.STOPS, _HELD, "the same, with a queue that stops over it", _END),
    StateTransition(_HELD, StateEvent.UNSAFE, _HELD, "`resume` is refused, and tries again the next time", _END),
    StateTransition(_HELD, StateEvent.UNFIT, _HELD, "the same", _END),
    StateTransition(_HELD, StateEvent.MENDABLE, _HELD, "the same: the cause is not mended yet", _END),
    StateTransition(
        _HELD, StateEvent.INTERRUPTED, _HELD, "the same, once: the interruption is reported before it goes on", _END
    ),
    StateTransition(_HELD, StateEvent.HOLD, _HELD, "its reason is added"),
    StateTransition(_HELD, StateEvent.ESTOP, _HELD, "its reason is added"),
    StateTransition(_HELD, StateEvent.STOP, _END, "over an error, the daemon ends with that error"),
    StateTransition(_HELD, StateEvent.ERROR, _END, "the journal is lost, say"),
)

_TABLE = {(row.source, row.trigger): row for row in TRANSITIONS}


def next_state(state: DaemonState, trigger: StateEvent, *, unattended: bool = False) -> DaemonState:
    """The next state. RuntimeError where the table has no such way: a fault of polishd."""
    row = _TABLE.get((state, trigger))
    if row is None:
        raise RuntimeError(f"a fault of polishd: no way leads on from {state} when: {trigger}; please report it")
    return row.unattended if unattended and row.unattended is not None else row.target


def accepting_states(order: StateEvent) -> frozenset[DaemonState]:
    """The states in which an order is obeyed: those to which it leads, and the end."""
    between = {row.target for row in TRANSITIONS if order is StateEvent.RESUME and row.trigger is StateEvent.BETWEEN}
    return frozenset({row.target for row in TRANSITIONS if row.trigger is order} | between | {DaemonState.FINISHED})
