"""Programs of any size in bounded memory: looked through, or rewritten from one file into another."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import BinaryIO, Protocol

import numpy as np

from polishd.api import ProgramError
from polishd.model.program import Encoding
from polishd.model.surface import FloatArray
from polishd.plugins.rnc_robot.nc.checks import Checks, unit, warnings
from polishd.plugins.rnc_robot.nc.dialect import GcodeDialect
from polishd.plugins.rnc_robot.nc.pieces import PIECE_BYTES, ProgramChunk, Scanner
from polishd.plugins.rnc_robot.nc.points import PointReader, Points, TimeWordCounts
from polishd.plugins.rnc_robot.nc.writer import Writer, refuse_times

Each = Callable[[ProgramChunk, Points, Checks], None]

ENOUGH_MOVES = 10_000
"""So many feed moves without a dwell, and the time sits in the feed."""

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
    ``file`` must be seekable: where its time sits is found out first. ProgramError leaves half a program in ``out``.
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

    passed = look_through(dialect, file, name, progress, write)
    times.finish()
    passed.changed = changed
    return passed


def _chunks(file: BinaryIO, digest: hashlib._Hash | None, progress: Progress | None) -> Iterator[bytes]:
    file.seek(0)
    while chunk := file.read(PIECE_BYTES):
        if digest is not None:
            digest.update(chunk)
        yield chunk
        if progress is not None:
            progress(len(chunk))


def _guessed(dialect: GcodeDialect, file: BinaryIO, name: str) -> Encoding:
    """Where the time sits: in dwells from the first dwell on; the whole program must bear it out."""
    scanner, tally = Scanner(dialect, name), TimeWordCounts()
    for piece in scanner.pieces(_chunks(file, None, None)):
        tally.add(piece)
        if tally.dwelled or tally.moves > ENOUGH_MOVES:
            return tally.sits_in()
    return tally.encoding(name)


def look_through(
    dialect: GcodeDialect, file: BinaryIO, name: str, progress: Progress | None = None, each: Each | None = None
) -> StreamCounts:
    """Read a program without keeping it; ``each`` piece with its points is given away. ProgramError names the line."""
    encoding = _guessed(dialect, file, name)
    scanner, tally, checks = Scanner(dialect, name), TimeWordCounts(), Checks(dialect, name, encoding)
    reader, passed = PointReader(dialect, name, encoding), StreamCounts(dialect.name, encoding)
    digest, still = hashlib.sha256(), 0
    for piece in scanner.pieces(_chunks(file, digest, progress)):
        tally.add(piece)
        points = reader.read(piece)
        checks.add(points, scanner)
        still += points.still
        if each is not None:
            each(piece, points, checks)
        _note(passed, dialect, points)
    if tally.encoding(name) != encoding:
        raise ProgramError(
            f"{name}: its time sits in the {encoding} at first, and in the {tally.encoding(name)} further on. "
            "To do: have it posted with one of them."
        )
    if not passed.points:
        raise ProgramError(f"{name}: all its feed moves go nowhere. To do: check that this is the polishing program.")
    checks.finish(scanner)
    passed.lines, passed.sha256 = scanner.lines, digest.hexdigest()
    passed.warnings = tuple(warnings(scanner, tally, encoding, still))
    return passed


def _note(passed: StreamCounts, dialect: GcodeDialect, points: Points) -> None:
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
    found = unit(dialect, passed.encoding, points.scale)
    passed.unit = found if passed.unit in ("", found) else "s and ms"
