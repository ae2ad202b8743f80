"""A program's bytes, piece by piece, as columns of moves and dwells."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from polishd.api import ProgramError
from polishd.model.program import IntArray
from polishd.model.surface import BoolArray, FloatArray
from polishd.plugins.rnc_robot.nc import codes as c
from polishd.plugins.rnc_robot.nc import compiled
from polishd.plugins.rnc_robot.nc.dialect import GcodeDialect
from polishd.plugins.rnc_robot.nc.refusals import explained, refuse, refuse_binary
from polishd.plugins.rnc_robot.nc.scan import scan
from polishd.plugins.rnc_robot.nc.tables import ScanColumns, Tables, WordBuffer, tables

PIECE_BYTES = 1 << 19


@dataclass(frozen=True, slots=True)
class ProgramChunk:
    """Whole lines of a program, and what is in them; see ``codes.py`` for the columns."""

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
        run = compiled.kernel(scan, len(text))
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
        try:
            run(data, len(text), look, at, now, scratch, found)
        except ProgramError as error:
            count = int(at[c.LINE]) - self.lines
            lines = text.split(b"\n", count)[:count]
            raise explained(error, self.dialect, self.name, lines, [int(value) for value in at]) from None
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
