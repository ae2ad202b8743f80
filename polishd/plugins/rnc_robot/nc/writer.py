"""New numbers in old places of a piece of text, and the rounding residue carried forward."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from polishd.api import ProgramError
from polishd.model.program import Encoding, IntArray
from polishd.model.surface import FloatArray
from polishd.plugins.rnc_robot.nc import compiled
from polishd.plugins.rnc_robot.nc.dialect import GcodeDialect
from polishd.plugins.rnc_robot.nc.pieces import ProgramChunk
from polishd.plugins.rnc_robot.nc.points import Points, counts_time
from polishd.plugins.rnc_robot.nc.refusals import refuse
from polishd.plugins.rnc_robot.nc.write import UNWRITABLE, direct, reciprocal, splice


class FormattedNumbers(NamedTuple):
    """New numbers of n points; ``decimals`` -1: the number stays."""

    mantissa: Any
    decimals: Any


class Edits(NamedTuple):
    """Places in a text, in order, and what comes there; see ``write.splice``."""

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
        text = spliced(piece.text, Edits(*(column[keep] for column in edits)), self._texts)
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
    """The numbers that ``write.direct`` or ``write.reciprocal`` finds for (n,) times, and what it returns.

    ProgramError at the first time that no number says: too large, or a feed of zero. ``size``: bytes of the text.
    """
    numbers = FormattedNumbers(np.zeros(len(times), dtype=np.int64), np.full(len(times), -1))
    answer = compiled.kernel(rule, size)(times, *arguments, numbers)
    bad = numbers.decimals == UNWRITABLE
    if bad.any():
        index = int(np.argmax(bad))
        raise ProgramError(
            f"{name}, line {line[index]}: no number that the controller takes says a time of {times[index]} s. "
            "To do: solve again with times that the feed can hold."
        )
    return numbers, answer


def spliced(text: bytes, edits: Edits, texts: list[bytes]) -> bytes:
    """The text with the edits in it; their ``prefix`` counts in ``texts``."""
    prefixes = NumberPrefixes(np.cumsum([0, *map(len, texts)]), np.frombuffer(b"".join(texts) or b" ", dtype=np.uint8))
    size = len(text) + len(edits.start) * (24 + max(map(len, texts)))
    run = compiled.kernel(splice, len(text))
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
