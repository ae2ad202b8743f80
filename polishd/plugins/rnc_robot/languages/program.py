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

import numpy as np

from polishd.api import Program, ProgramError
from polishd.model.program import IntArray
from polishd.model.surface import FloatArray
from polishd.plugins.rnc_robot.languages.columns import NONE, numbers, table, tool_axis
from polishd.plugins.rnc_robot.languages.parser import POSTED, MatchedStatement, Scan, scan
from polishd.plugins.rnc_robot.languages.profile import LanguageProfile

_UNITS = {1.0: "s", 0.001: "ms"}
FEW = 4
"""So many feed moves may lead in and out without a dwell, however few the points are."""


def read(profile: LanguageProfile, text: bytes, name: str) -> Program:
    """Read a program; ``name`` is for messages. A point is a feed move with its own dwell.

    ProgramError names the line, what is wrong with it and what to do.
    """
    found = scan(profile, text, name)
    require_points(found)
    points = found.points
    xyz_mm, turn = _places(found)
    feed = np.array(points.feed_mm_min)
    line = numbers(points.number_line)
    lines = text.count(b"\n") + (not text.endswith(b"\n"))
    orientation = profile.orientation
    return Program(
        text=text,
        sha256=hashlib.sha256(text).hexdigest(),
        name=name,
        dialect=profile.name,
        encoding="dwell",
        line=line,
        block=line - 1,
        start_mm=xyz_mm,
        end_mm=xyz_mm,
        axis=tool_axis(
            orientation.convention, orientation.axes, turn, tool_z_into_part=orientation.tool_z == "into_part"
        ),
        time_s=np.array(points.time) * profile.dwell.unit_s,
        lines=lines,
        feed_mm_min=feed,
        unit=_UNITS.get(profile.dwell.unit_s, f"{profile.dwell.unit_s:g} s"),
        max_feed_mm_min=float(np.nanmax(feed, initial=0.0)),
        warnings=tuple(_warnings(found, feed, len(points))),
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


def _places(found: Scan) -> tuple[FloatArray, FloatArray]:
    """Where the moves lead, (n, 3) mm and (n, k) as the profile writes it; all with the same tool in the same frame."""
    points, positions = found.points, found.positions
    rows = len(points)
    xyz_mm, turn = table(points.xyz_mm, rows).copy(), table(points.turn, rows).copy()
    target = numbers(points.target)
    number = np.array([positions.number.get(name, NONE) for name in points.targets.values()], dtype=np.int64)
    to = np.flatnonzero(target != NONE)
    declared = number[target[to]]
    _require_one_context(found, to, declared)
    if to.size:
        count = len(positions.line)
        xyz_mm[to] = table(positions.xyz_mm, count)[declared] + xyz_mm[to]
        turn[to] = table(positions.turn, count)[declared]
    return xyz_mm, turn


def _require_one_context(found: Scan, to: IntArray, declared: IntArray) -> None:
    """ProgramError at the first point, in program order, of an unknown position, or of another tool or frame.

    ``to`` are the points at declared positions, ``declared`` the numbers of these.
    """
    points, positions = found.points, found.positions
    own, theirs = points.contexts.values(), positions.contexts.values()
    of_move, of_place = numbers(points.context), np.full(len(points), NONE)
    known = declared != NONE
    of_place[to[known]] = numbers(positions.context)[declared[known]]
    lost = int(to[~known][0]) if not known.all() else len(points)

    def context(pair: tuple[int, int]) -> tuple[str | None, ...]:
        both = (*own[pair[0]], *((None, None) if pair[1] == NONE else theirs[pair[1]]))
        return tuple(name and found.folded(name) for name in both)

    # few pairs say it of all points: each is looked at once, where it stands first
    pairs, firsts = np.unique(of_move * (len(theirs) + 1) + of_place + 1, return_index=True)
    first: tuple[object, ...] = ()
    for at in sorted(firsts[: pairs.size].tolist()):
        if at >= lost:
            break
        here = context((int(of_move[at]), int(of_place[at])))
        first = first or here
        if here != first:
            raise found.refuse_line(
                points.move_line[at],
                f"another tool or frame ({_named(here)}) than at the first point ({_named(first)})",
                "have it posted with one tool in one frame",
            )
    if lost < len(points):
        name = points.targets.values()[points.target[lost]]
        raise found.refuse_line(
            points.move_line[lost], f"the position {name} is not declared as a constant in this file", POSTED
        )


def _named(context: Sequence[object]) -> str:
    return ", ".join(str(name) for name in context if name) or "none"


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
    limit = found.profile.line_limit
    length = found.body_lines if found.moving is None else found.moving_lines
    if limit and length > limit:
        warnings.append(f"{length} lines in the program, the controller takes {limit}: split it")
    return warnings


# New times: each number keeps its length and decimals where it can.


def rewrite(profile: LanguageProfile, program: Program, time_s: FloatArray) -> bytes:
    """The program with ``time_s`` (n,) seconds at its points; no byte changed outside the numbers of its dwells.

    A time that stays keeps its number as it is. The others are written in whole quanta of the profile, and what
    rounding leaves is carried to the next, so that each is within one quantum and the sum is too. ProgramError for
    times that cannot be written.
    """
    found = scan(profile, program.text, program.name)
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


# Splits a program where the controller limits its lines; each part is a complete program.

MOTIONS = ("move", "approach", "dwell", "dwell_in_position")


@dataclass(frozen=True, slots=True)
class _Cut:
    """A part: what is repeated of the program before it, and its own stretch of the body."""

    repeated: list[MatchedStatement]
    own: list[MatchedStatement]


def split(profile: LanguageProfile, text: bytes, name: str = "the program") -> list[bytes]:
    """The program in parts that the controller takes; the same bytes in a list of one where it fits.

    Each part begins with what stood before the first motion and with the last move of the part before, so that it
    starts where that ended; it keeps the positions that it uses. From the second on, the routine is named ``NAME_2``,
    ... and numbered lines count from 1 again. ProgramError where there is no dwell to part the program after.
    """
    found = scan(profile, text, name, keep=True)
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
