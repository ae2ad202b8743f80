"""Checksums of the journal: of each row, of the number of commits, and of the frames in the WAL.

SQLite detects a flipped bit only where it breaks the structure of a page. It does not report a changed value, nor a
frame of the WAL with a wrong checksum (it drops this frame and all commits after it). So each row has a CRC-32 of its
table and values, a row counts the commits, and a file beside the journal names the last commit that returned. The
daemon checks the journal before it opens it for writing, and does not change a damaged one.
"""

from __future__ import annotations

import os
import sqlite3
import struct
import time
import zlib
from collections.abc import Iterator, Mapping
from contextlib import closing, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, Self
from urllib.parse import quote

CHECK_S = 2.0
"""Time limit for the check of rows and structure at a start, s. The newest rows come first."""
ROWS_PER_LOOK = 2_000
"""Rows between two reads of the clock."""
OPCODES_PER_LOOK = 20_000
"""SQLite instructions between two reads of the clock."""

WAL_HEADER, FRAME_HEADER = struct.Struct(">8I"), struct.Struct(">6I")
WAL_MAGIC, WAL_MAGIC_BIG_ENDIAN = 0x377F0682, 0x377F0683

KEYS: Mapping[str, str] = {
    "commits": "id",
    "job": "id",
    "queue": "id",
    "map": "id",
    "pass": "job, cycle",
    "phase": "id",
    "event": "id",
    "segment": "job, cycle, seq",
}
"""Key of each table, in the order of the check: the largest tables come last."""
DISPENSABLE = ("event", "phase")
"""Tables on which no later pass depends: a damaged row may be deleted."""


def row_crc(*values: Any) -> int:
    """Return the CRC-32 of a table's name and of the values of one of its rows."""
    text = ascii(values)
    if "-0.0" in text:  # SQLite stores it as 0
        text = ascii(tuple(value + 0.0 if isinstance(value, float) else value for value in values))
    return zlib.crc32(text.encode())


def register_checksum(connection: sqlite3.Connection) -> None:
    """Add the function ``row_crc`` to a connection that writes rows. A reading one does not need it."""
    connection.create_function("row_crc", -1, row_crc, deterministic=True)


class CommitRecord:
    """File beside the journal that names its last commit. It is written after each commit and never synced.

    It never names a commit that is not durable. After a power failure it may name an earlier one.
    """

    NAME = "journal.commits"

    def __init__(self, path: Path) -> None:
        """``path`` is that of the journal."""
        self.path = path.with_name(self.NAME)
        self._file = -1

    @classmethod
    def open(cls, path: Path) -> Self:
        """Open it for writing; OSError where that fails."""
        record = cls(path)
        record._file = os.open(record.path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
        return record

    def write(self, journal_id: str, count: int) -> None:
        """Write the commit. An error is ignored: the journal's next commit fails too, on the same disk."""
        with suppress(OSError):
            os.pwrite(self._file, self._line(journal_id, count), 0)

    def read(self) -> tuple[str, int] | None:
        """Return the journal's id and the named commit; None where the file is missing or incomplete."""
        try:
            content = self.path.read_bytes()
            journal_id, count, _ = content.decode("ascii").split()
            return (journal_id, int(count)) if content == self._line(journal_id, int(count)) else None
        except (OSError, ValueError):
            return None

    def close(self) -> None:
        """Close the file."""
        if self._file >= 0:
            os.close(self._file)
            self._file = -1

    @staticmethod
    def _line(journal_id: str, count: int) -> bytes:
        text = f"{journal_id} {count:020d}"
        return f"{text} {zlib.crc32(text.encode()):08x}\n".encode("ascii", "replace")


@dataclass(frozen=True, slots=True)
class Damage:
    """Damage of a journal."""

    what: str
    table: str = ""
    where: str = ""
    """SQL condition of the damaged row; empty for other damage."""


class CheckResult(NamedTuple):
    """Result of a check."""

    damage: Damage | None
    is_complete: bool
    """All rows and pages were checked within the time limit."""


class _Clock:
    """Ends the check of a large journal."""

    def __init__(self, within_s: float) -> None:
        self._end_s = time.monotonic() + within_s

    def is_over(self) -> bool:
        """Return whether the time is over."""
        return time.monotonic() > self._end_s


def check_journal(path: Path, schema: Mapping[int, Mapping[str, str]], within_s: float = CHECK_S) -> CheckResult:
    """Check a journal without changing it. ``schema``: SQL of each table and index, by format with checksums.

    sqlite3.Error or OSError where the disk fails. A file that is no database is not checked.
    """
    if (damage := _wal_damage(path)) is not None:
        return CheckResult(damage, is_complete=False)
    clock = _Clock(within_s)
    wal = path.with_name(f"{path.name}-wal")
    mode = "mode=ro" if wal.exists() and wal.stat().st_size else "immutable=1"  # creates no file beside it
    try:
        with closing(sqlite3.connect(f"file:{quote(str(path.absolute()))}?{mode}", uri=True, timeout=5.0)) as journal:
            journal.text_factory = _text
            return _check(journal, path, schema, clock)
    except sqlite3.DatabaseError as error:
        if _is_damage(error):
            return CheckResult(Damage(f"a page cannot be read: {error}"), is_complete=False)
        raise
    except (ValueError, OverflowError, MemoryError) as error:  # a changed length or name
        return CheckResult(Damage(f"a page cannot be read: {error}"), is_complete=False)


def _check(
    journal: sqlite3.Connection, path: Path, schemas: Mapping[int, Mapping[str, str]], clock: _Clock
) -> CheckResult:
    (version,) = journal.execute("PRAGMA user_version").fetchone()
    found = dict(journal.execute("SELECT name, sql FROM sqlite_schema WHERE sql IS NOT NULL"))
    has_checksums = any("row_crc" in str(sql) for sql in found.values())
    if version not in schemas:
        if version < min(schemas) and (has_checksums or (version == 0 and found)):
            what = f"its header states format {version}, its tables have format {max(schemas)}"
            return CheckResult(Damage(what), is_complete=False)
        return CheckResult(_structure(journal, clock), is_complete=True)
    wrong = sorted(name for name, sql in {**schemas[version], **found}.items() if found.get(name) != sql
                   or schemas[version].get(name) != sql)  # fmt: skip
    if wrong:
        return CheckResult(Damage(f"the definition of {wrong[0]!r} is not the one of format {version}"), False)
    complete = True
    for table, key in KEYS.items():
        damage, whole = _rows(journal, table, key, clock)
        complete = complete and whole
        if damage is not None:
            return CheckResult(damage, is_complete=False)
    damage = _commits(journal, path) or _structure(journal, clock)
    return CheckResult(damage, complete and not clock.is_over())


def _rows(journal: sqlite3.Connection, table: str, key: str, clock: _Clock) -> tuple[Damage | None, bool]:
    """Return the first row that does not match its checksum, the newest first; and whether all were checked."""
    names = [row[1] for row in journal.execute(f"PRAGMA table_info({table})")]
    keys = key.split(", ")
    order = ", ".join(f"{name} DESC" for name in keys)
    sql = f"SELECT crc, {', '.join(names)} FROM {table} ORDER BY {order}"  # noqa: S608 - constant names
    columns = [names.index(name) for name in keys]
    cursor = journal.execute(sql)
    last: tuple[Any, ...] = ()
    while True:
        try:
            rows = cursor.fetchmany(ROWS_PER_LOOK)
        except sqlite3.DatabaseError as error:
            if not _is_damage(error):
                raise
            after = f" after {_named(keys, last)}" if last else ""
            return Damage(f"a row of {table}{after} cannot be read: {error}", table), False
        except (ValueError, OverflowError, MemoryError) as error:
            return Damage(f"a row of {table} cannot be read: {error}", table), False
        if not rows:
            return None, True
        for crc, *values in rows:
            last = tuple(values[column] for column in columns)
            if crc != row_crc(table, *values):
                where = _named(keys, last)
                return Damage(f"the row {where} of {table} does not match its checksum", table, where), False
        if clock.is_over() and table in {"event", "segment"}:
            return None, False


def _named(keys: list[str], values: tuple[Any, ...]) -> str:
    return " AND ".join(f"{key} = {value!a}" for key, value in zip(keys, values, strict=True))


def _commits(journal: sqlite3.Connection, path: Path) -> Damage | None:
    """Return the damage where commits that returned are missing."""
    record = CommitRecord(path)
    named = record.read()
    rows = journal.execute("SELECT journal, count FROM commits").fetchall()
    if named is None or not rows or rows[0][0] != named[0] or rows[0][1] >= named[1]:
        return None
    return Damage(
        f"the last {named[1] - rows[0][1]} commits are missing: it ends at commit {rows[0][1]}, {record.path} names "
        f"commit {named[1]} (if you restored an older copy on purpose, delete {record.path.name})"
    )


def _structure(journal: sqlite3.Connection, clock: _Clock) -> Damage | None:
    """Return the first fault of pages and indexes within the time limit."""
    journal.set_progress_handler(clock.is_over, OPCODES_PER_LOOK)
    try:
        found = [str(row[0]) for row in journal.execute("PRAGMA integrity_check(1)")]
    except sqlite3.OperationalError as error:
        if getattr(error, "sqlite_errorname", "") == "SQLITE_INTERRUPT":
            return None
        raise
    finally:
        journal.set_progress_handler(None, 0)
    return None if found == ["ok"] else Damage(f"its pages do not fit together: {' '.join(found[0].split())}")


def _text(content: bytes) -> str:
    """Decode any bytes: text that is not UTF-8 any more fails its checksum, not the decoding."""
    return content.decode("utf-8", "surrogateescape")


def _is_damage(error: sqlite3.Error) -> bool:
    name = getattr(error, "sqlite_errorname", "")
    if name.startswith("SQLITE_ERROR"):
        return True  # such as a changed name of the schema
    return name.startswith(("SQLITE_CORRUPT", "SQLITE_FORMAT", "SQLITE_TOOBIG", "SQLITE_MISMATCH", "SQLITE_NOMEM"))


# the write-ahead log


class _Frame(NamedTuple):
    """Frame of the WAL: one page."""

    number: int
    commits: bool
    """The last one of a transaction."""
    is_current: bool
    """It has the salts of the header, so it is not from an earlier use of the file."""
    before: tuple[int, int]
    """Checksum stated in the frame before it, or in the header."""
    stated: tuple[int, int]
    content: bytes
    """Bytes that the checksum covers beside that."""


def _wal_damage(path: Path) -> Damage | None:
    """Return the damage of a frame that a later transaction follows, so that it had been synced.

    A damaged frame of the last transaction may be a write that a power failure interrupted: the number of commits
    shows whether it had returned. Behind it there may be frames of a transaction that an earlier kill or a full disk
    interrupted: SQLite overwrites them with the same salts, and they have correct checksums among themselves.
    """
    wal = path.with_name(path.name + "-wal")
    try:
        content = wal.read_bytes()
    except FileNotFoundError:
        return None
    if len(content) < WAL_HEADER.size or not any(content[: WAL_HEADER.size]):
        return None
    magic, _, page, _, *_, high, low = WAL_HEADER.unpack_from(content)
    order = ">" if magic == WAL_MAGIC_BIG_ENDIAN else "<"
    checked = _checksum(content[: WAL_HEADER.size - 8], (0, 0), order)
    if magic not in {WAL_MAGIC, WAL_MAGIC_BIG_ENDIAN} or checked != (high, low) or page.bit_count() != 1:
        return Damage(f"the header of {wal.name} does not match its checksum")
    return _frame_damage(list(_frames(content, page, (high, low))), order, wal.name)


def _frames(content: bytes, page: int, checksum: tuple[int, int]) -> Iterator[_Frame]:
    salts, size = content[16:24], FRAME_HEADER.size + page
    for number, start in enumerate(range(WAL_HEADER.size, len(content) - size + 1, size), 1):
        _, pages, _, _, high, low = FRAME_HEADER.unpack_from(content, start)
        covered = content[start : start + 8] + content[start + FRAME_HEADER.size : start + size]
        current = content[start + 8 : start + 16] == salts
        yield _Frame(number, pages != 0, current, checksum, (high, low), covered)
        checksum = (high, low)


def _frame_damage(frames: list[_Frame], order: str, name: str) -> Damage | None:
    def is_sound(frame: _Frame) -> bool:
        return frame.is_current and _checksum(frame.content, frame.before, order) == frame.stated

    first = next((frame for frame in frames if not is_sound(frame)), None)
    if first is None:
        return None
    rest = frames[first.number - 1 :]
    ended = next((frame.number for frame in rest if frame.is_current and frame.commits), None)
    if ended is not None and any(is_sound(frame) for frame in frames[ended : ended + 1]):  # not the rest: see above
        return Damage(f"frame {first.number} of {name} does not match its checksum, and later commits depend on it")
    return None


def _checksum(content: bytes, start: tuple[int, int], order: str) -> tuple[int, int]:
    """Return SQLite's WAL checksum: two sums over pairs of 32-bit words."""
    one, two = start
    for first, second in struct.iter_unpack(f"{order}II", content):
        one = (one + first + two) & 0xFFFFFFFF
        two = (two + second + one) & 0xFFFFFFFF
    return one, two
