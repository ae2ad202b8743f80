"""What the cells' journals say, taken once: each event by its own number, each job, map and pass by its own place."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from polishd.model.errors import ConfigError
from polishd.shop.database import DatabaseTransaction

JOB = ("job", "name", "part_id", "started", "ended", "outcome", "detail")
PASS = ("job", "cycle", "program_sha256", "started", "ended", "how", "facts")
MAP = ("job", "cycle", "taken", "stats")
LESSON = ("recipe", "job", "of_cycle", "at_s", "tool", "rate", "sigma")
EVENT = ("seq", "job", "at", "cycle", "name", "data")
"""Columns, in the order in which a report has their values."""


@dataclass(frozen=True, slots=True)
class CellReport:
    """What a cell tells at once: of events those with numbers ``first`` to ``last``, and rows as they are now."""

    journal: str
    """Which of the cell's journals: it may have begun another one."""
    first: int
    last: int
    before: str
    """Hash of the event before the first one, as the journal has it; empty: it is the journal's first."""
    tail: str
    """The same of the last one."""
    now: Mapping[str, Any]
    """What the cell does, for people."""
    events: Sequence[Sequence[Any]] = ()
    """Without each pass's progress."""
    jobs: Sequence[Sequence[Any]] = ()
    passes: Sequence[Sequence[Any]] = ()
    maps: Sequence[Sequence[Any]] = ()
    lessons: Sequence[Sequence[Any]] = ()
    claims: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    """State and reason of each claim in the cell's queue, by request."""

    def __post_init__(self) -> None:
        """TypeError where a field is not what it says: reports come from outside."""
        kinds = {"journal": str, "first": int, "last": int, "before": str, "tail": str, "now": dict, "claims": dict}
        for name, kind in kinds.items():
            if not isinstance(getattr(self, name), kind):
                raise TypeError(f"{name} is no {kind.__name__}")


def take(sql: DatabaseTransaction, cell: str, report: CellReport) -> int:
    """Take what is not known yet; the number of the last event that is known now.

    One that begins beyond that is not taken: the cell begins again where the shop is. ConfigError where the journal is
    not the one of which the shop has taken so much.
    """
    now = {"name": cell, "heard": time.time(), "now": json.dumps(dict(report.now))}
    sql.insert("INSERT OR REPLACE INTO cell", now)
    key = {"cell": cell, "journal": report.journal}
    known = sql.row("SELECT upto, tail FROM feed WHERE cell = ? AND journal = ?", *key.values())
    upto, tail = (0, "") if known is None else (known["upto"], known["tail"])
    _rows(sql, "job", JOB, key, report.jobs)
    _rows(sql, "pass", PASS, key, report.passes)
    _rows(sql, "map", MAP, key, report.maps)
    _rows(sql, "lesson", LESSON, {"cell": cell}, report.lessons)
    if report.first == upto + 1 and report.before != tail:
        raise ConfigError(
            f"{cell}: its journal is not what it was: of {upto} events that this shop has, the last is another now. "
            "Was an older copy put back? Begin a new journal there: move cell.state_dir aside"
        )
    if report.first != upto + 1 or report.last < report.first:
        return int(upto)
    numbers = [values[0] for values in report.events]
    if numbers != sorted(set(numbers)) or not all(report.first <= number <= report.last for number in numbers):
        raise ValueError("events out of their order")
    for values in report.events:
        sql.insert("INSERT INTO event", {**key, **dict(zip(EVENT, values, strict=True))})
    row = {**key, "upto": report.last, "tail": report.tail}
    sql.insert("INSERT OR REPLACE INTO feed", row)
    return report.last


def offers(sql: DatabaseTransaction, cell: str) -> list[dict[str, Any]]:
    """What other cells have learned of each recipe: the latest."""
    rows = sql.rows(
        "SELECT recipe, cell, job, of_cycle, at_s, rate, sigma, max(at_s) FROM lesson WHERE cell != ? GROUP BY recipe",
        cell,
    )
    return [{key: value for key, value in row.items() if key != "max(at_s)"} for row in rows]


def _rows(
    sql: DatabaseTransaction, table: str, columns: Sequence[str], key: Mapping[str, Any], rows: Sequence[Sequence[Any]]
) -> None:
    for values in rows:
        sql.insert(f"INSERT OR REPLACE INTO {table}", {**key, **dict(zip(columns, values, strict=True))})
