"""Which lines of two programs differ in more than the numbers that carry time, and whether such a change may be."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from io import BytesIO
from typing import Literal

import numpy as np

from polishd.model.program import IntArray

Kind = Literal["comment", "timing", "other"]
TIME = b"\0"
"""Stands for a number that carries time; no program holds this byte."""
AHEAD = 64
"""Lines looked ahead for the place where two texts agree again."""

_NUMBER = rb"[-+]?[ \t]*+(?:[0-9][0-9 \t]*+\.?[0-9 \t]*+|\.[ \t]*+[0-9][0-9 \t]*+)"
# Possessive, and from the first blank of a run on: a long run of blanks is gone over once
_GAP = rb"(?:(?<![ \t])[ \t]++)?"
_F = _GAP + rb"(?<![A-Za-z_])[Ff][ \t]*+=?[ \t]*+"
_G4 = rb"[Gg][ \t]*0*4(?:\.0*)?(?![0-9.])"
_WORD = rb"[ \t]*+[A-Za-z]*+[ \t]*+=?[ \t]*+\0[ \t]*+"
_ADDED_F = re.compile(_F + rb"\0")
_TIMING = re.compile(
    rb"^[ \t]*+(?:[Nn][0-9 \t]++)?(?:"
    + _G4
    + _WORD
    + rb"|"
    + _WORD
    + _G4
    + rb"[ \t]*+|#[Tt][Ii][Mm][Ee]"
    + _WORD
    + rb");?[ \t]*$"
    rb"|" + _F + rb"(?:\0|" + _NUMBER + rb")"
    rb"|" + _GAP + rb"(?<![A-Za-z_])[Gg][ \t]*+9[345](?![0-9.])"
)


@dataclass(frozen=True, slots=True)
class LineChange:
    """A line that differs in more than its time."""

    kind: Kind
    """``comment``: only what a controller skips. ``timing``: F words or dwells of points, as a change of encoding
    brings and takes them. ``other``: anything else, so motion is not proved."""
    old_line: int | None
    """1-based; None where the line was added."""
    new_line: int | None
    """1-based; None where it was taken out."""
    old: str
    new: str

    def __str__(self) -> str:
        if self.old_line is None:
            return f'line {self.new_line} was added: "{self.new}"'
        if self.new_line is None:
            return f'line {self.old_line} was taken out: "{self.old}"'
        return f'line {self.old_line} "{self.old}" became line {self.new_line} "{self.new}"'


def skeleton(text: bytes, spans: IntArray) -> bytes:
    """The text with ``TIME`` in place of the numbers at ``spans`` (m, 2), byte offsets in rising order."""
    ends = np.concatenate([[0], spans[:, 1]]).tolist()
    starts = np.concatenate([spans[:, 0], [len(text)]]).tolist()
    return TIME.join([text[end:start] for end, start in zip(ends, starts, strict=True)])


@dataclass(frozen=True, slots=True)
class _Side:
    """One of the two texts: its lines as they are, and as skeletons."""

    text: Sequence[bytes]
    bones: Sequence[bytes]

    def shown(self, index: int) -> str:
        return self.text[index].decode("ascii", "backslashreplace").strip(" \t\n").replace("\r", "\\r")[:120]


@dataclass(frozen=True)
class ChangeRules:
    """What may differ besides the numbers that carry time."""

    comments: Sequence[str]
    """How comments are written: ``()``, or what begins one that runs to the end of the line."""
    encoding_changed: bool
    """Time moved from dwells to feeds or back: F words, G93, G94 and the points' dwell blocks may differ. Else only F
    words that carry time may come and go."""

    @cached_property
    def _comment(self) -> re.Pattern[bytes]:
        ways = [rb"\([^()]*\)" if mark == "()" else re.escape(mark.encode()) + rb".*" for mark in self.comments]
        return re.compile(rb"|".join(ways) or rb"(?!)")

    def code(self, line: bytes) -> bytes:
        """A line without its comments."""
        return self._comment.sub(b"", line).rstrip()

    def bare(self, line: bytes) -> bytes:
        """What is left of a line without comments and timing."""
        timing = _TIMING if self.encoding_changed else _ADDED_F
        return timing.sub(b"", self.code(line)).strip()


def changes(
    old: bytes, new: bytes, old_spans: IntArray, new_spans: IntArray, rules: ChangeRules
) -> Iterator[LineChange]:
    """The lines of two programs that differ in more than the numbers at their spans, in order.

    Args:
        old: The one program.
        new: The other.
        old_spans: (m, 2) byte offsets of its numbers that carry time, rising.
        new_spans: The same of the other.
        rules: What of the rest may differ: it says the kind of each change.
    """
    bones = skeleton(old, old_spans), skeleton(new, new_spans)
    if bones[0] == bones[1]:
        return
    before, after = _Side(_lines(old), _lines(bones[0])), _Side(_lines(new), _lines(bones[1]))
    i = j = 0
    while i < len(before.bones) or j < len(after.bones):
        if i < len(before.bones) and j < len(after.bones) and before.bones[i] == after.bones[j]:
            i, j = i + 1, j + 1
            continue
        kind, taken, added = _step(before.bones, i, after.bones, j, rules)
        yield LineChange(
            kind,
            i + 1 if taken else None,
            j + 1 if added else None,
            before.shown(i) if taken else "",
            after.shown(j) if added else "",
        )
        i, j = i + taken, j + added


def _lines(text: bytes) -> list[bytes]:
    """The lines with their ends: a last line that has none differs from one that has."""
    return BytesIO(text).readlines()


def _step(old: Sequence[bytes], i: int, new: Sequence[bytes], j: int, rules: ChangeRules) -> tuple[Kind, bool, bool]:
    """What the difference at lines i and j is, and on which side a line is consumed."""
    one = old[i] if i < len(old) else None
    other = new[j] if j < len(new) else None
    if one is not None and other is not None:
        same = _same(one, other, rules)
        if same is not None:
            return same, True, True
    added = _only(other, rules)
    if added is not None and (one is None or rules.bare(one)):
        return added, False, True
    removed = _only(one, rules)
    if removed is not None:
        return removed, True, False
    if one is None or other is None:
        return "other", one is not None, other is not None
    gone = next((k for k, line in enumerate(old[i : i + AHEAD]) if line == other), AHEAD)
    come = next((k for k, line in enumerate(new[j : j + AHEAD]) if line == one), AHEAD)
    return "other", gone <= come, come <= gone


def _same(one: bytes, other: bytes, rules: ChangeRules) -> Kind | None:
    """The kind of a change within a line; None where the lines differ in more than comments and timing."""
    if not one.strip() or not other.strip():
        return None
    if rules.code(one) == rules.code(other):
        return "comment"
    if rules.bare(one) != rules.bare(other) or _indent(one) != _indent(other):
        return None
    return "timing"


def _indent(line: bytes) -> bytes:
    return line[: len(line) - len(line.lstrip())]


def _only(line: bytes | None, rules: ChangeRules) -> Kind | None:
    """The kind of a whole line that may come or go; None for lines that do something else."""
    if line is None or rules.bare(line):
        return None
    return "timing" if rules.code(line).strip() else "comment"
