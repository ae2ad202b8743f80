"""A whole program of ISO-like NC text, as columns of points."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from polishd.api import Program, ProgramError
from polishd.model.program import Encoding
from polishd.model.surface import FloatArray
from polishd.plugins.rnc_robot.dialect import Dialect
from polishd.plugins.rnc_robot.nc import codes as c
from polishd.plugins.rnc_robot.nc.pieces import PIECE_BYTES, Piece, Scanner
from polishd.plugins.rnc_robot.nc.points import PointReader, Points, Tally


@dataclass(frozen=True, slots=True)
class Read:
    """A program in memory."""

    scanner: Scanner
    pieces: list[Piece]
    tally: Tally
    points: list[Points]
    """Of each piece."""
    encoding: Encoding


def parse(dialect: Dialect, text: bytes, name: str) -> Read:
    """Moves, dwells and points of a program. ProgramError names the line and the reason."""
    scanner, tally = Scanner(dialect, name), Tally()
    starts = range(0, len(text), PIECE_BYTES)
    pieces = []
    for piece in scanner.pieces(text[start : start + PIECE_BYTES] for start in starts):
        tally.add(piece)
        pieces.append(piece)
    encoding = tally.encoding(name)
    reader = PointReader(dialect, name, encoding)
    return Read(scanner, pieces, tally, [reader.read(piece) for piece in pieces], encoding)


def read(dialect: Dialect, text: bytes, name: str) -> Program:
    """Read a program; ``name`` is for messages. ProgramError names the line and the reason."""
    found = parse(dialect, text, name)
    points = joined(found.points)
    if not len(points.line):
        raise ProgramError(f"{name}: all its feed moves go nowhere. To do: check that this is the polishing program.")
    checks = Checks(dialect, name)
    checks.add(points)
    turned_by = checks.finish(found.scanner)
    line = points.line
    return Program(
        text=text,
        sha256=hashlib.sha256(text).hexdigest(),
        name=name,
        dialect=dialect.name,
        encoding=found.encoding,
        line=line,
        block=line - 1,
        start_mm=np.nan_to_num(points.before[:, :3], nan=0.0),
        end_mm=np.nan_to_num(points.after[:, :3], nan=0.0),
        axis=tool_axes(name, turned_by, points),
        time_s=points.time_s,
        lines=found.scanner.lines,
        max_feed_mm_min=float(np.nanmax(points.feed_mm_min, initial=0.0)),
        warnings=tuple(warnings(found.scanner, found.tally, found.encoding, points.still)),
        feed_mm_min=points.feed_mm_min,
        unit=unit(dialect, found.encoding, points.scale),
    )


def joined(parts: list[Points]) -> Points:
    """Points of all pieces as one."""
    if len(parts) == 1:
        return parts[0]
    columns = map(np.concatenate, zip(*(part[:-1] for part in parts), strict=True))
    return Points._make([*columns, sum(part.still for part in parts)])


def unit(dialect: Dialect, encoding: Encoding, scale: FloatArray) -> str:
    """The unit of the numbers that carry the time, as written."""
    if encoding == "dwell":
        found = [name for name, size in (("s", 1.0), ("ms", 0.001)) if (scale == size).any()]
        return " and ".join(found)
    return dialect.feed.unit if encoding == "feed" else dialect.feed.g93


class Checks:
    """What can only be judged over the whole program: axes that were never said, and how the tool is turned."""

    def __init__(self, dialect: Dialect, name: str) -> None:
        self._name = name
        self._dialect = dialect
        self._letters = [*"XYZABC", *dialect.axes.vector]
        self._lost = [0] * c.AXES
        """Line of the first point for which nobody has said where the axis is."""
        self._zero = 0

    def add(self, points: Points) -> None:
        """Look at further points."""
        lost = np.isnan(points.after).any(axis=0)
        for axis in np.flatnonzero(lost):
            if not self._lost[axis]:
                self._lost[axis] = int(points.line[int(np.argmax(np.isnan(points.after[:, axis])))])

    def finish(self, scanner: Scanner) -> str:
        """Which rotary axes turn the tool, outermost first; ProgramError where an axis is said too late."""
        named = [bool(scanner.at[c.NAMED] >> axis & 1) for axis in range(c.AXES)]
        for axis, line in enumerate(self._lost):
            if named[axis] and line:
                raise ProgramError(
                    f"{self._name}, line {line}: a point, and where {self._letters[axis].rstrip('=')} is, is not said "
                    "before it. To do: say it before the first point, and after every move to a reference point "
                    "(G28, G53)."
                )
        used = {letter for letter, said in zip("ABC", named[3:6], strict=True) if said}
        pairs = [pair for pair in self._dialect.axes.rotary if used <= set(pair)]
        if used and not pairs:
            raise ProgramError(
                f"{self._name}: {' and '.join(sorted(used))} turn the tool, in an order that the dialect "
                f"{self._dialect.name} does not say. To do: say it in axes.rotary of a dialect of your own."
            )
        return "vector" if any(named[6:]) else pairs[0] if used else ""


def tool_axes(name: str, turned_by: str, points: Points) -> FloatArray:
    """Unit tool axis (n, 3) of points, tip to spindle: (0, 0, 1) where nothing turns it."""
    if turned_by != "vector":
        return tool_axis(turned_by, *np.nan_to_num(points.after[:, 3:6], nan=0.0).T)
    vector = points.after[:, 6:9]
    length = np.linalg.norm(vector, axis=1, keepdims=True)
    if not (length > 0).all():
        line = int(points.line[int(np.argmin(length > 0))])
        raise ProgramError(f"{name}, line {line}: the tool vector is zero. To do: correct it.")
    return np.asarray(vector / length)


def tool_axis(pair: str, a_deg: FloatArray, b_deg: FloatArray, c_deg: FloatArray) -> FloatArray:
    """Unit tool axis (n, 3), tip to spindle: the rotations of ``pair``, outermost first, of (0, 0, 1).

    ``CA`` is Rz(C) Rx(A): (sin C sin A, -cos C sin A, cos A); an empty pair is (0, 0, 1).
    """
    zero = np.zeros(len(a_deg))
    axis = [zero, zero, zero + 1.0]
    degrees = {"A": a_deg, "B": b_deg, "C": c_deg}
    for letter in reversed(pair):
        angle = np.radians(degrees[letter])
        if not angle.any():
            continue
        one, other = {"A": (1, 2), "B": (2, 0), "C": (0, 1)}[letter]
        cosine, sine = np.cos(angle), np.sin(angle)
        axis[one], axis[other] = cosine * axis[one] - sine * axis[other], sine * axis[one] + cosine * axis[other]
    return np.stack(axis, axis=-1)


class _Mode(NamedTuple):
    slot: int
    code: str


_ASSUMED = (_Mode(c.UNIT, "G21"), _Mode(c.DISTANCE, "G90"), _Mode(c.FEED_MODE, "G94"))


def warnings(scanner: Scanner, tally: Tally, encoding: Encoding, still: int) -> list[str]:
    """What was read over, and what was assumed."""
    dialect, at, found = scanner.dialect, scanner.at, []
    for mode in _ASSUMED:
        code = float(mode.code[1:])
        if not at[mode.slot] and any(code in codes for codes in dialect.g.values()):
            found.append(f"nobody said {mode.code}: assumed")
    found += [f"nobody said where {axis} is: assumed 0" for k, axis in enumerate("XYZ") if not at[c.NAMED] >> k & 1]
    found += doubts(scanner, encoding)
    if tally.stray:
        found.append(f"{tally.stray} dwells that no feed move leads to are not points and are not changed")
    if encoding == "dwell" and tally.moves > tally.dwelled:
        without = tally.moves - tally.dwelled
        found.append(f"{without} feed moves have no dwell: they are not points, and their time is not changed")
    if still:
        found.append(f"{still} feed moves go nowhere: they are not points")
    if dialect.dwell.resolution_s and encoding == "dwell":
        found.append(f"{dialect.title} dwells in steps of {dialect.dwell.resolution_s:g} s, whatever is written")
    if scanner.rest:
        found.append(f"the text after the program's end (line {at[c.ENDED]}) is not read and not changed")
    if not at[c.ENDED]:
        found.append("the file ends without M2, M30 or %: it may be cut short")
    return found


def doubts(scanner: Scanner, encoding: Encoding) -> list[str]:
    """Numbers whose unit is up to a machine parameter; ProgramError where the time would depend on them."""
    reasons = (
        (scanner.at[c.UNSURE], "positions without a decimal point are mm or least increments, by machine parameter"),
        (scanner.at[c.UNSURE_FEED], "the unit of F is up to the machine: F without a decimal point, or beside G70"),
    )
    found = [(line, reason) for line, reason in reasons if line]
    if encoding == "feed" and found:
        line, reason = found[0]
        raise ProgramError(
            f"{scanner.name}, line {line}: {reason}, and the time is in the feed. To do: have it posted with decimal "
            "points in millimetres, or say text.whole_positions and feed.whole in a dialect of your own."
        )
    return [f"line {line}: {reason}: taken as it stands" for line, reason in found]
