"""The robot controller's own reader of RNC blocks: line by line, modal, without guesses.

G0 G1 G4 G20 G21 G90 G91 G93 G94, M0 M2 M30, words N F P X Y Z A C; comments ``( )`` and ``;``, ``%`` and blank lines;
G17 G40 G49 G54 G61 G64 G80 are accepted and change nothing.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Literal, Protocol

from polishd.config.simulator_devices import SimRobotSection
from polishd.model.errors import ProgramError
from polishd.model.surface import BoolArray

Pose = tuple[float, float, float, float, float]
Kind = Literal["none", "move", "dwell", "pause"]

AXES = "XYZAC"
_COMMENT = re.compile(r"\([^()]*\)")
_WORD = re.compile(r"([A-Z])([+-]?(?:\d+\.?\d*|\.\d+))")
_NEUTRAL = {17.0, 40.0, 49.0, 54.0, 61.0, 64.0, 80.0}
_GROUPS = ({0.0, 1.0}, {4.0}, {20.0, 21.0}, {90.0, 91.0}, {93.0, 94.0})
_KNOWN = _NEUTRAL.union(*_GROUPS)
_LETTERS = frozenset("NGMFPXYZAC")


@dataclass(frozen=True, slots=True)
class SimProgramBlock:
    """Meaning of a line: end of the tool, speed (mm/s or deg/s; 0 = rapid), or duration of a dwell."""

    kind: Kind
    end: Pose
    rate: float = 0.0
    """Speed of a ``move``; seconds of a ``dwell``."""
    inverse: bool = False
    """``rate`` of a move is seconds for the whole block (G93)."""
    exact: bool = False
    """The tool stops at its end."""


@dataclass(slots=True)
class Reader:
    """Modal state between lines."""

    pose: Pose
    motion: int | None = None
    inch: bool = False
    relative: bool = False
    inverse: bool = False
    feed: float | None = None
    ended: bool = False

    def read(self, line: bytes) -> SimProgramBlock:
        """Parse one line; ProgramError names the problem."""
        words = [] if self.ended else _words(line)
        if not words:
            return SimProgramBlock("none", self.pose)
        state = _Line.of(words)
        self._modes(state)
        if "P" in state.values and 4.0 not in state.g:
            raise ProgramError("P without G4")
        if 4.0 in state.g:
            return self._dwell(state)
        if state.m & {2.0, 30.0}:
            self.ended = True
        if any(axis in state.values for axis in AXES):
            return self._move(state)
        return SimProgramBlock("pause" if 0.0 in state.m else "none", self.pose)

    def _modes(self, line: _Line) -> None:
        for low, high, name in ((21.0, 20.0, "inch"), (90.0, 91.0, "relative"), (94.0, 93.0, "inverse")):
            if low in line.g or high in line.g:
                if name == "inverse" and (high in line.g) != self.inverse:
                    self.feed = None
                setattr(self, name, high in line.g)
        if line.g & {0.0, 1.0}:
            self.motion = int(1.0 in line.g)
        if "F" in line.values:
            self.feed = line.values["F"]
            if self.feed <= 0.0:
                raise ProgramError("F must be above 0")

    def _dwell(self, line: _Line) -> SimProgramBlock:
        if any(axis in line.values for axis in AXES):
            raise ProgramError("G4 beside motion")
        seconds = line.values.get("P")
        if seconds is None or seconds < 0.0:
            raise ProgramError("G4 wants P seconds, 0 or more")
        return SimProgramBlock("dwell", self.pose, seconds)

    def _move(self, line: _Line) -> SimProgramBlock:
        if line.m:
            raise ProgramError("an M word beside motion")
        if self.motion is None:
            raise ProgramError("axis words before G0 or G1")
        end = list(self.pose)
        for k, axis in enumerate(AXES):
            if axis in line.values:
                value = line.values[axis] * (25.4 if self.inch and k < 3 else 1.0)
                end[k] = end[k] + value if self.relative else value
        self.pose = (end[0], end[1], end[2], end[3], end[4])
        if self.motion == 0:
            return SimProgramBlock("move", self.pose)
        if self.feed is None or (self.inverse and "F" not in line.values):
            raise ProgramError("G1 without F")
        if self.inverse:
            return SimProgramBlock("move", self.pose, 60.0 / self.feed, inverse=True)
        return SimProgramBlock("move", self.pose, self.feed * (25.4 if self.inch else 1.0) / 60.0)


@dataclass(slots=True)
class _Line:
    g: set[float] = field(default_factory=set)
    m: set[float] = field(default_factory=set)
    values: dict[str, float] = field(default_factory=dict)

    @classmethod
    def of(cls, words: list[tuple[str, float]]) -> _Line:
        line = cls()
        for letter, value in words:
            if letter == "G":
                line.g.add(value)
            elif letter == "M":
                line.m.add(value)
            elif letter in line.values:
                raise ProgramError(f"{letter} twice")
            else:
                line.values[letter] = value
        if line.g - _KNOWN or line.m - {0.0, 2.0, 30.0}:
            raise ProgramError("a G or M word that this controller does not know")
        if len(line.g) > 1 and any(len(line.g & group) > 1 for group in _GROUPS):
            raise ProgramError("two G words of one group")
        return line


def _words(line: bytes) -> list[tuple[str, float]]:
    text = line.decode("ascii", errors="replace").strip()
    if "(" in text:
        text = _COMMENT.sub("", text)
    text = "".join(text.split(";", 1)[0].split()).upper()
    if text in {"", "%"}:
        return []
    words: list[tuple[str, float]] = []
    at = 0
    for match in _WORD.finditer(text):
        if match.start() != at or match[1] not in _LETTERS:
            break
        words.append((match[1], float(match[2])))
        at = match.end()
    if at != len(text):
        raise ProgramError(f"cannot read {text[at:]!r}")
    return words


# The intake of a program: each block is read, checked and hashed before it is accepted.


class BlockReader(Protocol):
    """Reader of one program, line by line."""

    def read(self, line: bytes) -> SimProgramBlock:
        """Return the meaning of a line; ProgramError names the problem."""
        ...


Reach = Callable[[list[SimProgramBlock]], BoolArray]
"""True for each of these blocks that ends within the robot's reach, (n,)."""


@dataclass(slots=True)
class Intake:
    """Intake of blocks. It accepts no block after a refused one, and no last block of a program with another hash."""

    config: SimRobotSection
    reach: Reach
    blocks: int
    blocks_sha256: str
    pose: Pose
    asked_from: int = -1
    """Block of the pending RESEND request."""
    reader: BlockReader | None = None
    """Reader of the program's language; None: RNC blocks."""
    _refusal: tuple[str, str] | None = None
    _reader: BlockReader = field(init=False)
    _hash: Any = field(default_factory=hashlib.sha256)

    def __post_init__(self) -> None:
        """Modal state starts again with each program."""
        self._reader = self.reader or Reader(self.pose)

    def refusal(self) -> tuple[str, str] | None:
        """Code and text of the first refusal."""
        return self._refusal

    def take(self, first: int, lines: list[bytes]) -> list[SimProgramBlock]:
        """Accept blocks, the first of which is the expected one; return those that are accepted."""
        blocks: list[SimProgramBlock] = []
        for seq, line in enumerate(lines, first):
            try:
                block = self._reader.read(line)
            except ProgramError as error:
                self._refuse(seq, "syntax", str(error))
                break
            if outside := self._outside(block):
                self._refuse(seq, "limits", outside)
                break
            blocks.append(block)
        can = self.reach(blocks)
        if not can.all():
            del blocks[int(can.argmin()) :]
            self._refuse(first + len(blocks), "limits", "out of the robot's reach")
        self._hash.update(b"".join(line + b"\n" for line in lines[: len(blocks)]))
        if first + len(blocks) == self.blocks and self._hash.hexdigest() != self.blocks_sha256:
            blocks.pop()
            self._refuse(self.blocks - 1, "hash", "with it these are not the blocks that LOAD announced")
        return blocks

    def _refuse(self, seq: int, code: str, text: str) -> None:
        self._refusal = code, f"block {seq}: {text}"

    def _outside(self, block: SimProgramBlock) -> str:
        limits = self.config
        ranges = (limits.x_mm, limits.y_mm, limits.z_mm, limits.a_deg)
        for axis, value, (low, high) in zip("XYZA", block.end, ranges, strict=False):
            if not low <= value <= high:
                return f"{axis} {value:g} is outside {low:g} to {high:g}"
        return ""
