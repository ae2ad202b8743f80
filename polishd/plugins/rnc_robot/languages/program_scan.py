"""State of a program's reading, and what its statements state: poses, tools and frames, zones, speeds and times."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, field

from polishd.api import ProgramError
from polishd.plugins.rnc_robot.languages.columns import (
    Context,
    MoveColumns,
    PointColumns,
    Positions,
    StatedBy,
    WrittenPose,
    is_rotation,
)
from polishd.plugins.rnc_robot.languages.profile import NUMBER, LanguageProfile
from polishd.plugins.rnc_robot.languages.statements import MatchedStatement, ProgramSource

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
class LineNumbers:
    """The numbers of a program's lines, as far as it is read."""

    highest: int = 0
    at: int = 0
    """The program's line that has this number."""
    falls: tuple[int, int, int, int] | None = None
    """Line and number of the first whose number does not rise, and line and number of the one before it."""

    def add(self, line: int, written: bytes) -> None:
        """One more line, with its number; empty: none."""
        number = int(written or b"0")
        if number and number <= self.highest and self.falls is None:
            self.falls = line, number, self.at, self.highest
        if number:
            self.highest, self.at = number, line


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
    section: str = ""
    """What the last statement that begins a section of declared positions said."""
    unread: dict[str, tuple[int, str]] = field(default_factory=dict)
    """Line and section of positions that are declared in a way that is not read, by name."""
    declared: int = 0
    """Statements that declare a position."""
    numbers: LineNumbers = field(default_factory=LineNumbers)
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
    ended_line: int = 0
    """Line of the statement that ends the program; 0: none so far."""
    counted: int = 0
    """The line that ``body_lines`` counted last."""
    override_line: int = 0
    """Line of the override that holds, where it is not 100 %; 0: none."""
    slowed_line: int = 0
    """Line of an override at which a move ran."""
    limit_line: int = 0
    """Line of the limit of the speed that holds, where it is below that of timed moves; 0: none."""
    limited_line: int = 0
    """Line of such a limit at which a move ran."""
    warnings: dict[str, None] = field(default_factory=dict)
    modal: dict[str, str] = field(default_factory=dict)
    zones: dict[str | None, str] = field(default_factory=dict)
    """The zone that was set last, by the name that it was set for."""
    feeds: dict[str | None, ModalFeed] = field(default_factory=dict)
    """The speed that was set last, by the name that it was set for."""
    axes: dict[str, float] = field(default_factory=dict)
    """Coordinates that were stated last, where these hold; NaN: a move to machine coordinates left it unknown."""
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

    def why_unread(self, name: str) -> tuple[str, str]:
        """Why no move may lead to a declared position that is not among ``positions``, and what to do."""
        wanted, (line, section) = self.profile.position_section, self.unread[self.folded(name)]
        if not wanted or section == wanted:
            return f"the position {name} (line {line}) is not written as x, y, z and angles", POSTED
        where = f"is in pulses or angles of the axes (line {line}, under ///{section})"
        if not section:
            where = f"has no unit (line {line}): no ///{wanted} stands before it"
        return f"the position {name} {where}", f"have it posted with its positions in mm, under ///{wanted}"

    def folded(self, name: str) -> str:
        """A name as the language compares it; of an array of the file beside the program, the first element is its."""
        rules = self.profile.data_file
        if rules is not None and rules.form == "xml":
            name = name.removesuffix("[0]")
        return name.lower() if self.profile.ignore_case else name


# What a statement states, with what holds from before.


def is_number(text: str) -> bool:
    """Whether a text is a number as programs write it."""
    return _NUMBER.fullmatch(text) is not None


def place_of(found: Scan, statement: MatchedStatement) -> WrittenPose:
    """The pose that a statement writes out."""
    if found.profile.modal_axes:
        place = modal_place(found, statement)
    else:
        written = [statement.number(name) for name in ("x", "y", "z", *found.profile.orientation.fields)]
        place = None if None in written else pose_of(found, statement.line, [value or 0.0 for value in written])
    if place is None:
        raise found.refuse(statement, "the position is not complete", POSTED)
    return place


def modal_place(found: Scan, statement: MatchedStatement) -> WrittenPose | None:
    """The pose of what a statement writes out and of what holds from before; None where a coordinate is not known."""
    turns = found.profile.orientation.fields
    values = {name: statement.number(name) for name in ("x", "y", "z", *turns)}
    found.axes |= {name: value for name, value in values.items() if value is not None}
    if not {"x", "y", "z"} <= found.axes.keys() or any(map(math.isnan, found.axes.values())):
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


def name_of_feed(found: Scan, statement: MatchedStatement) -> str | None:
    """The name for which a statement sets, or takes, a speed or a zone; None: for all."""
    name = statement.text("feed_of")
    return None if name is None else found.folded(name)


def stops_at_end(found: Scan, statement: MatchedStatement) -> bool:
    """Whether the robot stops at the end of a move, by its zone or the zone that holds."""
    profile = found.profile
    own = "zone" in statement.match.re.groupindex
    zone = statement.text("zone") if own else found.zones.get(name_of_feed(found, statement), found.zones.get(None))
    if zone is None:
        return not profile.blends_without_zone
    if zone.lower() in profile.exact_stop:
        return True
    try:
        return float(zone) == 0
    except ValueError:
        return False


def feed_unit_mm_min(found: Scan, unit: str | None) -> float:
    """One written unit of a speed, mm/min; NaN where it is not known."""
    return found.profile.feed_units_mm_min.get((unit or "").lower(), math.nan)


def stated_time(found: Scan, statement: MatchedStatement) -> StatedTime:
    """What states the move's time: its own time or speed, or a speed that was set before."""
    rules, groups = found.profile.move_time, statement.match.re.groupindex
    if statement.number("t"):
        factor = math.nan if rules is None else rules.units_s.get((statement.text("t_unit") or "").lower(), math.nan)
        return StatedTime(StatedBy.TIME, statement.number("t") or math.nan, factor, statement.match.span("t"))
    if statement.text("rate") is not None:
        number = statement.number("rate") or math.nan
        factor = feed_unit_mm_min(found, statement.text("feed_unit"))
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
        modal = found.feeds.get(name_of_feed(found, statement), ModalFeed("", "", span))
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
    return StatedTime(by, number, feed_unit_mm_min(found, unit), span)


def context_at(found: Scan, statement: MatchedStatement) -> Context:
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
