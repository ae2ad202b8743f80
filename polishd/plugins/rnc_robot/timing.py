"""Which numbers of a program carry time: in dwells, in feeds, or in inverse time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from polishd.api import ProgramError
from polishd.model.program import Encoding
from polishd.plugins.rnc_robot.interpreter import Interpreter, Move, Position
from polishd.plugins.rnc_robot.modal import AXES
from polishd.plugins.rnc_robot.words import Place, Word


@dataclass(frozen=True, slots=True)
class Point:
    """A timed point and the number that says its time.

    A dwell's time is the number itself; in a feed it is ``scale / number`` seconds.
    """

    place: Place
    start: Position
    end: Position
    number: Word
    number_line: int
    """Line that the number stands in: the point's own, or an earlier one whose F still holds."""
    tail: int
    scale: float
    time_s: float
    feed_mm_min: float

    @property
    def own(self) -> bool:
        """The number stands in the point's own block."""
        return self.number_line == self.place.number


def points(name: str, reader: Interpreter, warnings: list[str]) -> tuple[Encoding, list[Point]]:
    """The timed points in program order. ProgramError where there are none, or where time sits in two places."""
    dwells = [dwell for dwell in reader.dwells if dwell.move is not None]
    stray = len(reader.dwells) - len(dwells)
    if stray:
        warnings.append(f"{stray} dwells that no feed move leads to are not points and are not changed")
    encoding: Encoding
    if dwells:
        encoding, found = "dwell", _dwelled(reader, warnings)
    else:
        encoding, found = _fed(reader.moves, warnings)
    if not found:
        raise ProgramError(
            f"{name}: nothing in it carries time: it needs feed moves (G1), with or without their own dwell "
            "(G4 P) each. To do: check that this is the polishing program."
        )
    return encoding, _positions_known(found, reader.named, warnings)


def _dwelled(reader: Interpreter, warnings: list[str]) -> list[Point]:
    found = []
    for dwell in reader.dwells:
        if dwell.move is None:
            continue
        move = reader.moves[dwell.move]
        if move.inverse:
            raise move.place.refuse("G93 and a dwell: time sits in two places", "have it posted with one of them")
        found.append(
            Point(
                dwell.place, move.end, move.end, dwell.time, dwell.place.number, 0, 1.0, dwell.time.value,
                move.feed.value * move.unit_mm,
            )
        )  # fmt: skip
    without = len(reader.moves) - len(found)
    if without > max(4, len(found)):
        owners = {dwell.move for dwell in reader.dwells}
        first = next(move for index, move in enumerate(reader.moves) if index not in owners)
        raise first.place.refuse(
            f"{len(found)} feed moves have a dwell of their own and {without} have none, this one the first: "
            "time sits in two places",
            "have it posted with dwells at all points or at none",
        )
    if without:
        warnings.append(f"{without} feed moves have no dwell: they are not points, and their time is not changed")
    return found


def _fed(moves: Sequence[Move], warnings: list[str]) -> tuple[Encoding, list[Point]]:
    found = []
    still = 0
    for move in moves:
        if move.inverse != moves[0].inverse:
            raise move.place.refuse("G93 and G94 in one program: time sits in two places", "have it posted with one")
        length_mm, turns = _length_mm(move), move.end[3:] != move.start[3:]
        if length_mm == 0 and not turns:
            still += 1
            continue
        if length_mm == 0 and not move.inverse:
            raise move.place.refuse("the tool turns on the spot, at a feed in deg/min", "have it posted with G93")
        scale = 60.0 if move.inverse else 60.0 * length_mm / move.unit_mm
        time_s = scale / move.feed.value
        found.append(
            Point(
                move.place, move.start, move.end, move.feed, move.feed_line, move.tail, scale, time_s,
                60.0 * length_mm / time_s,
            )
        )  # fmt: skip
    if still:
        warnings.append(f"{still} feed moves go nowhere: they are not points")
    return ("inverse" if moves and moves[0].inverse else "feed"), found


def _length_mm(move: Move) -> float:
    squares = 0.0
    for start, end, axis in zip(move.start[:3], move.end[:3], AXES, strict=False):
        if math.isnan(end):  # not said yet, so it does not move either
            continue
        if math.isnan(start):
            raise move.place.refuse(f"a feed move from nobody knows what {axis}", "go to its start with G0 first")
        squares += (end - start) ** 2
    return math.sqrt(squares)


def _positions_known(found: list[Point], named: set[str], warnings: list[str]) -> list[Point]:
    """Refuse a point before an axis that is said later; what is never said is zero."""
    first = found[0]
    for axis, value in zip(AXES, first.end, strict=True):
        if not math.isnan(value):
            continue
        if axis in named:
            raise first.place.refuse(f"the first point, and {axis} is said only later", f"say {axis} before it")
        if axis in "XYZ":
            warnings.append(f"nobody said where {axis} is: assumed 0")
    return found
