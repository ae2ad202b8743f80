"""What each ending of a job means for its part, and for the queue: one table, which the queue works by.

The table in docs/queue.md is made from this one.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from polishd.model import errors
from polishd.model.cycle import Outcome

How = Literal["accepted", "rejected", "put aside"]
QueueEffect = Literal["goes on", "stops", "waits"]


@dataclass(frozen=True, slots=True)
class ResultRule:
    """One row: what ended a job, what becomes of its part, and what of the queue."""

    ends: tuple[Outcome | type[errors.PolishdError], ...]
    how: How | None
    """None: the job is not over; a person mends the cause while the cell is held, or the daemon ends."""
    queue: QueueEffect
    why: str


RULES = (
    ResultRule((Outcome.IN_TOLERANCE,), "accepted", "goes on", "the part is in tolerance"),
    ResultRule((Outcome.AS_PROGRAMMED,), "accepted", "goes on", "it was polished as its program says, to teach"),
    ResultRule((Outcome.CYCLES_USED,), "rejected", "goes on", "all its passes are used"),
    ResultRule((Outcome.STALLED,), "put aside", "goes on", "its passes bring too little, and a person may find why"),
    ResultRule(
        (Outcome.DIVERGED,), "rejected", "goes on", "its surface got worse: the next part tells whether it is the cell"
    ),
    ResultRule(
        (errors.RemovalCheckStop,),
        "put aside",
        "stops",
        "instrument or alignment is wrong, and would be for the next part, too",
    ),
    ResultRule(
        (errors.ToolStop,), "put aside", "stops", "the tool would remove otherwise than planned from the next part, too"
    ),
    ResultRule((errors.WrongSeat,), "put aside", "goes on", "it does not sit where it should; nothing was polished"),
    ResultRule(
        (errors.HandlingError,), None, "waits", "a person is asked to clean or to condition, and the job goes on"
    ),
    ResultRule((errors.SurfaceError,), "put aside", "goes on", "its map cannot be trusted, or shows another part"),
    ResultRule(
        (errors.ProgramError, errors.PlanRefused, errors.ComputeError, errors.ConfigError, errors.PluginError),
        "put aside",
        "goes on",
        "nothing moves for a job that cannot be read, computed or planned",
    ),
    ResultRule(
        (errors.DeviceError,), None, "waits", "the device is at fault, not the part: the job goes on when it is mended"
    ),
    ResultRule((errors.PolishdError,), "put aside", "stops", "what is not known to be safe is a person's to judge"),
)
"""The first row that fits holds; of errors that came out of contact."""

TORN = ResultRule(
    (errors.DeviceError, errors.SafetyStop), "put aside", "goes on", "its pass was cut off: somebody should look at it"
)
"""Of errors that cut off a pass, once every device confirmed that it is safe; where one did not, the daemon ends."""


@dataclass(frozen=True, slots=True)
class JobResult:
    """How a job ended, and whether the queue goes on."""

    how: How
    reason: str
    fault: str
    """The error's class, or the outcome; empty for an accepted part."""
    stops: str = ""
    """Why the queue stops; empty where it goes on."""


def rule_of(end: Outcome | errors.PolishdError, *, torn: bool = False) -> ResultRule:
    """The row for that end."""
    if isinstance(end, Outcome):
        return next(rule for rule in RULES if end in rule.ends)
    if torn:
        return TORN
    kinds = [(rule, kind) for rule in RULES for kind in rule.ends if isinstance(kind, type)]
    return next(rule for rule, kind in kinds if isinstance(end, kind))


def judge(end: Outcome | errors.PolishdError, *, torn: bool, previous: str, tool: str = "") -> JobResult | None:
    """The verdict; None where the job is not over (``Rule.how``).

    ``torn``: it cut off a pass, and every device confirmed since that it is safe; ``previous``: the fault of the job
    before; ``tool``: what its passes showed of the tool, over which no job should go on, whatever became of this one.
    """
    rule = rule_of(end, torn=torn)
    if rule.how is None:
        return None
    fault = "" if rule.how == "accepted" else end.value if isinstance(end, Outcome) else type(end).__name__
    told = rule.why if isinstance(end, Outcome) else f"{fault}: {end}"
    stops = ""
    if rule.queue == "stops":
        stops = rule.why
    elif tool:
        stops = tool
    elif fault and fault == previous:
        stops = f"two parts in a row ended with the same fault, {fault}"
    return JobResult(rule.how, told, fault, stops)
