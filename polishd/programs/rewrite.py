"""Rewrite programs from file to file: any size, complete or not at all, in parts where lines are limited."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from io import BytesIO
from itertools import chain, islice
from pathlib import Path
from typing import BinaryIO, cast

import numpy as np

from polishd import __version__
from polishd.model.errors import ProgramError
from polishd.model.program import Encoding, Program
from polishd.model.surface import FloatArray
from polishd.plugins.rnc_robot.dialect import AnyDialect, GcodeDialect
from polishd.plugins.rnc_robot.formats import beside_of, read, rewrite
from polishd.plugins.rnc_robot.gcode.rewrite import rewrite_stream, scan_program
from polishd.plugins.rnc_robot.languages import split
from polishd.plugins.rnc_robot.verify import verify
from polishd.util.files import open_input, read_all, require_new_file, whole_file

# A CSV of dwells: one number in seconds a row, no header, one row a point; or the dwell.csv of a plan.

_PIECE = 1 << 20
"""Bytes read at a time, so that a table of any length needs no more memory."""
COLUMN = b"dwell_s"
"""Header of the dwells in a table of several columns."""
_PLAIN = b"0123456789+-.eE \t\r\n"


LONGEST_S = 1e6
"""A longer dwell at one point (12 days) is a mistake: milliseconds, or a total."""


class DwellTable:
    """Rows of a table of dwells, read in order and in blocks, to limit the memory."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.total_s = 0.0
        """Sum of the times that were taken."""
        self._rows = chain.from_iterable(rows.tolist() for rows in dwell_rows(path))
        self._taken = 0

    def take(self, count: int) -> FloatArray:
        """Take the next (count,) s. ProgramError where there are fewer, or where a row is no dwell."""
        rows = np.fromiter(islice(self._rows, count), np.float64)
        self._taken += len(rows)
        if len(rows) < count:
            raise ProgramError(f"{self.path}, row {self._taken + 1} is missing: the program has more points. {_COUNT}")
        self.total_s += math.fsum(rows)
        return rows

    @property
    def warnings(self) -> tuple[str, ...]:
        """What is odd about the rows that were taken."""
        none = f"{self.path}: all {self._taken} rows are 0 s: the new program removes nothing"
        return () if self.total_s else (none,)

    def finish(self) -> None:
        """ProgramError where there are more rows."""
        if next(self._rows, None) is not None:
            raise ProgramError(
                f"{self.path}, row {self._taken + 1} is one too many: the program has {self._taken} points. {_COUNT}"
            )


_COUNT = "To do: write one row a point; polishd program inspect counts them."


def dwell_rows(path: Path) -> Iterator[FloatArray]:
    """Read the rows of a table of dwells, s, as arrays of (k,), in order. Lines end in LF or CRLF.

    Of several columns that a header names, as in the ``dwell.csv`` of a plan, ``COLUMN`` is read. The header is no row.

    Raises:
        ProgramError: The file cannot be read, or a row is not one number of seconds, 0 to ``LONGEST_S``; names the row.
    """
    done = 0
    try:
        with open_input(path) as file:
            rows = file.readlines(_PIECE)
            if rows:
                rows[0] = rows[0].removeprefix(b"\xef\xbb\xbf")
            column = _column(rows[0]) if rows else None
            if column is not None:
                rows = rows[1:] or file.readlines(_PIECE)
            while rows:
                rows = rows if column is None else [_field(row, column) for row in rows]
                yield _values(path, rows, done)
                done += len(rows)
                rows = file.readlines(_PIECE)
    except OSError as error:
        raise ProgramError(f"{path}: cannot be read: {error.strerror}. To do: check the path of the dwells.") from error
    if not done:
        raise ProgramError(f"{path}: the table of dwells is empty. To do: write one dwell in seconds a row.")


def _column(first: bytes) -> int | None:
    """Index of ``COLUMN`` in a header of several columns; None: the row is no such header."""
    names = [name.strip() for name in first.split(b",")]
    return names.index(COLUMN) if len(names) > 1 and COLUMN in names else None


def _field(row: bytes, column: int) -> bytes:
    return b"".join(row.split(b",")[column : column + 1])


def _values(path: Path, rows: list[bytes], before: int) -> FloatArray:
    """Numbers of some rows; ``before`` rows precede them."""
    with suppress(ValueError):  # the error is located below
        values = np.array(list(map(float, rows)), dtype=np.float64) + 0.0  # no -0.0
        if not b"".join(rows).translate(None, _PLAIN) and (values >= 0).all() and (values <= LONGEST_S).all():
            return values
    for number, row in enumerate(rows, before + 1):
        reason = _reason(row, number)
        if reason is not None:
            shown = row.decode("utf-8", "backslashreplace").strip()[:60]
            raise ProgramError(
                f'{path}, row {number} {reason}: "{shown}". To do: write one dwell in seconds a row, and no header; '
                "or give the dwell.csv of a plan."
            )
    raise ProgramError(f"{path}: cannot be read as numbers from row {before + 1} on.")


def _reason(row: bytes, number: int) -> str | None:
    """Error in a row; None: the row is valid."""
    text = row.strip()
    if not text:
        return "is empty"
    if b"," in text or b";" in text:
        return "holds a comma or semicolon: one number a row, with a decimal point"
    try:
        value = float(text)
    except ValueError:
        return "is a header" if number == 1 and text[:1].isalpha() else "is not a number"
    if not np.isfinite(value):
        return "is not finite"
    if value < 0:
        return "is below zero"
    if value > LONGEST_S:
        return f"asks for more than {LONGEST_S:.0f} s ({LONGEST_S / 86400:.0f} days) at one point"
    return "is not a plain number" if text.translate(None, _PLAIN) else None


Progress = Callable[[int], None]
"""Callback with the number of bytes read."""

_FIRST_LINES = re.compile(rb"(?:[ \t]*(?:%|;\$PATH|[Oo:][0-9]).*\n|[ \t]*\r?\n)*")
"""Lines before which nothing may be written: tape marks, program numbers and paths."""


@dataclass(frozen=True, slots=True)
class RewriteResult:
    """Result of a rewrite, with times read back from the file."""

    out: tuple[Path, ...]
    encoding: Encoding
    points: int
    rows: int
    """Number of requested times; fewer than points where moves without a dwell now carry their time, too."""
    asked_total_s: float
    dwell_total_s: float
    warnings: tuple[str, ...] = ()


def rewrite_file(
    file: Path,
    table: DwellTable,
    out: Path,
    dialect: AnyDialect,
    encoding: Encoding | None = None,
    *,
    comment: bool = False,
    force: bool = True,
    progress: Progress | None = None,
) -> RewriteResult:
    """Write the program in ``file`` to ``out`` with the times of ``table``.

    NC text whose encoding stays goes through in bounded memory and is read back before it gets its name. Everything
    else is held in memory and proved to move as before. Where the controller limits the lines of a program, ``out``
    is the first of several files: ``out_2``, ``out_3``, ... ``force``: replace existing files.

    Raises:
        ConfigError: An output exists, without ``force``.
        ProgramError: Anything is wrong with program, table or output. Nothing was written.
    """
    sources = (file, table.path)
    require_new_target(out, *sources)
    require_new_file(out, force=force)
    mark = _comment(dialect) if comment else b""
    if isinstance(dialect, GcodeDialect) and encoding is None:
        return _streamed(file, table, out, dialect, mark=mark, progress=progress)
    return _held(
        read_program_file(dialect, file), table, out, dialect, encoding, mark=mark, sources=sources, force=force
    )


def require_new_target(out: Path, *sources: Path) -> None:
    """ProgramError where ``out`` is one of the input files, under any name."""
    for source in sources:
        with suppress(OSError):  # a missing or unreadable file is refused when it is opened
            if out.samefile(source):
                raise ProgramError(f"{out}: is what is read. To do: name another file.")


def content(file: Path) -> bytes:
    """Bytes of a program's file; ProgramError where it cannot be read."""
    with opened(file) as source:
        return source.read()


def read_program_file(dialect: AnyDialect, file: Path) -> Program:
    """Read a program, with the file beside it that declares its positions. ProgramError."""
    return read(dialect, content(file), file.name, beside_of(dialect, file))


@contextmanager
def opened(file: Path) -> Iterator[BinaryIO]:
    """Open a program's file for repeated reading; ProgramError where it cannot be read."""
    try:
        with open_input(file) as source:
            yield source if source.seekable() else BytesIO(read_all(source))  # a pipe is held in memory
    except OSError as error:
        raise ProgramError(f"{file}: cannot be read: {error.strerror or error}. To do: check the path.") from error


def _streamed(
    file: Path, table: DwellTable, out: Path, dialect: GcodeDialect, *, mark: bytes, progress: Progress | None
) -> RewriteResult:
    with opened(file) as source, target_file(out) as target:
        sink = cast(BinaryIO, _Marked(target, mark)) if mark else target
        passed = rewrite_stream(dialect, source, file.name, table, sink, progress=progress)
        found = scan_program(dialect, target, out.name)
    return RewriteResult(
        (out,), passed.encoding, found.points, found.points, table.total_s, found.time_s, table.warnings
    )


def _held(
    program: Program,
    table: DwellTable,
    out: Path,
    dialect: AnyDialect,
    encoding: Encoding | None,
    *,
    mark: bytes,
    sources: Sequence[Path],
    force: bool,
) -> RewriteResult:
    times = table.take(program.n)
    table.finish()
    text = _marked(rewrite(dialect, program, times, encoding), mark)
    proof = verify(program.text, text, dialect, beside=program.beside)
    if proof.difference is not None:
        raise ProgramError(f"{program.name}: cannot be written in other words without a change: {proof.difference}.")
    parts = [text] if isinstance(dialect, GcodeDialect) else split(dialect, text, program.name, program.beside)
    outs = [out, *(out.with_stem(f"{out.stem}_{number}") for number in range(2, len(parts) + 1))]
    for path in outs:
        require_new_target(path, *sources)
        require_new_file(path, force=force)
    with ExitStack() as stack:  # all files are on the disk before the first gets its name
        for path, part in zip(outs, parts, strict=True):
            stack.enter_context(target_file(path)).write(part)
    written = program.encoding if encoding is None else encoding
    if isinstance(dialect, GcodeDialect) and written == "time":
        written = "inverse"
    return RewriteResult(
        tuple(outs), written, proof.points, program.n, table.total_s, proof.time_after_s, table.warnings
    )


@contextmanager
def target_file(path: Path) -> Iterator[BinaryIO]:
    """A file that gets its name at the end of the block; ProgramError where it cannot be written."""
    try:
        with whole_file(path) as file:
            yield file
    except OSError as error:
        raise ProgramError(f"{path}: cannot be written: {error.strerror}. To do: name another --out.") from error


def _comment(dialect: AnyDialect) -> bytes:
    """Comment line about the rewrite, in the dialect's syntax."""
    if not isinstance(dialect, GcodeDialect):
        raise ProgramError(
            f"in {dialect.name} a line of comment has no place that is sure everywhere. To do: leave --comment out."
        )
    words = f"polishd {__version__}, {datetime.now(UTC):%Y-%m-%d %H:%M} UTC: dwell rewritten"
    return (f"({words})" if "()" in dialect.text.comments else f"; {words}").encode("ascii")


class _Marked:
    """Insert a line of comment before the first piece of a streamed program."""

    def __init__(self, target: BinaryIO, mark: bytes) -> None:
        self._target = target
        self._mark = mark

    def write(self, piece: bytes) -> int:
        """As `StreamCounts.write` of a file."""
        text, self._mark = _marked(piece, self._mark), b""
        return self._target.write(text)


def _marked(text: bytes, mark: bytes) -> bytes:
    """The text with the mark in a separate line, after tape marks and program number."""
    if not mark:
        return text
    found = _FIRST_LINES.match(text)
    at = 0 if found is None else found.end()
    stop = b"\r\n" if b"\r\n" in text[: text.find(b"\n") + 1] else b"\n"
    return text[:at] + mark + stop + text[at:]
