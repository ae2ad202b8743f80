"""Queue of jobs: rows of the journal with the jobs that wait, the current one, and the result of each.

A row holds the text of the job file as it was checked, and the hashes of the files that it names. That job runs.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

from polishd.config.job_file import JobFile
from polishd.config.toml_loader import did_you_mean, join_words
from polishd.daemon.journal.journal import JOURNAL_NAME, over_row
from polishd.daemon.journal.store import Row, Store
from polishd.daemon.runtime.exit_record import locked
from polishd.model import errors
from polishd.model.errors import ConfigError
from polishd.model.states import Outcome

# Result of each end of a job, for its part and for the queue. The queue works by this table.

How = Literal["accepted", "rejected", "set aside"]
QueueEffect = Literal["goes on", "stops", "waits"]


@dataclass(frozen=True, slots=True)
class ResultRule:
    """One row: the end of a job, the result for its part, and the effect on the queue."""

    ends: tuple[Outcome | type[errors.PolishdError], ...]
    how: How | None
    """None: the job is not over. An operator corrects the cause while the cell is held, or the daemon ends."""
    queue: QueueEffect
    why: str


RULES = (
    ResultRule((Outcome.IN_TOLERANCE,), "accepted", "goes on", "the part is in tolerance"),
    ResultRule(
        (Outcome.AS_PROGRAMMED,), "accepted", "goes on", "the part was polished as programmed, to measure the process"
    ),
    ResultRule((Outcome.CYCLES_USED,), "rejected", "goes on", "the job has used all its passes"),
    ResultRule(
        (Outcome.STALLED,), "set aside", "goes on", "its passes remove too little; an operator can find the cause"
    ),
    ResultRule(
        (Outcome.DIVERGED,),
        "rejected",
        "goes on",
        "its surface got worse: the next part shows whether the cell is the cause",
    ),
    ResultRule(
        (errors.RemovalCheckStop,),
        "set aside",
        "stops",
        "instrument or alignment is wrong, also for the next part",
    ),
    ResultRule(
        (errors.ToolStop,), "set aside", "stops", "the removal from the next part would differ from the plan, too"
    ),
    ResultRule((errors.WrongSeat,), "set aside", "goes on", "the part is not seated correctly; nothing was polished"),
    ResultRule(
        (errors.HandlingError,), None, "waits", "an operator has to clean or to condition, then the job continues"
    ),
    ResultRule((errors.SurfaceError,), "set aside", "goes on", "its map is not valid, or shows another part"),
    ResultRule(
        (errors.ProgramError, errors.PlanRefused, errors.ComputeError, errors.ConfigError, errors.PluginError),
        "set aside",
        "goes on",
        "the job cannot be read, computed or planned; nothing moved",
    ),
    ResultRule(
        (errors.DeviceError,),
        None,
        "waits",
        "the device is the cause, not the part: the job continues when it is repaired",
    ),
    ResultRule((errors.PolishdError,), "set aside", "stops", "an operator has to decide what is safe"),
)
"""The first row that matches applies, to errors outside contact."""

TORN = ResultRule(
    (errors.DeviceError, errors.SafetyStop),
    "set aside",
    "goes on",
    "its pass was interrupted: an operator should inspect the part",
)
"""Row of errors that interrupted a pass, where each device confirmed its safe state. Else the daemon ends."""


@dataclass(frozen=True, slots=True)
class JobResult:
    """Result of a job, and whether the queue continues."""

    how: How
    reason: str
    fault: str
    """The error's class, or the outcome; empty for an accepted part."""
    stops: str = ""
    """Why the queue stops; empty where it continues."""


def rule_of(end: Outcome | errors.PolishdError, *, torn: bool = False) -> ResultRule:
    """Return the row for that end."""
    if isinstance(end, Outcome):
        return next(rule for rule in RULES if end in rule.ends)
    if torn:
        return TORN
    kinds = [(rule, kind) for rule in RULES for kind in rule.ends if isinstance(kind, type)]
    return next(rule for rule, kind in kinds if isinstance(end, kind))


def judge(end: Outcome | errors.PolishdError, *, torn: bool, previous: str, tool: str = "") -> JobResult | None:
    """Return the result; None where the job is not over (``ResultRule.how``).

    ``torn``: the error interrupted a pass, and each device confirmed its safe state. ``previous``: the fault of the job
    before. ``tool``: finding about the tool, which stops the queue with any result of this job.
    """
    rule = rule_of(end, torn=torn)
    if rule.how is None:
        return None
    fault = "" if rule.how == "accepted" else end.value if isinstance(end, Outcome) else type(end).__name__
    reason = rule.why if isinstance(end, Outcome) else f"{fault}: {end}"
    stops = ""
    if rule.queue == "stops":
        stops = rule.why
    elif tool:
        stops = tool
    elif fault and fault == previous:
        stops = f"two parts in a row ended with the same fault, {fault}"
    return JobResult(rule.how, reason, fault, stops)


REMOVED = "removed"
"""Result of a job that an operator removed before it began."""
BY_A_PERSON = "set aside by an operator"
TO_DO = "ended IS NULL ORDER BY begun IS NULL, place"
_COLUMNS = "id, name, part_id, path, content, files, added, job, begun, ended, verdict, reason, fault, claim"


@dataclass(frozen=True, slots=True)
class NewJob:
    """A checked job for the queue."""

    name: str
    """``job.id``."""
    part_id: str
    file: JobFile
    files: Mapping[str, Any]
    """Files that the job names, by key: ``{"file", "sha256"}``."""
    claim: str = ""
    """Claim by which a shop gave the part to this cell; empty without a shop."""


@dataclass(frozen=True, slots=True)
class QueueEntry:
    """A job of the queue. Times are Unix times."""

    id: int
    name: str
    part_id: str
    path: str
    content: str
    files: Mapping[str, Any]
    added_s: float
    job: int | None
    """Its row in the journal's jobs, after its begin."""
    begun_s: float | None
    ended_s: float | None
    verdict: str | None
    reason: str
    """Reason of the result."""
    fault: str
    """As of ``JobResult``; the same fault twice in a row stops the queue."""
    claim: str
    """As of ``NewJob``: the job may begin after the shop confirms the claim (``daemon.queue.requests``)."""

    @property
    def state(self) -> str:
        """``waiting``, ``under way``, or its result."""
        return self.verdict or ("waiting" if self.begun_s is None else "under way")

    @property
    def file(self) -> JobFile:
        """The job's file, as it was added."""
        return JobFile(Path(self.path), self.content)

    def facts(self) -> dict[str, Any]:
        """Return its values for people and programs, without the file's text."""
        known = asdict(self)
        return {"state": self.state, **{key: known[key] for key in known if key not in {"id", "content", "job"}}}


class Queue:
    """Jobs in working order; at most one is under way."""

    def __init__(self, store: Store) -> None:
        self._store = store
        self._to_do: list[QueueEntry] | None = None
        """Cache of ``to_do``, so that ``status`` does not read the disk. None before the first call."""

    @classmethod
    @contextmanager
    def at_rest(cls, state_dir: Path) -> Iterator[Queue]:
        """Open the queue of a cell without a daemon; ConfigError where a daemon runs."""
        with locked(state_dir):
            store = Store.open(state_dir / JOURNAL_NAME)
            try:
                yield cls(store)
            finally:
                store.close()

    def entries(self) -> list[QueueEntry]:
        """Return all jobs: those that ended, in that order; the one under way; those that wait, in order."""
        return self._where("1 ORDER BY ended IS NULL, begun IS NULL AND ended IS NULL, place")

    def to_do(self) -> list[QueueEntry]:
        """Return the job under way and those that wait, in order."""
        if self._to_do is None:
            self._to_do = self._where(TO_DO)
        return self._to_do

    def under_way(self) -> QueueEntry | None:
        """Return the job that has begun and not ended."""
        return next((entry for entry in self.to_do() if entry.begun_s is not None), None)

    def next(self, may: Callable[[QueueEntry], bool] = lambda _: True) -> QueueEntry | None:
        """Return the first waiting job that may begin."""
        return next(filter(may, self.waiting()), None)

    def waiting(self) -> list[QueueEntry]:
        """Return the waiting jobs in order."""
        return [entry for entry in self.to_do() if entry.begun_s is None]

    def of_claim(self, claim: str) -> QueueEntry | None:
        """Return the job with that claim of a shop, or None."""
        return next(iter(self._where("claim = ?", (claim,))), None)

    def holds(self, entry: QueueEntry) -> bool:
        """Return whether it waits or is under way."""
        return any(one.id == entry.id for one in self.to_do())

    def require_held(self, entry: QueueEntry) -> None:
        """ConfigError where it was removed meanwhile."""
        if not self.holds(entry):
            raise ConfigError(f"the job {entry.name!r} was removed from the queue")

    def last_ended(self) -> QueueEntry | None:
        """Return the job that ended last."""
        return next(iter(self._where("begun IS NOT NULL AND ended IS NOT NULL ORDER BY place DESC LIMIT 1")), None)

    def add(self, jobs: Sequence[NewJob]) -> None:
        """Add jobs at the end, all or none; ConfigError where a name is already in the queue or done.

        A job whose claim is in the queue already is the same job and is not added again.
        """
        jobs = [job for job in jobs if not (job.claim and self.of_claim(job.claim))]
        wrong = [line for number, job in enumerate(jobs) if (line := self._taken(job, jobs[:number]))]
        if wrong:
            raise ConfigError("\n".join(wrong))
        ((place,),) = self._store.read("SELECT ifnull(max(place), 0) FROM queue")
        sql = "INSERT INTO queue (place, name, part_id, path, content, files, claim, added) VALUES (?,?,?,?,?,?,?,?)"
        rows = [
            (place + 1 + n, job.name, job.part_id, str(job.file.path), job.file.text, json.dumps(dict(job.files)))
            for n, job in enumerate(jobs)
        ]
        self._write(*((sql, (*row, job.claim, time.time())) for row, job in zip(rows, jobs, strict=True)))

    def move(self, name: str, where: str, other: str = "") -> None:
        """Move a waiting job ``before`` or ``after`` another waiting one, or to the ``first`` or ``last`` position."""
        waiting = self.waiting()
        moved = _named(waiting, name)
        rest = [entry for entry in waiting if entry is not moved]
        if where in {"before", "after"}:
            at = rest.index(_named(rest, other)) + (where == "after")
        elif where in {"first", "last"}:
            at = 0 if where == "first" else len(rest)
        else:
            raise ConfigError(f"{where!r} is not a position. Use before ID, after ID, first or last")
        order = [*rest[:at], moved, *rest[at:]]
        places = sorted(
            place for (place,) in self._store.read("SELECT place FROM queue WHERE begun IS NULL AND ended IS NULL")
        )
        sql = "UPDATE queue SET place = ? WHERE id = ?"
        self._write(*((sql, (place, entry.id)) for place, entry in zip(places, order, strict=True)))

    def remove(self, name: str, reason: str = "") -> None:
        """As ``remove_waiting``; without a daemon also the job under way, which is set aside."""
        entry = self.under_way()
        if entry is None or entry.name != name:
            self.remove_waiting(name, reason)
            return
        over = [over_row(entry.job, "set aside", reason)] if entry.job else []
        self.end(entry, JobResult("set aside", reason or BY_A_PERSON, ""), *over)

    def remove_waiting(self, name: str, reason: str = "") -> None:
        """Remove a waiting job; its row stays. ConfigError where it begins at the same moment."""
        entry = _named(self.waiting(), name)
        sql, values = self._end_row(entry, REMOVED, reason, "")
        self._write((f"{sql} AND begun IS NULL", values))
        if self.holds(entry):
            raise ConfigError(f"the job {name!r} has just begun. Hold the cell first (polishd hold)")

    def begin_row(self, entry: QueueEntry) -> Row:
        """Return the row that sets it under way as the newest job of the journal, to write with that job's row.

        A kill between two separate writes would leave a job in the journal that the queue does not know, and the shop
        could give its part to another cell.
        """
        sql = "UPDATE queue SET begun = ?, job = (SELECT max(id) FROM job) WHERE id = ? AND ended IS NULL"
        return sql, (time.time(), entry.id)

    def begin(self, entry: QueueEntry, job: int) -> None:
        """Set it under way as that row of the journal's jobs; ConfigError where it was removed meanwhile."""
        sql = "UPDATE queue SET begun = ?, job = ? WHERE id = ? AND ended IS NULL"
        self._write((sql, (time.time(), job, entry.id)))
        self.require_held(entry)

    def end(self, entry: QueueEntry, verdict: JobResult, *also: Row) -> None:
        """Record its end, durable, together with other rows. A job that did not begin gets the same begin and end."""
        begun = ("UPDATE queue SET begun = ifnull(begun, ?) WHERE id = ?", (time.time(), entry.id))
        self._write(begun, self._end_row(entry, verdict.how, verdict.reason, verdict.fault), *also)

    def _end_row(self, entry: QueueEntry, verdict: str, reason: str, fault: str) -> Row:
        # The place of an ended job is its turn among the ends: ``ended`` is wall time, and a clock can be set back.
        sql = (
            "UPDATE queue SET ended = ?, verdict = ?, reason = ?, fault = ?, "
            "place = (SELECT max(place) + 1 FROM queue) WHERE id = ?"
        )
        return sql, (time.time(), verdict, reason, fault, entry.id)

    def _write(self, *rows: Row) -> None:
        self._store.write(*rows)
        self._to_do = self._where(TO_DO)

    def _taken(self, job: NewJob, before: Iterable[NewJob]) -> str:
        """Return why a name cannot be added; empty where it can. A job set aside or removed may be added again."""
        sql = "SELECT ifnull(verdict, 'in the queue') FROM queue WHERE name = ? AND ifnull(verdict, '') NOT IN (?, ?)"
        done = (
            "SELECT ifnull(outcome, 'under way') FROM job WHERE name = ? AND ifnull(outcome, '') NOT IN ('stopped', ?)"
        )
        found = self._store.read(sql, (job.name, REMOVED, "set aside")) or self._store.read(
            done, (job.name, "set aside")
        )
        twice = any(job.name == other.name for other in before)
        if not (found or twice):
            return ""
        how = "named twice" if twice else found[0][0]
        return f"{job.file.path}: job.id: {job.name!r} is {how} already. Set another job.id"

    def _where(self, condition: str, values: Sequence[Any] = ()) -> list[QueueEntry]:
        rows = self._store.read(f"SELECT {_COLUMNS} FROM queue WHERE {condition}", values)  # noqa: S608 - our own words
        return [QueueEntry(*row[:5], json.loads(row[5]), *row[6:]) for row in rows]  # type: ignore[call-arg]


def _named(entries: Sequence[QueueEntry], name: str) -> QueueEntry:
    for entry in entries:
        if entry.name == name:
            return entry
    names = [entry.name for entry in entries]
    raise ConfigError(
        f"no job {name!r} waits in the queue{did_you_mean(name, names)} Waiting: {join_words(names)}. "
        "Run polishd queue list CELL.toml"
    )
