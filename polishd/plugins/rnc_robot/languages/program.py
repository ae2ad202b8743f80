"""Read a program in a robot language as columns of points, and write it with new times.

New numbers go to old locations; the rounding residue is carried on.
"""

from __future__ import annotations

import hashlib
import math
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from io import BytesIO
from itertools import takewhile
from typing import Any

import numpy as np

from polishd.api import Program, ProgramError
from polishd.model.surface import FloatArray
from polishd.plugins.rnc_robot.languages.columns import StatedBy, numbers, tool_axis
from polishd.plugins.rnc_robot.languages.move_times import feed_unit, line_count, rewrite_moves, spliced, styled
from polishd.plugins.rnc_robot.languages.parser import scan
from polishd.plugins.rnc_robot.languages.profile import LanguageProfile
from polishd.plugins.rnc_robot.languages.program_scan import Scan
from polishd.plugins.rnc_robot.languages.statements import MatchedStatement
from polishd.plugins.rnc_robot.languages.timed_moves import (
    TimedMoves,
    context_of,
    locations,
    move_timing,
    require_rules,
    timed_moves,
)

_UNITS = {1.0: "s", 0.001: "ms"}
FEW = 4
"""So many feed moves may lead in and out without a dwell, however few the points are."""


def read(profile: LanguageProfile, text: bytes, name: str, beside: bytes = b"") -> Program:
    """Read a program; ``name`` is for messages, ``beside`` the file that declares its positions.

    A point is a feed move with its own dwell or, where no feed move has one, a feed move that states its own time.
    ProgramError names the line, what is wrong with it and what to do.
    """
    found = scan(profile, text, name, beside)
    if not len(found.points) and found.columns is not None and found.moves:
        return _read_moves(found, timed_moves(found))
    require_points(found)
    points = found.points
    xyz_mm, turn = locations(found, points)
    feed = np.array(points.feed_mm_min)
    return _program(
        found,
        encoding="dwell",
        line=numbers(points.number_line),
        start_mm=xyz_mm,
        end_mm=xyz_mm,
        axis=_axes(profile, turn),
        time_s=np.array(points.time) * profile.dwell.unit_s,
        feed_mm_min=feed,
        unit=_UNITS.get(profile.dwell.unit_s, f"{profile.dwell.unit_s:g} s"),
        warnings=tuple(_warnings(found, feed, len(points))),
    )


def tool_and_frame(profile: LanguageProfile, text: bytes, name: str) -> tuple[str | None, ...]:
    """Tool and frame of the controller that a program's points are written for; None: it does not name it."""
    return context_of(scan(profile, text, name))


def _read_moves(found: Scan, moves: TimedMoves) -> Program:
    """A program whose moves carry their time."""
    if not moves.rows.size:
        if moves.fast.size:
            first, (_, rules) = int(moves.fast[0]), require_rules(found)
            raise found.refuse_line(
                moves.columns.move_line[first],
                f"no feed move carries time, and {moves.fast.size} are faster than {rules.greatest_mm_s:g} mm/s (this "
                f"is the first): is the speed in {feed_unit(found.profile, moves.columns.factor[first])}?",
                "correct the speed or its unit, or set move_time.greatest_mm_s in a profile that extends this one",
            )
        raise ProgramError(
            f"{found.source.name}: no feed move has a dwell, and none leads from one known position to another: "
            "nothing carries time. To do: check that this is the polishing program, and its dialect."
        )
    by_time = moves.stated == StatedBy.TIME
    named = (moves.stated == StatedBy.TIME) | (moves.stated == StatedBy.FIXED)
    units = {feed_unit(found.profile, factor) for factor in np.unique(_factors(moves)[~named]).tolist()}
    if (moves.stated == StatedBy.FIXED).any() and found.profile.move_time is not None:
        units.add(feed_unit(found.profile, found.profile.feed_units_mm_min[found.profile.move_time.speed_unit]))
    warnings = (*found.warnings, *moves.warnings)
    if found.dwells:
        warnings += (f"{found.dwells} dwells that no feed move leads to are not points and are not changed",)
    if moves.stops[:-1].any():
        count = int(moves.stops[:-1].sum())
        warnings += (f"{count} timed moves end with an exact stop: slowing down and starting again take time there",)
    line = numbers(moves.columns.move_line)[moves.rows]
    return _program(
        found,
        encoding="time" if by_time.all() else "feed",
        line=line,
        start_mm=moves.start_mm,
        end_mm=moves.end_mm,
        axis=_axes(found.profile, moves.turn),
        time_s=moves.time_s,
        feed_mm_min=moves.feed_mm_min,
        unit=" and ".join([*(["s"] if by_time.any() else []), *sorted(units)]),
        warnings=warnings + _length_warning(found),
        timing=move_timing(found.profile, moves.stops),
    )


def _factors(moves: TimedMoves) -> FloatArray:
    return np.array(moves.columns.factor)[moves.rows]


def _axes(profile: LanguageProfile, turn: FloatArray) -> FloatArray:
    """(n, 3) unit tool axes."""
    orientation = profile.orientation
    into = orientation.tool_z == "into_part"
    return tool_axis(orientation.convention, orientation.axes, turn, tool_z_into_part=into)


def _program(found: Scan, **columns: Any) -> Program:
    """The program's record from its columns."""
    text, beside = found.source.data, found.source.beside
    return Program(
        text=text,
        beside=beside,
        sha256=hashlib.sha256(text + beside).hexdigest(),
        name=found.source.name,
        dialect=found.profile.name,
        block=columns["line"] - 1,
        lines=text.count(b"\n") + (not text.endswith(b"\n")),
        max_feed_mm_min=float(np.nanmax(columns["feed_mm_min"], initial=0.0)),
        **columns,
    )


def require_points(found: Scan) -> None:
    """ProgramError where there is no point, or where most feed moves have no dwell."""
    count = len(found.points)
    if not count:
        raise ProgramError(
            f"{found.source.name}: no feed move has a dwell: nothing carries time. "
            "To do: check that this is the polishing program, and its dialect."
        )
    without = found.moves - count
    if without > max(FEW, count):
        raise found.refuse_line(
            found.bare_line,
            f"{count} feed moves have a dwell, {without} have none (this is the first): time sits in two places",
            "have it posted with dwells at all points",
        )


def _warnings(found: Scan, feed: FloatArray, count: int) -> list[str]:
    """What a user should know, each once."""
    warnings = list(found.warnings)
    if found.dwells > count:
        stray = found.dwells - count
        warnings.append(f"{stray} dwells that no feed move leads to are not points and are not changed")
    if found.moves > count:
        without = found.moves - count
        warnings.append(f"{without} feed moves have no dwell: they are not points, and their time is not changed")
    if np.isnan(feed).any():
        warnings.append(f"the feeds of {int(np.isnan(feed).sum())} points are not written as numbers: not known")
    return [*warnings, *_length_warning(found)]


def _length_warning(found: Scan) -> tuple[str, ...]:
    limit = found.profile.line_limit
    length = found.body_lines if found.moving is None else found.moving_lines
    too_long = f"{length} lines in the program, the controller takes {limit}: split it"
    return (too_long,) if limit and length > limit else ()


# New times: each number keeps its length and decimals where it can.


def rewrite(profile: LanguageProfile, program: Program, time_s: FloatArray) -> bytes:
    """The program with ``time_s`` (n,) seconds at its points; no byte changed outside the numbers of its dwells.

    A time that stays keeps its number as it is. The others are written in whole quanta of the profile, and what
    rounding leaves is carried to the next, so that each is within one quantum and the sum is too. ProgramError for
    times that cannot be written.
    """
    if program.encoding != "dwell":
        return rewrite_moves(profile, program, time_s)
    found = scan(profile, program.text, program.name, program.beside)
    require_points(found)
    points = found.points
    times = np.ascontiguousarray(time_s, dtype=np.float64)
    if times.shape != (len(points),):
        raise ProgramError(
            f"{program.name}: {len(points)} points need as many times, not an array of {times.shape}. "
            "To do: solve for this program."
        )
    dwell = profile.dwell
    out, text = BytesIO(), memoryview(program.text)
    at, residue = 0, 0.0
    columns = zip(points.time, times.data, points.start, points.end, points.dwell_line, strict=True)
    for old, new_s, start, end, line in columns:
        if new_s == old * dwell.unit_s:
            continue
        if not (math.isfinite(new_s) and 0 <= new_s <= dwell.max_s):
            bounds = f"from 0 to {dwell.max_s:g} s" if math.isfinite(dwell.max_s) else "from 0 s"
            raise found.refuse_line(
                line, f"a dwell of {new_s} s cannot be written, only one {bounds}", "solve again within that"
            )
        wanted = min(new_s + residue, dwell.max_s)
        quanta = max(round(wanted / dwell.quantum_s), 0)
        residue = new_s + residue - quanta * dwell.quantum_s
        out.write(text[at:start])
        out.write(styled(quanta * dwell.steps, dwell.decimals, program.text[start:end]))
        at = end
    out.write(text[at:])
    return out.getvalue()


# Splits a program where the controller limits its lines; each part is a complete program.

MOTIONS = ("move", "approach", "dwell", "dwell_in_position")


@dataclass(frozen=True, slots=True)
class _Cut:
    """A part: what is repeated of the program before it, and its own stretch of the body."""

    repeated: list[MatchedStatement]
    own: list[MatchedStatement]


def split(profile: LanguageProfile, text: bytes, name: str = "the program", beside: bytes = b"") -> list[bytes]:
    """The program in parts that the controller takes; the same bytes in a list of one where it fits.

    Each part begins with what stood before the first motion and with the last move of the part before, so that it
    starts where that ended; it keeps the positions that it uses. From the second on, the routine is named ``NAME_2``,
    ... and numbered lines count from 1 again. ProgramError where there is no dwell to part the program after.
    """
    found = scan(profile, text, name, beside, keep=True)
    body = _body_of(found)
    if not profile.line_limit or len(_lines(body)) <= profile.line_limit:
        return [text]
    if found.moving is None:
        raise ProgramError(f"{name}: too long, and the profile names no begin of a routine. To do: split it by hand.")
    return [_part(found, body, cut, number) for number, cut in enumerate(_cuts(found, body), start=1)]


def _cuts(found: Scan, body: Sequence[MatchedStatement]) -> Iterable[_Cut]:
    """Cut after the last dwell that fits, part by part."""
    first = next(index for index, statement in enumerate(body) if statement.kind in MOTIONS)
    preamble, at = list(body[:first]), first
    repeated: list[MatchedStatement] = []
    while at < len(body):
        room = found.profile.line_limit - len(_lines([*preamble, *repeated]))
        end, taken, best = at, 0, at
        while end < len(body):
            taken += end == at or body[end].line != body[end - 1].line
            if taken > room:
                break
            end += 1
            if end == len(body) or (body[end - 1].kind.startswith("dwell") and body[end].line != body[end - 1].line):
                best = end
        if best == at:
            raise found.refuse(
                body[at], f"no dwell to part the program after within {room} lines from here", "split it by hand"
            )
        yield _Cut([*preamble, *repeated], list(body[at:best]))
        repeated = _held(found, body[first:best], body[best:])
        at = best


def _held(found: Scan, before: Sequence[MatchedStatement], after: Sequence[MatchedStatement]) -> list[MatchedStatement]:
    """What a part needs of those before: positions declared on the way, the feed that holds, and the last move."""
    moves = [statement for statement in before if statement.kind == "move"]
    used = _used([*moves[-1:], *after])
    declared = [
        statement
        for statement in before
        if statement.kind == "position" and found.folded(statement.text("target") or "") in used
    ]
    feeds = [statement for statement in before if statement.kind == "neutral" and statement.text("feed")]
    return [*declared, *feeds[-1:], *moves[-1:]]


def _part(found: Scan, body: Sequence[MatchedStatement], cut: _Cut, number: int) -> bytes:
    """Head, what is repeated, the part's own stretch, and tail."""
    data = found.source.data
    begin = found.moving
    if begin is None or not begin.text("program"):
        raise ProgramError(f"{found.source.name}: the routine has no name to count its parts by. To do: name it.")
    body_start = _line_start(data, body[0].match.start())
    body_end = _line_end(data, body[-1].match.end())
    kept = _used([*cut.repeated, *cut.own])
    renamed = begin.match.end("program")
    head = _positions(found, 0, renamed, kept) + (b"_%d" % number if number > 1 else b"")
    head += _positions(found, renamed, body_start, kept)
    numbered = sum("n" in statement.match.re.groupindex for statement in [*cut.repeated, *cut.own])
    head = spliced(head, line_count(found.profile, head, numbered))
    start, end = _line_start(data, cut.own[0].match.start()), _line_end(data, cut.own[-1].match.end())
    numbers = iter(range(1, len(body) + 1)) if number > 1 else None
    repeated = [
        _renumbered(data, [statement], _line_start(data, statement.match.start()), statement.match.end(), numbers)
        for statement in cut.repeated
    ]
    stop = b"\r\n" if b"\r\n" in data else b"\n"
    own = _renumbered(data, cut.own, start, end, numbers)
    tail = _positions(found, body_end, len(data), kept)
    return b"".join([head, *(piece + stop for piece in repeated), own, tail])


def _renumbered(
    data: bytes, own: Sequence[MatchedStatement], start: int, end: int, numbers: Iterator[int] | None
) -> bytes:
    """A stretch of the program; line numbers, where it has them, from ``numbers``, in the width that they had."""
    if numbers is None:
        return data[start:end]
    pieces, at = [], start
    for statement in own:
        if not statement.text("n"):
            continue
        low, high = statement.match.span("n")
        pieces += [data[at:low], str(next(numbers)).rjust(high - low).encode()]
        at = high
    return b"".join([*pieces, data[at:end]])


def _positions(found: Scan, start: int, end: int, kept: set[str]) -> bytes:
    """A stretch of the program without the declared positions that a part does not use."""
    data = found.source.data
    pieces, at = [], start
    for statement in found.kept or ():
        low, high = statement.match.span()
        declares = statement.kind in {"position", "neutral"} and statement.text("target") is not None
        if declares and start <= low and high <= end and found.folded(statement.text("target") or "") not in kept:
            pieces.append(data[at : max(_line_start(data, low), at)])
            at = min(_line_end(data, high), end)
    return b"".join([*pieces, data[at:end]])


def _used(stretch: Iterable[MatchedStatement]) -> set[str]:
    """Names of the positions that motions go to, or may go to: without a target, all their words."""
    names: set[str] = set()
    for statement in stretch:
        if statement.kind not in {"move", "approach"}:
            continue
        fields = ("target", "via") if statement.text("target") else ("via", "items")
        for name in fields:
            words = re.findall(r"\w+", statement.text(name) or "")
            names.update(words, (word.lower() for word in words))
    return names


def _body_of(found: Scan) -> list[MatchedStatement]:
    """The statements of the routine that moves (of the whole file, where the language has no routines)."""
    kept = found.kept or []
    if found.moving is None:
        return kept
    return list(takewhile(lambda statement: statement.kind != "end", kept[kept.index(found.moving) + 1 :]))


def _lines(stretch: Iterable[MatchedStatement]) -> set[int]:
    return {statement.line for statement in stretch}


def _line_start(data: bytes, at: int) -> int:
    """Where the line begins, or ``at`` where something else stands before it on the line."""
    start = data.rfind(b"\n", 0, at) + 1
    return at if data[start:at].strip() else start


def _line_end(data: bytes, at: int) -> int:
    """Where the next line begins, or the end."""
    end = data.find(b"\n", at)
    return len(data) if end < 0 else end + 1
