"""The queue of parts: rows of the journal, the only truth of what waits, what is under way, and how each job ended.

What was added is what runs: a row holds the job file's text as it was judged, and the hashes of the files it names.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

from polishd.config.job import JobFile
from polishd.config.toml_loader import did_you_mean, join_words
from polishd.daemon.journal.journal import JOURNAL_NAME, over_row
from polishd.daemon.journal.store import Row, Store
from polishd.daemon.runtime.exit_record import locked
from polishd.model import errors
from polishd.model.errors import ConfigError
from polishd.model.states import Outcome

# What each ending of a job means for its part, and for the queue: one table, which the queue works by.

How = Literal["accepted", "rejected", "set aside"]
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
    ResultRule((Outcome.STALLED,), "set aside", "goes on", "its passes bring too little, and a person may find why"),
    ResultRule(
        (Outcome.DIVERGED,), "rejected", "goes on", "its surface got worse: the next part tells whether it is the cell"
    ),
    ResultRule(
        (errors.RemovalCheckStop,),
        "set aside",
        "stops",
        "instrument or alignment is wrong, and would be for the next part, too",
    ),
    ResultRule(
        (errors.ToolStop,), "set aside", "stops", "the tool would remove otherwise than planned from the next part, too"
    ),
    ResultRule((errors.WrongSeat,), "set aside", "goes on", "it does not sit where it should; nothing was polished"),
    ResultRule(
        (errors.HandlingError,), None, "waits", "a person is asked to clean or to condition, and the job goes on"
    ),
    ResultRule((errors.SurfaceError,), "set aside", "goes on", "its map cannot be trusted, or shows another part"),
    ResultRule(
        (errors.ProgramError, errors.PlanRefused, errors.ComputeError, errors.ConfigError, errors.PluginError),
        "set aside",
        "goes on",
        "nothing moves for a job that cannot be read, computed or planned",
    ),
    ResultRule(
        (errors.DeviceError,), None, "waits", "the device is at fault, not the part: the job goes on when it is mended"
    ),
    ResultRule((errors.PolishdError,), "set aside", "stops", "what is not known to be safe is a person's to judge"),
)
"""The first row that fits holds; of errors that came out of contact."""

TORN = ResultRule(
    (errors.DeviceError, errors.SafetyStop), "set aside", "goes on", "its pass was cut off: somebody should look at it"
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


REMOVED = "removed"
"""The verdict of a job that a person took out before it began."""
BY_A_PERSON = "set aside by a person"
TO_DO = "ended IS NULL ORDER BY begun IS NULL, place"
_COLUMNS = "id, name, part_id, path, content, files, added, job, begun, ended, verdict, reason, fault, claim"


@dataclass(frozen=True, slots=True)
class NewJob:
    """A job that was judged and may wait."""

    name: str
    """``job.id``."""
    part_id: str
    file: JobFile
    files: Mapping[str, Any]
    """By key, the files that it names itself: ``{"file", "sha256"}``."""
    claim: str = ""
    """By which a shop gave its part to this cell; empty: no shop did."""


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
    """Its row in the journal's jobs, from its begin on."""
    begun_s: float | None
    ended_s: float | None
    verdict: str | None
    reason: str
    """Why it ended so."""
    fault: str
    """What was wrong, in one word; two in a row stop the queue. Empty where nothing was."""
    claim: str
    """As of ``NewJob``: it may begin once the shop has said that the claim stands (``daemon.queue.requests``)."""

    @property
    def state(self) -> str:
        """``waiting``, ``under way``, or its verdict."""
        return self.verdict or ("waiting" if self.begun_s is None else "under way")

    @property
    def file(self) -> JobFile:
        """The job's file, as it was when it was added."""
        return JobFile(Path(self.path), self.content)

    def facts(self) -> dict[str, Any]:
        """For people and programs; the file's text is left out."""
        known = asdict(self)
        return {"state": self.state, **{key: known[key] for key in known if key not in {"id", "content", "job"}}}


class Queue:
    """Jobs in the order in which they are worked; one at most is under way."""

    def __init__(self, store: Store) -> None:
        self._store = store
        self._to_do: list[QueueEntry] | None = None
        """What ``next_action`` answers: ``status`` does not go to the disk. None: nobody has asked yet."""

    @classmethod
    @contextmanager
    def at_rest(cls, state_dir: Path) -> Iterator[Queue]:
        """The queue of a cell that no daemon runs; ConfigError where one does."""
        with locked(state_dir):
            store = Store.open(state_dir / JOURNAL_NAME)
            try:
                yield cls(store)
            finally:
                store.close()

    def entries(self) -> list[QueueEntry]:
        """All there ever were: those that ended, as they ended; the one under way; those that wait, in their order."""
        return self._where("1 ORDER BY ended IS NULL, ended, begun IS NULL, place")

    def to_do(self) -> list[QueueEntry]:
        """The one under way, and those that wait, in their order."""
        if self._to_do is None:
            self._to_do = self._where(TO_DO)
        return self._to_do

    def under_way(self) -> QueueEntry | None:
        """The job that was begun and has not ended."""
        return next((entry for entry in self.to_do() if entry.begun_s is not None), None)

    def next(self, may: Callable[[QueueEntry], bool] = lambda _: True) -> QueueEntry | None:
        """The first of those that wait, and may begin."""
        return next(filter(may, self.waiting()), None)

    def waiting(self) -> list[QueueEntry]:
        """Those that wait, in their order."""
        return [entry for entry in self.to_do() if entry.begun_s is None]

    def of_claim(self, claim: str) -> QueueEntry | None:
        """The job that came by that claim of a shop; None where none did."""
        return next(iter(self._where("claim = ?", (claim,))), None)

    def holds(self, entry: QueueEntry) -> bool:
        """Whether it waits, or is under way."""
        return any(one.id == entry.id for one in self.to_do())

    def require_held(self, entry: QueueEntry) -> None:
        """ConfigError where it was taken out meanwhile."""
        if not self.holds(entry):
            raise ConfigError(f"the job {entry.name!r} was taken out of the queue")

    def last_ended(self) -> QueueEntry | None:
        """The job that was worked last."""
        return next(
            iter(self._where("begun IS NOT NULL AND ended IS NOT NULL ORDER BY ended DESC, id DESC LIMIT 1")), None
        )

    def add(self, jobs: Sequence[NewJob]) -> None:
        """Put them at the end, all or none; ConfigError where a name is in the queue already, or is done.

        What came by the same claim before is the same job: nothing is added.
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
        """Put a job that waits ``before`` or ``after`` another one that does, or ``first`` or ``last`` of all."""
        waiting = self.waiting()
        moved = _named(waiting, name)
        rest = [entry for entry in waiting if entry is not moved]
        if where in {"before", "after"}:
            at = rest.index(_named(rest, other)) + (where == "after")
        elif where in {"first", "last"}:
            at = 0 if where == "first" else len(rest)
        else:
            raise ConfigError(f"{where!r} is no place; say before ID, after ID, first or last")
        order = [*rest[:at], moved, *rest[at:]]
        places = sorted(
            place for (place,) in self._store.read("SELECT place FROM queue WHERE begun IS NULL AND ended IS NULL")
        )
        sql = "UPDATE queue SET place = ? WHERE id = ?"
        self._write(*((sql, (place, entry.id)) for place, entry in zip(places, order, strict=True)))

    def remove(self, name: str, reason: str = "") -> None:
        """As ``remove_waiting``; at rest, where no daemon goes on with it, also the one under way: it is set aside."""
        entry = self.under_way()
        if entry is None or entry.name != name:
            self.remove_waiting(name, reason)
            return
        over = [over_row(entry.job, "set aside", reason)] if entry.job else []
        self.end(entry, JobResult("set aside", reason or BY_A_PERSON, ""), *over)

    def remove_waiting(self, name: str, reason: str = "") -> None:
        """Take a job out that waits; its row stays, with its end. ConfigError where it begins in the same moment."""
        entry = _named(self.waiting(), name)
        sql, values = self._end_row(entry, REMOVED, reason, "")
        self._write((f"{sql} AND begun IS NULL", values))
        if self.holds(entry):
            raise ConfigError(f"the job {name!r} has just begun: hold the cell first (polishd hold)")

    def begin_row(self, entry: QueueEntry) -> Row:
        """It is under way as the newest of the journal's jobs: to be written together with that job's row.

        Between the two a kill would leave a job in the journal of which the queue knows nothing, and whose part another
        cell may be given.
        """
        sql = "UPDATE queue SET begun = ?, job = (SELECT max(id) FROM job) WHERE id = ? AND ended IS NULL"
        return sql, (time.time(), entry.id)

    def begin(self, entry: QueueEntry, job: int) -> None:
        """It is under way, as that row of the journal's jobs; ConfigError where it was taken out meanwhile."""
        sql = "UPDATE queue SET begun = ?, job = ? WHERE id = ? AND ended IS NULL"
        self._write((sql, (time.time(), job, entry.id)))
        self.require_held(entry)

    def end(self, entry: QueueEntry, verdict: JobResult, *also: Row) -> None:
        """It is over, durably, together with other rows; one that never came to its begin has begun and ended now."""
        begun = ("UPDATE queue SET begun = ifnull(begun, ?) WHERE id = ?", (time.time(), entry.id))
        self._write(begun, self._end_row(entry, verdict.how, verdict.reason, verdict.fault), *also)

    def _end_row(self, entry: QueueEntry, verdict: str, reason: str, fault: str) -> Row:
        sql = "UPDATE queue SET ended = ?, verdict = ?, reason = ?, fault = ? WHERE id = ?"
        return sql, (time.time(), verdict, reason, fault, entry.id)

    def _write(self, *rows: Row) -> None:
        self._store.write(*rows)
        self._to_do = self._where(TO_DO)

    def _taken(self, job: NewJob, before: Iterable[NewJob]) -> str:
        """Why a name cannot be added; empty where it can. One that was set aside or removed may come again."""
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
        return f"{job.file.path}: job.id: {job.name!r} is {how} already; give this job a name of its own"

    def _where(self, condition: str, values: Sequence[Any] = ()) -> list[QueueEntry]:
        rows = self._store.read(f"SELECT {_COLUMNS} FROM queue WHERE {condition}", values)  # noqa: S608 - our own words
        return [QueueEntry(*row[:5], json.loads(row[5]), *row[6:]) for row in rows]  # type: ignore[call-arg]


def _named(entries: Sequence[QueueEntry], name: str) -> QueueEntry:
    for entry in entries:
        if entry.name == name:
            return entry
    names = [entry.name for entry in entries]
    raise ConfigError(f"no job {name!r} waits in the queue{did_you_mean(name, names)} There wait: {join_words(names)}")
