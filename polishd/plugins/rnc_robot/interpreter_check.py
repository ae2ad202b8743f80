"""Two programs as LinuxCNC's interpreter runs them: the same motion call by call, and the times that we read."""

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
"""Calls that move nothing: what a change of times may change."""
_ROUNDING = 1e-9
"""Relative: two ways of working out one time in doubles."""


@dataclass(frozen=True, slots=True)
class Interpreted:
    """What LinuxCNC's interpreter made of two programs."""

    difference: str | None
    """The first difference in motion, or between a time and what we read; None: there is none."""
    calls: int
    """Calls compared: everything but dwells, feeds and comments."""
    times: int
    """Times of points, of both programs, that were compared with what polishd reads."""
    digits: str
    """How exactly, in words."""


@dataclass(slots=True)
class _Timed:
    """What a program's calls say about time: kept while they stream past."""

    line: array[int] = field(default_factory=lambda: array("q"))
    time_s: array[float] = field(default_factory=lambda: array("d"))
    feed: float = 0.0
    at: tuple[float, ...] = ()

    def dwell(self, call: Call) -> None:
        self.line.append(call.line)
        self.time_s.append(float(call.arguments))

    def move(self, call: Call) -> None:
        """The time of a feed move: 60 L / F over X, Y, Z.

        Where the tool only turns it is not told (NaN): F is then deg/min, scaled like a length or not by units that
        the calls do not name.
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


def interpreted(old: Program, new: Program, dialect: GcodeDialect) -> Interpreted:
    """Run both programs through LinuxCNC's interpreter at the same time, and compare call by call.

    Compared are all calls but DWELL, SET_FEED_RATE, SET_FEED_MODE and comments; their order counts. Dwells are then
    compared with ``time_s`` of the programs; where time sits in the feed, so are the times of the moves (only with
    doubles: four decimals say too little about short moves). No times are compared where the dialect's numbers mean
    something else to LinuxCNC. ProgramError where LinuxCNC is missing or refuses.
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
    return Interpreted(None if difference is None else f"LinuxCNC: {difference}", count, checked, digits)


def _means_the_same(program: Program, dialect: GcodeDialect) -> bool:
    """Whether the numbers that carry the time mean to LinuxCNC what they mean in the dialect."""
    if program.encoding != "dwell":
        return dialect.feed.unit == "mm/min" and dialect.feed.g93 == "1/min"
    unit = dialect.dwell.words.get("P")
    return unit is not None and unit.whole == unit.decimal == "s"


def _motion(calls: Iterator[Call], program: Program, timed: _Timed) -> Iterator[Call]:
    """The calls that move something; the rest goes into ``timed``."""
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
    """The first point whose time LinuxCNC sees differently, in words; None where all agree."""
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
    """Of the dwells, those that are the points' as far as they can be told apart without line numbers."""
    if len(times) <= len(wanted):
        return times
    found: list[float] = []
    for time_s in times:
        if len(found) < len(wanted) and abs(time_s - wanted[len(found)]) <= PRINTED * 1.01:
            found.append(time_s)
    return np.array(found)
