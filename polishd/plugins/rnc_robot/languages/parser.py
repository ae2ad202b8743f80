"""Moves, dwells and routines of a program in a robot language, with all refusals."""

from __future__ import annotations

import math
import re

from polishd.plugins.rnc_robot.gcode.refusals import refuse_byte_order_mark
from polishd.plugins.rnc_robot.languages.columns import NONE, StatedBy
from polishd.plugins.rnc_robot.languages.declarations import (
    take_context,
    take_declarations_beside,
    take_position,
    take_speed,
    take_unread_position,
)
from polishd.plugins.rnc_robot.languages.profile import LanguageProfile
from polishd.plugins.rnc_robot.languages.program_scan import (
    LARGEST_MM,
    ModalFeed,
    Move,
    Scan,
    StatedTime,
    context_at,
    feed_unit_mm_min,
    is_number,
    modal_place,
    name_of_feed,
    place_of,
    stated_time,
    stops_at_end,
)
from polishd.plugins.rnc_robot.languages.statements import MatchedStatement, ProgramSource, statements


def scan(
    profile: LanguageProfile,
    text: bytes,
    name: str,
    beside: bytes = b"",
    *,
    keep: bool = False,
    keep_columns: bool = False,
    draft: bool = False,
) -> Scan:
    """Read a program through. ProgramError where it may mean several things.

    Args:
        profile: the language.
        text: the program.
        name: for messages.
        beside: content of the file beside it that declares its positions.
        keep: keep all its statements, too.
        keep_columns: keep the columns of all its motions, although dwells carry the time.
        draft: its lines are not numbered yet, and its head does not count them yet.
    """
    refuse_byte_order_mark(text, name)
    found = Scan(profile, ProgramSource(text, name, beside), [] if keep else None, keep_columns=keep_columns)
    if profile.move_time is None:
        found.columns = None
    if beside:
        take_declarations_beside(found)
    for statement in statements(profile, found.source):
        if found.finished:
            raise found.refuse(statement, "a statement after the end of the program", "remove it")
        _require_running(found, statement)
        if found.kept is not None:
            found.kept.append(statement)
        found.line = statement.line
        if statement.kind not in {"begin", "end"} and found.counted != statement.line:
            found.counted, found.body_lines = statement.line, found.body_lines + 1
        if (number := statement.match.re.groupindex.get("n")) is not None:
            found.numbers.add(statement.line, statement.match[number])
        _TAKE[statement.kind](found, statement)
    unfinished = "finish" in profile.kinds and not found.finished
    if found.line and (unfinished or found.routine is not None):
        raise found.refuse_line(found.line, "the program breaks off: its end is missing", "check that it is whole")
    _check_calls(found)
    _leave_bare(found)
    if not draft:
        _check_numbers(found)
        _check_count(found)
    return found


def _check_numbers(found: Scan) -> None:
    """ProgramError at the first line whose number does not rise, where a number is an address."""
    if not found.profile.rising_numbers or found.numbers.falls is None:
        return
    line, number, before, highest = found.numbers.falls
    same = f"the line number {number} a second time (the first is in line {before})"
    raise found.refuse_line(
        line,
        same if number == highest else f"the line number {number} behind {highest} (in line {before})",
        "check that the file is whole and not two files mixed, and have it posted again with rising line numbers",
    )


def _check_count(found: Scan) -> None:
    """ProgramError where the head's count of positions contradicts the program: it is torn, or mixed of two."""
    regex = found.profile.position_count
    head = re.search(regex.encode(), found.source.data) if regex else None
    if head is None:
        return
    stated = sum(map(int, re.findall(rb"[0-9]+", head[1])))
    if stated and stated != found.declared:
        raise found.refuse_line(
            found.source.data.count(b"\n", 0, head.start(1)) + 1,
            f"the head counts {stated} positions, the program has {found.declared}",
            "check that the file is whole and not two files mixed, and have it posted again; if it is right, correct "
            "the count, or write 0",
        )


def _move(found: Scan, statement: MatchedStatement) -> None:
    _inside(found, statement)
    target = statement.text("target")
    stated = stated_time(found, statement)
    move = Move(
        statement.line,
        place_of(found, statement) if target is None else None,
        None if target is None else found.folded(target),
        _offset(found, statement),
        stops_at_end(found, statement),
        stated.number * stated.factor if stated.by > StatedBy.TIME else math.nan,
        context_at(found, statement),
    )
    if target is not None and found.folded(target) in found.unread and move.target not in found.positions:
        raise found.refuse(statement, *found.why_unread(target))
    if target is not None and found.profile.declare_before_use and move.target not in found.positions:
        raise found.refuse(statement, f"the position {target} is not declared before its use", found.undeclared)
    _keep_motion(found, statement, move, stated)
    found.slowed_line = found.slowed_line or found.override_line
    found.limited_line = found.limited_line or found.limit_line
    _leave_bare(found)
    found.moves += 1
    found.last = found.at = move
    found.dwelled = False


def _leave_bare(found: Scan) -> None:
    """The last feed move gets no dwell any more."""
    if found.last is not None and not found.dwelled and not found.bare_line:
        found.bare_line = found.last.line


def _offset(found: Scan, statement: MatchedStatement) -> tuple[float, float, float]:
    if "dx" not in statement.match.re.groupindex:
        return 0.0, 0.0, 0.0
    dx, dy, dz = ((statement.number(axis) or 0.0) * found.profile.unit_mm for axis in ("dx", "dy", "dz"))
    if not max(abs(dx), abs(dy), abs(dz)) <= LARGEST_MM:
        raise found.refuse(statement, "an offset beyond any robot", "correct it")
    return dx, dy, dz


def _keep_motion(found: Scan, statement: MatchedStatement, move: Move, stated: StatedTime) -> None:
    """A motion's row among the columns of all of them, where these are kept."""
    columns = found.columns
    if found.positions_beside and move.target is not None:
        found.used.add(move.target)
    if columns is None:
        return
    if move.place is not None:
        columns.xyz_mm.extend(value + more for value, more in zip(move.place.xyz_mm, move.offset_mm, strict=True))
        columns.turn.extend(move.place.turn)
    else:
        columns.xyz_mm.extend(move.offset_mm if move.target is not None else [math.nan] * 3)
        columns.turn.extend([math.nan] * len(found.profile.orientation.fields))
    columns.move_line.append(move.line)
    columns.target.append(NONE if move.target is None else columns.targets.of(move.target))
    columns.context.append(columns.contexts.of(move.context))
    columns.stated.append(stated.by)
    columns.number.append(stated.number)
    columns.factor.append(stated.factor)
    columns.start.append(stated.span[0])
    columns.end.append(stated.span[1])
    groups = statement.match.re.groupindex
    here = statement.match.start("here") if "here" in groups else -1
    columns.here.append(here)
    columns.there.append(statement.match.start("there") if "there" in groups else here)
    begin, end = statement.match.span()
    columns.begin.append(begin)
    columns.until.append(end)
    columns.stops.append(move.stops)
    columns.arc.append("via" in groups)
    feed_of = name_of_feed(found, statement)
    columns.feed_of.append(NONE if feed_of is None else columns.names.of(feed_of))
    columns.dwell.append(NONE)


def _approach(found: Scan, statement: MatchedStatement) -> None:
    _inside(found, statement)
    found.at = None
    target, fields, place = statement.text("target"), statement.match.re.groupindex, None
    if found.profile.modal_axes:
        place = modal_place(found, statement) if "x" in fields else None
    elif found.columns is not None and "x" in fields and statement.text("x") is not None:
        place = place_of(found, statement)
    if "x" not in fields:  # it leads to a location that the program does not state
        machine = statement.text("machine")
        for axis in ("x", "y", "z", *found.profile.orientation.fields) if machine else "xyz":
            if machine is None or axis in machine.lower():
                found.axes[axis] = math.nan
    if found.columns is not None:
        named = None if target is None else found.folded(target)
        move = Move(
            statement.line, place, named, _offset(found, statement), False, math.nan, context_at(found, statement)
        )
        _keep_motion(found, statement, move, StatedTime(StatedBy.APPROACH))


def _dwell(found: Scan, statement: MatchedStatement) -> None:
    _inside(found, statement)
    time = statement.number("time")
    if time is None or not 0 <= time < math.inf:
        raise found.refuse(statement, "a dwell is a time of zero or more", "correct it")
    move = found.at
    if move is not None:
        if found.dwelled:
            raise found.refuse(statement, "two dwells at one point", "write their sum in one")
        if not move.stops and statement.kind == "dwell":
            _fly_by(found, statement, move)
        found.dwelled = True
        if found.columns is not None:
            if found.keep_columns:
                found.columns.dwell[-1] = len(found.points)
            else:
                found.columns = None
        _keep_point(found, statement, time, move)
    found.dwells += 1


def _keep_point(found: Scan, statement: MatchedStatement, time: float, move: Move) -> None:
    """A move and its dwell are a point."""
    points, place = found.points, move.place
    if place is None:
        points.xyz_mm.extend(move.offset_mm)
        points.turn.extend([math.nan] * len(found.profile.orientation.fields))
    else:
        points.xyz_mm.extend(value + more for value, more in zip(place.xyz_mm, move.offset_mm, strict=True))
        points.turn.extend(place.turn)
    points.feed_mm_min.append(move.feed_mm_min)
    points.time.append(time)
    points.move_line.append(move.line)
    points.dwell_line.append(statement.line)
    start, end = statement.match.span("time")
    points.number_line.append(statement.line + found.source.data.count(b"\n", statement.match.start(), start))
    points.start.append(start)
    points.end.append(end)
    points.target.append(NONE if move.target is None else points.targets.of(move.target))
    points.context.append(points.contexts.of(move.context))


def _fly_by(found: Scan, statement: MatchedStatement, move: Move) -> None:
    if found.profile.dwell.fly_by == "refuse":
        raise found.refuse(
            statement,
            f"a dwell after the fly-by move of line {move.line}: it need not be spent at the point",
            "end the move with an exact stop",
        )
    found.warnings[
        "dwells after fly-by moves: the controller stops there all the same, as it plans no further than a wait"
    ] = None


def _neutral(found: Scan, statement: MatchedStatement) -> None:
    for name in ("tool", "frame"):
        text = statement.text(name)
        if text is not None:
            found.modal[name] = text
    if (section := statement.text("section")) is not None:
        found.section = section
    if statement.text("target") is not None:
        take_unread_position(found, statement)
    if (zone := statement.text("zone")) is not None:
        found.zones[name_of_feed(found, statement)] = zone
    if (override := statement.text("override")) is not None:
        found.override_line = 0 if _is_whole(override) else statement.line
    if (limit := statement.text("speed_limit")) is not None:
        found.limit_line = 0 if _is_high(found, limit) else statement.line
    if (feed := statement.text("feed")) is not None:
        found.feeds[name_of_feed(found, statement)] = ModalFeed(
            feed, statement.text("feed_unit") or "", statement.match.span("feed")
        )


def _is_whole(override: str) -> bool:
    """Whether an override is 100 %."""
    return is_number(override) and float(override) == 100


def _is_high(found: Scan, limit: str) -> bool:
    """Whether a limit of the speed lets all timed moves have the speeds that they state, or that are written later."""
    rules = found.profile.move_time
    least = 0.0 if rules is None else 60 * rules.greatest_mm_s
    return is_number(limit) and float(limit) * feed_unit_mm_min(found, "") >= least * (1 - 1e-9)


def _assumed(found: Scan, statement: MatchedStatement) -> None:
    context = found.named_contexts.get(found.folded(statement.text("context_name") or ""))
    if context is None:
        found.warnings[statement.note] = None
        return
    found.modal |= {name: text for name, text in zip(("tool", "frame"), context, strict=True) if text is not None}


def _begin(found: Scan, statement: MatchedStatement) -> None:
    if found.routine is not None:
        raise found.refuse(statement, "a routine inside a routine", "have it posted as one routine")
    found.routine, found.begun = found.folded(statement.text("program") or ""), statement
    found.routines.add(found.routine)
    found.body_lines = found.counted = 0


def _end(found: Scan, statement: MatchedStatement) -> None:
    if found.routine is None:
        raise found.refuse(statement, "the end of a routine that has not begun", "remove it")
    found.routine, found.at = None, None
    if found.moving is not None and found.moving is found.begun:
        found.moving_lines = found.body_lines


def _run(found: Scan, statement: MatchedStatement) -> None:
    if found.routine is not None:
        raise found.refuse(statement, "calls are not read", "have it posted as one routine")
    moving = found.moving.text("program") if found.moving else None
    if found.folded(statement.text("program") or "") != found.folded(moving or ""):
        raise found.refuse(statement, "a call of something else than the routine that moves", "remove it")
    found.finished = True


def _call(found: Scan, statement: MatchedStatement) -> None:
    """A call inside a routine: whether its routine exists is known at the end of the file."""
    name = statement.text("routine") or ""
    if found.routine is None:
        raise found.refuse(statement, "a call outside any routine", "remove it")
    if found.folded(name) in found.calls:
        first = found.calls[found.folded(name)][0].line
        raise found.refuse(
            statement, f"a second call of {name} (the first is in line {first})", "have it posted as one routine"
        )
    found.calls[found.folded(name)] = statement, found.routine


def _check_calls(found: Scan) -> None:
    """ProgramError at a call of a routine that is not in the file, or where a routine calls itself."""
    done: set[str] = set()
    for name, (statement, _) in found.calls.items():
        if name not in found.routines:
            raise found.refuse(
                statement,
                "a call, or a statement that the profile does not know: the file has no routine of this name",
                "have it posted with all routines in one file",
            )
        above, passed = name, set[str]()
        while above in found.calls and above not in done:
            if above in passed:
                raise found.refuse(statement, "a routine that calls itself", "have it posted as one routine")
            passed.add(above)
            above = found.calls[above][1]
        done |= passed


def _finish(found: Scan, statement: MatchedStatement) -> None:
    if found.routine is not None:
        raise found.refuse(statement, "the end of the file inside a routine", "check that it is whole")
    found.finished = True


_TAKE = {
    "move": _move, "approach": _approach, "dwell": _dwell, "dwell_in_position": _dwell, "position": take_position,
    "speed": take_speed, "context": take_context, "neutral": _neutral, "assumed": _assumed, "begin": _begin,
    "end": _end, "run": _run, "call": _call, "finish": _finish,
}  # fmt: skip


def _require_running(found: Scan, statement: MatchedStatement) -> None:
    """ProgramError at a motion or dwell behind the statement that ends the program."""
    if found.ended_line and statement.kind in _MOTION:
        raise found.refuse(
            statement,
            f"a motion or dwell after the end of the program in line {found.ended_line}",
            "remove it, or the end before it",
        )
    if statement.text("ends") is not None:
        found.ended_line = statement.line


_MOTION = frozenset({"move", "approach", "dwell", "dwell_in_position"})


def _inside(found: Scan, statement: MatchedStatement) -> None:
    """A motion or dwell stands in the one routine that moves."""
    if "begin" not in found.profile.kinds:
        return
    if found.begun is None or found.routine is None:
        raise found.refuse(statement, "a motion or dwell outside any routine", "check that the program is whole")
    if found.moving is None:
        found.moving = found.begun
    if found.moving is not found.begun:
        raise found.refuse(
            statement,
            f"a second routine that moves (the first begins in line {found.moving.line}): which runs when is not read",
            "have it posted as one routine",
        )
