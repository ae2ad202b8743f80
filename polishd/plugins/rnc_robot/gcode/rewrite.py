"""New numbers in old places of a piece of text, and the rounding residue carried forward."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from io import BytesIO
from itertools import chain, islice
from typing import Any, BinaryIO, NamedTuple, Protocol

import numpy as np

from polishd.api import Program, ProgramError
from polishd.model.program import Encoding, IntArray
from polishd.model.surface import FloatArray
from polishd.plugins.rnc_robot.gcode import jit
from polishd.plugins.rnc_robot.gcode.checks import Checks, WrittenUnit, warnings
from polishd.plugins.rnc_robot.gcode.dialect import GcodeDialect
from polishd.plugins.rnc_robot.gcode.kernels import UNWRITABLE, direct, reciprocal, splice
from polishd.plugins.rnc_robot.gcode.refusals import refuse
from polishd.plugins.rnc_robot.gcode.time_words import (
    PIECE_BYTES,
    PointReader,
    Points,
    ProgramChunk,
    Scanner,
    TimeWordCounts,
    counts_time,
)


class FormattedNumbers(NamedTuple):
    """New numbers of n points; ``decimals`` -1: the number stays."""

    mantissa: Any
    decimals: Any


class Edits(NamedTuple):
    """Places in a text, in order, and what comes there; see ``kernels.splice``."""

    start: Any
    end: Any
    prefix: Any
    mantissa: Any
    decimals: Any
    style: Any


class NumberPrefixes(NamedTuple):
    """Texts that an edit may put before its number, one after the other."""

    at: Any
    bytes: Any


class Writer:
    """Writes piece after piece; what rounding leaves goes on to the next one."""

    def __init__(self, dialect: GcodeDialect, name: str, encoding: Encoding) -> None:
        self._dialect = dialect
        self._name = name
        self._counts_time = counts_time(dialect, encoding)
        self._usual = min(dialect.dwell.decimals, dialect.dwell.most_decimals)
        self._least = int(encoding != "dwell")
        self._state = np.zeros(3)
        self._texts = [b"", b" F", b" f"]

    def write(self, piece: ProgramChunk, points: Points, times_s: FloatArray) -> bytes:
        """The piece's text with these times, (n,) s."""
        numbers, own = self._numbers(points, times_s, len(piece.text)), points.start >= 0
        keep = numbers.decimals >= 0
        if not keep.any():
            return piece.text
        place = np.where(own, points.start, points.tail)
        edits = Edits(
            place, np.where(own, points.end, points.tail), np.where(own, 0, 1 + points.lower), numbers.mantissa,
            numbers.decimals, points.style,
        )  # fmt: skip
        text = splice_numbers(piece.text, Edits(*(column[keep] for column in edits)), self._texts)
        refuse_long(self._dialect, self._name, text, piece.first_line, points.line[keep])
        return text

    def _numbers(self, points: Points, times_s: FloatArray, size: int) -> FormattedNumbers:
        name, line, old, scale, style = self._name, points.line, points.time_s, points.scale, points.style
        if self._counts_time:
            usual, least, residue = self._usual, self._least, self._state[0]
            numbers, self._state[0] = numbers_of(
                direct, size, name, line, times_s, old, scale, style, usual, least, residue
            )
            return numbers
        lines, most = np.stack([points.line, points.f_line], axis=1), self._dialect.feed.most_decimals
        return numbers_of(
            reciprocal, size, name, line, times_s, old, scale, style, lines, points.number, most, self._state
        )[0]


def numbers_of(
    rule: Callable[..., Any], size: int, name: str, line: IntArray, times: FloatArray, *arguments: Any
) -> tuple[FormattedNumbers, Any]:
    """The numbers that ``kernels.direct`` or ``kernels.reciprocal`` finds for (n,) times, and what it returns.

    ProgramError at the first time that no number says: too large, or a feed of zero. ``size``: bytes of the text.
    """
    numbers = FormattedNumbers(np.zeros(len(times), dtype=np.int64), np.full(len(times), -1))
    packed = (np.ascontiguousarray(one) if isinstance(one, np.ndarray) else one for one in arguments)  # compiled once
    answer = jit.kernel(rule, size)(times, *packed, numbers)
    bad = numbers.decimals == UNWRITABLE
    if bad.any():
        index = int(np.argmax(bad))
        raise ProgramError(
            f"{name}, line {line[index]}: no number that the controller takes says a time of {times[index]} s. "
            "To do: solve again with times that the feed can hold."
        )
    return numbers, answer


def splice_numbers(text: bytes, edits: Edits, texts: list[bytes]) -> bytes:
    """The text with the edits in it; their ``prefix`` counts in ``texts``."""
    prefixes = NumberPrefixes(np.cumsum([0, *map(len, texts)]), np.frombuffer(b"".join(texts) or b" ", dtype=np.uint8))
    size = len(text) + len(edits.start) * (24 + max(map(len, texts)))
    run = jit.kernel(splice, len(text))
    if run is splice:
        out = bytearray(size)
        used = run(
            text, Edits(*(column.tolist() for column in edits)), NumberPrefixes(*(p.tolist() for p in prefixes)), out
        )
        return bytes(out[:used])
    room = np.empty(size, dtype=np.uint8)
    used = run(np.frombuffer(text, dtype=np.uint8), edits, prefixes, room)
    return room[:used].tobytes()


def refuse_long(dialect: GcodeDialect, name: str, text: bytes, first_line: int, lines: IntArray) -> None:
    """ProgramError where one of the ``lines``, in a text that begins at ``first_line``, has become too long."""
    longest = dialect.text.longest_line
    ends = np.flatnonzero(np.frombuffer(text, dtype=np.uint8) == 10)
    sizes = (np.diff(ends, prepend=-1, append=len(text)) - 1)[lines - first_line]
    if (sizes > longest).any():
        number = int(lines[int(np.argmax(sizes > longest))])
        line = text.split(b"\n", number - first_line + 1)[number - first_line]
        raise refuse(
            name, number, line, f"longer than {longest} bytes once its time is changed",
            "split the line, or shorten its comment",
        )  # fmt: skip


def refuse_times(dialect: GcodeDialect, encoding: Encoding, name: str, line: IntArray, times: FloatArray) -> None:
    """ProgramError at the first time that the encoding cannot hold."""
    longest = dialect.dwell.longest_s if encoding == "dwell" else np.inf
    good = np.isfinite(times) & (times <= longest) & ((times >= 0) if encoding == "dwell" else (times > 0))
    if not good.all():
        index = int(np.argmin(good))
        limit = f"at most {longest:g}, " if times[index] > longest else ""
        raise ProgramError(
            f"{name}, line {line[index]}: a time of {times[index]} s cannot be written as {encoding}. "
            f"To do: solve again with times that are {limit}{'not below' if encoding == 'dwell' else 'above'} zero."
        )


# Programs of any size in bounded memory: looked through, or rewritten from one file into another.

Each = Callable[[ProgramChunk, Points, Checks], None]

ENOUGH_MOVES = 10_000
"""So many feed moves without a dwell, and the time sits in the feed."""
MOST_PIECES = 64
"""So much text without a dwell or so many moves, and the same holds: these pieces are kept."""

Progress = Callable[[int], None]
"""Hears of bytes read."""


class Times(Protocol):
    """New times, in the order of the points."""

    def take(self, count: int) -> FloatArray:
        """The next so many, s; ProgramError where there are fewer."""
        ...

    def finish(self) -> None:
        """ProgramError where there are more."""
        ...


@dataclass(slots=True)
class StreamCounts:
    """What went by."""

    dialect: str
    encoding: Encoding = "feed"
    unit: str = ""
    sha256: str = ""
    lines: int = 0
    points: int = 0
    time_s: float = 0.0
    """Sum of the points' times as the program has them."""
    range_s: tuple[float, float] = (np.inf, -np.inf)
    """The shortest and the longest of them."""
    changed: int = 0
    low_mm: FloatArray = field(default_factory=lambda: np.full(3, np.inf))
    high_mm: FloatArray = field(default_factory=lambda: np.full(3, -np.inf))
    feed_mm_min: tuple[float, float] = (np.inf, -np.inf)
    warnings: tuple[str, ...] = ()


def rewrite_stream(
    dialect: GcodeDialect,
    file: BinaryIO,
    name: str,
    times: Times,
    out: BinaryIO,
    *,
    progress: Progress | None = None,
) -> StreamCounts:
    """Write the program with other times to ``out``; what it was before.

    No byte changes outside numbers that carry time. Where F still holds from an earlier block and must differ, an F
    word is added. What rounding leaves is carried to the next point, so that the total is exact to one quantum.
    ProgramError leaves half a program in ``out``.
    """
    writer: Writer | None = None
    changed = 0

    def write(piece: ProgramChunk, points: Points, checks: Checks) -> None:
        nonlocal writer, changed
        if writer is None:
            writer = Writer(dialect, name, checks.encoding)
        new = times.take(len(points.line))
        refuse_times(dialect, checks.encoding, name, points.line, new)
        changed += int(np.count_nonzero(new != points.time_s))
        out.write(writer.write(piece, points, new))

    passed = scan_program(dialect, file, name, progress, write)
    times.finish()
    passed.changed = changed
    return passed


def _chunks(file: BinaryIO, digest: hashlib._Hash, progress: Progress | None) -> Iterator[bytes]:
    file.seek(0)
    while chunk := file.read(PIECE_BYTES):
        digest.update(chunk)
        yield chunk
        if progress is not None:
            progress(len(chunk))


def _beginning(pieces: Iterator[ProgramChunk], tally: TimeWordCounts) -> list[ProgramChunk]:
    """The first pieces, which show where the time sits: in dwells from the first dwell on."""
    found = []
    for piece in islice(pieces, MOST_PIECES):
        found.append(piece)
        tally.add(piece)
        if tally.dwelled or tally.moves > ENOUGH_MOVES:
            break
    return found


def scan_program(
    dialect: GcodeDialect, file: BinaryIO, name: str, progress: Progress | None = None, each: Each | None = None
) -> StreamCounts:
    """Read a program without keeping it; ``each`` piece with its points is given away. ProgramError names the line."""
    scanner, tally, digest, still = Scanner(dialect, name), TimeWordCounts(), hashlib.sha256(), 0
    pieces = scanner.pieces(_chunks(file, digest, progress))
    begin = _beginning(pieces, tally)
    encoding = tally.sits_in()  # the whole program must bear it out
    checks, reader = Checks(dialect, name, encoding), PointReader(dialect, name, encoding)
    passed, written = StreamCounts(dialect.name, encoding), WrittenUnit(dialect, encoding)
    for number, piece in enumerate(chain(begin, pieces)):
        if number >= len(begin):
            tally.add(piece)
        points = reader.read(piece)
        checks.add(points, scanner)
        still += points.still
        if each is not None:
            each(piece, points, checks)
        written.add(points)
        _note(passed, points)
    if tally.encoding(name) != encoding:
        raise ProgramError(
            f"{name}: its time sits in the {encoding} at first, and in the {tally.encoding(name)} further on. "
            "To do: have it posted with one of them."
        )
    if not passed.points:
        raise ProgramError(f"{name}: all its feed moves go nowhere. To do: check that this is the polishing program.")
    checks.finish(scanner)
    passed.unit, passed.lines, passed.sha256 = str(written), scanner.lines, digest.hexdigest()
    passed.warnings = tuple(warnings(scanner, tally, encoding, still))
    return passed


def _note(passed: StreamCounts, points: Points) -> None:
    if not len(points.line):
        return
    places = points.after[:, :3]  # NaN: never said, which is 0
    passed.low_mm = np.minimum(passed.low_mm, np.nan_to_num(np.fmin.reduce(places, axis=0), nan=0.0))
    passed.high_mm = np.maximum(passed.high_mm, np.nan_to_num(np.fmax.reduce(places, axis=0), nan=0.0))
    low, high = passed.feed_mm_min
    passed.feed_mm_min = (
        float(np.nanmin(points.feed_mm_min, initial=low)),
        float(np.nanmax(points.feed_mm_min, initial=high)),
    )
    shortest, longest = passed.range_s
    passed.range_s = (min(shortest, float(points.time_s.min())), max(longest, float(points.time_s.max())))
    passed.points += len(points.line)
    passed.time_s += float(points.time_s.sum())


# A whole program of ISO-like NC text in memory: read as columns of points, and written with other times.


def read(dialect: GcodeDialect, text: bytes, name: str) -> Program:
    """Read a program; ``name`` is for messages. ProgramError names the line and the reason."""
    columns = []

    def keep(_piece: ProgramChunk, points: Points, checks: Checks) -> None:
        start, end = (np.nan_to_num(places[:, :3], nan=0.0) for places in (points.before, points.after))
        columns.append((points.line, start, end, checks.tool_axes(points), points.time_s, points.feed_mm_min))

    passed = scan_program(dialect, BytesIO(text), name, each=keep)
    line, start_mm, end_mm, axis, time_s, feed_mm_min = map(np.concatenate, zip(*columns, strict=True))
    return Program(
        text=text,
        sha256=passed.sha256,
        name=name,
        dialect=dialect.name,
        encoding=passed.encoding,
        line=line,
        block=line - 1,
        start_mm=start_mm,
        end_mm=end_mm,
        axis=axis,
        time_s=time_s,
        lines=passed.lines,
        max_feed_mm_min=max(passed.feed_mm_min[1], 0.0),
        warnings=passed.warnings,
        feed_mm_min=feed_mm_min,
        unit=passed.unit,
    )


def rewrite(dialect: GcodeDialect, program: Program, time_s: FloatArray) -> bytes:
    """The program with ``time_s`` (n,) seconds at its points, as ``rewrite_stream`` writes it.

    ProgramError for times that cannot be written.
    """
    out = BytesIO()
    rewrite_stream(dialect, BytesIO(program.text), program.name, ProgramRow(program, time_s), out)
    return out.getvalue()


class ProgramRow:
    """Times of a program's points, taken one after the other."""

    def __init__(self, program: Program, time_s: FloatArray) -> None:
        self.times = np.array(time_s, dtype=np.float64)
        self._taken = 0
        if self.times.shape != (program.n,):
            raise ProgramError(
                f"{program.name}: {program.n} points need as many times, not an array of {self.times.shape}."
            )

    def take(self, count: int) -> FloatArray:
        """The next so many."""
        self._taken += count
        return self.times[self._taken - count : self._taken]

    def finish(self) -> None:
        """All are taken: the program was read with as many points."""
