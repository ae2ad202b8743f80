"""Prove that two programs move alike and differ only in their times, and report by how much these differ.

With rs274, LinuxCNC's interpreter runs both: motion is compared call by call, and times as polishd reads them.
"""

from __future__ import annotations

import math
import re
from array import array
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from io import BytesIO
from itertools import zip_longest
from pathlib import Path
from typing import Literal

import numpy as np

from polishd.api import Program, ProgramError
from polishd.drivers.linuxcnc.interpreter import PRINTED, Call, canonical_calls, exact_python
from polishd.model.program import IntArray
from polishd.model.surface import FloatArray
from polishd.plugins.rnc_robot import formats
from polishd.plugins.rnc_robot.dialect import AnyDialect, GcodeDialect
from polishd.plugins.rnc_robot.gcode import kernels as c
from polishd.plugins.rnc_robot.gcode.checks import Checks
from polishd.plugins.rnc_robot.gcode.rewrite import scan_program
from polishd.plugins.rnc_robot.gcode.time_words import Points, ProgramChunk
from polishd.plugins.rnc_robot.languages.columns import NONE, StatedBy, numbers
from polishd.plugins.rnc_robot.languages.move_times import timeless_lines
from polishd.plugins.rnc_robot.languages.parser import scan
from polishd.plugins.rnc_robot.languages.profile import LanguageProfile
from polishd.plugins.rnc_robot.languages.timed_moves import locations, require_rules, timed_moves
from polishd.util.files import read_input

_SILENT = frozenset((b"COMMENT", b"MESSAGE", b"SET_FEED_RATE", b"SET_FEED_MODE", b"DWELL"))
"""Calls that move nothing; a change of times may change them."""
_ROUNDING = 1e-9
"""Relative difference of two computations of one time in doubles."""


@dataclass(frozen=True, slots=True)
class InterpreterResult:
    """Result of running two programs through LinuxCNC's interpreter."""

    difference: str | None
    """The first difference in motion, or between a time and the time that polishd reads; None: there is none."""
    calls: int
    """Calls compared: everything but dwells, feeds and comments."""
    times: int
    """Times of points, of both programs, that were compared with what polishd reads."""
    digits: str
    """Description of the accuracy."""


@dataclass(slots=True)
class _Timed:
    """Times of a program's calls, collected while the calls are streamed."""

    line: array[int] = field(default_factory=lambda: array("q"))
    time_s: array[float] = field(default_factory=lambda: array("d"))
    feed: float = 0.0
    at: tuple[float, ...] = ()

    def dwell(self, call: Call) -> None:
        self.line.append(call.line)
        self.time_s.append(float(call.arguments))

    def move(self, call: Call) -> None:
        """The time of a feed move: 60 L / F over X, Y, Z.

        NaN where the tool only turns: F is then deg/min, and the calls do not state whether units scale it.
        """
        to = tuple(call.numbers())
        if call.name == b"STRAIGHT_FEED" and self.at and to != self.at:
            length = math.dist(to[:3], self.at[:3])
            self.line.append(call.line)
            self.time_s.append(60.0 * length / self.feed if length > 0 < self.feed else math.nan)
        self.at = to


def readable(dialect: AnyDialect) -> GcodeDialect:
    """The dialect; ProgramError where no program of it is one for LinuxCNC's interpreter."""
    if isinstance(dialect, GcodeDialect):
        return dialect
    raise ProgramError(
        f"LinuxCNC's interpreter reads NC text, and {dialect.name} is none. To do: verify without --with rs274."
    )


def interpreted(old: Program, new: Program, dialect: GcodeDialect) -> InterpreterResult:
    """Run both programs through LinuxCNC's interpreter at the same time, and compare call by call.

    All calls except DWELL, SET_FEED_RATE, SET_FEED_MODE and comments are compared, in order. Dwells are then compared
    with ``time_s`` of the programs. If the feed carries the time, the times of the moves are compared too (only with
    doubles: four decimals are too coarse for short moves). Times are not compared where the dialect's numbers mean
    something else in LinuxCNC. ProgramError where LinuxCNC is missing or refuses.
    """
    exact = exact_python() is not None
    timed = _Timed(), _Timed()
    with (
        canonical_calls(old.text, old.name, exact=exact) as before,
        canonical_calls(new.text, new.name, exact=exact) as after,
    ):
        count, difference = _compare(_motion(before, old, timed[0]), _motion(after, new, timed[1]))
    checked = 0
    for program, found in zip((old, new), timed, strict=True):
        if difference is None and _means_the_same(program, dialect) and (exact or program.encoding == "dwell"):
            checked += program.n - sum(map(math.isnan, found.time_s))
            difference = _times_differ(program, found, exact=exact)
    digits = "doubles" if exact else "the four decimals that rs274 prints"
    return InterpreterResult(None if difference is None else f"LinuxCNC: {difference}", count, checked, digits)


def _means_the_same(program: Program, dialect: GcodeDialect) -> bool:
    """Whether the numbers that carry the time mean to LinuxCNC what they mean in the dialect."""
    if program.encoding != "dwell":
        return dialect.feed.unit == "mm/min" and dialect.feed.g93 == "1/min"
    unit = dialect.dwell.words.get("P")
    return unit is not None and unit.whole == unit.decimal == "s"


def _motion(calls: Iterator[Call], program: Program, timed: _Timed) -> Iterator[Call]:
    """Yield the calls that move something; add the times of the others to ``timed``."""
    feeds = program.encoding != "dwell"
    for call in calls:
        if call.name not in _SILENT:
            if feeds and call.name.startswith(b"STRAIGHT_"):
                timed.move(call)
            yield call
        elif call.name == b"DWELL" and not feeds:
            timed.dwell(call)
        elif call.name == b"SET_FEED_RATE":
            timed.feed = float(call.arguments)


def _compare(before: Iterator[Call], after: Iterator[Call]) -> tuple[int, str | None]:
    count = 0
    for one, other in zip_longest(before, after):
        if one is None or other is None or one[1:] != other[1:]:
            return count, f"call {count + 1}: {_shown(one)} became {_shown(other)}"
        count += 1
    return count, None


def _shown(call: Call | None) -> str:
    if call is None:
        return "nothing"
    where = f"line {call.line}, " if call.line else ""
    return f"{where}{call.name.decode()}({call.arguments.decode('ascii', 'replace')})"


def _times_differ(program: Program, found: _Timed, *, exact: bool) -> str | None:
    """Describe the first point whose time differs in LinuxCNC; None where all agree."""
    times = np.frombuffer(found.time_s, dtype=np.float64) if found.time_s else np.zeros(0)
    if exact:
        lines = np.frombuffer(found.line, dtype=np.int64) if found.line else np.zeros(0, dtype=np.int64)
        times = times[np.isin(lines, program.line)]
    else:
        times = _subsequence(times, program.time_s)
    if len(times) != program.n:
        return f"{program.name}: polishd reads {program.n} timed points, LinuxCNC {len(times)}"
    allowed = _ROUNDING * np.maximum(program.time_s, 1.0) + (0.0 if exact else PRINTED)
    wrong = np.flatnonzero(np.abs(times - program.time_s) > allowed)
    if not wrong.size:
        return None
    first = int(wrong[0])
    return (
        f"{program.name}, line {program.line[first]}: polishd reads {program.time_s[first]:.9g} s, "
        f"LinuxCNC {times[first]:.9g} s"
    )


def _subsequence(times: FloatArray, wanted: FloatArray) -> FloatArray:
    """Return the dwells of the points, as far as they can be distinguished without line numbers."""
    if len(times) <= len(wanted):
        return times
    found: list[float] = []
    for time_s in times:
        if len(found) < len(wanted) and abs(time_s - wanted[len(found)]) <= PRINTED * 1.01:
            found.append(time_s)
    return np.array(found)


# The motion of a program and the positions of its times, by which two programs are compared.

COLUMNS = ("x", "y", "z", "a", "b", "c", "i", "j", "k")
"""Of NC text: mm, degrees, and the tool vector as written."""


@dataclass(frozen=True, slots=True)
class ProgramMotion:
    """A program's moves in order, m of them."""

    program: Program
    line: IntArray
    """(m,) 1-based."""
    kind: IntArray
    """(m,) rapid, straight or arc, as the dialect distinguishes them; both programs use the same numbers."""
    places: FloatArray
    """(m, k) end of each move; NaN where the program does not state it."""
    point: IntArray
    """(n,) 0-based move that each timed point belongs to."""
    spans: IntArray
    """(s, 2) byte offsets of the numbers that carry the points' time, rising."""


def motion(dialect: AnyDialect, text: bytes, name: str, beside: bytes = b"") -> ProgramMotion:
    """Read a program. ProgramError names the line and the reason."""
    program = formats.read(dialect, text, name, beside)
    return _of_nc(program, dialect) if isinstance(dialect, GcodeDialect) else _of_language(program, dialect)


def _of_nc(program: Program, dialect: GcodeDialect) -> ProgramMotion:
    moves, places, spans, owners = [], [], [], []
    begin = 0

    def keep(piece: ProgramChunk, timed: Points, _checks: Checks) -> None:
        nonlocal begin
        moves.append(piece.moves)
        places.append(piece.places[:, : c.AXES])
        mine = timed.start >= 0  # an F of an earlier line is counted there
        spans.append(np.column_stack([timed.start, timed.end])[mine] + begin)
        owners.append(piece.dwells[piece.dwells[:, c.D_MOVE] >= 0, c.D_MOVE])
        begin += len(piece.text)

    scan_program(dialect, BytesIO(program.text), program.name, each=keep)
    line = np.concatenate([rows[:, c.M_LINE] for rows in moves])
    return ProgramMotion(
        program=program,
        line=line,
        kind=np.concatenate([rows[:, c.M_KIND] for rows in moves]) & ~c.K_INVERSE,
        places=np.vstack(places),
        point=np.concatenate(owners) if program.encoding == "dwell" else np.searchsorted(line, program.line),
        spans=np.vstack(spans),
    )


def _of_language(program: Program, profile: LanguageProfile) -> ProgramMotion:
    """Compare only moves with a dwell; the text comparison covers the others (their positions may be elsewhere)."""
    timed = scan(profile, program.text, program.name, program.beside).points
    return ProgramMotion(
        program=program,
        line=program.line,
        kind=np.zeros(program.n, dtype=np.int64),
        places=np.hstack([program.end_mm, program.axis]),
        point=np.arange(program.n),
        spans=np.column_stack([numbers(timed.start), numbers(timed.end)]),
    )


def _of_moves(program: Program, profile: LanguageProfile) -> ProgramMotion:
    """Compare all motions: where they lead, and the speed of those that are no points."""
    found = scan(profile, program.text, program.name, program.beside, keep_columns=True)
    moves, (columns, _) = timed_moves(found), require_rules(found)
    xyz_mm, turn = locations(found, columns, np.zeros(0, dtype=np.int64))
    speed = np.array(columns.number) * np.array(columns.factor)
    speed[moves.rows] = np.nan
    stated, dwell = numbers(columns.stated), numbers(columns.dwell)
    point = np.flatnonzero(dwell != NONE) if program.encoding == "dwell" else moves.rows
    spans = np.column_stack([numbers(columns.start), numbers(columns.end)])[moves.rows]
    return ProgramMotion(
        program=program,
        line=numbers(columns.move_line),
        kind=np.where(stated == StatedBy.APPROACH, 0, 1),
        places=np.column_stack([xyz_mm, turn, speed]),
        point=point,
        spans=spans,
    )


def _timeless_texts(
    old: ProgramMotion, new: ProgramMotion, profile: LanguageProfile
) -> tuple[tuple[LineChange, ...], str | None]:
    """As `_texts`, of programs in a robot language whose moves carry their time, or carried it before."""
    recoded = (old.program.encoding == "dwell") != (new.program.encoding == "dwell")
    one, other = (
        timeless_lines(
            scan(profile, side.program.text, side.program.name, side.program.beside, keep=True, keep_columns=True),
            recoded=recoded,
        )
        for side in (old, new)
    )
    for (number, line), (new_number, new_line) in zip_longest(one, other, fillvalue=(0, b"")):
        if line != new_line:
            before, after = (
                text.replace(TIME, b"..").decode("ascii", "backslashreplace").strip()[:120] for text in (line, new_line)
            )
            change = LineChange("other", number or None, new_number or None, before, after)
            return (change,), str(change)
    return (), None


# Lines of two programs that differ in more than the numbers that carry time, and which changes are allowed.

Kind = Literal["comment", "timing", "other"]
TIME = b"\0"
"""Replaces a number that carries time; no program contains this byte."""
AHEAD = 64
"""Lines searched ahead for the point where two texts agree again."""

_NUMBER = rb"[-+]?[ \t]*+(?:[0-9][0-9 \t]*+\.?[0-9 \t]*+|\.[ \t]*+[0-9][0-9 \t]*+)"
# Possessive, and from the first blank of a run on: a long run of blanks is gone over once
_GAP = rb"(?:(?<![ \t])[ \t]++)?"
_F = _GAP + rb"(?<![A-Za-z_])[Ff][ \t]*+=?[ \t]*+"
_G4 = rb"[Gg][ \t]*0*4(?:\.0*)?(?![0-9.])"
_WORD = rb"[ \t]*+[A-Za-z]*+[ \t]*+=?[ \t]*+\0[ \t]*+"
_ADDED_F = re.compile(_F + rb"\0")
_TIMING = re.compile(
    rb"^[ \t]*+(?:[Nn][0-9 \t]++)?(?:"
    + _G4
    + _WORD
    + rb"|"
    + _WORD
    + _G4
    + rb"[ \t]*+|#[Tt][Ii][Mm][Ee]"
    + _WORD
    + rb");?[ \t]*$"
    rb"|" + _F + rb"(?:\0|" + _NUMBER + rb")"
    rb"|" + _GAP + rb"(?<![A-Za-z_])[Gg][ \t]*+9[345](?![0-9.])"
)


@dataclass(frozen=True, slots=True)
class LineChange:
    """A line that differs in more than its time."""

    kind: Kind
    """``comment``: only text that a controller skips. ``timing``: F words or dwells of points, which a change of
    encoding adds and removes. ``other``: anything else, so motion is not proved."""
    old_line: int | None
    """1-based; None where the line was added."""
    new_line: int | None
    """1-based; None where it was removed."""
    old: str
    new: str

    def __str__(self) -> str:
        if self.old_line is None:
            return f'line {self.new_line} was added: "{self.new}"'
        if self.new_line is None:
            return f'line {self.old_line} was removed: "{self.old}"'
        return f'line {self.old_line} "{self.old}" became line {self.new_line} "{self.new}"'


def skeleton(text: bytes, spans: IntArray) -> bytes:
    """The text with ``TIME`` in place of the numbers at ``spans`` (m, 2), byte offsets in rising order."""
    ends = np.concatenate([[0], spans[:, 1]]).tolist()
    starts = np.concatenate([spans[:, 0], [len(text)]]).tolist()
    return TIME.join([text[end:start] for end, start in zip(ends, starts, strict=True)])


@dataclass(frozen=True, slots=True)
class _Side:
    """One of the two texts: its lines as they are, and as skeletons."""

    text: Sequence[bytes]
    bones: Sequence[bytes]

    def shown(self, index: int) -> str:
        return self.text[index].decode("ascii", "backslashreplace").strip(" \t\n").replace("\r", "\\r")[:120]


@dataclass(frozen=True)
class ChangeRules:
    """Differences that are allowed besides the numbers that carry time."""

    comments: Sequence[str]
    """Comment syntax: ``()``, or the mark that begins a comment up to the end of the line."""
    encoding_changed: bool
    """Time moved from dwells to feeds or back: F words, G93, G94 and the points' dwell blocks may differ. Otherwise
    only F words that carry time may be added or removed."""

    @cached_property
    def _comment(self) -> re.Pattern[bytes]:
        ways = [rb"\([^()]*\)" if mark == "()" else re.escape(mark.encode()) + rb".*" for mark in self.comments]
        return re.compile(rb"|".join(ways) or rb"(?!)")

    def code(self, line: bytes) -> bytes:
        """A line without its comments."""
        return self._comment.sub(b"", line).rstrip()

    def bare(self, line: bytes) -> bytes:
        """A line without its comments and timing."""
        timing = _TIMING if self.encoding_changed else _ADDED_F
        return timing.sub(b"", self.code(line)).strip()


def changes(
    old: bytes, new: bytes, old_spans: IntArray, new_spans: IntArray, rules: ChangeRules
) -> Iterator[LineChange]:
    """The lines of two programs that differ in more than the numbers at their spans, in order.

    Args:
        old: The one program.
        new: The other.
        old_spans: (m, 2) byte offsets of its numbers that carry time, rising.
        new_spans: (m, 2) likewise of the other.
        rules: Allowed differences in the rest; they give the kind of each change.
    """
    bones = skeleton(old, old_spans), skeleton(new, new_spans)
    if bones[0] == bones[1]:
        return
    before, after = _Side(_lines(old), _lines(bones[0])), _Side(_lines(new), _lines(bones[1]))
    i = j = 0
    while i < len(before.bones) or j < len(after.bones):
        if i < len(before.bones) and j < len(after.bones) and before.bones[i] == after.bones[j]:
            i, j = i + 1, j + 1
            continue
        kind, taken, added = _step(before.bones, i, after.bones, j, rules)
        yield LineChange(
            kind,
            i + 1 if taken else None,
            j + 1 if added else None,
            before.shown(i) if taken else "",
            after.shown(j) if added else "",
        )
        i, j = i + taken, j + added


def _lines(text: bytes) -> list[bytes]:
    """The lines with their line ends: a last line without one differs from a line that has one."""
    return BytesIO(text).readlines()


def _step(old: Sequence[bytes], i: int, new: Sequence[bytes], j: int, rules: ChangeRules) -> tuple[Kind, bool, bool]:
    """Return the kind of the difference at lines i and j, and the sides on which a line is consumed."""
    one = old[i] if i < len(old) else None
    other = new[j] if j < len(new) else None
    if one is not None and other is not None:
        same = _same(one, other, rules)
        if same is not None:
            return same, True, True
    added = _only(other, rules)
    if added is not None and (one is None or rules.bare(one)):
        return added, False, True
    removed = _only(one, rules)
    if removed is not None:
        return removed, True, False
    if one is None or other is None:
        return "other", one is not None, other is not None
    gone = next((k for k, line in enumerate(old[i : i + AHEAD]) if line == other), AHEAD)
    come = next((k for k, line in enumerate(new[j : j + AHEAD]) if line == one), AHEAD)
    return "other", gone <= come, come <= gone


def _same(one: bytes, other: bytes, rules: ChangeRules) -> Kind | None:
    """The kind of a change within a line; None where the lines differ in more than comments and timing."""
    if not one.strip() or not other.strip():
        return None
    if rules.code(one) == rules.code(other):
        return "comment"
    if rules.bare(one) != rules.bare(other) or _indent(one) != _indent(other):
        return None
    return "timing"


def _indent(line: bytes) -> bytes:
    return line[: len(line) - len(line.lstrip())]


def _only(line: bytes | None, rules: ChangeRules) -> Kind | None:
    """The kind of a whole line that may be added or removed; None for any other line."""
    if line is None or rules.bare(line):
        return None
    return "timing" if rules.code(line).strip() else "comment"


LISTED = 1000
"""Longest list of changes other than times."""


@dataclass(frozen=True, slots=True)
class Verification:
    """Comparison of two programs: motion, times, and other changes."""

    identical_motion: bool
    difference: str | None
    """Description of the first difference in motion; None where there is none."""
    points: int
    """Timed points of the new program."""
    changed_points: int | None
    """Points of both whose times differ; None where motion differs: times are not compared then."""
    largest_change_s: float | None
    """None likewise."""
    time_before_s: float
    """Sum over the points."""
    time_after_s: float
    range_before_s: tuple[float, float]
    """Shortest and longest time of a point."""
    range_after_s: tuple[float, float]
    other_changes: tuple[LineChange, ...]
    """Lines that differ in more than numbers that carry time, in order; the first ``LISTED`` of them."""
    proved_by: tuple[str, ...]
    """What was compared and found the same, in words; empty where motion is not proved."""


def verify(
    old: bytes | Path,
    new: bytes | Path,
    dialect: AnyDialect,
    *,
    with_rs274: bool = False,
    beside: bytes = b"",
) -> Verification:
    """Compare two programs of one dialect.

    Identical motion is claimed where (a) the texts are the same but for numbers that carry time, comments, and, after
    a change of encoding, F words and dwell blocks; (b) both read as the same moves, rapids too, bit for bit; (c) asked
    for, LinuxCNC's interpreter makes the same calls of both and sees the times that we read.

    The file beside a program declares its positions; ``beside`` is its content where the programs are no files. A new
    program without one takes the old one's.

    Raises:
        ProgramError: A program cannot be read; LinuxCNC is asked for and missing, or refuses.
    """
    nc = readable(dialect) if with_rs274 else None
    one = motion(dialect, *_content(old, "old"), _beside(dialect, old) or beside)
    other = motion(dialect, *_content(new, "new"), _beside(dialect, new) or one.program.beside)
    if not isinstance(dialect, GcodeDialect) and {one.program.encoding, other.program.encoding} != {"dwell"}:
        one, other = (_of_moves(side.program, dialect) for side in (one, other))
        listed, difference = _timeless_texts(one, other, dialect)
    else:
        listed, difference = _texts(one, other, dialect)
    difference = difference or _places(one, other)
    proved = [
        f"text: {one.program.lines} lines, every byte but the {len(other.spans)} numbers that carry time"
        + (f", and {len(listed)} lines of comments or timing" if listed else ""),
        f"motion: {len(other.line)} moves, kind, place and order, bit for bit",
    ]
    if nc is not None and difference is None:
        said = interpreted(one.program, other.program, nc)
        difference = said.difference
        proved.append(f"LinuxCNC: {said.calls} canonical calls and {said.times} times, in {said.digits}")
    return _verification(one, other, listed, difference, tuple(proved))


def _content(program: bytes | Path, name: str) -> tuple[bytes, str]:
    """Text, and a name for messages."""
    if isinstance(program, bytes):
        return program, name
    try:
        return read_input(program), program.name
    except OSError as error:
        raise ProgramError(f"{program}: cannot be read: {error.strerror}. To do: check the path.") from error


def _beside(dialect: AnyDialect, program: bytes | Path) -> bytes:
    return b"" if isinstance(program, bytes) else formats.beside_of(dialect, program)


def _texts(old: ProgramMotion, new: ProgramMotion, dialect: AnyDialect) -> tuple[tuple[LineChange, ...], str | None]:
    """Lines that differ in more than time, and the first of them that motion may depend on, in words."""
    one, other = old.program, new.program
    comments = dialect.text.comments if dialect.kind == "nc" else dialect.comments
    rules = ChangeRules(tuple(comments), encoding_changed=one.encoding != other.encoding)
    listed: list[LineChange] = []
    worst = None
    for change in changes(one.text, other.text, old.spans, new.spans, rules):
        if worst is None and change.kind == "other":
            worst = str(change)
        if len(listed) < LISTED:
            listed.append(change)
        elif worst is not None:
            break
    return tuple(listed), worst


def _places(old: ProgramMotion, new: ProgramMotion) -> str | None:
    """The first move that is not the same in both, in words."""
    count = min(len(old.line), len(new.line))
    here, there = old.places[:count], new.places[:count]
    same = ((here == there) | (np.isnan(here) & np.isnan(there))).all(axis=1)
    same &= old.kind[:count] == new.kind[:count]
    if same.all() and len(old.line) == len(new.line):
        return None
    if same.all():
        return f"{old.program.name} has {len(old.line)} moves, {new.program.name} {len(new.line)}"
    index = int(np.argmin(same))
    return (
        f"move {index + 1}: line {old.line[index]} to {_words(here[index])} became "
        f"line {new.line[index]} to {_words(there[index])}"
    )


def _words(place: FloatArray) -> str:
    names = COLUMNS if len(place) == len(COLUMNS) else ("x", "y", "z", "i", "j", "k", " ", " ")
    return " ".join(
        f"{name}{value!r}" for name, value in zip(names, place.tolist(), strict=False) if not math.isnan(value)
    )


def _verification(
    old: ProgramMotion,
    new: ProgramMotion,
    listed: tuple[LineChange, ...],
    difference: str | None,
    proved: tuple[str, ...],
) -> Verification:
    one, other = old.program, new.program
    change = _changes_s(old, new) if difference is None else None
    return Verification(
        identical_motion=difference is None,
        difference=difference,
        points=other.n,
        changed_points=None if change is None else int(np.count_nonzero(change)),
        largest_change_s=None if change is None else float(np.abs(change).max(initial=0.0)),
        time_before_s=float(one.time_s.sum()),
        time_after_s=float(other.time_s.sum()),
        range_before_s=(float(one.time_s.min()), float(one.time_s.max())),
        range_after_s=(float(other.time_s.min()), float(other.time_s.max())),
        other_changes=listed,
        proved_by=proved if difference is None else (),
    )


def _changes_s(old: ProgramMotion, new: ProgramMotion) -> FloatArray:
    """By how much the time of each move changed that is a point of both programs."""
    before, after = np.full(len(old.line), np.nan), np.full(len(new.line), np.nan)
    before[old.point], after[new.point] = old.program.time_s, new.program.time_s
    change = after - before
    return np.asarray(change[~np.isnan(change)])
