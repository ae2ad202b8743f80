"""The journal's tables, how a file of an earlier format becomes one of this, and whole copies of it."""

from __future__ import annotations

import contextlib
import os
import sqlite3
from collections.abc import Callable, Iterator
from pathlib import Path

from polishd.files import sync_folder
from polishd.model.errors import ConfigError

SCHEMA_VERSION = 5

QUEUE = """
CREATE TABLE queue (
    id INTEGER PRIMARY KEY, place INTEGER NOT NULL, name TEXT NOT NULL, part_id TEXT NOT NULL, path TEXT NOT NULL,
    content TEXT NOT NULL, files TEXT NOT NULL, added REAL NOT NULL, job INTEGER REFERENCES job, begun REAL,
    ended REAL, verdict TEXT, reason TEXT NOT NULL DEFAULT '', fault TEXT NOT NULL DEFAULT '');
CREATE INDEX queue_of_name ON queue (name);
CREATE INDEX queue_to_do ON queue (place) WHERE ended IS NULL;
CREATE INDEX map_of_job ON map (job);
CREATE INDEX phase_of_job ON phase (job);
CREATE INDEX event_of_job ON event (job);
"""
"""What came with format 3 for the queue. A journal knows many jobs: what one of them asks is found by an index."""

CLAIM = """
ALTER TABLE queue ADD COLUMN claim TEXT NOT NULL DEFAULT '';
"""
"""What came with format 5: by which claim a shop gave the part to this cell; empty: no shop did."""

SCHEMA = (
    """
CREATE TABLE job (
    id INTEGER PRIMARY KEY, name TEXT NOT NULL, part_id TEXT NOT NULL, terms TEXT NOT NULL,
    started REAL NOT NULL, ended REAL, outcome TEXT, detail TEXT, run_dir TEXT NOT NULL DEFAULT '');
CREATE TABLE map (
    id INTEGER PRIMARY KEY, job INTEGER NOT NULL REFERENCES job, cycle INTEGER NOT NULL, sha256 TEXT NOT NULL,
    path TEXT NOT NULL, stats TEXT NOT NULL, taken REAL NOT NULL, arrays TEXT NOT NULL DEFAULT '');
CREATE TABLE phase (
    id INTEGER PRIMARY KEY, job INTEGER NOT NULL REFERENCES job, cycle INTEGER NOT NULL, phase TEXT NOT NULL,
    started REAL NOT NULL, ended REAL, outcome TEXT, error TEXT);
CREATE TABLE pass (
    job INTEGER NOT NULL REFERENCES job, cycle INTEGER NOT NULL, program_sha256 TEXT NOT NULL,
    boot_id TEXT NOT NULL, blocks INTEGER NOT NULL, contact_from INTEGER NOT NULL, contact_to INTEGER NOT NULL,
    facts TEXT NOT NULL, started REAL NOT NULL, ended REAL, how TEXT,
    plan TEXT NOT NULL DEFAULT '', start TEXT NOT NULL DEFAULT '',
    reach_s REAL, uncertain_from INTEGER, uncertain_to INTEGER, PRIMARY KEY (job, cycle));
CREATE TABLE segment (
    job INTEGER NOT NULL, cycle INTEGER NOT NULL, seq INTEGER NOT NULL, start_s REAL NOT NULL, end_s REAL NOT NULL,
    touched INTEGER, recovered INTEGER NOT NULL, force_n REAL, rpm REAL, told_s REAL, sensor_force_n REAL,
    PRIMARY KEY (job, cycle, seq)) WITHOUT ROWID;
CREATE TABLE event (
    id INTEGER PRIMARY KEY, job INTEGER NOT NULL, at REAL NOT NULL, cycle INTEGER, name TEXT NOT NULL,
    data TEXT NOT NULL);
"""
    + QUEUE
    + CLAIM
)
"""``job.terms`` is JSON, see ``same_job``; ``map.arrays``, ``pass.plan`` and ``pass.start`` name files of the store.

``segment.touched`` is NULL where nobody knows.
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

STEPS = {1: FROM_1, 2: FROM_2 + QUEUE, 3: FROM_3, 4: CLAIM}
"""From each earlier format to the next."""

OF_A_JOB = ("map", "phase", "pass", "segment", "event", "queue")
"""Tables whose rows name a job."""

Connect = Callable[[Path], sqlite3.Connection]


def connect(path: Path) -> sqlite3.Connection:
    """A connection as the store wants it: transactions begin when told, and several threads take turns."""
    return sqlite3.connect(path, isolation_level=None, check_same_thread=False, timeout=5.0)


def open_file(path: Path, connect: Connect = connect) -> sqlite3.Connection:
    """The journal's file with the tables of this format, made or brought up to date; ConfigError where it cannot be.

    Of a file of an earlier format a copy stays beside it (``old_copy``).
    """
    try:
        connection = connect(path)
    except sqlite3.Error as error:
        raise ConfigError(f"{path}: the journal cannot be opened: {error}; look at cell.state_dir") from error
    try:
        _prepare(connection, path)
    except (sqlite3.Error, OSError) as error:
        connection.close()
        raise ConfigError(f"{path}: the journal cannot be used: {error}; {_advice(error)}") from error
    except ConfigError:
        connection.close()
        raise
    return connection


def _advice(error: sqlite3.Error | OSError) -> str:
    """A file that is no journal may go; one that the disk refuses must stay, with the job in it."""
    if getattr(error, "sqlite_errorname", "").startswith(("SQLITE_NOTADB", "SQLITE_CORRUPT")):
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
        copy_whole(connection, old_copy(path, version))
    if version != SCHEMA_VERSION:
        script = "".join(STEPS[step] for step in range(version, SCHEMA_VERSION)) if version else SCHEMA
        connection.executescript(f"BEGIN IMMEDIATE; {script} PRAGMA user_version={SCHEMA_VERSION}; COMMIT;")
        sync_folder(path.parent)
