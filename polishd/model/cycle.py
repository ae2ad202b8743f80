"""Phases and outcomes of a job, and what hooks are told."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any


class Phase(StrEnum):
    """The phases of a cycle, in time order."""

    MEASURE = "measure"
    LEARN = "learn"
    SOLVE = "solve"
    PLAN = "plan"
    RUN = "run"


class Outcome(StrEnum):
    """How a job ended."""

    IN_TOLERANCE = "in_tolerance"
    CYCLES_USED = "cycles_used"
    DIVERGED = "diverged"
    STOPPED = "stopped"


EXIT_CODES: Mapping[Outcome, int] = {
    Outcome.IN_TOLERANCE: 0,
    Outcome.CYCLES_USED: 1,
    Outcome.STOPPED: 1,
    Outcome.DIVERGED: 6,
}


@dataclass(frozen=True, slots=True)
class Event:
    """Something that happened, for ``polishd_on_event``, the status socket and the log."""

    name: str
    cycle: int | None = None
    data: Mapping[str, Any] = field(default_factory=dict)
