"""From a program's text in a robot language to its columns of points."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from itertools import takewhile

import numpy as np

from polishd.api import Program, ProgramError
from polishd.model.surface import FloatArray
from polishd.plugins.rnc_robot.languages.orientation import tool_axis
from polishd.plugins.rnc_robot.languages.profile import Profile
from polishd.plugins.rnc_robot.languages.scan import POSTED, Dwell, Move, Place, Scan, scan
from polishd.plugins.rnc_robot.languages.statements import Statement

_UNITS = {1.0: "s", 0.001: "ms"}
FEW = 4
"""So many feed moves may lead in and out without a dwell, however few the points are."""


def read(profile: Profile, text: bytes, name: str) -> Program:
    """Read a program; ``name`` is for messages. A point is a feed move with its own dwell.

    ProgramError names the line, what is wrong with it and what to do.
    """
    found = scan(profile, text, name)
    pairs = points(found)
    places = _places(found, [move for move, _ in pairs])
    xyz_mm = np.array([place.xyz_mm for place in places]).reshape(-1, 3)
    turn = np.array([place.turn for place in places])
    feed = np.array([move.feed_mm_min for move, _ in pairs])
    line = np.array([_number_line(found, dwell) for _, dwell in pairs], dtype=np.int64)
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
        time_s=np.array([dwell.time for _, dwell in pairs]) * profile.dwell.unit_s,
        lines=lines,
        feed_mm_min=feed,
        unit=_UNITS.get(profile.dwell.unit_s, f"{profile.dwell.unit_s:g} s"),
        max_feed_mm_min=float(np.nanmax(feed, initial=0.0)),
        warnings=tuple(_warnings(found, feed, len(pairs))),
    )


def points(found: Scan) -> list[tuple[Move, Dwell]]:
    """The points in program order. ProgramError where there is none, or where most feed moves have no dwell."""
    pairs = [(dwell.move, dwell) for dwell in found.dwells if dwell.move is not None]
    if not pairs:
        raise ProgramError(
            f"{found.source.name}: no feed move in it has a dwell of its own: nothing carries time. "
            "To do: check that this is the polishing program, and its dialect."
        )
    without = len(found.moves) - len(pairs)
    if without > max(FEW, len(pairs)):
        owners = {id(move) for move, _ in pairs}
        first = next(move for move in found.moves if id(move) not in owners)
        raise found.refuse(
            first.statement,
            f"{len(pairs)} feed moves have a dwell, {without} have none (this is the first): time sits in two places",
            "have it posted with dwells at all points",
        )
    return pairs


def _places(found: Scan, moves: Sequence[Move]) -> list[Place]:
    """Where the moves lead, all with the same tool in the same frame."""
    places: list[Place] = []
    first: tuple[object, ...] = ()
    for move in moves:
        place = move.place or _declared(found, move)
        context = tuple(name and found.folded(name) for name in (*move.context, *place.context))
        first = first or context
        if context != first:
            raise found.refuse(
                move.statement,
                f"another tool or frame ({_named(context)}) than at the first point ({_named(first)})",
                "have it posted with one tool in one frame",
            )
        x, y, z = (value + more for value, more in zip(place.xyz_mm, move.offset_mm, strict=True))
        places.append(Place((x, y, z), place.turn))
    return places


def _declared(found: Scan, move: Move) -> Place:
    if move.target not in found.positions:
        raise found.refuse(
            move.statement, f"the position {move.target} is not declared as a constant in this file", POSTED
        )
    return found.positions[move.target][0]


def _named(context: Sequence[object]) -> str:
    return ", ".join(str(name) for name in context if name) or "none"


def _number_line(found: Scan, dwell: Dwell) -> int:
    """The line that the dwell's number stands in; its statement may begin earlier."""
    match = dwell.statement.match
    return dwell.statement.line + found.source.data.count(b"\n", match.start(), match.start("time"))


def _warnings(found: Scan, feed: FloatArray, count: int) -> list[str]:
    """What a user should know, each once."""
    warnings = list(found.warnings)
    if found.dwells and len(found.dwells) > count:
        stray = len(found.dwells) - count
        warnings.append(f"{stray} dwells that no feed move leads to are not points and are not changed")
    if len(found.moves) > count:
        without = len(found.moves) - count
        warnings.append(f"{without} feed moves have no dwell: they are not points, and their time is not changed")
    if np.isnan(feed).any():
        warnings.append(f"the feeds of {int(np.isnan(feed).sum())} points are not written as numbers: not known")
    limit, length = found.profile.line_limit, len({statement.line for statement in body_of(found)})
    if limit and length > limit:
        warnings.append(f"{length} lines in the program, the controller takes {limit}: split it")
    return warnings


def body_of(found: Scan) -> list[Statement]:
    """The statements of the routine that moves (of the whole file, where the language has no routines)."""
    if found.moving is None:
        return found.statements
    after = found.statements[found.statements.index(found.moving) + 1 :]
    return list(takewhile(lambda statement: statement.kind != "end", after))
