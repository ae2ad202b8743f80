"""What a person must know who finds a cell held, or its daemon gone.

It is kept in the state folder, so that ``polishd status`` tells it where no daemon runs.
"""

from __future__ import annotations

import json
import logging
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from polishd.daemon.journal import Journal
from polishd.daemon.last_word import RECORD_NAME, EndCause, safety_sentence
from polishd.daemon.states import DaemonState
from polishd.files import write_atomic
from polishd.model.errors import PolishdError
from polishd.model.events import Event, StateChanged

log = logging.getLogger(__name__)


def safety_of(state: str, reason: str, unsafe: Sequence[str] | None, *, queue: bool = False) -> StateChanged:
    """As an event; see ``stands``."""
    return StateChanged(state=state, reason=reason, standing=safety_sentence(state, unsafe, queue=queue))


def killed_safety(names: Iterable[str]) -> tuple[str, ...]:
    """What is known of those devices should the daemon be killed while it polishes."""
    return tuple(f"{name}: no daemon lived to ask it" for name in names)


def causes(journal: Journal, failure: Exception | None) -> tuple[EndCause, ...]:
    """All of this job, in time order, those of earlier runs of the daemon too; only ``failure`` of a lost journal."""
    found: list[EndCause] = []
    try:
        told = journal.errors()
    except PolishdError:  # its loss is, or follows, the failure
        return (EndCause(utc_now(), type(failure).__name__, str(failure), ended=True),) if failure else ()
    for at_s, name, data in told:
        cause = EndCause(_iso(at_s), str(data["kind"]), str(data["error"]), ended=name == "failed")
        if cause.ended and found and replace(found[-1], ended=True, at=cause.at) == cause:
            found[-1] = replace(found[-1], ended=True)  # held over it, and then stopped: one cause
        else:
            found.append(cause)
    return tuple(found)


def recording_exit(
    state_dir: Path, run_dir: Callable[[], Path | None], *, queue: bool = False
) -> Callable[[Event], None]:
    """A sink for the bus that keeps what each change of state says, for the case that the daemon is killed."""

    def keep(event: Event) -> None:
        if isinstance(event, StateChanged) and event.state != DaemonState.FINISHED:
            record_exit(state_dir, {**event.data, "run_dir": str(run_dir() or ""), "queue": queue})

    return keep


def record_exit(state_dir: Path, facts: Mapping[str, Any]) -> None:
    """Make it what ``last_ending`` tells; a disk that takes no more is logged, and keeps nobody from the end."""
    path = state_dir / RECORD_NAME
    try:
        write_atomic(path, json.dumps({**facts, "at": utc_now()}, indent=2).encode() + b"\n")
    except OSError:
        log.exception("%s cannot be written", path)
        with suppress(OSError):
            path.unlink()  # an older one would tell what is no longer so


def utc_now() -> str:
    """ISO 8601, UTC, to the second."""
    return datetime.now(UTC).isoformat(timespec="seconds")


def _iso(at_s: float) -> str:
    return datetime.fromtimestamp(at_s, UTC).isoformat(timespec="seconds")
