"""Move a program's time into another encoding: dwells, a feed a block, or inverse time."""

from __future__ import annotations

from typing import Any

import numpy as np

from polishd.api import Program, ProgramError
from polishd.model.program import Encoding, IntArray
from polishd.model.surface import FloatArray
from polishd.plugins.rnc_robot.gcode import kernels as c
from polishd.plugins.rnc_robot.gcode.checks import doubts
from polishd.plugins.rnc_robot.gcode.dialect import GcodeDialect, written_dwell_word
from polishd.plugins.rnc_robot.gcode.kernels import direct, reciprocal
from polishd.plugins.rnc_robot.gcode.refusals import refuse
from polishd.plugins.rnc_robot.gcode.rewrite import (
    Edits,
    ProgramRow,
    numbers_of,
    refuse_long,
    refuse_times,
    splice_numbers,
)
from polishd.plugins.rnc_robot.gcode.time_words import (
    PointReader,
    Points,
    ProgramChunk,
    Scanner,
    counts_time,
    same_places,
)

_TEXTS = [b"", b" F", b" f", b"93", b"94", b"G93\n", b"G93\r\n"]
_NOTHING, _F, _, _93, _94, _LINE_93, _LINE_93_CRLF, _DWELL, _DWELL_CRLF = range(9)


def recode(dialect: GcodeDialect, program: Program, time_s: FloatArray, encoding: Encoding) -> bytes:
    """Return the program with ``time_s`` (n,) seconds at its points, written as ``encoding``.

    To dwells: add a dwell block after each point's move, which keeps its feed. To feeds or inverse time: write an F
    into each point's move and remove its dwell block. Everything else is unchanged. ProgramError where the dialect or
    a move does not allow it.
    """
    whole = program.text.endswith(b"\n")
    scanner = Scanner(dialect, program.name)
    (piece,) = scanner.pieces(iter([program.text if whole else program.text + b"\n"]))
    times = ProgramRow(program, time_s).times
    refuse_times(dialect, encoding, program.name, program.line, times)
    if encoding == "inverse" and dialect.feed.g93 == "refuse":
        raise ProgramError(
            f"{program.name}: {dialect.title} knows no inverse time (G93). To do: use --encoding feed or dwell."
        )
    points = PointReader(dialect, program.name, program.encoding).read(piece)
    written = dialect.dwell.written.encode("ascii")
    texts = [*_TEXTS, b"\n" + written, b"\r\n" + written]
    if encoding == "dwell":
        _refuse_in_last_block(piece, scanner, int(program.line[-1]))
        parts = [_dwells(dialect, piece, points, times, program.name)]
    else:
        parts = _feeds(scanner, piece, points, times, old=program.encoding, new=encoding)
    text = splice_numbers(piece.text, _sorted(parts), texts)
    behind = scanner.lines - scanner.at[c.ENDED] if scanner.at[c.ENDED] else 0  # there any line may stand
    refuse_long(dialect, program.name, text, 1, np.arange(1, text.count(b"\n") - behind + 1))
    return text if whole else text[:-1]


def _refuse_in_last_block(piece: ProgramChunk, scanner: Scanner, last: int) -> None:
    """Refuse a point in the program's last block: a dwell behind it would not run."""
    if last == scanner.at[c.ENDED]:
        raise refuse(
            scanner.name, last, piece.line(last), "the program ends in a point's block",
            "put M2 or M30 into a separate block",
        )  # fmt: skip


def _feeds(
    scanner: Scanner, piece: ProgramChunk, points: Points, times: FloatArray, *, old: Encoding, new: Encoding
) -> list[Edits]:
    doubts(scanner, new)
    moves = _Moves(scanner.dialect, piece, scanner.name)
    parts = [moves.feeds(new, moves.times(points, times, old == "dwell")), _modes(piece, new)]
    return [*parts, _no_dwells(piece, points, scanner)] if old == "dwell" else parts


def _sorted(parts: list[Edits]) -> Edits:
    columns = [np.concatenate(column) for column in zip(*parts, strict=True)]
    order = np.lexsort((columns[2], columns[0]))
    return Edits(*(column[order] for column in columns))


def _plain(start: IntArray, end: IntArray, prefix: IntArray | int) -> Edits:
    """Edits without a number."""
    count = len(start)
    none = np.zeros(count, dtype=np.int64)
    return Edits(start, end, np.broadcast_to(np.asarray(prefix), (count,)), none, none - 1, none)


def _dwells(dialect: GcodeDialect, piece: ProgramChunk, points: Points, times: FloatArray, name: str) -> Edits:
    """A block for each point, behind its move's line."""
    word = dialect.dwell.words[written_dwell_word(dialect)]
    decimal = word.decimal != "refuse"
    scale = 0.001 if (word.decimal if decimal else word.whole) == "ms" else 1.0
    style = (c.S_POINT if decimal else 0) | (c.S_KEEP if word.decimal != word.whole else 0)
    count = len(times)
    old, scales, styles = np.full(count, np.nan), np.full(count, scale), np.full(count, style)
    size, decimals = len(piece.text), dialect.dwell.decimals
    numbers, _ = numbers_of(direct, size, name, points.line, times, old, scales, styles, decimals, 0, 0.0)
    at, crlf = _line_ends(piece.text, points.tail)
    return Edits(at, at, np.where(crlf, _DWELL_CRLF, _DWELL), numbers.mantissa, numbers.decimals, styles)


def _line_ends(text: bytes, inside: IntArray) -> tuple[IntArray, IntArray]:
    """Return the ends of the lines at these offsets, and whether each ends in CRLF."""
    data = np.frombuffer(text, dtype=np.uint8)
    ends = np.append(np.flatnonzero(data == 10), len(data))
    at = ends[np.searchsorted(ends, inside)]
    crlf = (at > 0) & (data[at - 1] == 13)
    return at - crlf, crlf


def _no_dwells(piece: ProgramChunk, points: Points, scanner: Scanner) -> Edits:
    """Remove the blocks of the dwells, with their line ends."""
    data = np.frombuffer(piece.text, dtype=np.uint8)
    ends = np.concatenate([[-1], np.flatnonzero(data == 10), [len(data)]])
    begin = ends[points.line - 1] + 1
    end = np.minimum(ends[points.line] + 1, len(data))
    others = piece.dwells[piece.dwells[:, c.D_MOVE] >= 0, c.D_OTHERS]
    if others.any():
        k = int(np.argmax(others > 0))
        raise refuse(
            scanner.name, int(points.line[k]), piece.text[begin[k] : end[k]],
            "the dwell's block contains other words, too",
            "keep the program's own encoding, or put the dwell into a separate block",
        )  # fmt: skip
    return _plain(begin, end, _NOTHING)


def _modes(piece: ProgramChunk, encoding: Encoding) -> Edits:
    """Exchange G94 and G93; write G93 before the first feed move where the program has neither."""
    start, end = piece.modes[:, c.E_START], piece.modes[:, c.E_END]
    words = _plain(start, end, _93 if encoding == "inverse" else _94)
    first = int(piece.moves[np.argmax(piece.moves[:, c.M_KIND] != c.RAPID), c.M_TAIL])
    if encoding != "inverse" or (len(start) and int(start[0]) < first):
        return words
    begin = np.array([piece.text.rfind(b"\n", 0, first) + 1])
    crlf = begin[0] >= 2 and piece.text[begin[0] - 2] == 13
    return _sorted([_plain(begin, begin, _LINE_93_CRLF if crlf else _LINE_93), words])


class _Moves:
    """The feed moves of a program, each with the time it is to take."""

    def __init__(self, dialect: GcodeDialect, piece: ProgramChunk, name: str) -> None:
        self._dialect = dialect
        self._piece = piece
        self._name = name
        places = np.vstack([piece.before, piece.places[:, : c.AXES]])
        self._feed = np.flatnonzero(piece.moves[:, c.M_KIND] != c.RAPID)
        self._rows = piece.moves[self._feed]
        step = (places[1:, :3] - places[:-1, :3])[self._feed]
        self._length_mm = np.linalg.norm(np.nan_to_num(step, nan=0.0), axis=1)
        same = same_places(places[:-1], places[1:])[self._feed].all(axis=1)
        self._refuse((self._rows[:, c.M_KIND] & c.K_ARC) != 0, "an arc cannot carry its time in the feed")
        self._refuse(np.isnan(places[1:, :3][self._feed]).any(axis=1), "the end of this move is not stated")
        self._refuse(np.isnan(step).any(axis=1), "a feed move from an unknown position")
        self._refuse(same, "a feed move that goes nowhere has no time in another encoding")
        per_minute = 60.0 if dialect.feed.unit == "mm/s" else 1.0
        self._unit = piece.places[self._feed, c.V_UNIT] * per_minute
        self._number = piece.places[self._feed, c.V_FEED]

    def times(self, points: Points, new_s: FloatArray, dwelled: bool) -> FloatArray:
        """(m,) seconds of each feed move: new ones for points, its own for the others."""
        inverse = self._rows[:, c.M_KIND] >= c.K_INVERSE
        own: FloatArray = 60.0 * self._length_mm / (self._number * self._unit)
        own[inverse] = self._number[inverse] if self._dialect.feed.g93 == "s" else 60.0 / self._number[inverse]
        if dwelled:
            dwells = self._piece.dwells[self._piece.dwells[:, c.D_MOVE] >= 0]
            which = np.searchsorted(self._feed, dwells[:, c.D_MOVE] - self._piece.first_move)
        else:
            which = np.searchsorted(self._rows[:, c.M_LINE], points.line)
        own[which] = new_s
        self._refuse(own <= 0, "the tool turns on the spot: the program does not state its time")
        return own

    def feeds(self, encoding: Encoding, times: FloatArray) -> Edits:
        """An F for each feed move, in its place or at the end of its block."""
        count, lines = len(times), self._rows[:, c.M_LINE]
        unsure = self._dialect.feed.whole == "unsure"
        style = self._rows[:, c.M_STYLE] | (c.S_POINT if unsure else 0)
        if encoding == "feed":
            self._refuse(self._length_mm == 0, "the tool turns on the spot: its feed would be in deg/min")
        old, size = np.full(count, np.nan), len(self._piece.text)
        if counts_time(self._dialect, encoding):
            decimals = self._dialect.dwell.decimals
            numbers, _ = numbers_of(
                direct, size, self._name, lines, times, old, np.ones(count), style, decimals, 1, 0.0
            )
        else:
            scale = np.full(count, 60.0) if encoding == "inverse" else 60.0 * self._length_mm / self._unit
            most, f_lines = self._dialect.feed.most_decimals, np.stack([lines] * 2, axis=1)
            state = np.zeros(3)
            numbers, _ = numbers_of(
                reciprocal, size, self._name, lines, times, old, scale, style, f_lines, self._number, most, state
            )
        own = self._rows[:, c.M_START] >= 0
        return Edits(
            np.where(own, self._rows[:, c.M_START], self._rows[:, c.M_TAIL]),
            np.where(own, self._rows[:, c.M_END], self._rows[:, c.M_TAIL]),
            np.where(own, _NOTHING, _F + self._rows[:, c.M_LOWER]), numbers.mantissa, numbers.decimals, style,
        )  # fmt: skip

    def _refuse(self, bad: Any, reason: str) -> None:
        advice = "keep the program's own encoding, or have it posted again"
        self._piece.refuse_first(self._name, self._rows, bad, reason, advice)
