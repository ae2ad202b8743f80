"""Puts new times into a program's text: new numbers in old places, and the rounding residue carried forward."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from polishd.api import Program, ProgramError
from polishd.model.program import Encoding
from polishd.model.surface import FloatArray
from polishd.plugins.rnc_robot.timing import Point

RELATIVE = 1e-4
"""Largest relative error of a block's time, as long as MOST_DECIMALS allow it."""
MOST_DECIMALS = 9


def rewritten(
    program: Program, lines: Sequence[bytes], encoding: Encoding, points: Sequence[Point], time_s: FloatArray
) -> bytes:
    """The program's text with these times; ``lines`` and ``points`` are the program's own."""
    times = _checked(program, encoding, time_s)
    edits = _dwells(lines, points, times) if encoding == "dwell" else _feeds(lines, points, times)
    pieces = program.text.split(b"\n")
    for number, (start, end, text) in edits.items():
        line = pieces[number - 1]
        pieces[number - 1] = line[:start] + text + line[end:]
    return b"\n".join(pieces)


Edits = dict[int, tuple[int, int, bytes]]
"""1-based line: what of it is replaced (start, end), by what."""


def _dwells(lines: Sequence[bytes], points: Sequence[Point], times: Sequence[float]) -> Edits:
    """One quantum for all changed dwells: fine enough for the shortest, and for the finest there was."""
    changed = [index for index, point in enumerate(points) if times[index] != point.time_s]
    shortest = min((times[index] for index in changed if times[index] > 0), default=1.0)
    old = {index: _number(lines, points[index]) for index in changed}
    finest = max((_decimals(number) for number in old.values()), default=0)
    digits = max(_needed(shortest), min(finest, MOST_DECIMALS))
    edits: Edits = {}
    residue = 0.0
    for index in changed:
        point, wanted = points[index], times[index] + residue
        text = _styled(max(wanted, 0.0), digits, old[index])
        residue = wanted - float(text)
        edits[point.place.number] = (point.number.start, point.number.end, text)
    return edits


def _feeds(lines: Sequence[bytes], points: Sequence[Point], times: Sequence[float]) -> Edits:
    """Digits as each feed needs them; a block takes of the residue what its own quantum can hold."""
    edits: Edits = {}
    residue = 0.0
    holds, holds_from = 0.0, 0
    for point, time_s in zip(points, times, strict=True):
        if point.number_line != holds_from:
            holds, holds_from = point.number.value, point.number_line
        if time_s == point.time_s:
            if holds != point.number.value:
                edits[point.place.number] = _edit(lines, point, _number(lines, point))
                holds = point.number.value
            continue
        old = _number(lines, point)
        feed = point.scale / time_s
        digits = max(_needed(feed), min(_decimals(old), MOST_DECIMALS))
        quantum_s = time_s / feed * 10.0**-digits
        wanted = time_s + max(-quantum_s / 2, min(quantum_s / 2, residue))
        text = _styled(point.scale / wanted, digits, old)
        residue += time_s - point.scale / float(text)
        if point.own or float(text) != holds:
            edits[point.place.number] = _edit(lines, point, text)
        holds = float(text)
    return edits


def _edit(lines: Sequence[bytes], point: Point, text: bytes) -> tuple[int, int, bytes]:
    if point.own:
        return point.number.start, point.number.end, text
    head = lines[point.place.number - 1][: point.tail]
    return point.tail, point.tail, (b" f" if head.islower() else b" F") + text


def _number(lines: Sequence[bytes], point: Point) -> bytes:
    """The number as the program writes it, without blanks."""
    text = lines[point.number_line - 1][point.number.start : point.number.end]
    return text.translate(None, b" \t")


def _decimals(number: bytes) -> int:
    return len(number.partition(b".")[2])


def _needed(value: float) -> int:
    """Decimals that make half a unit of the last one smaller than RELATIVE / 2 of the value, carry included."""
    return min(MOST_DECIMALS, max(0, math.ceil(-math.log10(value * RELATIVE))))


def _styled(value: float, digits: int, old: bytes) -> bytes:
    """The value with so many decimals, written as ``old`` is: its trailing zeros, its point, its bare ``.5``."""
    whole, _, fraction = f"{value:.{digits}f}".encode().partition(b".")
    keep = _decimals(old)
    fraction = fraction[:keep] + fraction[keep:].rstrip(b"0")
    if fraction or b"." in old:
        bare = old.lstrip(b"+").startswith(b".") and whole == b"0" and fraction
        number = (b"" if bare else whole) + b"." + fraction
    else:
        number = whole
    return b"+" + number if old.startswith(b"+") else number


def _checked(program: Program, encoding: Encoding, time_s: FloatArray) -> list[float]:
    times = np.asarray(time_s, dtype=np.float64)
    if times.shape != (program.n,):
        raise ProgramError(f"{program.name}: {program.n} points need as many times, not an array of {times.shape}.")
    good = np.isfinite(times) & ((times >= 0) if encoding == "dwell" else (times > 0))
    if not good.all():
        index = int(np.argmin(good))
        raise ProgramError(
            f"{program.name}, line {program.line[index]}: a time of {times[index]} s cannot be written as "
            f"{encoding}. To do: solve again with a lower bound above zero."
        )
    return [float(time) for time in times]
