"""Compare two programs as LinuxCNC's interpreter runs them: motion call by call, and times as polishd reads them."""

from __future__ import annotations

import math
from array import array
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import zip_longest

import numpy as np

from polishd.api import Program, ProgramError
from polishd.drivers.linuxcnc.interpreter import PRINTED, Call, canonical_calls, exact_python
from polishd.model.surface import FloatArray
from polishd.plugins.rnc_robot.dialect import AnyDialect, GcodeDialect

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
