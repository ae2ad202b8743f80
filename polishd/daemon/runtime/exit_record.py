"""Record how the daemon ended, so that ``polishd status`` can report it when no daemon runs.

It must load fast: ``polishd status`` imports it without numpy, cell models and journal.
"""

from __future__ import annotations

import fcntl
import json
import os
import shlex
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from polishd.model.devices import port_of
from polishd.model.errors import ConfigError
from polishd.model.states import CellSafety, DaemonState
from polishd.util.files import make_folder

RECORD_NAME = "ending.json"
_AGAIN = "polishd run CELL.toml starts a daemon, which holds; polishd resume CELL.toml begins with a new measurement"
_OVER = "read report.html in the run folder; this job is over, polishd run CELL.toml begins a new one"
NEXT: Mapping[str, str] = {
    "idle": "polishd queue add CELL.toml JOB.toml adds a job to the queue; polishd stop CELL.toml ends the daemon",
    "changing": "without a loader: insert the part, then run polishd resume CELL.toml",
    "held": (
        "correct the cause, then run polishd resume CELL.toml, which begins with a new measurement; a changed file of "
        "the cell takes effect only after polishd stop CELL.toml and polishd run CELL.toml"
    ),
    "unknown": f"check that this is the right cell, and inspect it, then: {_AGAIN}",
    "killed": f"inspect the cell, then: {_AGAIN}",
    "failed": f"the daemon has ended; correct the cause, then: {_AGAIN}",
    "stopped": f"the daemon has ended; to continue this job: {_AGAIN}",
    "in_tolerance": _OVER,
    "as_programmed": f"the estimates are saved, polishd estimates show CELL.toml shows them: {_OVER}",
    "cycles_used": f"the part is not in tolerance: {_OVER}",
    "diverged": f"the surface got worse: {_OVER}",
    "stalled": f"passes remove less than predicted: {_OVER}",
}
"""Next action, by state or outcome. It never proposes resume without a daemon, nor run with a held one."""


def next_action(state: str, *, queue: bool) -> str:
    """Return the next action, by state or outcome, for a queue or a single job."""
    text = NEXT.get(state, "")
    return text.replace("polishd run CELL.toml", "polishd run CELL.toml --queue") if queue else text


def safety_sentence(state: str, unsafe: Sequence[str] | None, *, queue: bool = False) -> CellSafety:
    """Return the safety of a cell. ``state``: of the daemon, or ``killed``, ``failed`` or the outcome after its end.

    ``unsafe`` is ``Cell.unsafe``; None: the cell was not opened, and no device was queried.
    """

    def confirmed(port: str) -> str:
        """Return whether all devices at that port confirmed it."""
        if unsafe is None:
            return "not asked"
        return "not confirmed" if any(port_of(entry.partition(":")[0]) == port for entry in unsafe) else "yes"

    return CellSafety(
        tool_off=confirmed("actuator"),
        robot_at_rest=confirmed("robot"),
        unsafe=list(unsafe or ()),
        next=next_action(state, queue=queue),
    )


def for_cell(text: str, cell: Path) -> str:
    """Return the text with the cell's path in its commands."""
    return text.replace("CELL.toml", shlex.quote(str(cell)))


@dataclass(frozen=True, slots=True)
class EndCause:
    """An error that held or ended a job's daemon."""

    at: str
    """ISO 8601, UTC."""
    kind: str
    error: str
    ended: bool
    """It ended the daemon; else the daemon held and waited for an operator."""

    def __str__(self) -> str:
        """One line."""
        return f"{self.at} {'ended' if self.ended else 'held'}: {self.kind}: {self.error}"


def last_ending(state_dir: Path) -> Mapping[str, Any]:
    """Return the record of the last daemon where none runs: how it ended, or that it was killed."""
    path = state_dir / RECORD_NAME
    try:
        facts: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        state, reason = facts["state"], facts["reason"]
        if state not in set(DaemonState) - {DaemonState.FINISHED}:
            return facts
        was = f"the daemon was killed, or its computer stopped, while {state}{f': {reason}' if reason else ''}"
        return {**facts, **_found("killed", was, tuple(facts["unsafe"]), queue=bool(facts.get("queue")))}
    except FileNotFoundError:
        return _found("unknown", f"no daemon has left a record in {state_dir}", None)
    except (OSError, ValueError, KeyError, TypeError) as error:
        return _found("unknown", f"{path} cannot be read: {error}", None)


def _found(state: str, reason: str, unsafe: Sequence[str] | None, *, queue: bool = False) -> dict[str, Any]:
    """Return the facts with the field names of the event ``state_changed``."""
    return {"state": state, "reason": reason, **asdict(safety_sentence(state, unsafe, queue=queue))}


# One daemon per state folder: a flock, which the kernel releases at any end of its holder.

LOCK_NAME = "lock"


@contextmanager
def locked(state_dir: Path) -> Iterator[None]:
    """Lock a cell's state folder (created with 0700) inside this block; ConfigError names the pid of the other holder.

    The file stays: without it two daemons could lock two files of the same name.
    """
    try:
        make_folder(state_dir, mode=0o700)
        handle = os.open(state_dir / LOCK_NAME, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    except OSError as error:
        raise unusable(state_dir, error) from error
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            pid = os.pread(handle, 32, 0).decode("ascii", "replace").strip() or "unknown"
            raise ConfigError(
                f"{state_dir}: another polishd runs this cell (pid {pid}). Stop it first (polishd stop), or set "
                "another cell.state_dir"
            ) from error
        try:
            os.ftruncate(handle, 0)
            os.pwrite(handle, f"{os.getpid()}\n".encode(), 0)
        except OSError as error:
            raise unusable(state_dir, error) from error
        yield
        os.ftruncate(handle, 0)
    finally:
        os.close(handle)


def unusable(state_dir: Path, error: OSError) -> ConfigError:
    """Return the error of a state folder that is full, read-only, or owned by another user."""
    where = error.filename or state_dir
    return ConfigError(f"{where}: the state folder cannot be used: {error.strerror}. Repair it, or set cell.state_dir")
