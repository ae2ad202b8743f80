"""Runs through an RS274 program: where the tool goes, and which numbers say how long it takes."""

from __future__ import annotations

import math
from typing import NamedTuple

from polishd.api import ProgramError
from polishd.plugins.rnc_robot.modal import AXES, Block, block
from polishd.plugins.rnc_robot.words import Place, Word

INCH_MM = 25.4
UNKNOWN = float("nan")
Position = tuple[float, ...]
"""x, y, z in mm, a, c in degrees; NaN where the program has not said it yet."""


class Move(NamedTuple):
    """A feed move."""

    place: Place
    start: Position
    end: Position
    feed: Word
    """The F word that governs it."""
    feed_line: int
    """Line of that word: the move's own where ``own`` is true."""
    inverse: bool
    """G93: F is 1/min; otherwise length units per minute."""
    unit_mm: float
    """Millimetres per length unit."""
    tail: int
    """Where the line's last word ends."""

    @property
    def own(self) -> bool:
        """The F word stands in the move's own block."""
        return self.feed_line == self.place.number


class Dwell(NamedTuple):
    """A G4 block."""

    place: Place
    time: Word
    move: int | None
    """Index of the feed move whose dwell it is; None where no feed move leads to it."""


class Interpreter:
    """Modal state while reading; ``moves`` and ``dwells`` are what it has found so far."""

    def __init__(self) -> None:
        self.moves: list[Move] = []
        self.dwells: list[Dwell] = []
        self.assumed: set[str] = set()
        self.named: set[str] = set()
        self._at: list[float] = [UNKNOWN] * len(AXES)
        self._motion: int | None = None
        self._inverse: bool | None = None
        self._absolute: bool | None = None
        self._unit_mm: float | None = None
        self._feed: Word | None = None
        self._feed_line = 0
        self._dwells_for: int | None = None
        self._dwelled = False

    def take(self, place: Place) -> bool:
        """Read one line; True where it ends the program."""
        found = block(place)
        if found is None:
            return False
        codes = found.codes
        if codes:
            self._modes(place, found)
        feed = found.numbers.get("F")
        if feed is not None:
            if feed.value <= 0:
                raise place.refuse("F is not above zero", "correct it")
            self._feed, self._feed_line = feed, place.number
        if "dwell" in codes:
            self._dwell(place, found)
        elif found.moves:
            self._move(place, found)
        return found.ends

    def _modes(self, place: Place, found: Block) -> None:
        codes = found.codes
        if "feed" in codes and (codes["feed"] == 930) != self._inverse:
            self._inverse = codes["feed"] == 930
            self._feed = None
        if "units" in codes:
            unit_mm = INCH_MM if codes["units"] == 200 else 1.0
            if unit_mm != (self._unit_mm or 1.0):
                if "F" in found.numbers:
                    raise place.refuse("F beside a change of units: it counts in the old ones", "put F a block later")
                self._feed = None
            self._unit_mm = unit_mm
        if "distance" in codes:
            self._absolute = codes["distance"] == 900
        if "motion" in codes:
            self._motion = codes["motion"]

    def _dwell(self, place: Place, found: Block) -> None:
        if found.moves:
            raise place.refuse(
                "dwell and axes in one block: some controllers dwell first, some take X for the time",
                "split the block, and write the time as G4 P in seconds",
            )
        if found.numbers.keys() & {"F", "S"}:
            raise place.refuse("G4 with F or S: time in another dialect, or revolutions", "write G4 P in seconds")
        time = found.numbers.get("P")
        if time is None:
            raise place.refuse("G4 without P", "write the time as G4 P in seconds")
        if time.value < 0:
            raise place.refuse("a dwell below zero", "correct it")
        if self._dwelled and self._dwells_for is None and self.dwells[-1].move is not None:
            raise place.refuse("two dwells at one point: which of them to change is not known", "make them one")
        self.dwells.append(Dwell(place, time, self._dwells_for))
        self._dwells_for, self._dwelled = None, True

    def _move(self, place: Place, found: Block) -> None:
        start = tuple(self._at)
        self._go(place, found)
        self._dwells_for, self._dwelled = None, False
        if self._motion == 0:
            return
        if self._motion != 10:
            raise place.refuse("axes before any G0 or G1", "write G0 or G1 into the block")
        inverse, unit_mm = self._feed_mode(), self._units()
        if self._feed is None or (inverse and self._feed_line != place.number):
            raise place.refuse("a feed move without F", "write F into the block (in G93 into every block)")
        self._dwells_for = len(self.moves)
        self.moves.append(
            Move(place, start, tuple(self._at), self._feed, self._feed_line, inverse, unit_mm, found.tail)
        )

    def _go(self, place: Place, found: Block) -> None:
        if self._absolute is None:
            self.assumed.add("G90")
        unit_mm = self._units()
        for index, axis in enumerate(AXES):
            word = found.numbers.get(axis)
            if word is None:
                continue
            self.named.add(axis)
            value = word.value * unit_mm if index < 3 else word.value
            if self._absolute is False:
                value += self._at[index]
                if math.isnan(value):
                    raise place.refuse(f"G91, and nobody said where {axis} is", "start with an absolute move (G90)")
            self._at[index] = value

    def _units(self) -> float:
        if self._unit_mm is None:
            self.assumed.add("G21")
            return 1.0
        return self._unit_mm

    def _feed_mode(self) -> bool:
        if self._inverse is None:
            self.assumed.add("G94")
            return False
        return self._inverse


def interpret(text: bytes, name: str) -> tuple[Interpreter, list[bytes], list[str]]:
    """Read a whole program: the interpreter after its last block, the lines without line ends, and warnings.

    Lines end in LF or CRLF, mixed as they come. A ``%`` line may open the program; M2, M30 or a further ``%``
    ends it, and nothing after that is read.
    """
    _refuse_binary(text, name)
    lines = [line.removesuffix(b"\r") for line in text.split(b"\n")]
    reader = Interpreter()
    opened = False
    end = 0
    for number, line in enumerate(lines, 1):
        place = Place(name, number, line)
        if b"%" in line and line.strip() == b"%":
            if opened or reader.moves or reader.dwells:
                end = number
                break
            opened = True
        elif reader.take(place):
            end = number
            break
    if not end:
        place = Place(name, len(lines), lines[-1])
        raise place.refuse(
            "the file ends without M2, M30 or %: it may be cut short", "fetch it again, or end it with M2"
        )
    warnings = [f"nobody said {code}: assumed" for code in sorted(reader.assumed)]
    if any(line.strip() not in (b"", b"%") for line in lines[end:]):
        warnings.append(f"the text after the program's end (line {end}) is not read and not changed")
    return reader, lines, warnings


def _refuse_binary(text: bytes, name: str) -> None:
    if not text.strip():
        raise ProgramError(f"{name}: the file is empty. To do: fetch it again.")
    if text.startswith((b"\xef\xbb\xbf", b"\xff\xfe", b"\xfe\xff")):
        raise ProgramError(f"{name}: it starts with a byte order mark. To do: save it as plain ASCII text.")
    control = text.translate(None, bytes(set(range(256)) - set(range(9)) - {11, 12, *range(14, 32), 127}))
    if control:
        number = text.count(b"\n", 0, text.index(control[:1])) + 1
        raise ProgramError(
            f"{name}, line {number}: byte {control[0]:#04x}: this is no text. To do: check which file this is."
        )
    if text.count(b"\r") != text.count(b"\r\n"):
        raise ProgramError(f"{name}: carriage returns without line feeds. To do: save it with LF or CRLF line ends.")
