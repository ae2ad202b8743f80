"""Where the moves of a program in a robot language lead, and which of them carry their own time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from polishd.api import ProgramError
from polishd.model.program import IntArray, MoveTiming
from polishd.model.surface import BoolArray, FloatArray
from polishd.plugins.rnc_robot.languages.columns import (
    NONE,
    MoveColumns,
    PointColumns,
    StatedBy,
    ValueNumbers,
    numbers,
    table,
)
from polishd.plugins.rnc_robot.languages.profile import LanguageProfile, MoveTime
from polishd.plugins.rnc_robot.languages.program_scan import Scan

SAME_PLACE_MM = 1e-6
Names = tuple[str | None, ...]


def locations(
    found: Scan, points: PointColumns | MoveColumns, required: IntArray | None = None
) -> tuple[FloatArray, FloatArray]:
    """Where motions lead, (n, 3) mm and (n, k) as the profile writes it; NaN where the program does not state it.

    ProgramError unless the ``required`` ones (default: all) have a position, with one tool in one frame.
    """
    rows = len(points)
    wanted = np.arange(rows) if required is None else required
    xyz_mm, turn = table(points.xyz_mm, rows).copy(), table(points.turn, rows).copy()
    declared, to = declared_positions(found, points), numbers(points.target) != NONE
    _require_one_context(found, points, wanted, declared)
    known, lost = np.flatnonzero(declared != NONE), np.flatnonzero(to & (declared == NONE))
    if known.size:
        count = len(found.positions.line)
        xyz_mm[known] = table(found.positions.xyz_mm, count)[declared[known]] + xyz_mm[known]
        turn[known] = table(found.positions.turn, count)[declared[known]]
    xyz_mm[lost] = np.nan
    return xyz_mm, turn


def contexts(found: Scan, points: PointColumns | MoveColumns, declared: IntArray) -> tuple[IntArray, list[Names]]:
    """(n,) number of tool and frame of each motion, those of its declared position included, and these by number."""
    own, theirs = points.contexts.values(), found.positions.contexts.values()
    of_position = np.full(len(points), NONE)
    known = declared != NONE
    of_position[known] = numbers(found.positions.context)[declared[known]]
    pairs, which = np.unique(numbers(points.context) * (len(theirs) + 1) + of_position + 1, return_inverse=True)
    named = ValueNumbers[Names]()

    def number(pair: int) -> int:
        move, position = divmod(pair, len(theirs) + 1)
        both = (*own[move], *((None, None) if position == 0 else theirs[position - 1]))
        return named.of(tuple(name and found.folded(name) for name in both))

    of_pair = np.array([number(pair) for pair in pairs.tolist()], dtype=np.int64)
    return of_pair[which], named.values()


def declared_positions(found: Scan, points: PointColumns | MoveColumns) -> IntArray:
    """(n,) number of the declared position that each motion leads to; ``NONE``: none, or an unknown one."""
    number = np.array([found.positions.number.get(name, NONE) for name in points.targets.values()], dtype=np.int64)
    target = numbers(points.target)
    declared, to = np.full(len(points), NONE), target != NONE
    declared[to] = number[target[to]]
    return declared


def context_of(found: Scan) -> Names:
    """What a program's points are written for, as the language compares it; None where the program does not name it."""
    points = found.points if len(found.points) or found.columns is None else found.columns
    _, named = contexts(found, points, declared_positions(found, points))
    if not named:
        return None, None
    own, of_position = named[-1][:2], named[-1][2:]
    tool, frame = (a or b for a, b in zip(own, of_position, strict=True))
    rest = found.profile.make.unnamed_frame if found.profile.make is not None else ""
    return tool, frame or found.folded(rest) or None


def _require_one_context(found: Scan, points: PointColumns | MoveColumns, wanted: IntArray, declared: IntArray) -> None:
    """ProgramError at the first wanted motion, in program order, to an unknown position or in another tool or frame."""
    unknown = (numbers(points.target)[wanted] != NONE) & (declared[wanted] == NONE)
    lost = int(wanted[np.argmax(unknown)]) if unknown.any() else len(points)
    number, named = contexts(found, points, declared)
    other = wanted[number[wanted] != number[wanted[:1]]] if wanted.size else wanted
    if other.size and other[0] < lost:
        at = int(other[0])
        raise found.refuse_line(
            points.move_line[at],
            f"another tool or frame ({_named(named[number[at]])}) than at the first point "
            f"({_named(named[number[wanted[0]]])})",
            "have it posted with one tool in one frame",
        )
    if lost < len(points):
        name = points.targets.values()[points.target[lost]]
        if found.folded(name) in found.unread:
            raise found.refuse_line(points.move_line[lost], *found.why_unread(name))
        raise found.refuse_line(
            points.move_line[lost], f"the position {name} is not declared as a constant in this file", found.undeclared
        )


def _named(context: Sequence[object]) -> str:
    return ", ".join(str(name) for name in context if name) or "none"


@dataclass(frozen=True, slots=True)
class TimedMoves:
    """The moves of a program that carry their time, n of m motions."""

    columns: MoveColumns
    rows: IntArray
    """(n,) of the columns."""
    start_mm: FloatArray
    end_mm: FloatArray
    turn: FloatArray
    time_s: FloatArray
    feed_mm_min: FloatArray
    stops: BoolArray
    warnings: tuple[str, ...]
    fast: IntArray
    """(k,) of the columns: feed moves that are faster than ``greatest_mm_s``."""

    @property
    def length_mm(self) -> FloatArray:
        """(n,) length of each move."""
        return np.asarray(np.linalg.norm(self.end_mm - self.start_mm, axis=1), dtype=np.float64)

    @property
    def stated(self) -> IntArray:
        """(n,) `StatedBy` of each move."""
        return numbers(self.columns.stated)[self.rows]


def timed_moves(found: Scan) -> TimedMoves:
    """The timed moves of a program without dwells at its points, or of one that was scanned with all its columns.

    ProgramError at the first feed move whose time is not known, and at arcs that carry their time.
    """
    columns, rules = require_rules(found)
    if found.slowed_line:
        raise found.refuse_line(
            found.slowed_line,
            "an override that is not 100 %: the moves do not take the time that they state",
            "have it posted with an override of 100 %, or with waits",
        )
    if found.limited_line:
        raise found.refuse_line(
            found.limited_line,
            f"a limit of the speed below {rules.greatest_mm_s:g} mm/s (move_time.greatest_mm_s): moves may take longer "
            "than they state",
            "have it posted with a higher limit or with waits, or set greatest_mm_s to the limit in a profile that "
            "extends this one",
        )
    stated, number, factor = numbers(columns.stated), np.array(columns.number), np.array(columns.factor)
    feed = np.where(stated > StatedBy.TIME, number * factor, np.nan)
    with np.errstate(invalid="ignore"):
        travel = feed > 60 * rules.greatest_mm_s * (1 + 1e-9)
    moving = (stated != StatedBy.APPROACH) & ~travel
    start_mm, end_mm, turn = _moved(found, columns, np.flatnonzero(moving))
    length = np.linalg.norm(end_mm - start_mm, axis=1)
    lost, still = moving & np.isnan(length), moving & (length <= SAME_PLACE_MM)
    timed = moving & ~lost & ~still
    dwelled = numbers(columns.dwell) != NONE
    _refuse_first(found, columns, timed & (numbers(columns.arc) != 0), "an arc cannot carry its time", POSTED_LINES)
    unknown = timed & ~dwelled & np.isnan(np.where(stated == StatedBy.TIME, number * factor, feed))
    _refuse_first(
        found, columns, unknown, "the speed of this move is no number: how long it takes is not known", WRITTEN
    )
    zero = timed & ~dwelled & (stated > StatedBy.TIME) & (feed <= 0)
    _refuse_first(found, columns, zero, "a speed of zero", "correct it")
    given = np.where(stated == StatedBy.TIME, number * factor, 1.0)
    wrong = timed & ~dwelled & ~((given > 0) & np.isfinite(given))
    _refuse_first(found, columns, wrong, "the time of a move is a number of seconds above zero", "correct it")
    rows = np.flatnonzero(timed)
    with np.errstate(invalid="ignore", divide="ignore"):
        time_s = np.where(stated == StatedBy.TIME, number * factor, 60 * length / feed)
        feed = np.where(stated == StatedBy.TIME, 60 * length / time_s, feed)
    counts = ((lost, "start at a position that the program does not state"), (still, "go nowhere"),
              (travel, f"are faster than {rules.greatest_mm_s:g} mm/s"))  # fmt: skip
    warnings = tuple(
        f"{int(which.sum())} feed moves {what}: they are not points, and their time is not changed"
        for which, what in counts
        if which.any()
    )
    stops = numbers(columns.stops)[rows] != 0
    return TimedMoves(
        columns,
        rows,
        start_mm[rows],
        end_mm[rows],
        turn[rows],
        time_s[rows],
        feed[rows],
        stops,
        warnings,
        np.flatnonzero(travel),
    )


WRITTEN = "have it posted with the speed or the time of each move written as a number"
POSTED_LINES = "have it posted with straight moves"


def require_rules(found: Scan) -> tuple[MoveColumns, MoveTime]:
    """Columns of the motions and rules of their time; ProgramError where the language has none."""
    if found.columns is None or found.profile.move_time is None:
        raise ProgramError(
            f"{found.source.name}: in {found.profile.name} time sits in dwells. "
            "To do: keep the encoding, or add [move_time] to your own profile."
        )
    return found.columns, found.profile.move_time


def _refuse_first(found: Scan, columns: MoveColumns, bad: BoolArray, reason: str, advice: str) -> None:
    if bad.any():
        raise found.refuse_line(columns.move_line[int(np.argmax(bad))], reason, advice)


def _moved(found: Scan, columns: MoveColumns, moving: IntArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Where each motion starts and ends, (m, 3) mm, and its orientation; NaN where that is not stated."""
    end_mm, turn = locations(found, columns, moving)
    start_mm = np.full_like(end_mm, np.nan)
    if len(end_mm):
        context, _ = contexts(found, columns, declared_positions(found, columns))
        same = np.append(False, context[1:] == context[:-1])
        start_mm[1:] = end_mm[:-1]
        start_mm[~same] = np.nan
    return start_mm, end_mm, turn


def move_timing(profile: LanguageProfile, stops: BoolArray) -> MoveTiming | None:
    """The language's limits of the times of these moves."""
    rules = profile.move_time
    if rules is None:
        return None
    return MoveTiming(rules.least_mm_s, rules.greatest_mm_s, rules.quantum_s, rules.blend_share, stops)
