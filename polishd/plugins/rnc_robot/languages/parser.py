"""Moves, dwells and positions of a program in a robot language, with all refusals."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, field

from polishd.api import ProgramError
from polishd.plugins.rnc_robot.languages.columns import (
    NONE,
    Context,
    MoveColumns,
    PointColumns,
    Positions,
    StatedBy,
    WrittenPose,
    is_rotation,
)
from polishd.plugins.rnc_robot.languages.profile import NUMBER, DataFile, LanguageProfile
from polishd.plugins.rnc_robot.languages.statements import (
    MatchedStatement,
    ProgramSource,
    require_short_lines,
    statements,
)

LARGEST_MM = 1e6
_NUMBER = re.compile(NUMBER)
NOWHERE = (-1, -1)
"""Span of a number that is not in the program's text."""
POSTED = "have it posted again with the positions written out"


@dataclass(frozen=True, slots=True)
class Move:
    """A feed move to a pose, or to a declared position with an offset."""

    line: int
    place: WrittenPose | None
    target: str | None
    offset_mm: tuple[float, float, float]
    stops: bool
    feed_mm_min: float
    context: Context


@dataclass(frozen=True, slots=True)
class ModalFeed:
    """A speed that holds for the moves behind it."""

    text: str
    unit: str
    span: tuple[int, int]


@dataclass(frozen=True, slots=True)
class StatedTime:
    """What states the time of a move, and where."""

    by: StatedBy
    number: float = math.nan
    factor: float = math.nan
    """One unit of the number, in s or in mm/min."""
    span: tuple[int, int] = (-1, -1)


@dataclass(slots=True)
class Scan:
    """A whole program: its points as columns, the rest counted."""

    profile: LanguageProfile
    source: ProgramSource
    kept: list[MatchedStatement] | None = None
    """All statements, on request only: a kilobyte each."""
    points: PointColumns = field(default_factory=PointColumns)
    columns: MoveColumns | None = field(default_factory=MoveColumns)
    """All motions; None once a dwell has shown that dwells carry the time, unless all are wanted."""
    keep_columns: bool = False
    positions: Positions = field(default_factory=Positions)
    positions_beside: int = 0
    """So many of these, the first ones, are declared in the file beside the program."""
    used: set[str] = field(default_factory=set)
    """Names of positions that motions lead to, where some are declared in the file beside the program."""
    named_contexts: dict[str, Context] = field(default_factory=dict)
    """Declared tools and frames by name."""
    calls: dict[str, tuple[MatchedStatement, str]] = field(default_factory=dict)
    """The call of each routine and the routine that it stands in, by the name of the called one."""
    routines: set[str] = field(default_factory=set)
    moves: int = 0
    """Feed moves."""
    dwells: int = 0
    bare_line: int = 0
    """Of the first feed move without a dwell, as far as the next move is read; 0: none."""
    body_lines: int = 0
    """Lines with statements in the routine that is open, or was the last; of the file, where there are no routines."""
    moving_lines: int = 0
    """Of the routine that moves, once it ended."""
    line: int = 0
    """Of the last statement that was read."""
    counted: int = 0
    """The line that ``body_lines`` counted last."""
    override_line: int = 0
    """Line of the override that holds, where it is not 100 %; 0: none."""
    slowed_line: int = 0
    """Line of an override at which a move ran."""
    warnings: dict[str, None] = field(default_factory=dict)
    modal: dict[str, str] = field(default_factory=dict)
    zones: dict[str | None, str] = field(default_factory=dict)
    """The zone that was set last, by the name that it was set for."""
    feeds: dict[str | None, ModalFeed] = field(default_factory=dict)
    """The speed that was set last, by the name that it was set for."""
    axes: dict[str, float] = field(default_factory=dict)
    """Coordinates that were stated last, where these hold."""
    speeds: dict[str, float] = field(default_factory=dict)
    """Declared speeds by name, mm/min."""
    last: Move | None = None
    """The last feed move."""
    at: Move | None = None
    """The feed move at whose end the robot stands: that one, or none."""
    dwelled: bool = False
    """The last feed move has its dwell."""
    routine: str | None = None
    """Name of the routine that is open."""
    moving: MatchedStatement | None = None
    """Begin of the routine that moves."""
    begun: MatchedStatement | None = None
    finished: bool = False

    def refuse(self, statement: MatchedStatement, reason: str, advice: str) -> ProgramError:
        """The error at a statement."""
        return self.refuse_line(statement.line, reason, advice)

    def refuse_line(self, line: int, reason: str, advice: str) -> ProgramError:
        """The error at a line."""
        return self.source.refuse(line, reason, advice)

    @property
    def undeclared(self) -> str:
        """What to do about a position that is not declared."""
        rules = self.profile.data_file
        return (
            POSTED if rules is None else f"put the {rules.ending} file that declares it beside the program, or {POSTED}"
        )

    def folded(self, name: str) -> str:
        """A name as the language compares it; of an array of the file beside the program, the first element is its."""
        rules = self.profile.data_file
        if rules is not None and rules.form == "xml":
            name = name.removesuffix("[0]")
        return name.lower() if self.profile.ignore_case else name


def scan(
    profile: LanguageProfile,
    text: bytes,
    name: str,
    beside: bytes = b"",
    *,
    keep: bool = False,
    keep_columns: bool = False,
) -> Scan:
    """Read a program through. ProgramError where it may mean several things.

    Args:
        profile: the language.
        text: the program.
        name: for messages.
        beside: content of the file beside it that declares its positions.
        keep: keep all its statements, too.
        keep_columns: keep the columns of all its motions, although dwells carry the time.
    """
    found = Scan(profile, ProgramSource(text, name, beside), [] if keep else None, keep_columns=keep_columns)
    if profile.move_time is None:
        found.columns = None
    if beside:
        _take_declarations(found)
    for statement in statements(profile, found.source):
        if found.finished:
            raise found.refuse(statement, "a statement after the end of the program", "remove it")
        if found.kept is not None:
            found.kept.append(statement)
        found.line = statement.line
        if statement.kind not in {"begin", "end"} and found.counted != statement.line:
            found.counted, found.body_lines = statement.line, found.body_lines + 1
        _TAKE[statement.kind](found, statement)
    unfinished = "finish" in profile.kinds and not found.finished
    if found.line and (unfinished or found.routine is not None):
        raise found.refuse_line(found.line, "the program breaks off: its end is missing", "check that it is whole")
    _check_calls(found)
    _leave_bare(found)
    return found


def _move(found: Scan, statement: MatchedStatement) -> None:
    _inside(found, statement)
    target = statement.text("target")
    stated = _stated(found, statement)
    move = Move(
        statement.line,
        place_of(found, statement) if target is None else None,
        None if target is None else found.folded(target),
        _offset(found, statement),
        _stops(found, statement),
        stated.number * stated.factor if stated.by > StatedBy.TIME else math.nan,
        _context(found, statement),
    )
    if target is not None and found.profile.declare_before_use and move.target not in found.positions:
        raise found.refuse(statement, f"the position {target} is not declared before its use", found.undeclared)
    _keep_motion(found, statement, move, stated)
    found.slowed_line = found.slowed_line or found.override_line
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
    feed_of = _feed_of(found, statement)
    columns.feed_of.append(NONE if feed_of is None else columns.names.of(feed_of))
    columns.dwell.append(NONE)


def _approach(found: Scan, statement: MatchedStatement) -> None:
    _inside(found, statement)
    found.at = None
    target, fields, place = statement.text("target"), statement.match.re.groupindex, None
    if found.profile.modal_axes:
        place = _modal_place(found, statement) if "x" in fields else None
    elif found.columns is not None and "x" in fields and statement.text("x") is not None:
        place = place_of(found, statement)
    if "x" not in fields:  # it leads to a location that the program does not state
        for axis in "xyz":
            found.axes.pop(axis, None)
    if found.columns is not None:
        named = None if target is None else found.folded(target)
        move = Move(
            statement.line, place, named, _offset(found, statement), False, math.nan, _context(found, statement)
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


def _position(found: Scan, statement: MatchedStatement) -> None:
    name = statement.text("target") or ""
    if found.folded(name) in found.positions:
        number = found.positions.number[found.folded(name)]
        if number >= found.positions_beside:
            other = found.positions.line[number]
            raise found.refuse(statement, f"the position {name} is declared in line {other} too", "keep one of them")
        if found.folded(name) in found.used:
            raise found.refuse(
                statement,
                f"the position {name} gets another value after a move to its value in the file beside the program",
                "use two positions",
            )
    context: Context = statement.text("tool"), statement.text("frame")
    if found.profile.modal_positions:
        context = _context(found, statement)
    found.positions.add(found.folded(name), place_of(found, statement), statement.line, context)


_DATA = re.compile(rb"<(/?)(Data|Value)\b([^<>]*)>")
_ATTRIBUTE = re.compile(rb"([A-Za-z_][\w:.-]*)\s*=\s*(?:\"([^\"<]*)\"|'([^'<]*)')")


def _take_declarations(found: Scan) -> None:
    """Positions, speeds, tools and frames from the file beside the program; all else in it does not count."""
    rules = found.profile.data_file
    if rules is None:
        return
    source = ProgramSource(found.source.beside, f"{found.source.name}: {rules.title}")
    other = Scan(found.profile, source)
    if rules.form == "xml":
        _take_elements(other, rules)
    else:
        _take_statements(other)
    found.positions, found.positions_beside = other.positions, len(other.positions.line)
    found.speeds, found.named_contexts = other.speeds, other.named_contexts
    found.feeds, found.zones = other.feeds, other.zones


def _take_statements(other: Scan) -> None:
    """Declarations at the begin of a line."""
    wanted = {"position": _position, "speed": _speed, "context": _declared_context}
    patterns = [pattern for pattern in other.profile.patterns if pattern.kind in wanted]
    require_short_lines(other.source)
    at = 0
    for line, text in enumerate(other.source.data.splitlines(keepends=True), 1):
        start = at + len(text) - len(text.lstrip())
        at += len(text)
        for pattern in patterns:
            if match := pattern.regex.match(other.source.data, start):
                wanted[pattern.kind](other, MatchedStatement(pattern.kind, match, line))
                break


def _take_elements(other: Scan, rules: DataFile) -> None:
    """Elements of XML arrays, each under ``name[key]``."""
    name = kind = ""
    at, line = 0, 1
    data = _without_comments(other.source.data)
    for match in _DATA.finditer(data):
        line += data.count(b"\n", at, match.start())
        at = match.start()
        named = {
            key.decode("latin-1"): (one or two).decode("latin-1") for key, one, two in _ATTRIBUTE.findall(match[3])
        }
        if match[2] == b"Data":
            name, kind = ("", "") if match[1] else (named.get("name", ""), named.get("type", ""))
            continue
        key = named.get("key", "")
        if match[1] or not name or not key.isdigit():
            continue
        if kind in rules.positions:
            _take_position(other, rules, f"{name}[{key}]", named, line)
        elif kind in rules.speeds:
            _take_speed(other, rules, f"{name}[{key}]", named)


def _without_comments(data: bytes) -> bytes:
    """XML with its comments blanked, line by line as long as before."""
    pieces, at = [], 0
    while (start := data.find(b"<!--", at)) >= 0:
        end = data.find(b"-->", start)
        end = len(data) if end < 0 else end
        pieces += [data[at:start], b"\n" * data.count(b"\n", start, end)]
        at = end
    return b"".join([*pieces, data[at:]])


def _take_position(other: Scan, rules: DataFile, name: str, named: dict[str, str], line: int) -> None:
    fields = ("x", "y", "z", *other.profile.orientation.fields)
    texts = [named.get(field, "0") for field in fields]
    if not all(_NUMBER.fullmatch(text) for text in texts):
        raise other.refuse_line(line, f"a value of {name} is no number", "correct it")
    pose = pose_of(other, line, [float(text) for text in texts])
    if other.folded(name) in other.positions:
        raise other.refuse_line(line, f"the position {name} is declared twice", "keep one of them")
    other.positions.add(other.folded(name), pose, line, (None, named.get(rules.frame)))


def _take_speed(other: Scan, rules: DataFile, name: str, named: dict[str, str]) -> None:
    """A speed that cannot be rewritten, as it is not in the program: until the program sets another."""
    if _NUMBER.fullmatch(named.get(rules.feed, "")):
        other.feeds[other.folded(name)] = ModalFeed(named[rules.feed], "", NOWHERE)
    if rules.zone in named:
        other.zones[other.folded(name)] = named[rules.zone]


def _neutral(found: Scan, statement: MatchedStatement) -> None:
    for name in ("tool", "frame"):
        text = statement.text(name)
        if text is not None:
            found.modal[name] = text
    if (zone := statement.text("zone")) is not None:
        found.zones[_feed_of(found, statement)] = zone
    if (override := statement.text("override")) is not None:
        found.override_line = 0 if _is_whole(override) else statement.line
    if (feed := statement.text("feed")) is not None:
        found.feeds[_feed_of(found, statement)] = ModalFeed(
            feed, statement.text("feed_unit") or "", statement.match.span("feed")
        )


def _is_whole(override: str) -> bool:
    """Whether an override is 100 %."""
    return _NUMBER.fullmatch(override) is not None and float(override) == 100


def _feed_of(found: Scan, statement: MatchedStatement) -> str | None:
    name = statement.text("feed_of")
    return None if name is None else found.folded(name)


def _speed(found: Scan, statement: MatchedStatement) -> None:
    """A speed declared under a name."""
    factor = _factor(found, statement.text("feed_unit"))
    found.speeds[found.folded(statement.text("feed_name") or "")] = (statement.number("rate") or math.nan) * factor


def _declared_context(found: Scan, statement: MatchedStatement) -> None:
    """A tool and a frame declared under a name."""
    name = found.folded(statement.text("context_name") or "")
    found.named_contexts[name] = statement.text("tool"), statement.text("frame")


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
    "move": _move, "approach": _approach, "dwell": _dwell, "dwell_in_position": _dwell, "position": _position,
    "speed": _speed, "context": _declared_context, "neutral": _neutral, "assumed": _assumed, "begin": _begin,
    "end": _end, "run": _run, "call": _call, "finish": _finish,
}  # fmt: skip


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


def place_of(found: Scan, statement: MatchedStatement) -> WrittenPose:
    """The pose that a statement writes out."""
    if found.profile.modal_axes:
        place = _modal_place(found, statement)
    else:
        written = [statement.number(name) for name in ("x", "y", "z", *found.profile.orientation.fields)]
        place = None if None in written else pose_of(found, statement.line, [value or 0.0 for value in written])
    if place is None:
        raise found.refuse(statement, "the position is not complete", POSTED)
    return place


def _modal_place(found: Scan, statement: MatchedStatement) -> WrittenPose | None:
    """The pose of what a statement writes out and of what holds from before; None where no x, y or z holds."""
    turns = found.profile.orientation.fields
    values = {name: statement.number(name) for name in ("x", "y", "z", *turns)}
    found.axes |= {name: value for name, value in values.items() if value is not None}
    if not {"x", "y", "z"} <= found.axes.keys():
        return None
    return pose_of(
        found, statement.line, [*(found.axes[axis] for axis in "xyz"), *(found.axes.get(t, 0.0) for t in turns)]
    )


def pose_of(found: Scan, line: int, written: Sequence[float]) -> WrittenPose:
    """The pose of x, y, z and the fields of the orientation; ProgramError where it is none."""
    profile = found.profile
    x, y, z, *turn = written
    xyz_mm = x * profile.unit_mm, y * profile.unit_mm, z * profile.unit_mm
    if not max(map(abs, xyz_mm)) <= LARGEST_MM:
        raise found.refuse_line(line, "a position beyond any robot", "correct it")
    if not is_rotation(profile.orientation.convention, turn):
        raise found.refuse_line(line, "the orientation is no rotation", "correct it")
    return WrittenPose(xyz_mm, tuple(turn))


def _stops(found: Scan, statement: MatchedStatement) -> bool:
    profile = found.profile
    own = "zone" in statement.match.re.groupindex
    zone = statement.text("zone") if own else found.zones.get(_feed_of(found, statement), found.zones.get(None))
    if zone is None:
        return not profile.blends_without_zone
    if zone.lower() in profile.exact_stop:
        return True
    try:
        return float(zone) == 0
    except ValueError:
        return False


def _factor(found: Scan, unit: str | None) -> float:
    """One written unit of a speed, mm/min; NaN where it is not known."""
    return found.profile.feed_units_mm_min.get((unit or "").lower(), math.nan)


def _stated(found: Scan, statement: MatchedStatement) -> StatedTime:
    """What states the move's time: its own time or speed, or a speed that was set before."""
    rules, groups = found.profile.move_time, statement.match.re.groupindex
    if statement.number("t"):
        factor = math.nan if rules is None else rules.units_s.get((statement.text("t_unit") or "").lower(), math.nan)
        return StatedTime(StatedBy.TIME, statement.number("t") or math.nan, factor, statement.match.span("t"))
    if statement.text("rate") is not None:
        number = statement.number("rate") or math.nan
        factor = _factor(found, statement.text("feed_unit"))
        return StatedTime(StatedBy.RATE, number, factor, statement.match.span("rate"))
    named = statement.text("feed_name")
    if named is not None:
        declared = found.speeds.get(found.folded(named), math.nan)
        return StatedTime(StatedBy.UNKNOWN if math.isnan(declared) else StatedBy.FIXED, declared, 1.0)
    own = statement.text("feed")
    unit: str | None = statement.text("feed_unit")
    holds = rules is not None and rules.feed_holds
    by, span = StatedBy.RATE, statement.match.span("feed") if own is not None else (-1, -1)
    if own is None and ("feed" not in groups or holds):
        modal = found.feeds.get(_feed_of(found, statement), ModalFeed("", "", span))
        own, unit, by, span = modal.text or None, modal.unit, StatedBy.MODAL, modal.span
    elif own is not None and holds:
        found.feeds[None] = ModalFeed(own, unit or "", span)
    if own is None:
        return StatedTime(StatedBy.UNKNOWN)
    try:
        number = float(own)
    except ValueError:
        return StatedTime(StatedBy.UNKNOWN)
    if by is StatedBy.RATE and rules is not None and rules.fixed_feeds:
        by = StatedBy.FIXED
    return StatedTime(by, number, _factor(found, unit), span)


def _context(found: Scan, statement: MatchedStatement) -> Context:
    """Tool and frame that the move is written for."""
    if (name := statement.text("context_name")) is not None:
        base = statement.text("base_name") or name
        if found.folded(base) != found.folded(name):
            raise found.refuse(statement, f"the tool of {name} with the base of {base}", "name one of them for both")
        context = found.named_contexts.get(found.folded(name))
        if context is not None:
            return context
        found.warnings["tools and frames that moves name are declared elsewhere: taken to be the same at all"] = None
        return None, None
    tool, frame = (
        statement.text(name) if name in statement.match.re.groupindex else found.modal.get(name)
        for name in ("tool", "frame")
    )
    return tool, frame
