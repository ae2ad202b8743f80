"""Write the times of moves in a robot language: new numbers, other encodings, and the residue carried forward."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import count

import numpy as np

from polishd.api import Program, ProgramError
from polishd.model.program import Encoding, IntArray
from polishd.model.surface import FloatArray
from polishd.plugins.rnc_robot.languages.columns import NONE, StatedBy, numbers
from polishd.plugins.rnc_robot.languages.parser import scan
from polishd.plugins.rnc_robot.languages.profile import LanguageProfile, MoveTime
from polishd.plugins.rnc_robot.languages.program_scan import NOWHERE, Scan
from polishd.plugins.rnc_robot.languages.statements import MatchedStatement
from polishd.plugins.rnc_robot.languages.timed_moves import TimedMoves, require_rules, timed_moves

WITHIN = 0.01
"""Share by which a speed may be beyond the language's limits."""
COARSE = 0.1
"""Largest relative error of the time that a written speed states: in steps of 0.1 mm/s speeds from 1 mm/s.

The plan counts with the times as written, and the residue is carried forward, so that neighbours make up for it.
"""


def feed_unit(profile: LanguageProfile, factor: float) -> str:
    """Name of a speed's unit that is so many mm/min."""
    named = {1.0: "mm/min", 60.0: "mm/s", 60000.0: "m/s"}
    written = next((name for name, size in profile.feed_units_mm_min.items() if size == factor and name), "")
    return written or named.get(factor, f"{factor:g} mm/min")


def styled(steps: int, decimals: int, old: bytes) -> bytes:
    """``steps`` of 10^-decimals as ``old`` is written: its plus, its leading zeros or bare ``.5``, its decimals.

    Zeros at the end go as far as the old number had no digits there.
    """
    mantissa = old.lower().partition(b"e")[0].lstrip(b"+-")
    old_whole, point, old_fraction = mantissa.partition(b".")
    digits = str(steps).rjust(decimals + 1, "0").encode()
    whole, fraction = (digits[:-decimals], digits[-decimals:]) if decimals else (digits, b"")
    keep = len(old_fraction)
    fraction = (fraction[:keep] + fraction[keep:].rstrip(b"0")).ljust(keep, b"0")
    if not old_whole and whole == b"0" and fraction:
        whole = b""
    elif len(old_whole) > 1 and old_whole.startswith(b"0"):
        whole = whole.rjust(len(old_whole), b"0")
    sign = b"+" if old.startswith(b"+") else b""
    return sign + whole + (b"." + fraction if fraction or point else b"")


@dataclass(frozen=True, slots=True)
class TextEdit:
    """What comes in place of a stretch of the text."""

    start: int
    end: int
    text: bytes


def spliced(data: bytes, edits: list[TextEdit]) -> bytes:
    """The text with edits in rising order."""
    pieces, at = [], 0
    for edit in edits:
        pieces += [data[at : edit.start], edit.text]
        at = edit.end
    return b"".join([*pieces, data[at:]])


@dataclass(frozen=True, slots=True)
class WrittenNumber:
    """A number as it is written: so many steps of 10^-decimals."""

    steps: int
    decimals: int
    time_s: float
    """The time of the move that it states."""

    @property
    def value(self) -> float:
        """In its unit."""
        return float(self.steps / 10**self.decimals)

    @property
    def plain(self) -> bytes:
        """Its text, without zeros at its end."""
        text = f"{self.value:.{self.decimals}f}"
        return (text.rstrip("0").rstrip(".") if "." in text else text).encode()


def _decimals(quantum: float) -> int:
    """Decimals of a number that resolves one quantum."""
    return next((n for n in range(12) if round(quantum * 10**n) and abs(quantum * 10**n % 1 - 0.5) > 0.5 - 1e-6), 12)


def time_number(quantum_s: float, unit_s: float, wanted_s: float) -> WrittenNumber:
    """The number of seconds, or of that unit, that is nearest to a time."""
    quantum = quantum_s / unit_s
    steps, decimals = max(round(wanted_s / quantum_s), 0), _decimals(quantum)
    return WrittenNumber(round(steps * quantum * 10**decimals), decimals, steps * quantum_s)


def speed_number(rules: MoveTime, length_mm: float, wanted_s: float, factor: float) -> WrittenNumber:
    """The number of a speed, in units of ``factor`` mm/min, that takes nearest to that time over the length."""
    quantum, decimals = rules.speed_quantum, _decimals(rules.speed_quantum)
    steps = max(round(60 * length_mm / wanted_s / factor / quantum), 1)
    return WrittenNumber(round(steps * quantum * 10**decimals), decimals, 60 * length_mm / (steps * quantum * factor))


def misfit(rules: MoveTime, length_mm: float, new_s: float, number: WrittenNumber, factor: float | None) -> str:
    """Why a move cannot state its time by that number; empty if it can. ``factor``: of a speed, None: of a time."""
    speed, least, greatest = length_mm / max(number.time_s, 1e-12), rules.least_mm_s, rules.greatest_mm_s
    if factor is None and not number.steps:
        return f"a time of {new_s:.6g} s is below the resolution of {rules.quantum_s:g} s"
    if not least * (1 - WITHIN) <= speed <= greatest * (1 + (1e-9 if factor else WITHIN)):
        return f"a speed of {speed:.6g} mm/s; a timed move takes {least:g} to {greatest:g} mm/s"
    if factor is not None and abs(number.time_s - new_s) > COARSE * new_s:
        step = rules.speed_quantum * factor / 60
        return (
            f"a time of {new_s:.6g} s is {length_mm / new_s:.6g} mm/s, and speeds are written in steps of {step:g} mm/s"
        )
    return ""


def carried_speed(rules: MoveTime, length_mm: float, new_s: float, residue_s: float, factor: float) -> WrittenNumber:
    """The number of a speed for a time and a part of the residue before; for the time alone where that cannot be."""
    part_s = float(np.clip(residue_s, -COARSE / 2 * new_s, COARSE / 2 * new_s))
    number = speed_number(rules, length_mm, new_s + part_s, factor)
    if misfit(rules, length_mm, new_s, number, factor):
        return speed_number(rules, length_mm, new_s, factor)
    return number


MISFIT = (
    "use longer blocks, write the times of the moves (--encoding time) where the language has them, or solve again "
    "within these limits (move_time in the profile)"
)


@dataclass(slots=True)
class _Writer:
    """Writes the times of a program's moves in program order."""

    found: Scan
    rules: MoveTime
    moves: TimedMoves
    edits: list[TextEdit] = field(default_factory=list)
    residue_s: float = 0.0
    seen: dict[int, tuple[int, int]] = field(default_factory=dict)
    """Where the program states the speed that holds, by the name that it is set for."""
    lines_changed: bool = False
    holds: dict[int, float] = field(default_factory=dict)
    """The speed that holds in the new text, mm/min, likewise."""

    def refuse(self, row: int, reason: str, advice: str) -> ProgramError:
        """The error at a move."""
        return self.found.refuse_line(self.moves.columns.move_line[row], reason, advice)

    def time(self, row: int, length_mm: float, new_s: float, unit_s: float) -> WrittenNumber:
        """The number of a move's time."""
        number = time_number(self.rules.quantum_s, unit_s, new_s + self.residue_s)
        return self._kept(row, length_mm, new_s, number, None)

    def speed(self, row: int, length_mm: float, new_s: float, factor: float) -> WrittenNumber:
        """The number of a move's speed."""
        number = carried_speed(self.rules, length_mm, new_s, self.residue_s, factor)
        return self._kept(row, length_mm, new_s, number, factor)

    def _kept(
        self, row: int, length_mm: float, new_s: float, number: WrittenNumber, factor: float | None
    ) -> WrittenNumber:
        if reason := misfit(self.rules, length_mm, new_s, number, factor):
            raise self.refuse(row, reason, MISFIT)
        self.residue_s += new_s - number.time_s
        return number

    def put(self, start: int, end: int, text: bytes) -> None:
        """Other text in place of a stretch."""
        self.edits.append(TextEdit(start, end, text))

    def number(self, row: int, number: WrittenNumber) -> None:
        """A new number in the place of the move's own."""
        start, end = self.moves.columns.start[row], self.moves.columns.end[row]
        self.put(start, end, styled(number.steps, number.decimals, self.found.source.data[start:end]))

    def region(self, row: int, form: str, name: str, number: bytes) -> None:
        """A time or speed in the move's text, in place of what states it now."""
        here, there = self.moves.columns.here[row], self.moves.columns.there[row]
        if not form or here < 0:
            raise self.refuse(
                row,
                f"the language has no form of this move that states its {name}",
                "keep the program's own encoding, or have it posted again",
            )
        self.put(here, there, form.replace("<t>" if name == "time" else "<feed>", number.decode()).encode())

    def line_before(self, row: int, text: str) -> None:
        """A statement in a line before the move's."""
        data, begin = self.found.source.data, self.moves.columns.begin[row]
        line = data.rfind(b"\n", 0, begin) + 1
        if data[line:begin].strip():
            raise self.refuse(row, "the move stands behind another statement in its line", "put it in a separate line")
        stop = _line_end(data, line)
        self.put(line, line, data[line:begin] + self._numbered(text, begin) + stop)

    def line_behind(self, row: int, text: str) -> None:
        """A statement in a line behind the move's."""
        data, until = self.found.source.data, self.moves.columns.until[row]
        end = data.find(b"\n", until)
        end = len(data) if end < 0 else end + 1
        rest = data[until:end].strip()
        if rest and not rest.decode("latin-1").startswith(tuple(self.found.profile.comments)):
            raise self.refuse(row, "another statement stands behind the move in its line", "put it in a separate line")
        begin = self.moves.columns.begin[row]
        indent = data[data.rfind(b"\n", 0, begin) + 1 : begin]
        stop = _line_end(data, end)
        self.put(end, end, indent + self._numbered(text, begin).replace(b"\n", stop + indent) + stop)

    def _numbered(self, text: str, begin: int) -> bytes:
        """A new line's text: with a number where the move's line has one."""
        self.lines_changed = True
        text = text.strip("\n")
        if not self.found.source.data[begin : begin + 1].isdigit():
            return unnumbered(text).encode()
        return text.replace("<n>", "1").encode()

    def modal_speed(self, row: int, number: bytes, value: float) -> None:
        """A speed that holds from this move on, before it or in it."""
        if self.rules.feed_line:
            name = self.moves.columns.feed_of[row]
            of = "" if name == NONE else self.moves.columns.names.values()[name]
            self.line_before(row, self.rules.feed_line.replace("<feed>", number.decode()).replace("<feed_of>", of))
        else:
            self.region(row, self.rules.feed, "speed", number)
        self.holds[self.moves.columns.feed_of[row]] = value

    @property
    def is_modal(self) -> bool:
        """Whether a speed holds for the moves behind it."""
        return bool(self.rules.feed_line) or self.rules.feed_holds

    def feed(self, row: int, new_s: float, length_mm: float, *, stays: bool) -> None:
        """The speed of one motion: its own number, one that holds, or the speed that it had."""
        columns = self.moves.columns
        by, factor, span = StatedBy(columns.stated[row]), columns.factor[row], (columns.start[row], columns.end[row])
        own = columns.number[row] * factor
        if by is StatedBy.MODAL or (by is StatedBy.RATE and self.is_modal):
            name = columns.feed_of[row]
            fresh = span != self.seen.get(name)
            self.seen[name], self.holds[name] = span, own if fresh else self.holds[name]
            if stays:
                if not math.isclose(self.holds[name], own, rel_tol=1e-12):
                    data = self.found.source.data
                    text = data[slice(*span)] if span != NOWHERE else f"{columns.number[row]:.15g}".encode()
                    self.modal_speed(row, text, own)
                return
            number = self.speed(row, length_mm, new_s, factor)
            value = number.value * factor
            if fresh and span != NOWHERE:
                self.number(row, number)
                self.holds[name] = value
            elif not math.isclose(self.holds[name], value, rel_tol=1e-12):
                self.modal_speed(row, number.plain, value)
        elif stays:
            return
        elif by is StatedBy.RATE:
            self.number(row, self.speed(row, length_mm, new_s, factor))
        else:
            factor = self.found.profile.feed_units_mm_min[self.rules.speed_unit]
            number = self.speed(row, length_mm, new_s, factor)
            if self.is_modal:
                self.modal_speed(row, number.plain, number.value * factor)
            else:
                self.region(row, self.rules.feed, "speed", number.plain)

    def text(self) -> bytes:
        """The program with all edits, its lines numbered anew where lines came or went."""
        edits = sorted(self.edits, key=lambda edit: (edit.start, edit.end))
        text = spliced(self.found.source.data, edits)
        return _renumbered(self.found, text) if self.lines_changed else text


def unnumbered(text: str) -> str:
    """A form of a statement without the number of its line."""
    return text.replace("<n> ", "").replace("<n>", "")


def _line_end(data: bytes, at: int) -> bytes:
    """The line end before an offset where a line begins."""
    return b"\r\n" if data[max(at - 2, 0) : at] == b"\r\n" else b"\n"


def rewrite_moves(profile: LanguageProfile, program: Program, time_s: FloatArray) -> bytes:
    """The program with ``time_s`` (n,) seconds for its moves; each keeps the form that states its time.

    A time that stays keeps its number. Where a speed holds for several moves, a move that needs another gets its own.
    """
    found = scan(profile, program.text, program.name, program.beside)
    moves, (_, rules) = timed_moves(found), require_rules(found)
    writer = _Writer(found, rules, moves)
    for row, new_s, old_s, length in _by_row(moves, _times(program, moves.rows.size, time_s)):
        stays = math.isnan(new_s) or new_s == old_s
        if moves.columns.stated[row] == StatedBy.TIME:
            if not stays:
                writer.number(row, writer.time(row, length, new_s, moves.columns.factor[row]))
        elif moves.columns.stated[row] > StatedBy.TIME:
            writer.feed(row, new_s, length, stays=stays)
    return writer.text()


def _by_row(moves: TimedMoves, times: FloatArray) -> Iterator[tuple[int, float, float, float]]:
    """Number, new time, old time and length of each motion; NaN for those that are no points."""
    table = np.full((len(moves.columns), 3), np.nan)
    table[moves.rows] = np.column_stack([times, moves.time_s, moves.length_mm])
    for row, (new_s, old_s, length) in enumerate(table.tolist()):
        yield row, new_s, old_s, length


def _times(program: Program, points: int, time_s: FloatArray) -> FloatArray:
    times = np.ascontiguousarray(time_s, dtype=np.float64)
    if times.shape != (points,):
        raise ProgramError(
            f"{program.name}: {points} points need as many times, not an array of {times.shape}. "
            "To do: solve for this program."
        )
    good = np.isfinite(times) & ((times >= 0) if program.encoding == "dwell" else (times > 0))
    if not good.all():
        at = int(np.argmin(good))
        line = program.line[at]
        raise ProgramError(
            f"{program.name}, line {line}: a time of {times[at]} s cannot be written as {program.encoding}. "
            f"To do: solve again with times {'not below' if program.encoding == 'dwell' else 'above'} zero."
        )
    return times


# Another encoding of the time: a speed, a time of the move, or a wait behind it.


def recode_moves(profile: LanguageProfile, program: Program, time_s: FloatArray, encoding: Encoding) -> bytes:
    """The program with ``time_s`` (n,) seconds at its points, written as ``encoding``.

    To a speed or a time: write it into each move, and remove the line of its wait; moves without a wait keep their
    time, and are points from then on. To waits: add a line behind each move, which keeps its speed.
    """
    found = scan(profile, program.text, program.name, program.beside, keep=True, keep_columns=True)
    moves, (columns, rules) = timed_moves(found), require_rules(found)
    if encoding == "inverse":
        rule = profile.move_time
        known = ["time"] if rule is not None and rule.time else []
        known += ["feed"] if rule is not None and (rule.feed or rule.feed_line) else []
        known += ["wait"] if rule is not None and rule.wait else []
        raise ProgramError(
            f"{program.name}: {profile.name} has no inverse time. To do: use --encoding {' or '.join(known)}."
        )
    times = moves.time_s.copy()
    if program.encoding == "dwell":
        given = _times(program, len(found.points), time_s)
        dwell = numbers(columns.dwell)
        _refuse_unmoved(found, moves, dwell, given)
        own = dwell[moves.rows]
        times[own != NONE] = given[own[own != NONE]]
        _refuse_zero(found, moves, times)
    else:
        times = _times(program, moves.rows.size, time_s)
    writer = _Writer(found, rules, moves)
    for row, new_s, _, length in _by_row(moves, times):
        _recode_move(writer, encoding, row, new_s, length)
    if program.encoding == "dwell":
        _remove_waits(writer)
    return writer.text()


def _recode_move(writer: _Writer, encoding: Encoding, row: int, new_s: float, length_mm: float) -> None:
    """The time of one motion in that encoding; NaN: it is no point."""
    columns, rules, timed = writer.moves.columns, writer.rules, not math.isnan(new_s)
    if encoding == "dwell":
        if timed:
            _write_wait(writer, row, new_s)
    elif encoding == "feed":
        if timed or columns.stated[row] > StatedBy.TIME:
            writer.feed(row, new_s, length_mm, stays=not timed)
    elif timed and columns.stated[row] == StatedBy.TIME:
        writer.number(row, writer.time(row, length_mm, new_s, columns.factor[row]))
    elif timed:
        unit_s = rules.units_s.get(rules.time_unit, 1.0)
        writer.region(row, rules.time, "time", writer.time(row, length_mm, new_s, unit_s).plain)


def _refuse_unmoved(found: Scan, moves: TimedMoves, dwell: IntArray, times: FloatArray) -> None:
    """ProgramError at a wait whose move has no length that is known."""
    timed = np.zeros(len(dwell), dtype=np.bool_)
    timed[moves.rows] = True
    for row in np.flatnonzero((dwell != NONE) & ~timed).tolist():
        if times[dwell[row]] > 0:
            raise found.refuse_line(
                moves.columns.move_line[row],
                "the way of this move is not known, is zero, or is run faster than a timed move: it carries no time",
                "keep the waits, or have it posted with a start that is written out",
            )


def _refuse_zero(found: Scan, moves: TimedMoves, times: FloatArray) -> None:
    bad = ~(times > 0)
    if bad.any():
        line = moves.columns.move_line[int(moves.rows[int(np.argmax(bad))])]
        raise found.refuse_line(
            line, "a move takes some time, and this one is to take none", "ask for a time above zero"
        )


def _write_wait(writer: _Writer, row: int, new_s: float) -> None:
    dwell, rules = writer.found.profile.dwell, writer.rules
    if not writer.moves.columns.stops[row] and dwell.fly_by == "refuse":
        raise writer.refuse(
            row,
            "the move blends into the next one: a wait would not be spent at the point",
            "keep the time in the moves, or have it posted with exact stops",
        )
    if not rules.wait:
        raise writer.refuse(row, "the profile has no form of a wait", "set move_time.wait in your own profile")
    number = time_number(dwell.quantum_s, dwell.unit_s, new_s + writer.residue_s)
    if new_s > dwell.max_s:
        raise writer.refuse(row, f"a dwell of {new_s:g} s is longer than {dwell.max_s:g} s", "solve again within that")
    writer.residue_s += new_s - number.time_s
    writer.line_behind(row, rules.wait.replace("<time>", number.plain.decode()))


def _remove_waits(writer: _Writer) -> None:
    found, data = writer.found, writer.found.source.data
    starts = set(found.points.start)
    for statement in found.kept or ():
        if not statement.kind.startswith("dwell") or statement.match.start("time") not in starts:
            continue
        stretch = _whole_line(data, *statement.match.span())
        if stretch is None:
            raise found.refuse(
                statement, "other text stands in the line of the wait", "put the wait in a separate line"
            )
        writer.put(*stretch, b"")
        writer.lines_changed = True


def _whole_line(data: bytes, start: int, end: int) -> tuple[int, int] | None:
    """The line of a statement that stands alone in it."""
    begin, after = data.rfind(b"\n", 0, start) + 1, data.find(b"\n", end)
    after = len(data) if after < 0 else after + 1
    return None if data[begin:start].strip() or data[end:after].strip() else (begin, after)


def _renumbered(old: Scan, text: bytes) -> bytes:
    """The new text with its lines numbered as the old one's are, and with their count in its head."""
    profile = old.profile
    if not any("n" in pattern.regex.groupindex for pattern in profile.patterns):
        return text
    beside = old.source.beside
    before = scan(profile, old.source.data, old.source.name, beside, keep=True)
    written = [
        int(before.source.data[slice(*span)] or b"0") for line in before.kept or () for span in _number_spans(line)
    ]
    first, step = (written[0], max(written[1] - written[0], 1)) if len(written) > 1 else (1, 1)
    found = scan(profile, text, old.source.name, beside, keep=True, draft=True)
    edits, number, numbered = list[TextEdit](), count(first, step), 0
    for statement in found.kept or ():
        for low, high in _number_spans(statement):
            digits, numbered = str(next(number)), numbered + 1
            if low < high:
                more = min(max(len(digits) - (high - low), 0), low - _blank_from(text, low))
                edits.append(TextEdit(low - more, high, digits.rjust(high - low + more).encode()))
    return spliced(text, [*line_count(profile, text, numbered), *edits])


def line_count(profile: LanguageProfile, text: bytes, numbered: int) -> list[TextEdit]:
    """The head's count of numbered lines, where it has one, as ``numbered``."""
    regex = profile.move_time.numbered_lines if profile.move_time is not None else ""
    head = re.search(regex.encode(), text) if regex else None
    return [] if head is None else [TextEdit(*head.span(1), str(numbered).encode())]


def _number_spans(statement: MatchedStatement) -> list[tuple[int, int]]:
    """Where a statement's lines are numbered: ``n`` and, of a second line, ``n2``."""
    return [statement.match.span(name) for name in ("n", "n2") if name in statement.match.re.groupindex]


def _blank_from(text: bytes, at: int) -> int:
    """Where the blanks before an offset begin."""
    while at and text[at - 1 : at] == b" ":
        at -= 1
    return at


# What two programs of one language must have in common.

TIME = b"\0"


def timeless_lines(found: Scan, *, recoded: bool) -> list[tuple[int, bytes]]:
    """Lines of a program without what carries its time, each with its 1-based number.

    ``recoded``: without its waits and the numbers of its lines, too.
    """
    edits = [*_timing_of_moves(found), *_timing_statements(found, recoded=recoded)]
    data = found.source.data
    if recoded:
        edits += [TextEdit(head.start, head.end, TIME) for head in line_count(found.profile, data, 0)]
    lines, number, at = list[tuple[int, bytes]](), 1, 0
    open_line, began = b"", 1
    for edit in [*sorted(edits, key=lambda edit: (edit.start, edit.end)), TextEdit(len(data), len(data), b"")]:
        for piece in data[at : edit.start].splitlines(keepends=True):
            began = began if open_line else number
            open_line += piece
            if piece.endswith(b"\n"):
                lines.append((began, open_line))
                number, open_line = number + 1, b""
        began = began if open_line else number
        open_line += edit.text
        number += data.count(b"\n", edit.start, edit.end)
        at = edit.end
    return [*lines, (began, open_line)] if open_line else lines


def _timing_of_moves(found: Scan) -> Iterator[TextEdit]:
    """What states the times of the timed moves, in them; where a speed holds, that of every move.

    A move that is no point states a speed anew behind one that has another now; what it is, its row says.
    """
    moves, (columns, rules) = timed_moves(found), require_rules(found)
    for row in range(len(columns)) if rules.feed_holds else moves.rows.tolist():
        here, there = columns.here[row], columns.there[row]
        if here >= 0:
            yield TextEdit(here, there, TIME)
        if columns.stated[row] in (StatedBy.TIME, StatedBy.RATE) and not here <= columns.start[row] < there:
            yield TextEdit(columns.start[row], columns.end[row], TIME)


def _timing_statements(found: Scan, *, recoded: bool) -> Iterator[TextEdit]:
    """The statements that set speeds, waits at points, and the numbers of lines."""
    data, rules = found.source.data, found.profile.move_time
    is_modal = rules is not None and (bool(rules.feed_line) or rules.feed_holds)
    starts = set(found.points.start)
    for statement in found.kept or ():
        alone = _whole_line(data, *statement.match.span())
        name = ""
        if statement.kind == "neutral" and is_modal and statement.text("feed"):
            name = "feed"
        elif recoded and statement.kind.startswith("dwell") and statement.match.start("time") in starts:
            name = "time"
        if name:
            yield TextEdit(*(alone or statement.match.span(name)), b"" if alone else TIME)
        elif recoded or is_modal:
            for start, end in _number_spans(statement):
                if start < end:
                    yield TextEdit(_blank_from(data, start), end, TIME)
