"""From a program's text in a robot language to its columns of points."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence

import numpy as np

from polishd.api import Program, ProgramError
from polishd.model.program import IntArray
from polishd.model.surface import FloatArray
from polishd.plugins.rnc_robot.languages.columns import NONE, numbers, table, tool_axis
from polishd.plugins.rnc_robot.languages.parser import POSTED, Scan, scan
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
