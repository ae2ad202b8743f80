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


class DaemonState(StrEnum):
    """Activity of a daemon."""

    STARTING = "starting"
    IDLE = "idle"
    CHANGING = "changing"
    POLISHING = "polishing"
    HELD = "held"
    FINISHED = "finished"
