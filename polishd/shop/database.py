"""The shop's database, with transactions for several threads and processes."""

from __future__ import annotations

import json
import sqlite3
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, Self

from polishd.model.errors import ConfigError, LinkError
from polishd.util.files import make_folder

# The shop's tables: SQLite in WAL mode with full sync, as the journal of a cell.

DATABASE_NAME = "shop.sqlite"
VERSION = 1
WAIT_S = 30.0
"""Longest time that server and command line wait for each other."""

SCHEMA = """
CREATE TABLE part (
    id INTEGER PRIMARY KEY, job TEXT NOT NULL UNIQUE, part_id TEXT NOT NULL, content TEXT NOT NULL,
    files TEXT NOT NULL, added REAL NOT NULL, by TEXT NOT NULL, state TEXT NOT NULL DEFAULT 'waiting'
        CHECK (state IN ('waiting', 'claimed', 'begun', 'aside', 'done', 'removed')),
    verdict TEXT NOT NULL DEFAULT '', reason TEXT NOT NULL DEFAULT '', ended REAL);
CREATE UNIQUE INDEX part_once ON part (part_id) WHERE state NOT IN ('done', 'removed');
CREATE INDEX part_waits ON part (id) WHERE state = 'waiting';
CREATE TABLE claim (
    request TEXT PRIMARY KEY, part INTEGER NOT NULL REFERENCES part, cell TEXT NOT NULL, given REAL NOT NULL,
    state TEXT NOT NULL DEFAULT 'given', back TEXT NOT NULL DEFAULT '', ended REAL, how TEXT NOT NULL DEFAULT '')
    WITHOUT ROWID;
CREATE UNIQUE INDEX one_cell ON claim (part) WHERE ended IS NULL;
CREATE INDEX claim_of_cell ON claim (cell) WHERE ended IS NULL;
CREATE TABLE not_for (part INTEGER NOT NULL REFERENCES part, cell TEXT NOT NULL, why TEXT NOT NULL,
    PRIMARY KEY (part, cell)) WITHOUT ROWID;
CREATE TABLE file (sha256 TEXT PRIMARY KEY, content BLOB NOT NULL);
CREATE TABLE cell (name TEXT PRIMARY KEY, heard REAL NOT NULL, now TEXT NOT NULL) WITHOUT ROWID;
CREATE TABLE feed (cell TEXT NOT NULL, journal TEXT NOT NULL, upto INTEGER NOT NULL, tail TEXT NOT NULL,
    PRIMARY KEY (cell, journal)) WITHOUT ROWID;
CREATE TABLE event (
    cell TEXT NOT NULL, journal TEXT NOT NULL, seq INTEGER NOT NULL, job INTEGER NOT NULL, at REAL NOT NULL,
    cycle INTEGER, name TEXT NOT NULL, data TEXT NOT NULL, PRIMARY KEY (cell, journal, seq)) WITHOUT ROWID;
CREATE TABLE job (
    cell TEXT NOT NULL, journal TEXT NOT NULL, job INTEGER NOT NULL, name TEXT NOT NULL, part_id TEXT NOT NULL,
    started REAL NOT NULL, ended REAL, outcome TEXT, detail TEXT, PRIMARY KEY (cell, journal, job)) WITHOUT ROWID;
CREATE TABLE pass (
    cell TEXT NOT NULL, journal TEXT NOT NULL, job INTEGER NOT NULL, cycle INTEGER NOT NULL,
    program_sha256 TEXT NOT NULL, started REAL NOT NULL, ended REAL, how TEXT, facts TEXT NOT NULL,
    PRIMARY KEY (cell, journal, job, cycle)) WITHOUT ROWID;
CREATE TABLE map (
    cell TEXT NOT NULL, journal TEXT NOT NULL, job INTEGER NOT NULL, cycle INTEGER NOT NULL, taken REAL NOT NULL,
    stats TEXT NOT NULL, PRIMARY KEY (cell, journal, job, cycle)) WITHOUT ROWID;
CREATE TABLE lesson (
    recipe TEXT NOT NULL, cell TEXT NOT NULL, job TEXT NOT NULL, of_cycle INTEGER NOT NULL, at_s REAL NOT NULL,
    tool TEXT NOT NULL, rate REAL NOT NULL, sigma REAL NOT NULL, PRIMARY KEY (recipe, cell)) WITHOUT ROWID;
CREATE TABLE word (
    id INTEGER PRIMARY KEY, at REAL NOT NULL, who TEXT NOT NULL, what TEXT NOT NULL, job TEXT NOT NULL,
    cell TEXT NOT NULL, why TEXT NOT NULL);
"""
"""``one_cell`` allows one open claim of a part at a time.

``word`` holds the shop's decisions and their authors; ``event`` holds the events of the cells' journals, with their
numbers.
"""


def open_database(path: Path) -> sqlite3.Connection:
    """Open the shop's file, and make it where it is missing; ConfigError where it cannot be used."""
    try:
        make_folder(path.parent, mode=0o700)
        connection = sqlite3.connect(path, isolation_level=None, check_same_thread=False, timeout=WAIT_S)
    except (sqlite3.Error, OSError) as error:
        raise ConfigError(f"{path}: the shop's database cannot be opened: {error}; look at shop.state_dir") from error
    try:
        for pragma in ("journal_mode=WAL", "synchronous=FULL", "foreign_keys=ON"):
            connection.execute(f"PRAGMA {pragma}")
        connection.execute("BEGIN IMMEDIATE")
        (version,) = connection.execute("PRAGMA user_version").fetchone()
        if version == 0:
            for statement in filter(str.strip, SCHEMA.split(";")):
                connection.execute(statement)
            connection.execute(f"PRAGMA user_version={VERSION}")
        connection.execute("COMMIT")
    except sqlite3.Error as error:
        connection.close()
        raise ConfigError(
            f"{path}: the shop's database cannot be used: {error}; leave it, and mend the disk"
        ) from error
    if version not in {0, VERSION}:
        connection.close()
        raise ConfigError(f"{path}: has format {version}, this polishd writes {VERSION}; use the one that wrote it")
    return connection


class Database:
    """One connection for several threads; ``with`` closes it."""

    def __init__(self, connection: sqlite3.Connection) -> None:
        self._connection = connection
        self._use = threading.RLock()

    @classmethod
    def open(cls, state_dir: Path) -> Self:
        """Open the database of a shop's folder; ConfigError where it cannot be used."""
        return cls(open_database(state_dir / DATABASE_NAME))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Idempotent."""
        self._connection.close()

    @contextmanager
    def transaction(self) -> Iterator[DatabaseTransaction]:
        """Commit the whole block durably, or nothing. LinkError where the disk or the lock fails.

        ConfigError where a row contradicts the others.
        """
        with self._use:
            try:
                self._connection.execute("BEGIN IMMEDIATE")
                try:
                    yield DatabaseTransaction(self._connection)
                    self._connection.execute("COMMIT")
                except BaseException:
                    if self._connection.in_transaction:  # SQLite rolls back without being asked, e.g. on a full disk
                        self._connection.execute("ROLLBACK")
                    raise
            except sqlite3.IntegrityError as error:
                raise ConfigError(
                    f"that does not go with what the shop has: {error}; nothing of it was taken"
                ) from error
            except sqlite3.Error as error:
                raise LinkError(f"the shop's database: {error}; nothing of this was taken; look at its disk") from error


Conflict = Literal["ABORT", "IGNORE", "REPLACE"]


class DatabaseTransaction:
    """Reads and writes of one transaction."""

    def __init__(self, connection: sqlite3.Connection) -> None:
        self._connection = connection

    def rows(self, sql: str, *values: Any) -> list[dict[str, Any]]:
        """All rows, each by column."""
        cursor = self._connection.execute(sql, values)
        names = [column[0] for column in cursor.description]
        return [dict(zip(names, row, strict=True)) for row in cursor.fetchall()]

    def row(self, sql: str, *values: Any) -> dict[str, Any] | None:
        """The first one; None where there is none."""
        return next(iter(self.rows(sql, *values)), None)

    def run(self, sql: str, *values: Any) -> int:
        """Write, and return the number of changed rows."""
        return self._connection.execute(sql, values).rowcount

    def insert(self, table: str, values: Mapping[str, Any], *, conflict: Conflict = "ABORT") -> None:
        """Insert one row; ``conflict``: SQLite's action where a row has the same key (ABORT: ConfigError)."""
        marks = ", ".join("?" * len(values))
        sql = f"INSERT OR {conflict} INTO {table} ({', '.join(values)}) VALUES ({marks})"  # noqa: S608 - our own words
        self.run(sql, *values.values())

    def log_decision(self, author: str, action: str, job: str, cell: str = "", why: str = "") -> None:
        """Record a decision of the shop and its author."""
        row = {"at": time.time(), "who": author, "what": action, "job": job, "cell": cell, "why": why}
        self.insert("word", row)


# Copies of the cells' journals: each event once by its number, each job, map and pass by its key.

JOB = ("job", "name", "part_id", "started", "ended", "outcome", "detail")
PASS = ("job", "cycle", "program_sha256", "started", "ended", "how", "facts")
MAP = ("job", "cycle", "taken", "stats")
LESSON = ("recipe", "job", "of_cycle", "at_s", "tool", "rate", "sigma")
EVENT = ("seq", "job", "at", "cycle", "name", "data")
"""Columns, in the order in which a report has their values."""


@dataclass(frozen=True, slots=True)
class CellReport:
    """One report of a cell: the events ``first`` to ``last``, and the rows in their present state."""

    journal: str
    """Identity of the journal: the cell may have begun another one."""
    first: int
    last: int
    before: str
    """Hash of the event before the first one in the journal; empty: the first is the journal's first."""
    tail: str
    """Hash of the last event."""
    now: Mapping[str, Any]
    """State of the cell, for people."""
    events: Sequence[Sequence[Any]] = ()
    """Without each pass's progress."""
    jobs: Sequence[Sequence[Any]] = ()
    passes: Sequence[Sequence[Any]] = ()
    maps: Sequence[Sequence[Any]] = ()
    lessons: Sequence[Sequence[Any]] = ()
    claims: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    """State and reason of each claim in the cell's queue, by request."""

    def __post_init__(self) -> None:
        """TypeError where a field has another type: reports come from outside."""
        kinds = {"journal": str, "first": int, "last": int, "before": str, "tail": str, "now": dict, "claims": dict}
        for name, kind in kinds.items():
            if not isinstance(getattr(self, name), kind):
                raise TypeError(f"{name} is no {kind.__name__}")


def take(sql: DatabaseTransaction, cell: str, report: CellReport) -> int:
    """Store the new events, and return the number of the last known event.

    A report that begins beyond it is not stored: the cell sends again from there. ConfigError where the journal
    contradicts the stored events.
    """
    now = {"name": cell, "heard": time.time(), "now": json.dumps(dict(report.now))}
    sql.insert("cell", now, conflict="REPLACE")
    key = {"cell": cell, "journal": report.journal}
    stored = sql.row("SELECT upto, tail FROM feed WHERE cell = ? AND journal = ?", *key.values())
    upto, tail = (0, "") if stored is None else (stored["upto"], stored["tail"])
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
        sql.insert("event", {**key, **dict(zip(EVENT, values, strict=True))})
    row = {**key, "upto": report.last, "tail": report.tail}
    sql.insert("feed", row, conflict="REPLACE")
    return report.last


def offers(sql: DatabaseTransaction, cell: str) -> list[dict[str, Any]]:
    """Latest rate of each recipe from the other cells."""
    rows = sql.rows(
        "SELECT recipe, cell, job, of_cycle, at_s, rate, sigma, max(at_s) FROM lesson WHERE cell != ? GROUP BY recipe",
        cell,
    )
    return [{key: value for key, value in row.items() if key != "max(at_s)"} for row in rows]


def _rows(
    sql: DatabaseTransaction, table: str, columns: Sequence[str], key: Mapping[str, Any], rows: Sequence[Sequence[Any]]
) -> None:
    for values in rows:
        sql.insert(table, {**key, **dict(zip(columns, values, strict=True))}, conflict="REPLACE")
