"""What the real journal makes of a disk after a crash, against what it had promised by then."""

from __future__ import annotations

import hashlib
import json
import sqlite3
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, field
from functools import cache, lru_cache
from pathlib import Path
from typing import Any

from polishd.daemon.journal import checksums
from polishd.daemon.journal.checksums import CommitRecord
from polishd.daemon.journal.journal import JOURNAL_NAME, Journal
from polishd.daemon.journal.store import connect, register_functions
from polishd.model.errors import PolishdError
from tests.campaigns.crash.disk import Files
from tests.campaigns.crash.recording import STATE, Op

ROWS = 50_000
"""Checksums of rows that are kept; a recording has some 6,000 rows."""


@dataclass(frozen=True, slots=True)
class Promised:
    """What the program had said and done when the power failed."""

    versions: Sequence[str]
    """Digests that the journal may have: after the last commit that returned, and after each that had begun since."""
    moved: tuple[str, ...]
    """Programs with which the robot had been sent off."""
    job: str
    """Under whose name the journal was open."""


@dataclass(slots=True)
class Promises:
    """Follows the marks."""

    begun: bytes = b""
    """The journal that was there before."""
    _moved: tuple[str, ...] = ()
    _job: str = ""
    _reference: sqlite3.Connection = field(init=False)
    _versions: list[str] = field(default_factory=list)
    _before: list[bytes] = field(default_factory=list)
    """Databases before each commit that has begun and has not returned, as ``_versions`` without the last."""
    _loaded: str = ""

    def __post_init__(self) -> None:
        self._reference = _in_memory(self.begun)
        self._versions.append(digest(self._reference))

    def take(self, mark: Op) -> None:
        """The next mark."""
        what: Mapping[str, Any] = mark.what
        if "commit" in what:
            self._before.append(_pages(self._reference))
            for sql, values in what["commit"]:
                if values is None:
                    self._reference.executescript(sql)
                else:
                    self._reference.execute(sql, values)
            self._versions.append(digest(self._reference))
        elif "durable" in what:
            self._versions, self._before = self._versions[-1:], []
        elif "job" in what:
            self._job = what["job"]
        elif "loads" in what:
            self._loaded = what["loads"]
        else:
            self._moved = (*self._moved, what.get("moves", self._loaded))

    def start(self, files: Files) -> None:
        """Begin with the journal in these files where the program before was killed as it committed."""
        if not self._before:
            return
        with tempfile.TemporaryDirectory(prefix="polishd-crash-") as folder:
            for name, content in files.items():
                if JOURNAL_NAME in name:
                    (Path(folder) / Path(name).name).write_bytes(content)
            with closing(connect(Path(folder) / JOURNAL_NAME)) as journal:
                found = digest(journal)
        if found not in self._versions:
            return  # lost: as each state from here on will show
        if found != self._versions[-1]:
            self._reference = _in_memory(self._before[self._versions.index(found)])
        self._versions, self._before = [found], []

    def now(self) -> Promised:
        """As of the last mark."""
        return Promised(tuple(self._versions), self._moved, self._job)


def _in_memory(pages: bytes) -> sqlite3.Connection:
    """Return a database with these pages; none: an empty one."""
    connection = sqlite3.connect(":memory:", isolation_level=None)
    if pages:
        connection.deserialize(pages[:18] + b"\1\1" + pages[20:])  # no WAL in memory
    connection.execute("PRAGMA foreign_keys=ON")
    register_functions(connection)
    return connection


@cache
def _columns(schema: str) -> str:
    """SQL that gives all of a table of that schema as one text; by C, since it is asked a hundred thousand times."""
    with sqlite3.connect(":memory:") as empty:
        register_functions(empty)
        empty.execute(schema)
        ((table,),) = empty.execute("SELECT name FROM sqlite_master WHERE type = 'table'")
        names = [row[1] for row in empty.execute(f"PRAGMA table_info({table})")]
    return f"SELECT group_concat({'||'.join(f'quote({name})' for name in names)}) FROM {table}"


_DIGESTS: dict[bytes, str] = {}
"""Digests of databases by the hash of their pages: a few hundred commits, in a hundred thousand states."""


def digest(connection: sqlite3.Connection) -> str:
    """Return a digest of the format, the tables and all rows; sqlite3.Error where a page cannot be read.

    The rows are read once for each database of identical pages. Pages include those of complete transactions in the
    WAL, so what is left of other transactions makes no difference.
    """
    pages = hashlib.blake2b(_pages(connection), digest_size=32).digest()
    if pages not in _DIGESTS:
        _DIGESTS[pages] = _digest_rows(connection)
    return _DIGESTS[pages]


def _pages(connection: sqlite3.Connection) -> bytes:
    """Return all pages; none of an empty database, to which ``serialize`` would begin to write."""
    return connection.serialize() if connection.execute("PRAGMA page_count").fetchone()[0] else b""


def _digest_rows(connection: sqlite3.Connection) -> str:
    tables = connection.execute("SELECT sql FROM sqlite_master WHERE type = 'table' ORDER BY name").fetchall()
    held = [connection.execute(_columns(sql)).fetchone()[0] for (sql,) in tables]
    version = connection.execute("PRAGMA user_version").fetchone()[0]
    return hashlib.blake2b(repr((version, *tables, *held)).encode(), digest_size=16).hexdigest()


cached_row_crc = lru_cache(ROWS, typed=True)(checksums.row_crc)
"""``row_crc`` depends on its arguments alone. ``typed``: 1, 1.0 and True are equal, and have different checksums."""


@contextmanager
def cached_checksums() -> Iterator[None]:
    """Let the journal compute the checksum of identical rows once. It still reads and compares each row."""
    compute = checksums.row_crc
    checksums.row_crc = cached_row_crc
    try:
        yield
    finally:
        checksums.row_crc = compute


@dataclass(frozen=True, slots=True)
class Verdict:
    """What was wrong; empty where nothing was."""

    lost: str = ""
    twice_unmarked: str = ""
    unopenable: str = ""


class Judge:
    """Puts what a crash left into a folder, and starts there."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._there: Files = {}

    def judge(self, files: Files, promised: Promised) -> Verdict:
        """Open it with the real journal."""
        self._put(files)
        state = self._folder / STATE
        state.mkdir(parents=True, exist_ok=True)  # as a daemon does when it takes the lock
        found = _Found()
        try:
            for path in state.glob("*.json"):
                json.loads(path.read_bytes())
            journal = Journal.open(state, job=promised.job, part_id="P1", connect=found.connect)
        except (PolishdError, sqlite3.Error, ValueError) as error:
            return Verdict(unopenable=f"{type(error).__name__}: {error}")
        with journal:
            lost = "" if found.version in promised.versions else "the journal is none that it can be"
            return Verdict(lost or _arrays(journal), _unmarked(journal, found.programs, promised.moved))

    def _put(self, files: Files) -> None:
        """Arrays that are there already are not written again."""
        for path in (self._folder / STATE).rglob("*"):
            name = str(path.relative_to(self._folder))
            ours = JOURNAL_NAME in name or CommitRecord.NAME in name  # written by each start
            if path.is_file() and (ours or files.get(name) is not self._there.get(name)):
                path.unlink()
        for name, content in files.items():
            path = self._folder / name
            if not path.exists():
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_bytes(content)
        self._there = files


@dataclass(slots=True)
class _Found:
    """What the file held before the journal did anything with it."""

    version: str = ""
    programs: frozenset[str] = frozenset()

    def connect(self, path: Path) -> sqlite3.Connection:
        """A ``Connect``."""
        connection = connect(path)
        self.version = digest(connection)
        if connection.execute("SELECT 1 FROM sqlite_master WHERE name = 'pass'").fetchall():
            self.programs = frozenset(name for (name,) in connection.execute("SELECT program_sha256 FROM pass"))
        return connection


def _arrays(journal: Journal) -> str:
    """What its rows name, by its own means."""
    try:
        for name in (
            *(record.arrays for record in journal.history),
            *(name for record in journal.passes for name in (record.plan, record.start)),
        ):
            if name:
                journal.arrays.content(name)
    except PolishdError as error:
        return str(error)
    return ""


def _unmarked(journal: Journal, programs: frozenset[str], moved: tuple[str, ...]) -> str:
    """What the robot was sent off with, and would be run again as if it had never been."""
    if unknown := sorted(set(moved) - programs):
        return f"the robot was sent off, and no pass says so: {unknown}"
    again = [record.cycle for record in journal.passes if record.cycle in journal.remaining(1000)]
    return f"passes that are run again: {again}" if again else ""
