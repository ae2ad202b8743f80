"""What a person must know who finds a cell held, or its daemon gone.

It is kept in the state folder, so that ``polishd status`` tells it where no daemon runs.
"""

from __future__ import annotations

import json
import logging
import shlex
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from polishd.config.cell import port_of
from polishd.daemon.journal import Journal
from polishd.daemon.states import State
from polishd.files import write_atomic
from polishd.model.concern import Standing
from polishd.model.errors import PolishdError
from polishd.model.events import Event, StateChanged

log = logging.getLogger(__name__)

RECORD_NAME = "ending.json"
_AGAIN = "polishd run CELL.toml; it comes up held, and polishd resume CELL.toml starts with a new measurement"
_OVER = "look at report.html in the run folder; this job is over, polishd run CELL.toml begins a new one"
NEXT: Mapping[str, str] = {
    "idle": "polishd job add CELL.toml JOB.toml adds a job to the queue; polishd stop CELL.toml ends the daemon",
    "changing": "where there is no loader: put the part in, then polishd resume CELL.toml",
    "held": (
        "when nothing is left to mend: polishd resume CELL.toml goes on, with a new measurement first; a file of the "
        "cell that was changed counts only after polishd stop CELL.toml and polishd run CELL.toml"
    ),
    "killed": f"look at the cell, then: {_AGAIN}",
    "failed": f"the daemon has ended; when that is mended: {_AGAIN}",
    "stopped": f"the daemon has ended; to go on with this job: {_AGAIN}",
    "in_tolerance": _OVER,
    "as_programmed": f"what the pass has taught is remembered, polishd beliefs CELL.toml shows it: {_OVER}",
    "cycles_used": f"the part is not in tolerance: {_OVER}",
    "diverged": f"the surface got worse: {_OVER}",
    "stalled": f"passes bring too little of what was predicted: {_OVER}",
}
"""What to do, by state or outcome: nobody is told to resume where no daemon runs, nor to run where one is held."""


def to_do(state: str, *, queue: bool) -> str:
    """What to do, by state or outcome, where a queue is worked or one job."""
    text = NEXT.get(state, "")
    return text.replace("polishd run CELL.toml", "polishd run CELL.toml --queue") if queue else text


def standing(state: str, reason: str, unsafe: Sequence[str] | None, *, queue: bool = False) -> StateChanged:
    """How a cell stands: ``state`` is the daemon's, or ``killed``, ``failed`` or the job's outcome where it has ended.

    ``unsafe`` is ``Cell.unsafe``; None: the cell was not opened, and no device was asked.
    """

    def confirmed(port: str) -> str:
        """By all devices at that port."""
        if unsafe is None:
            return "not asked"
        return "not confirmed" if any(port_of(entry.partition(":")[0]) == port for entry in unsafe) else "yes"

    return StateChanged(
        state=state,
        reason=reason,
        standing=Standing(
            tool_off=confirmed("actuator"),
            robot_at_rest=confirmed("robot"),
            unsafe=list(unsafe or ()),
            next=to_do(state, queue=queue),
        ),
    )


def for_cell(text: str, cell: Path) -> str:
    """With commands that can be copied."""
    return text.replace("CELL.toml", shlex.quote(str(cell)))


def gone(names: Iterable[str]) -> tuple[str, ...]:
    """What is known of those devices should the daemon be killed while it polishes."""
    return tuple(f"{name}: no daemon lived to ask it" for name in names)


@dataclass(frozen=True, slots=True)
class Cause:
    """An error that held or ended a job's daemon."""

    at: str
    """ISO 8601, UTC."""
    kind: str
    error: str
    ended: bool
    """It ended the daemon; else a person could mend it while the daemon waited."""

    def __str__(self) -> str:
        """One line."""
        return f"{self.at} {'ended' if self.ended else 'held'}: {self.kind}: {self.error}"


def causes(journal: Journal, failure: Exception | None) -> tuple[Cause, ...]:
    """All of this job, in time order, those of earlier runs of the daemon too; only ``failure`` of a lost journal."""
    found: list[Cause] = []
    try:
        told = journal.errors()
    except PolishdError:  # its loss is, or follows, the failure
        return (Cause(now(), type(failure).__name__, str(failure), ended=True),) if failure else ()
    for at_s, name, data in told:
        cause = Cause(_iso(at_s), str(data["kind"]), str(data["error"]), ended=name == "failed")
        if cause.ended and found and replace(found[-1], ended=True, at=cause.at) == cause:
            found[-1] = replace(found[-1], ended=True)  # held over it, and then stopped: one cause
        else:
            found.append(cause)
    return tuple(found)


def keeping(state_dir: Path, run_dir: Callable[[], Path | None], *, queue: bool = False) -> Callable[[Event], None]:
    """A sink for the bus that keeps what each change of state says, for the case that the daemon is killed."""

    def keep(event: Event) -> None:
        if isinstance(event, StateChanged) and event.state != State.FINISHED:
            keep_ending(state_dir, {**event.data, "run_dir": str(run_dir() or ""), "queue": queue})

    return keep


def keep_ending(state_dir: Path, facts: Mapping[str, Any]) -> None:
    """Make it what ``last_ending`` tells; a disk that takes no more is logged, and keeps nobody from the end."""
    path = state_dir / RECORD_NAME
    try:
        write_atomic(path, json.dumps({**facts, "at": now()}, indent=2).encode() + b"\n")
    except OSError:
        log.exception("%s cannot be written", path)
        with suppress(OSError):
            path.unlink()  # an older one would tell what is no longer so


def last_ending(state_dir: Path) -> Mapping[str, Any]:
    """What is known where no daemon runs: how the last one ended, or that it was killed."""
    path = state_dir / RECORD_NAME
    try:
        facts: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        state, reason = facts["state"], facts["reason"]
        if state not in set(State) - {State.FINISHED}:
            return facts
        was = f"the daemon was killed, or its machine went down, while {state}{f': {reason}' if reason else ''}"
        return {**facts, **standing("killed", was, tuple(facts["unsafe"]), queue=bool(facts.get("queue"))).data}
    except FileNotFoundError:
        return standing("unknown", f"no daemon has left word in {state_dir}", None).data
    except (OSError, ValueError, KeyError, TypeError) as error:
        return standing("unknown", f"{path} cannot be read: {error}", None).data


def now() -> str:
    """ISO 8601, UTC, to the second."""
    return datetime.now(UTC).isoformat(timespec="seconds")


def _iso(at_s: float) -> str:
    return datetime.fromtimestamp(at_s, UTC).isoformat(timespec="seconds")
