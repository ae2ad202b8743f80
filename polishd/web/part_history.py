"""Parts of a cell over months: a table that is filtered, sorted and paged in memory, and figures by week.

Jobs that have ended never change, so each is read from the journal once. Reading 10,000 parts takes seconds, a page of
them milliseconds.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import quantiles
from typing import Any

from polishd.daemon.journal.history import JobHistory, read_history, read_only
from polishd.daemon.journal.journal import JOURNAL_NAME
from polishd.daemon.queue.queue import RULES
from polishd.model.errors import ConfigError
from polishd.model.states import Outcome
from polishd.model.tolerance import LineResult, part_holds

RESULTS = ("accepted", "rejected", "set aside", "stopped", "under way")
"""Results of a part. A job of a cell without queue has that of the same end in a queue."""
OF_OUTCOME: Mapping[str, str] = {
    end.value: rule.how for rule in RULES for end in rule.ends if isinstance(end, Outcome) and rule.how
}
MOST_PAGE, PAGE = 200, 50
"""Largest and default number of rows of an answer."""
MOST_WEEKS = 260
MOST_FILTER = 200


@dataclass(frozen=True, slots=True)
class PartRow:
    """A part in the table. Times are Unix times."""

    number: int
    """Number of its job in the journal."""
    job: str
    part: str
    began_s: float
    ended_s: float | None
    result: str
    """One of ``RESULTS``."""
    outcome: str
    reason: str
    """Reason of the queue for the result; empty without a queue."""
    passes: int
    interrupted: int
    contact_s: float
    """Time in contact."""
    first_rms_nm: float | None
    last_rms_nm: float | None
    met: bool | None
    """All lines of the tolerance hold in the last map; None: there is no map, or no tolerance."""
    worst: Mapping[str, Any] | None
    """Line of the tolerance that the last map keeps worst."""
    gain: float | None
    """Share of the RMS that the first pass removed."""
    over_predicted: tuple[float, ...]
    """Measured over predicted RMS of each pass."""
    faults: int
    week_s: float
    """Unix time of the begin of the week in which it ended or, where it is under way, began."""

    @property
    def hours(self) -> float | None:
        """Hours from begin to end, waiting included."""
        return None if self.ended_s is None else (self.ended_s - self.began_s) / 3600

    def facts(self) -> dict[str, Any]:
        """Return its values for JSON."""
        facts = asdict(self)
        del facts["over_predicted"], facts["week_s"]
        return {**facts, "hours": self.hours}


SORTS: Mapping[str, Callable[[PartRow], Any]] = {
    "number": lambda row: row.number,
    "part": lambda row: row.part.lower(),
    "date": lambda row: row.began_s,
    "result": lambda row: row.result,
    "passes": lambda row: row.passes,
    "first": lambda row: row.first_rms_nm,
    "last": lambda row: row.last_rms_nm,
    "hours": lambda row: row.hours,
    "met": lambda row: row.met,
}


@dataclass(frozen=True, slots=True)
class PartFilter:
    """Filter for the parts of a table or a chart."""

    text: str = ""
    """In the name of part or job, without regard to case."""
    result: str = ""
    since_s: float | None = None
    """Parts that began at this Unix time or later."""
    until_s: float | None = None

    def matches(self, row: PartRow) -> bool:
        """Return whether a part is one of these."""
        text = self.text.lower()
        return (
            (not text or text in row.part.lower() or text in row.job.lower())
            and (not self.result or row.result == self.result)
            and (self.since_s is None or row.began_s >= self.since_s)
            and (self.until_s is None or row.began_s < self.until_s)
        )


class PartHistory:
    """Parts of one cell. Its methods read the disk: call them in a thread."""

    def __init__(self, state_dir: Path) -> None:
        self._state_dir = state_dir
        self._lock = threading.Lock()
        self._ended: list[PartRow] = []
        """Rows of the jobs before the first one that is under way."""

    def page(self, chosen: PartFilter, sort: str = "", offset: int = 0, limit: int = PAGE) -> dict[str, Any]:
        """Return the rows of a page, with the number of all parts and of those that match.

        ``sort``: a key of ``SORTS``, with ``-`` before it for the opposite order; default: the newest first. Parts
        without that figure are last. ConfigError for another key.
        """
        name = (sort or "-number").removeprefix("-")
        if name not in SORTS:
            raise ConfigError(
                f"sort is {name!r}. Use one of {', '.join(SORTS)}, with - before it for the opposite order"
            )
        rows = self.rows()
        found = [row for row in rows if chosen.matches(row)]
        key = SORTS[name]
        with_value = sorted(
            (row for row in found if key(row) is not None), key=key, reverse=sort.startswith("-") or not sort
        )
        ordered = with_value + [row for row in found if key(row) is None]
        page = ordered[offset : offset + limit]
        return {"total": len(rows), "matched": len(found), "offset": offset, "parts": [row.facts() for row in page]}

    def weeks(self, chosen: PartFilter) -> list[dict[str, Any]]:
        """Return the figures of each week with a part that matches, the oldest first, at most ``MOST_WEEKS``."""
        by_week: dict[float, list[PartRow]] = {}
        for row in self.rows():
            if row.result != "under way" and chosen.matches(row):
                by_week.setdefault(row.week_s, []).append(row)
        return [_week(at_s, by_week[at_s]) for at_s in sorted(by_week)[-MOST_WEEKS:]]

    def row(self, number: int) -> PartRow | None:
        """Return the part of a job, or None."""
        return next((row for row in reversed(self.rows()) if row.number == number), None)

    def typical_s(self, jobs: Iterable[int]) -> tuple[float, int] | None:
        """Return the median time from begin to end of finished jobs, s, and their number; None: there is none."""
        selected = set(jobs)
        took = [
            row.ended_s - row.began_s
            for row in self.rows()
            if row.number in selected and row.ended_s is not None and row.result in {"accepted", "rejected"}
        ]
        return (quantile(took, 2), len(took)) if took else None

    def rows(self) -> list[PartRow]:
        """Return all parts in the order of their begin."""
        path = self._state_dir / JOURNAL_NAME
        with self._lock:
            if not path.exists():
                return []
            if self._ended and not self._holds(self._ended[-1]):  # another journal, such as one from a backup
                self._ended = []
            after = self._ended[-1].number if self._ended else 0
            jobs, results = read_history(self._state_dir, after), self._queue_results(after)
            new = [_row(job, *results.get(job.number, ("", ""))) for job in jobs]
            first_open = next((n for n, row in enumerate(new) if row.ended_s is None), len(new))
            self._ended += new[:first_open]
            return self._ended + new[first_open:]

    def _holds(self, row: PartRow) -> bool:
        """Whether the journal has this job. A new file may have the inode of the old one."""
        with read_only(self._state_dir) as journal:
            found = journal.execute("SELECT name, started FROM job WHERE id = ?", (row.number,)).fetchone()
        return found is not None and tuple(found) == (row.job, row.began_s)

    def _queue_results(self, after: int) -> dict[int, tuple[str, str]]:
        with read_only(self._state_dir) as journal:
            sql = "SELECT job, ifnull(verdict, ''), reason FROM queue WHERE job > ?"
            return {job: (verdict, reason) for job, verdict, reason in journal.execute(sql, (after,))}


def _row(job: JobHistory, verdict: str, reason: str) -> PartRow:
    measured = job.measured
    judged = measured[-1].judged if measured else ()
    over = tuple(one.rms_nm / one.predicted_nm for one in measured if one.predicted_nm)
    first = measured[1] if len(measured) > 1 and measured[1].predicted_nm is not None else None
    return PartRow(
        number=job.number,
        job=job.job,
        part=job.part_id,
        began_s=job.began_s,
        ended_s=job.ended_s,
        result=verdict or _result(job),
        outcome=job.outcome,
        reason=reason,
        passes=job.passes,
        interrupted=job.interrupted,
        contact_s=job.contact_s,
        first_rms_nm=measured[0].rms_nm if measured else None,
        last_rms_nm=measured[-1].rms_nm if measured else None,
        met=part_holds(judged) if judged else None,
        worst=_line(job.worst),
        gain=None if first is None or not measured[0].rms_nm else 1 - first.rms_nm / measured[0].rms_nm,
        over_predicted=over,
        faults=len(job.faults),
        week_s=week_of(job.ended_s if job.ended_s is not None else job.began_s),
    )


def _result(job: JobHistory) -> str:
    if job.ended_s is None:
        return "under way"
    return OF_OUTCOME.get(job.outcome) or ("set aside" if job.outcome == "set aside" else "stopped")


def _line(line: LineResult | None) -> dict[str, Any] | None:
    return None if line is None else {"what": line.what, "value": line.counted, "limit": line.limit, "unit": line.unit}


def week_of(at_s: float) -> float:
    """Return the begin of the week, Monday 0:00 of this computer's time zone, as Unix time."""
    at = time.localtime(at_s)
    return time.mktime((at.tm_year, at.tm_mon, at.tm_mday - at.tm_wday, 0, 0, 0, 0, 0, -1))


def _week(at_s: float, rows: Sequence[PartRow]) -> dict[str, Any]:
    hours = [row.hours for row in rows if row.hours is not None]
    over = [one for row in rows for one in row.over_predicted]
    return {
        "at_s": at_s,
        "parts": len(rows),
        "accepted": sum(row.result == "accepted" for row in rows),
        "contact_h": sum(row.contact_s for row in rows) / 3600,
        "hours": _quartiles(hours),
        "gain": _quartiles([row.gain for row in rows if row.gain is not None]),
        "over_predicted": _quartiles(over),
    }


def _quartiles(values: Sequence[float]) -> list[float] | None:
    """Return lower quartile, median and upper quartile; None of none."""
    return [quantile(values, n) for n in (1, 2, 3)] if values else None


def quantile(values: Sequence[float], quarter: int) -> float:
    """Return the quartile of a number of values, at least one."""
    return values[0] if len(values) == 1 else quantiles(values, n=4, method="inclusive")[quarter - 1]
