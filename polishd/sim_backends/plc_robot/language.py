"""Programs in a robot's own language: what the readers of the simulated controller have in common."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from bisect import bisect_left
from collections.abc import Mapping, Sequence
from typing import ClassVar

from polishd.model.errors import ProgramError
from polishd.sim_backends.robot.program_reader import Pose, SimProgramBlock
from polishd.sim_backends.universal_robots.arm import Quaternion, after, wrist_deg

FLAT_DEG = 1e-6
"""Lean of the tool below which its C means nothing."""


def number_of(text: str, what: str) -> float:
    """Return a finite number; ProgramError if the text is none."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise ProgramError(f"{what}: {text.strip()!r} is not a number")
    return value


def turn_about(axis: int, deg: float) -> Quaternion:
    """Return the turn about x (0), y (1) or z (2)."""
    half = math.radians(deg) / 2.0
    sine = [0.0, 0.0, 0.0]
    sine[axis] = math.sin(half)
    return math.cos(half), sine[0], sine[1], sine[2]


def turned_in_order(axes: Sequence[int], angles_deg: Sequence[float]) -> Quaternion:
    """Return the product of the turns: each about the axis that those before it have turned."""
    whole: Quaternion = (1.0, 0.0, 0.0, 0.0)
    for axis, deg in zip(axes, angles_deg, strict=True):
        whole = after(whole, turn_about(axis, deg))
    return whole


class LanguageReader(ABC):
    """Read a program line by line; each line is a block of the motion.

    It raises ProgramError for a line that it does not know: nothing is guessed.
    """

    axes: ClassVar[Sequence[int]]
    """Axes of the language's three angles, each in the frame that the turns before it made."""
    order: ClassVar[Sequence[int]]
    """Numbers of its angles in this order."""

    def __init__(self, pose: Pose, name: str) -> None:
        """``name``: name of the file without its ending."""
        self.pose = pose
        self.name = name
        self.positions: dict[str, Pose] = {}
        self.numbers: list[int] = []
        """Number that the controller shows at each line read so far; it never falls."""
        self.number = 0
        self.ended = False

    @staticmethod
    @abstractmethod
    def inserted(lines: Sequence[bytes]) -> list[int]:
        """Return the 0-based lines that polishd's driver added."""

    @abstractmethod
    def statement(self, text: str) -> SimProgramBlock:
        """Return the meaning of a stripped line that is not empty."""

    def read(self, line: bytes) -> SimProgramBlock:
        """Return the meaning of one line."""
        text = line.decode("latin-1").strip()
        block = self.statement(text) if text and not self.ended else self.nothing()
        self.numbers.append(self.number)
        return block

    def finish(self) -> None:
        """Check the program after its last line; ProgramError if it has no end."""
        if not self.ended:
            raise ProgramError("the program has no end")

    def begins_at(self, at: int) -> int:
        """Return the first line that has the same number as this one (0-based)."""
        return bisect_left(self.numbers, self.numbers[at])

    def nothing(self, *, exact: bool = False) -> SimProgramBlock:
        """Return a block without motion."""
        return SimProgramBlock("none", self.pose, exact=exact)

    def dwell(self, seconds: str, what: str) -> SimProgramBlock:
        """Return a wait at rest."""
        value = number_of(seconds, what)
        if value < 0.0:
            raise ProgramError(f"{what}: {value:g} s is less than 0")
        return SimProgramBlock("dwell", self.pose, value)

    def place(self, name: str, values: Sequence[str]) -> None:
        """Store a position: x, y, z in mm and the language's angles in deg."""
        if len(values) != 6:
            raise ProgramError(f"{name} has {len(values)} numbers, not 6")
        x, y, z, *angles = (number_of(value, name) for value in values)
        a, c = wrist_deg(turned_in_order(self.axes, [angles[at] for at in self.order]))
        self.positions[name] = (x, y, z, a, c)

    def move(self, target: str, rate: float, *, exact: bool) -> SimProgramBlock:
        """Return the move to a stored position, at mm/s; 0: as fast as the robot can."""
        if target not in self.positions:
            raise ProgramError(f"the position {target} is not known")
        x, y, z, a, c = self.positions[target]
        before = self.pose[4]
        c = before if a < FLAT_DEG else c + 360.0 * round((before - c) / 360.0)
        self.pose = (x, y, z, a, c)
        return SimProgramBlock("move", self.pose, rate, exact=exact)


def tags_of(text: str, known: Mapping[str, str]) -> dict[str, str]:
    """Return ``KEY=value`` pairs, with keys of ``known``, which has their units; ProgramError for any other."""
    found: dict[str, str] = {}
    for item in text.split():
        key, equals, value = item.partition("=")
        if not equals or key not in known or key in found:
            raise ProgramError(f"{item!r} is not one of {', '.join(known)}, each once")
        found[key] = value
    return found
