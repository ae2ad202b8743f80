"""Phases and outcomes of a job."""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum


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
    """How a job ended."""

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
