"""A program's bytes, piece by piece, as columns of moves and dwells."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from polishd.api import ProgramError
from polishd.model.program import Encoding, IntArray
from polishd.model.surface import BoolArray, FloatArray
from polishd.plugins.rnc_robot.gcode import jit
from polishd.plugins.rnc_robot.gcode import kernels as c
from polishd.plugins.rnc_robot.gcode.dialect import GcodeDialect, ScanColumns, Tables, WordBuffer, tables
from polishd.plugins.rnc_robot.gcode.refusals import explain_refusal, refuse, refuse_binary
from polishd.plugins.rnc_robot.gcode.scanner import scan

PIECE_BYTES = 1 << 19


@dataclass(frozen=True, slots=True)
class ProgramChunk:
    """Whole lines of a program, and what is in them; see ``kernels.py`` for the columns."""

    text: bytes
    first_line: int
    """1-based number of its first line."""
    first_move: int
    """0-based number of its first move in the program."""
    moves: IntArray
    """(n, MOVE_INTS)"""
    places: FloatArray
    """(n, MOVE_FLOATS)"""
    before: FloatArray
    """(AXES,) where the tool is before the first move; NaN: not said."""
    dwells: IntArray
    """(d, DWELL_INTS)"""
    times: FloatArray
    """(d, DWELL_FLOATS)"""
    modes: IntArray
    """(m, MODE_INTS): the numbers of G93 and G94."""

    def line(self, number: int) -> bytes:
        """The text of the program's line of that 1-based number."""
        index = number - self.first_line
        return self.text.split(b"\n", index + 1)[index]

    def refuse_first(self, name: str, moves: IntArray, bad: BoolArray, reason: str, advice: str) -> None:
        """ProgramError at the first of these moves that is bad."""
        if bad.any():
            line = int(moves[int(np.argmax(bad)), c.M_LINE])
            raise refuse(name, line, self.line(line), reason, advice)


class Scanner:
    """Takes a program's bytes in order; its modal state goes from piece to piece."""

    def __init__(self, dialect: GcodeDialect, name: str) -> None:
        self.dialect = dialect
        self.name = name
        self.at = [0] * c.AT_SIZE
        self.lines = 0
        self.rest = False
        """There is text behind the program's end."""
        self._lists = tables(dialect)
        self._now = [float("nan")] * (c.AXES + 1) + [1.0, 1.0, 0.0]
        self.at[c.DWELLS_FOR] = -1
        self.at[c.VECTORING] = int(bool(dialect.axes.vector) and not dialect.g.get("vectors_on"))
        self._arrays: tuple[Tables, WordBuffer, ScanColumns] | None = None

    def pieces(self, chunks: Iterator[bytes]) -> Iterator[ProgramChunk]:
        """Columns of whole lines, as the chunks come. ProgramError names line and reason."""
        left = b""
        for chunk in chunks:
            cut = chunk.rfind(b"\n") + 1
            if not cut and len(left) <= self.dialect.text.longest_line:
                left += chunk
                continue
            cut = cut or len(chunk)  # a line without end: refused, not gathered
            yield self._piece(left + chunk[:cut] if left else chunk[:cut])
            left = chunk[cut:]
        if left:
            yield self._piece(left)
        self._check_end(left)

    def _piece(self, text: bytes) -> ProgramChunk:
        refuse_binary(text, self.name, self.lines, self.dialect.text)
        count = text.count(b"\n") + (not text.endswith(b"\n"))
        first_line, first_move, before = self.lines + 1, self.at[c.MOVES], np.array(self._now[: c.AXES])
        found = self._scan(text, count)
        if self.at[c.ENDED] and not self.rest:
            self.rest = bool(text[self.at[c.NEXT] :].translate(None, b"% \t\r\n"))
        self.at[c.NEXT] = 0
        self.lines += count
        moves, dwells, modes = (self.at[slot] for slot in (c.N_MOVES, c.N_DWELLS, c.N_MODES))
        piece = ProgramChunk(
            text, first_line, first_move, _rows(found.moves, moves, c.MOVE_INTS, np.int64),
            _rows(found.places, moves, c.MOVE_FLOATS, np.float64), before,
            _rows(found.dwells, dwells, c.DWELL_INTS, np.int64), _rows(found.times, dwells, c.DWELL_FLOATS, np.float64),
            _rows(found.modes, modes, c.MODE_INTS, np.int64),
        )  # fmt: skip
        self.at[c.N_MOVES] = self.at[c.N_DWELLS] = self.at[c.N_MODES] = 0
        return piece

    def _scan(self, text: bytes, room: int) -> ScanColumns:
        run = jit.kernel(scan, len(text))
        at: Any
        now: Any
        data: Any
        if run is scan:
            found = _found(room, list)
            scratch = WordBuffer([0] * (c.W_INTS * c.MOST_WORDS), [0.0] * c.MOST_WORDS, [-1] * c.WORDS)
            look, at, now, data = self._lists, self.at, self._now, text
        else:
            look, scratch, found = self._compiled(room)
            at, now, data = np.array(self.at), np.array(self._now), np.frombuffer(text, dtype=np.uint8)
        ends = np.flatnonzero(np.frombuffer(text, dtype=np.uint8) == ord("\n"))
        if not text.endswith(b"\n"):
            ends = np.append(ends, len(text))
        try:
            run(data, ends.tolist() if run is scan else ends, look, at, now, scratch, found)
        except ProgramError as error:
            count = int(at[c.LINE]) - self.lines
            lines = text.split(b"\n", count)[:count]
            raise explain_refusal(error, self.dialect, self.name, lines, [int(value) for value in at]) from None
        if run is not scan:
            self.at, self._now = at.tolist(), now.tolist()
        return found

    def _compiled(self, lines: int) -> tuple[Tables, WordBuffer, ScanColumns]:
        """Arrays for compiled code, kept while they are large enough."""
        if self._arrays is None or len(self._arrays[2].moves) < (lines + 1) * c.MOVE_INTS:
            values: Any = (value if isinstance(value, int | float) else np.array(value) for value in self._lists)
            look = Tables(*values)
            scratch = WordBuffer(
                np.zeros(c.W_INTS * c.MOST_WORDS, dtype=np.int64), np.zeros(c.MOST_WORDS), np.full(c.WORDS, -1)
            )
            self._arrays = look, scratch, _found(lines + lines // 4, np.array)
        return self._arrays

    def _check_end(self, left: bytes) -> None:
        """Refuse a program that is cut short, as far as that can be seen."""
        if self.at[c.ENDED]:
            return
        if not self.lines:
            raise ProgramError(f"{self.name}: the file is empty. To do: fetch it again.")
        number = self.lines + (not left)
        if self.dialect.text.end == "required" or (self.at[c.OPENED] and self.dialect.text.tape == "percent"):
            raise refuse(
                self.name, number, left, "the file ends without M2, M30 or %: it may be cut short",
                "fetch it again, or end it with M2",
            )  # fmt: skip
        if left:
            raise refuse(
                self.name, number, left, "the file ends in mid-line without M2, M30 or %: it may be cut short",
                "fetch it again, or end its last line",
            )  # fmt: skip


def _found(lines: int, kind: Any) -> ScanColumns:
    ints, floats = (c.MOVE_INTS, c.DWELL_INTS, c.MODE_INTS), (c.MOVE_FLOATS, c.DWELL_FLOATS)
    rows = lines + 1
    moves, dwells, modes = (kind([0]).repeat(rows * n) if kind is np.array else [0] * (rows * n) for n in ints)
    places, times = (kind([0.0]).repeat(rows * n) if kind is np.array else [0.0] * (rows * n) for n in floats)
    return ScanColumns(moves, places, dwells, times, modes)


def _rows(flat: Any, rows: int, columns: int, kind: type) -> Any:
    return np.array(flat[: rows * columns], dtype=kind).reshape(rows, columns)


# Which numbers of a program carry time: in dwells, in feeds, or in feeds that count time (G93).


@dataclass(slots=True)
class TimeWordCounts:
    """What of moves and dwells a program has, so far."""

    moves: int = 0
    """Feed moves."""
    dwelled: int = 0
    """Dwells that a feed move leads to."""
    stray: int = 0
    inverse: int = 0
    """Feed moves under G93."""
    first_without: int = 0
    """Line of the first feed move without a dwell."""
    _last: int = 0
    """Line of a move without a dwell that the last piece ended with."""

    def add(self, piece: ProgramChunk) -> None:
        """Count a piece."""
        kind = piece.moves[:, c.M_KIND]
        feed = kind != c.RAPID
        owned = int(np.count_nonzero(piece.dwells[:, c.D_MOVE] >= 0))
        self.moves += int(np.count_nonzero(feed))
        self.dwelled += owned
        self.stray += len(piece.dwells) - owned
        self.inverse += int(np.count_nonzero(kind >= c.K_INVERSE))
        self._find_first_without(piece, feed)

    def _find_first_without(self, piece: ProgramChunk, feed: BoolArray) -> None:
        """A move at a piece's end may have its dwell in the next one."""
        if self.first_without or not (feed.any() or len(piece.dwells)):
            return
        owners = piece.dwells[piece.dwells[:, c.D_MOVE] >= 0, c.D_MOVE] - piece.first_move
        if self._last and not (len(owners) and owners[0] < 0):
            self.first_without = self._last
            return
        alone = feed.copy()
        alone[owners[owners >= 0]] = False
        at = np.flatnonzero(alone)
        ends = len(at) > 0 and at[-1] == len(feed) - 1
        self._last = int(piece.moves[at[-1], c.M_LINE]) if ends else 0
        if len(at) > ends:
            self.first_without = int(piece.moves[at[0], c.M_LINE])

    def sits_in(self) -> Encoding:
        """Where the time of these moves sits."""
        return "dwell" if self.dwelled else "inverse" if self.inverse else "feed"

    def encoding(self, name: str) -> Encoding:
        """The same of a whole program. ProgramError where nothing carries any, or where it sits in two places."""
        if self.dwelled:
            without = self.moves - self.dwelled
            if without > max(4, self.dwelled):
                raise ProgramError(
                    f"{name}, line {self.first_without}: {self.dwelled} feed moves have a dwell of their own and "
                    f"{without} have none, this one the first: time sits in two places. "
                    "To do: have it posted with dwells at all points or at none."
                )
        elif not self.moves:
            raise ProgramError(
                f"{name}: nothing in it carries time: it needs feed moves (G1), with or without their own dwell "
                "(G4 P) each. To do: check that this is the polishing program."
            )
        return self.sits_in()


class Points(NamedTuple):
    """Timed points of a piece, n of them, in order."""

    line: IntArray
    """1-based line of the dwell, or of the feed move."""
    start: IntArray
    """Where the number begins in the piece's text; -1: its F stands in an earlier line."""
    end: IntArray
    style: IntArray
    f_line: IntArray
    """Line of the F that governs a feed move; for dwells the line itself."""
    tail: IntArray
    """Where the last word of a feed move's line ends."""
    lower: IntArray
    """1 where that word is in lower case."""
    unit_size: FloatArray
    """One written unit of the number: of a dwell in s, of a feed in mm (25.4: the feed is in inches)."""
    scale: FloatArray
    """Seconds of a number of 1: times the number for dwells and F in seconds, over the number for other feeds."""
    number: FloatArray
    time_s: FloatArray
    before: FloatArray
    """(n, AXES) where the tool is before."""
    after: FloatArray
    """(n, AXES) where it is after it."""
    feed_mm_min: FloatArray
    still: int
    """Feed moves that go nowhere: no points."""


class PointReader:
    """Points of piece after piece, in an encoding that is known."""

    def __init__(self, dialect: GcodeDialect, name: str, encoding: Encoding) -> None:
        self.dialect = dialect
        self.name = name
        self.encoding = encoding
        self._feeds = np.zeros(0)
        self._per_minute = 60.0 if dialect.feed.unit == "mm/s" else 1.0
        self._counts_time = counts_time(dialect, encoding)

    def read(self, piece: ProgramChunk) -> Points:
        """Points of the next piece; ProgramError names the line."""
        places = np.vstack([piece.before, piece.places[:, : c.AXES]])
        return self._dwelled(piece, places) if self.encoding == "dwell" else self._fed(piece, places)

    def _dwelled(self, piece: ProgramChunk, places: FloatArray) -> Points:
        mine = piece.dwells[:, c.D_MOVE] >= 0
        dwells, times = piece.dwells[mine], piece.times[mine]
        at = places[dwells[:, c.D_MOVE] - piece.first_move + 1]
        feeds = np.concatenate([self._feeds[-1:] if len(self._feeds) else [np.nan], self._feed_mm_min(piece, places)])
        self._feeds = feeds
        none = np.zeros(len(dwells), dtype=np.int64)
        return Points(
            dwells[:, c.D_LINE], dwells[:, c.D_START], dwells[:, c.D_END], dwells[:, c.D_STYLE], dwells[:, c.D_LINE],
            none, none, times[:, c.D_SCALE], times[:, c.D_SCALE], times[:, c.D_SECONDS] / times[:, c.D_SCALE],
            times[:, c.D_SECONDS], at, at, feeds[dwells[:, c.D_MOVE] - piece.first_move + 1], 0,
        )  # fmt: skip

    def _feed_mm_min(self, piece: ProgramChunk, places: FloatArray) -> FloatArray:
        """Feed of each move; NaN for rapids, and where the length of an inverse-time move is not known."""
        kind = piece.moves[:, c.M_KIND]
        feed = piece.places[:, c.V_FEED] * piece.places[:, c.V_UNIT] * self._per_minute
        feed[kind == c.RAPID] = np.nan
        inverse = kind >= c.K_INVERSE
        if inverse.any():
            number = piece.places[inverse, c.V_FEED]
            time_s = number if self.dialect.feed.g93 == "s" else 60.0 / number
            length = np.linalg.norm(places[1:, :3] - places[:-1, :3], axis=1)[inverse]
            feed[inverse] = np.where((kind[inverse] & c.K_ARC) != 0, np.nan, 60.0 * length / time_s)
        return feed

    def _fed(self, piece: ProgramChunk, places: FloatArray) -> Points:
        feed = _mask(piece.moves[:, c.M_KIND] != c.RAPID)
        moves, number, unit_mm = piece.moves[feed], piece.places[feed, c.V_FEED], piece.places[feed, c.V_UNIT]
        before, after = places[:-1][feed], places[1:][feed]
        self._check_feeds(piece, moves)
        length_mm = self._length_mm(piece, moves, before, after)
        turns = length_mm == 0
        turns[turns] = ~same_places(before[turns, 3:], after[turns, 3:]).all(axis=1)
        going = (length_mm > 0) | turns
        inverse = self.encoding == "inverse"
        if inverse:
            scale = np.full(len(moves), 1.0 if self._counts_time else 60.0)
        else:
            piece.refuse_first(self.name, moves, turns, "the tool turns on the spot, at a feed in deg/min",
                               "have it posted with G93")  # fmt: skip
            scale = 60.0 * length_mm / (unit_mm * self._per_minute)
        time_s = number * scale if self._counts_time else scale / number
        with np.errstate(divide="ignore", invalid="ignore"):
            feed_mm_min = 60.0 * length_mm / time_s
        found = Points(
            moves[:, c.M_LINE], moves[:, c.M_START], moves[:, c.M_END], moves[:, c.M_STYLE], moves[:, c.M_F_LINE],
            moves[:, c.M_TAIL], moves[:, c.M_LOWER], unit_mm, scale, number, time_s, before, after, feed_mm_min, 0,
        )  # fmt: skip
        kept = _mask(going)
        columns = [column[kept] for column in found[:-1]]
        return Points._make([*columns, int(np.count_nonzero(~going))])

    def _check_feeds(self, piece: ProgramChunk, moves: IntArray) -> None:
        kind = moves[:, c.M_KIND]
        inverse = self.encoding == "inverse"
        piece.refuse_first(
            self.name, moves, (kind >= c.K_INVERSE) != inverse, "G93 and G94 in one program: time sits in two places",
            "have it posted with one",
        )  # fmt: skip
        piece.refuse_first(
            self.name, moves, (kind & c.K_ARC) != 0, "an arc, and time sits in the feed: it is no straight move",
            "have it posted with straight moves (G1), or with dwells",
        )  # fmt: skip

    def _length_mm(self, piece: ProgramChunk, moves: IntArray, before: FloatArray, after: FloatArray) -> FloatArray:
        step = after[:, :3] - before[:, :3]
        squares = np.einsum("ij,ij->i", step, step)
        if not np.isnan(squares).any():
            return np.asarray(np.sqrt(squares))
        for axis in range(3):
            lost = np.isnan(before[:, axis]) & ~np.isnan(after[:, axis])
            reason = f"a feed move from an unknown {'XYZ'[axis]}"
            piece.refuse_first(self.name, moves, lost, reason, "go to its start with G0 first")
        return np.asarray(np.linalg.norm(np.nan_to_num(step, nan=0.0), axis=1))


def counts_time(dialect: GcodeDialect, encoding: Encoding) -> bool:
    """Whether a number is the time, and not what it is divided by."""
    return encoding == "dwell" or (encoding == "inverse" and dialect.feed.g93 == "s")


def _mask(chosen: BoolArray) -> BoolArray | slice:
    """An index of the chosen rows; without a copy where that is all of them."""
    return slice(None) if chosen.all() else chosen


def same_places(one: FloatArray, other: FloatArray) -> BoolArray:
    """Compare coordinates; two that are both unknown (NaN) count as equal."""
    return np.asarray((one == other) | (np.isnan(one) & np.isnan(other)))
