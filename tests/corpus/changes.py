"""What a rewrite did to a program's bytes, found without the reader: only numbers that carry time may differ."""

from __future__ import annotations

import re
from decimal import Decimal

import numpy as np
from numpy.typing import NDArray

from polishd.api import Program

# What stands before a dwell's number, by dialect.
_P = rb"[Pp]"
_DWELL = {
    "rs274": _P,
    "grbl": _P,
    "weihong": _P,
    "haas": _P,
    "fanuc": rb"[PpXxUu]",
    "siemens-iso": rb"[PpXxUu]",
    "siemens": rb"[Ff]",
    "twincat-nci": rb"[XxFf]",
    "twincat-cnc": rb"(?:[Xx]|\#[Tt][Ii][Mm][Ee]|[Gg]0?4(?=[ \t]))",
    "codesys": rb"(?:[Tt][Ii][Mm][Ee]=|[Tt])",
}
_NUMBER = rb"([ \t]*)([-+]?[ \t]*[0-9.](?:[0-9. \t]*[0-9.])?)"
_COMMENT = re.compile(rb"\([^()]*\)|;[^\r]*")


def time_number(line: bytes, dialect: str, encoding: str) -> tuple[int, int] | None:
    """Return the range of the number with the time of the line, or None."""
    # comments become blanks' like of one length: no word stands in them
    code = _COMMENT.sub(lambda found: b"_" * len(found[0]), line)
    word = _DWELL[dialect] if encoding == "dwell" else b"[Ff]"
    found = re.search(word + _NUMBER, code)
    return found.span(2) if found else None


def numbers(text: bytes, program: Program) -> list[bytes | None]:
    """At each of the program's points, the number as this text writes it; None where an earlier F holds."""
    lines = text.split(b"\n")
    found = []
    for number in program.line:
        line = lines[number - 1]
        place = time_number(line, program.dialect, program.encoding)
        found.append(line[slice(*place)].translate(None, b" \t") if place else None)
    return found


def strayed(program: Program, new: bytes) -> list[str]:
    """Lines that differ by more than a time number: none, or the rewriter has a fault."""
    old_lines, new_lines = program.text.split(b"\n"), new.split(b"\n")
    if len(old_lines) != len(new_lines):
        return [f"{len(old_lines)} lines became {len(new_lines)}"]
    points = set(program.line.tolist())
    return [
        f"line {number}: {old!r} became {new!r}"
        for number, (old, new) in enumerate(zip(old_lines, new_lines, strict=True), 1)
        if old != new and not (number in points and _only_time(old, new, program))
    ]


def _only_time(old: bytes, new: bytes, program: Program) -> bool:
    place_new = time_number(new, program.dialect, program.encoding)
    if place_new is None:
        return False
    head, tail = new[: place_new[0]], new[place_new[1] :]
    place_old = time_number(old, program.dialect, program.encoding)
    if place_old is None:  # an F word was added to a feed move that had none
        return program.encoding != "dwell" and re.sub(rb" ?[Ff]$", b"", head) + tail == old
    return head == old[: place_old[0]] and tail == old[place_old[1] :]


def quanta_s(program: Program, new: bytes, time_s: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n,) seconds that one unit of the last digit written is worth, where a point's time is ``time_s``."""
    quanta = []
    feed = Decimal(0)
    step = Decimal(0)
    for number, time in zip(numbers(new, program), time_s, strict=True):
        if number is not None:
            feed = Decimal(number.decode())
            step = Decimal(1).scaleb(-len(number.partition(b".")[2]))
        if program.encoding == "dwell":
            unit = Decimal("0.001") if number is not None and milliseconds(program.dialect, number) else 1
            quanta.append(float(step * unit))
        elif program.dialect == "twincat-cnc" and program.encoding == "inverse":
            quanta.append(float(step))
        else:
            quanta.append(time * float(step / feed) if feed else 0.0)
    return np.array(quanta)


def milliseconds(dialect: str, number: bytes) -> bool:
    """Whether a dwell's number is in ms; that of a Fanuc is its P, the only one without a point."""
    return dialect == "weihong" or (dialect in ("fanuc", "haas", "siemens-iso") and b"." not in number)
