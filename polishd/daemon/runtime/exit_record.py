"""The last word of a cell's daemon, as whoever looks where none runs finds it in the state folder.

It is light: ``polishd status`` imports it, and no numpy, no models of a cell and no journal with it.
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
_AGAIN = "polishd run CELL.toml; it comes up held, and polishd resume CELL.toml starts with a new measurement"
_OVER = "look at report.html in the run folder; this job is over, polishd run CELL.toml begins a new one"
NEXT: Mapping[str, str] = {
    "idle": "polishd queue add CELL.toml JOB.toml adds a job to the queue; polishd stop CELL.toml ends the daemon",
    "changing": "where there is no loader: put the part in, then polishd resume CELL.toml",
    "held": (
        "when nothing is left to mend: polishd resume CELL.toml goes on, with a new measurement first; a file of the "
        "cell that was changed counts only after polishd stop CELL.toml and polishd run CELL.toml"
    ),
    "killed": f"look at the cell, then: {_AGAIN}",
    "failed": f"the daemon has ended; when that is mended: {_AGAIN}",
    "stopped": f"the daemon has ended; to go on with this job: {_AGAIN}",
    "in_tolerance": _OVER,
    "as_programmed": f"what the pass has taught is remembered, polishd estimates CELL.toml shows it: {_OVER}",
    "cycles_used": f"the part is not in tolerance: {_OVER}",
    "diverged": f"the surface got worse: {_OVER}",
    "stalled": f"passes bring too little of what was predicted: {_OVER}",
}
"""What to do, by state or outcome: nobody is told to resume where no daemon runs, nor to run where one is held."""


def next_action(state: str, *, queue: bool) -> str:
    """What to do, by state or outcome, where a queue is worked or one job."""
    text = NEXT.get(state, "")
    return text.replace("polishd run CELL.toml", "polishd run CELL.toml --queue") if queue else text


def safety_sentence(state: str, unsafe: Sequence[str] | None, *, queue: bool = False) -> CellSafety:
    """How a cell stands: ``state`` is the daemon's, or ``killed``, ``failed`` or the job's outcome where it has ended.

    ``unsafe`` is ``Cell.unsafe``; None: the cell was not opened, and no device was asked.
    """

    def confirmed(port: str) -> str:
        """By all devices at that port."""
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
    """With commands that can be copied."""
    return text.replace("CELL.toml", shlex.quote(str(cell)))


@dataclass(frozen=True, slots=True)
class EndCause:
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


def last_ending(state_dir: Path) -> Mapping[str, Any]:
    """What is known where no daemon runs: how the last one ended, or that it was killed."""
    path = state_dir / RECORD_NAME
    try:
        facts: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        state, reason = facts["state"], facts["reason"]
        if state not in set(DaemonState) - {DaemonState.FINISHED}:
            return facts
        was = f"the daemon was killed, or its machine went down, while {state}{f': {reason}' if reason else ''}"
        return {**facts, **_found("killed", was, tuple(facts["unsafe"]), queue=bool(facts.get("queue")))}
    except FileNotFoundError:
        return _found("unknown", f"no daemon has left word in {state_dir}", None)
    except (OSError, ValueError, KeyError, TypeError) as error:
        return _found("unknown", f"{path} cannot be read: {error}", None)


def _found(state: str, reason: str, unsafe: Sequence[str] | None, *, queue: bool = False) -> dict[str, Any]:
    """With the names that the event of a changed state has."""
    return {"state": state, "reason": reason, **asdict(safety_sentence(state, unsafe, queue=queue))}


# One daemon per state folder: an flock that the kernel drops when its holder ends, however it ends.

LOCK_NAME = "lock"


@contextmanager
def locked(state_dir: Path) -> Iterator[None]:
    """Exclusive use of a cell's state folder (made, 0700) inside this block; ConfigError names the pid that has it.

    The file stays: removing it would let two daemons lock two files of one name.
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
                f"{state_dir}: another polishd runs this cell (pid {pid}); "
                "stop it first (polishd stop), or give this cell a state_dir of its own"
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
    """What the system says of a state folder that is full, read-only, or somebody else's."""
    where = error.filename or state_dir
    return ConfigError(f"{where}: the state folder cannot be used: {error.strerror}; mend it, or change cell.state_dir")
