"""The shop's tables: SQLite in WAL mode with full sync, as the journal of a cell."""

from __future__ import annotations

import sqlite3
from pathlib import Path

from polishd.files import make_folder
from polishd.model.errors import ConfigError

DATABASE_NAME = "shop.sqlite"
VERSION = 1
WAIT_S = 30.0
"""Server and command line take turns; whoever has to wait for longer says so."""

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
"""``one_cell`` is the rule of the house: of a part there is one claim at a time that has not ended.

``word`` is what the shop decided, and who wanted it; ``event`` is what the cells' journals say, by their own numbers.
"""


def open_database(path: Path) -> sqlite3.Connection:
    """The shop's file, made where it is not there; ConfigError where it cannot be used."""
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
