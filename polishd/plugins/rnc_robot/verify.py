"""Proves that two programs move alike and differ only in their times, and says by how much these differ."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from polishd.api import ProgramError
from polishd.model.surface import FloatArray
from polishd.plugins.rnc_robot.canonical import interpreted, readable
from polishd.plugins.rnc_robot.dialect import AnyDialect
from polishd.plugins.rnc_robot.motion import COLUMNS, ProgramMotion, motion
from polishd.plugins.rnc_robot.text_changes import ChangeRules, LineChange, changes

LISTED = 1000
"""Most changes beside times that are listed."""


@dataclass(frozen=True, slots=True)
class Verification:
    """What two programs have in common, and in what they differ."""

    identical_motion: bool
    difference: str | None
    """The first difference that speaks against identical motion, in words; None where there is none."""
    points: int
    """Timed points of the new program."""
    changed_points: int
    """Points of both whose times differ."""
    largest_change_s: float
    time_before_s: float
    """Sum over the points."""
    time_after_s: float
    range_before_s: tuple[float, float]
    """Shortest and longest time of a point."""
    range_after_s: tuple[float, float]
    other_changes: tuple[LineChange, ...]
    """Lines that differ in more than numbers that carry time, in order; the first ``LISTED`` of them."""
    proved_by: tuple[str, ...]
    """What was compared and found the same, in words; empty where motion is not proved."""


def verify(old: bytes | Path, new: bytes | Path, dialect: AnyDialect, *, with_rs274: bool = False) -> Verification:
    """Compare two programs of one dialect.

    Identical motion is claimed where (a) the texts are the same but for numbers that carry time, comments, and, after
    a change of encoding, F words and dwell blocks; (b) both read as the same moves, rapids too, bit for bit; (c) asked
    for, LinuxCNC's interpreter makes the same calls of both and sees the times that we read.

    Raises:
        ProgramError: A program cannot be read; LinuxCNC is asked for and missing, or refuses.
    """
    nc = readable(dialect) if with_rs274 else None
    one, other = (motion(dialect, *_content(program, name)) for program, name in ((old, "old"), (new, "new")))
    listed, difference = _texts(one, other, dialect)
    difference = difference or _places(one, other)
    proved = [
        f"text: {one.program.lines} lines, every byte but the {len(other.spans)} numbers that carry time"
        + (f", and {len(listed)} lines of comments or timing" if listed else ""),
        f"motion: {len(other.line)} moves, kind, place and order, bit for bit",
    ]
    if nc is not None and difference is None:
        said = interpreted(one.program, other.program, nc)
        difference = said.difference
        proved.append(f"LinuxCNC: {said.calls} canonical calls and {said.times} times, in {said.digits}")
    return _verification(one, other, listed, difference, tuple(proved))


def _content(program: bytes | Path, name: str) -> tuple[bytes, str]:
    """Text, and a name for messages."""
    if isinstance(program, bytes):
        return program, name
    try:
        return program.read_bytes(), program.name
    except OSError as error:
        raise ProgramError(f"{program}: cannot be read: {error.strerror}. To do: check the path.") from error


def _texts(old: ProgramMotion, new: ProgramMotion, dialect: AnyDialect) -> tuple[tuple[LineChange, ...], str | None]:
    """Lines that differ in more than time, and the first of them that motion may depend on, in words."""
    one, other = old.program, new.program
    comments = dialect.text.comments if dialect.kind == "nc" else dialect.comments
    rules = ChangeRules(tuple(comments), encoding_changed=one.encoding != other.encoding)
    listed: list[LineChange] = []
    worst = None
    for change in changes(one.text, other.text, old.spans, new.spans, rules):
        if worst is None and change.kind == "other":
            worst = str(change)
        if len(listed) < LISTED:
            listed.append(change)
        elif worst is not None:
            break
    return tuple(listed), worst


def _places(old: ProgramMotion, new: ProgramMotion) -> str | None:
    """The first move that is not the same in both, in words."""
    count = min(len(old.line), len(new.line))
    here, there = old.places[:count], new.places[:count]
    same = ((here == there) | (np.isnan(here) & np.isnan(there))).all(axis=1)
    same &= old.kind[:count] == new.kind[:count]
    if same.all() and len(old.line) == len(new.line):
        return None
    if same.all():
        return f"{old.program.name} has {len(old.line)} moves, {new.program.name} {len(new.line)}"
    index = int(np.argmin(same))
    return (
        f"move {index + 1}: line {old.line[index]} to {_words(here[index])} became "
        f"line {new.line[index]} to {_words(there[index])}"
    )


def _words(place: FloatArray) -> str:
    names = COLUMNS if len(place) == len(COLUMNS) else ("x", "y", "z", "i", "j", "k")
    return " ".join(
        f"{name}{value!r}" for name, value in zip(names, place.tolist(), strict=True) if not math.isnan(value)
    )


def _verification(
    old: ProgramMotion,
    new: ProgramMotion,
    listed: tuple[LineChange, ...],
    difference: str | None,
    proved: tuple[str, ...],
) -> Verification:
    one, other = old.program, new.program
    change = _changes_s(old, new) if difference is None else np.zeros(0)
    return Verification(
        identical_motion=difference is None,
        difference=difference,
        points=other.n,
        changed_points=int(np.count_nonzero(change)),
        largest_change_s=float(np.abs(change).max(initial=0.0)),
        time_before_s=float(one.time_s.sum()),
        time_after_s=float(other.time_s.sum()),
        range_before_s=(float(one.time_s.min()), float(one.time_s.max())),
        range_after_s=(float(other.time_s.min()), float(other.time_s.max())),
        other_changes=listed,
        proved_by=proved if difference is None else (),
    )


def _changes_s(old: ProgramMotion, new: ProgramMotion) -> FloatArray:
    """By how much the time of each move changed that is a point of both programs."""
    before, after = np.full(len(old.line), np.nan), np.full(len(new.line), np.nan)
    before[old.point], after[new.point] = old.program.time_s, new.program.time_s
    change = after - before
    return np.asarray(change[~np.isnan(change)])
