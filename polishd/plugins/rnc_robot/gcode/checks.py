"""Checks over a whole program: axes that are stated too late, rotation of the tool, assumed modes."""

from __future__ import annotations

import numpy as np

from polishd.api import ProgramError
from polishd.model.program import Encoding
from polishd.model.surface import FloatArray
from polishd.plugins.rnc_robot.gcode import kernels as c
from polishd.plugins.rnc_robot.gcode.dialect import GcodeDialect
from polishd.plugins.rnc_robot.gcode.time_words import Points, Scanner, TimeWordCounts


class WrittenUnit:
    """Unit of the numbers that carry the time, as they are written: after G20, G70 or G700 feeds are in inches."""

    def __init__(self, dialect: GcodeDialect, encoding: Encoding) -> None:
        per_mm = dialect.feed.unit
        self._names = {
            "dwell": {1.0: "s", 0.001: "ms"},
            "feed": {1.0: per_mm, 25.4: per_mm.replace("mm/", "inch/")},
        }.get(encoding, {})
        self._one = dialect.feed.g93
        self._found: set[float] = set()

    def add(self, points: Points) -> None:
        """Take the units of further points."""
        self._found.update(size for size in self._names if (points.unit_size == size).any())

    def __str__(self) -> str:
        """One unit, or both: "mm/min and inch/min"."""
        return " and ".join(name for size, name in self._names.items() if size in self._found) or self._one


class Checks:
    """Checks that need the whole program: axes that are never stated, and rotation of the tool."""

    def __init__(self, dialect: GcodeDialect, name: str, encoding: Encoding) -> None:
        self.encoding = encoding
        self._name = name
        self._dialect = dialect
        self._letters = [*"XYZABC", *dialect.axes.vector]
        self._lost = [0] * c.AXES
        """Line of the first point before which the program does not state the axis."""
        self._turned_by = ""

    def add(self, points: Points, scanner: Scanner) -> None:
        """Check further points, which ``scanner`` has just read."""
        self._turned_by = self._turning(scanner)
        zero = (points.after[:, 6:9] == 0).all(axis=1) if self._turned_by == "vector" else np.zeros(0, dtype=np.bool_)
        if zero.any():
            line = int(points.line[int(np.argmax(zero))])
            raise ProgramError(f"{self._name}, line {line}: the tool vector is zero. To do: correct it.")
        lost = np.isnan(points.after.sum(axis=0))
        for axis in np.flatnonzero(lost):
            if not self._lost[axis]:
                self._lost[axis] = int(points.line[int(np.argmax(np.isnan(points.after[:, axis])))])

    def finish(self, scanner: Scanner) -> None:
        """ProgramError where the program states an axis only after a point."""
        for axis, line in enumerate(self._lost):
            if line and scanner.at[c.NAMED] >> axis & 1:
                raise ProgramError(
                    f"{self._name}, line {line}: a point before {self._letters[axis].rstrip('=')} is stated. To do: "
                    "state the axis before the first point, and after every move to a reference point "
                    "(G28, G53)."
                )

    def tool_axes(self, points: Points) -> FloatArray:
        """Unit tool axis (n, 3) of the points added last, tip to spindle: (0, 0, 1) where nothing turns it."""
        if self._turned_by != "vector":
            angles = np.nan_to_num(points.after[:, 3:6], nan=0.0).T
            if self._dialect.axes.turns == "table":
                return tool_axis(self._turned_by[::-1], *-angles)
            return tool_axis(self._turned_by, *angles)
        vector = np.nan_to_num(points.after[:, 6:9], nan=0.0)
        with np.errstate(invalid="ignore"):  # ``finish`` refuses an axis that is stated too late
            return np.asarray(vector / np.linalg.norm(vector, axis=1, keepdims=True))

    def _turning(self, scanner: Scanner) -> str:
        """Rotary axes that have turned the tool so far, outermost first; "vector" for a tool vector."""
        if scanner.at[c.NAMED] >> 6:
            return "vector"
        used = {letter for axis, letter in enumerate("ABC", 3) if scanner.at[c.NAMED] >> axis & 1}
        pairs = [pair for pair in self._dialect.axes.rotary if used <= set(pair)]
        if used and not pairs:
            raise ProgramError(
                f"{self._name}: {' and '.join(sorted(used))} turn the tool, in an order that the dialect "
                f"{self._dialect.name} does not define. To do: set axes.rotary in your own dialect."
            )
        return pairs[0] if used else ""


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


_ASSUMED = {c.UNIT: 21.0, c.DISTANCE: 90.0, c.FEED_MODE: 94.0}
"""G codes of the default modes."""


def warnings(scanner: Scanner, tally: TimeWordCounts, encoding: Encoding, still: int) -> list[str]:
    """Parts of the program that are ignored, and modes that are assumed."""
    dialect, at, found = scanner.dialect, scanner.at, []
    for slot, code in _ASSUMED.items():
        if not at[slot] and any(code in codes for codes in dialect.g.values()):
            found.append(f"no G{code:g} in the program: assumed")
    found += [
        f"the program does not state {axis}: assumed 0" for k, axis in enumerate("XYZ") if not at[c.NAMED] >> k & 1
    ]
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
    """Numbers whose unit depends on a machine parameter; ProgramError where the time depends on them."""
    reasons = (
        (scanner.at[c.UNSURE], "positions without a decimal point are mm or least increments, by machine parameter"),
        (scanner.at[c.UNSURE_FEED], "the unit of F depends on the machine: F without a decimal point, or beside G70"),
    )
    found = [(line, reason) for line, reason in reasons if line]
    if encoding == "feed" and found:
        line, reason = found[0]
        raise ProgramError(
            f"{scanner.name}, line {line}: {reason}, and the time is in the feed. To do: have it posted with decimal "
            "points in millimetres, or set text.whole_positions and feed.whole in your own dialect."
        )
    return [f"line {line}: {reason}: read as written" for line, reason in found]
