"""The journal's tables, how a file of an earlier format becomes one of this, and whole copies of it."""

from __future__ import annotations

import contextlib
import logging
import os
import secrets
import shlex
import sqlite3
from collections.abc import Callable, Iterator, Mapping
from functools import cache
from pathlib import Path

from polishd.daemon.journal_check import (
    CHECK_S,
    DISPENSABLE,
    CommitRecord,
    Damage,
    check_journal,
    register_checksum,
)
from polishd.files import sync_folder
from polishd.model.errors import ConfigError, JournalDamage

log = logging.getLogger(__name__)

SCHEMA_VERSION = 6

QUEUE_4 = """
CREATE TABLE queue (
    id INTEGER PRIMARY KEY, place INTEGER NOT NULL, name TEXT NOT NULL, part_id TEXT NOT NULL, path TEXT NOT NULL,
    content TEXT NOT NULL, files TEXT NOT NULL, added REAL NOT NULL, job INTEGER REFERENCES job, begun REAL,
    ended REAL, verdict TEXT, reason TEXT NOT NULL DEFAULT '', fault TEXT NOT NULL DEFAULT '');
"""
INDEXES: Mapping[str, str] = {
    "queue_of_name": "queue (name)",
    "queue_to_do": "queue (place) WHERE ended IS NULL",
    "map_of_job": "map (job)",
    "phase_of_job": "phase (job)",
    "event_of_job": "event (job)",
}
MADE_INDEXES = "".join(f"CREATE INDEX {name} ON {what};\n" for name, what in INDEXES.items())
QUEUE = QUEUE_4 + MADE_INDEXES
"""What came with format 3 for the queue. A journal knows many jobs: what one of them asks is found by an index."""

CLAIM = """
ALTER TABLE queue ADD COLUMN claim TEXT NOT NULL DEFAULT '';
"""
"""What came with format 5: by which claim a shop gave the part to this cell; empty: no shop did."""


def _table(name: str, columns: str, key: str = "", options: str = "") -> str:
    """SQL of a table whose rows carry a checksum, which SQLite computes whenever it writes one."""
    names = ", ".join(column.split()[0] for column in columns.split(", "))
    crc = f"crc INTEGER NOT NULL GENERATED ALWAYS AS (row_crc('{name}', {names})) STORED"
    return f"CREATE TABLE {name} ({columns}, {crc}{f', {key}' if key else ''}){options};\n"


JOB = (
    "id INTEGER PRIMARY KEY, name TEXT NOT NULL, part_id TEXT NOT NULL, terms TEXT NOT NULL, started REAL NOT NULL, "
    "ended REAL, outcome TEXT, detail TEXT, run_dir TEXT NOT NULL DEFAULT ''"
)
MAP = (
    "id INTEGER PRIMARY KEY, job INTEGER NOT NULL REFERENCES job, cycle INTEGER NOT NULL, sha256 TEXT NOT NULL, "
    "path TEXT NOT NULL, stats TEXT NOT NULL, taken REAL NOT NULL, arrays TEXT NOT NULL DEFAULT ''"
)
PHASE = (
    "id INTEGER PRIMARY KEY, job INTEGER NOT NULL REFERENCES job, cycle INTEGER NOT NULL, phase TEXT NOT NULL, "
    "started REAL NOT NULL, ended REAL, outcome TEXT, error TEXT"
)
RUN = (
    "job INTEGER NOT NULL REFERENCES job, cycle INTEGER NOT NULL, program_sha256 TEXT NOT NULL, "
    "boot_id TEXT NOT NULL, blocks INTEGER NOT NULL, contact_from INTEGER NOT NULL, contact_to INTEGER NOT NULL, "
    "facts TEXT NOT NULL, started REAL NOT NULL, ended REAL, how TEXT, plan TEXT NOT NULL DEFAULT '', "
    "start TEXT NOT NULL DEFAULT '', reach_s REAL, uncertain_from INTEGER, uncertain_to INTEGER"
)
SEGMENT = (
    "job INTEGER NOT NULL, cycle INTEGER NOT NULL, seq INTEGER NOT NULL, start_s REAL NOT NULL, end_s REAL NOT NULL, "
    "touched INTEGER, recovered INTEGER NOT NULL, force_n REAL, rpm REAL, told_s REAL, sensor_force_n REAL"
)
EVENT = (
    "id INTEGER PRIMARY KEY, job INTEGER NOT NULL, at REAL NOT NULL, cycle INTEGER, name TEXT NOT NULL, "
    "data TEXT NOT NULL"
)
QUEUED = (
    "id INTEGER PRIMARY KEY, place INTEGER NOT NULL, name TEXT NOT NULL, part_id TEXT NOT NULL, path TEXT NOT NULL, "
    "content TEXT NOT NULL, files TEXT NOT NULL, added REAL NOT NULL, job INTEGER REFERENCES job, begun REAL, "
    "ended REAL, verdict TEXT, reason TEXT NOT NULL DEFAULT '', fault TEXT NOT NULL DEFAULT '', "
    "claim TEXT NOT NULL DEFAULT ''"
)
TABLES = (
    _table("job", JOB)
    + _table("map", MAP)
    + _table("phase", PHASE)
    + _table("pass", RUN, "PRIMARY KEY (job, cycle)")
    + _table("segment", SEGMENT, "PRIMARY KEY (job, cycle, seq)", " WITHOUT ROWID")
    + _table("event", EVENT)
    + _table("queue", QUEUED)
)
COMMITS = _table("commits", "id INTEGER PRIMARY KEY CHECK (id = 1), journal TEXT NOT NULL, count INTEGER NOT NULL")
"""One row: which journal this is, and how many commits of the store it has seen."""

SCHEMA = TABLES + COMMITS + MADE_INDEXES
"""``job.terms`` is JSON, see ``same_job``; ``map.arrays``, ``pass.plan`` and ``pass.start`` name files of the store.

``segment.touched`` is NULL where nobody knows. ``crc`` is a checksum of the row (``journal_check``).
"""

FROM_1 = """
ALTER TABLE job RENAME COLUMN config_sha256 TO terms;
UPDATE job SET terms = 'null';
ALTER TABLE job ADD COLUMN run_dir TEXT NOT NULL DEFAULT '';
ALTER TABLE map ADD COLUMN arrays TEXT NOT NULL DEFAULT '';
ALTER TABLE pass ADD COLUMN plan TEXT NOT NULL DEFAULT '';
ALTER TABLE pass ADD COLUMN start TEXT NOT NULL DEFAULT '';
"""
FROM_2 = """
ALTER TABLE pass ADD COLUMN reach_s REAL;
ALTER TABLE pass ADD COLUMN uncertain_from INTEGER;
ALTER TABLE pass ADD COLUMN uncertain_to INTEGER;
ALTER TABLE segment RENAME TO segment_2;
CREATE TABLE segment (
    job INTEGER NOT NULL, cycle INTEGER NOT NULL, seq INTEGER NOT NULL, start_s REAL NOT NULL, end_s REAL NOT NULL,
    touched INTEGER, recovered INTEGER NOT NULL, force_n REAL, rpm REAL, told_s REAL,
    PRIMARY KEY (job, cycle, seq)) WITHOUT ROWID;
INSERT INTO segment SELECT job, cycle, seq, start_s, end_s,
    CASE WHEN recovered AND in_contact THEN NULL ELSE in_contact END, recovered, NULL, NULL, NULL FROM segment_2;
DROP TABLE segment_2;
"""
"""Of a block that was recovered, contact had been told by its place in the program."""

FROM_3 = """
ALTER TABLE segment ADD COLUMN sensor_force_n REAL;
"""

_CHILDREN: Mapping[str, str] = {
    "map": MAP, "phase": PHASE, "pass": RUN, "segment": SEGMENT, "event": EVENT, "queue": QUEUED
}  # fmt: skip


def _with_checksums() -> str:
    """Each table is made anew: SQLite adds no stored column to one that is there."""
    tables = {**_CHILDREN, "job": JOB}
    named = {table: ", ".join(column.split()[0] for column in columns.split(", ")) for table, columns in tables.items()}
    return "".join(
        [
            *(f"DROP INDEX {index};\n" for index in INDEXES),
            *(f"ALTER TABLE {table} RENAME TO {table}_5;\n" for table in tables),
            SCHEMA,
            *(f"INSERT INTO {table} ({named[table]}) SELECT {named[table]} FROM {table}_5;\n" for table in  # noqa: S608
              ("job", *_CHILDREN)),
            *(f"DROP TABLE {table}_5;\n" for table in tables),
        ]
    )  # fmt: skip


FROM_5 = _with_checksums()
STEPS = {1: FROM_1, 2: FROM_2 + QUEUE, 3: FROM_3, 4: CLAIM, 5: FROM_5}
"""From each earlier format to the next."""
JSON_COLUMNS = (("job", "terms"), ("map", "stats"), ("pass", "facts"), ("event", "data"))
"""Of a format without checksums: a row whose JSON cannot be read is damaged."""

OF_A_JOB = ("map", "phase", "pass", "segment", "event", "queue")
"""Tables whose rows name a job."""

Connect = Callable[[Path], sqlite3.Connection]


def connect(path: Path) -> sqlite3.Connection:
    """A connection as the store wants it: transactions begin when told, and several threads take turns."""
    connection = sqlite3.connect(path, isolation_level=None, check_same_thread=False, timeout=5.0)
    register_checksum(connection)
    return connection


def open_file(path: Path, connect: Connect = connect) -> sqlite3.Connection:
    """The journal's file with the tables of this format, made or brought up to date; ConfigError where it cannot be.

    Of a file of an earlier format a copy stays beside it (``old_copy``). JournalDamage where it is damaged: it is left
    as it is.
    """
    require_sound(path)
    try:
        connection = connect(path)
        register_checksum(connection)
    except sqlite3.Error as error:
        raise ConfigError(f"{path}: the journal cannot be opened: {error}; look at cell.state_dir") from error
    try:
        _prepare(connection, path)
    except (sqlite3.Error, OSError) as error:
        connection.close()
        kind = JournalDamage if _is_broken(error) else ConfigError
        raise kind(f"{path}: the journal cannot be used: {error}; {_advice(error)}") from error
    except ConfigError:
        connection.close()
        raise
    return connection


@cache
def _definitions() -> dict[str, str]:
    """SQL of each table and index of this format, as SQLite keeps it."""
    with contextlib.closing(sqlite3.connect(":memory:")) as empty:
        register_checksum(empty)
        empty.executescript(SCHEMA)
        return dict(empty.execute("SELECT name, sql FROM sqlite_schema WHERE sql IS NOT NULL"))


def require_sound(path: Path) -> None:
    """JournalDamage where rows, pages or commits of the file are damaged. It is only read.

    An error of the disk is left to whoever opens the file for writing.
    """
    if not path.exists() or path.with_name(f"{path.name}-journal").exists():
        return  # not there, or not quite made yet: it is rolled back when it is opened
    try:
        damage, is_complete = check_journal(path, {SCHEMA_VERSION: _definitions()})
    except (sqlite3.Error, OSError) as error:
        log.info("%s: the journal cannot be checked before it is opened: %s", path, error)
        return
    if damage is not None:
        raise JournalDamage(f"{path}: the journal is damaged: {damage.what}. {_remedy(path, damage)}")
    if not is_complete:
        log.info("%s: only the newest rows were checked: the whole takes longer than %g s", path, CHECK_S)


def _remedy(path: Path, damage: Damage) -> str:
    drop = ""
    if damage.where and damage.table in DISPENSABLE:
        sql = f"DELETE FROM {damage.table} WHERE {damage.where}"  # noqa: S608 - a command that is shown
        drop = f', delete that row (no pass depends on it: sqlite3 {shlex.quote(str(path))} "{sql}")'
    return (
        f"To do: check the disk and the memory of this computer, then restore {path.parent} from a backup{drop}, or "
        f"move {path.name}, {path.name}-wal and {CommitRecord.NAME} aside to begin with an empty journal"
    )


def _is_broken(error: sqlite3.Error | OSError) -> bool:
    """The file is no database, or not a sound one."""
    return getattr(error, "sqlite_errorname", "").startswith(("SQLITE_NOTADB", "SQLITE_CORRUPT"))


def _advice(error: sqlite3.Error | OSError) -> str:
    """A file that is no journal may go; one that the disk refuses must stay, with the job in it."""
    if _is_broken(error):
        return "move the file aside to start a new one"
    return "leave the file where it is, and mend the disk, or its rights"


def old_copy(path: Path, version: int) -> Path:
    """Where a journal of an earlier format is kept as it was."""
    return path.with_suffix(f".v{version}.sqlite")


def copy_whole(connection: sqlite3.Connection, path: Path) -> None:
    """A whole, durable copy, as of now, which stands alone."""
    with _partial(path) as partial, contextlib.closing(sqlite3.connect(partial)) as copy:
        connection.backup(copy)
        copy.execute("PRAGMA journal_mode=DELETE")


def copy_job(connection: sqlite3.Connection, path: Path, job: int) -> None:
    """A durable journal of that job alone, as of now: however many there are, it is as large as the job."""
    with _partial(path) as partial:
        with contextlib.closing(sqlite3.connect(partial)) as copy:
            register_checksum(copy)
            copy.executescript(f"{SCHEMA} PRAGMA user_version={SCHEMA_VERSION};")
        connection.execute("ATTACH ? AS copy", (str(partial),))
        try:
            for table, key in {"job": "id", **dict.fromkeys(OF_A_JOB, "job")}.items():
                names = ", ".join(row[1] for row in connection.execute(f"PRAGMA copy.table_info({table})"))
                sql = f"INSERT INTO copy.{table} ({names}) SELECT {names} FROM main.{table} WHERE {key} = ?"  # noqa: S608
                connection.execute(sql, (job,))
        finally:
            connection.execute("DETACH copy")


@contextlib.contextmanager
def _partial(path: Path) -> Iterator[Path]:
    """A file to write, which becomes ``path`` at the end, durable."""
    partial = path.with_name(f".{path.name}.partial")
    with contextlib.suppress(FileNotFoundError):
        partial.unlink()
    yield partial
    with partial.open("rb") as file:
        os.fsync(file.fileno())
    partial.replace(path)
    sync_folder(path.parent)


def _prepare(connection: sqlite3.Connection, path: Path) -> None:
    connection.execute("PRAGMA journal_mode=WAL")
    connection.execute("PRAGMA synchronous=FULL")
    connection.execute("PRAGMA foreign_keys=ON")
    (version,) = connection.execute("PRAGMA user_version").fetchone()
    if version not in {0, *STEPS, SCHEMA_VERSION}:
        raise ConfigError(
            f"{path}: the journal has format {version}, this polishd writes format {SCHEMA_VERSION}; "
            "use the polishd that wrote it, or move the file aside to start a new one"
        )
    if version in STEPS:
        _require_json(connection, path)
        copy_whole(connection, old_copy(path, version))
    if version != SCHEMA_VERSION:
        script = "".join(STEPS[step] for step in range(version, SCHEMA_VERSION)) if version else SCHEMA
        script += f"INSERT INTO commits (id, journal, count) VALUES (1, '{secrets.token_hex(8)}', 0);"  # noqa: S608
        connection.executescript(f"BEGIN IMMEDIATE; {script} PRAGMA user_version={SCHEMA_VERSION}; COMMIT;")
        sync_folder(path.parent)


def _require_json(connection: sqlite3.Connection, path: Path) -> None:
    """JournalDamage where a row of a format without checksums holds JSON that cannot be read."""
    there = {name for (name,) in connection.execute("SELECT name FROM sqlite_schema WHERE type = 'table'")}
    for table, column in JSON_COLUMNS:
        columns = [row[1] for row in connection.execute(f"PRAGMA table_info({table})")] if table in there else []
        if column not in columns:
            continue
        sql = f"SELECT rowid FROM {table} WHERE NOT json_valid({column}) LIMIT 1"  # noqa: S608 - our own words
        for (row,) in connection.execute(sql):
            damage = Damage(f"{column} of the row rowid = {row} of {table} is no JSON", table, f"rowid = {row}")
            raise JournalDamage(f"{path}: the journal is damaged: {damage.what}. {_remedy(path, damage)}")
