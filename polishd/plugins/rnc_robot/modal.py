"""The modal state of an RS274 program: which codes are known, and what a block says once sorted."""

from __future__ import annotations

from typing import NamedTuple

from polishd.plugins.rnc_robot.words import Place, Word, words

AXES = "XYZAC"

# Code times ten: modal group. What is not here is refused.
_GROUPS = {
    0: "motion", 10: "motion", 800: "motion",
    40: "dwell",
    170: "plane", 180: "plane", 190: "plane",
    200: "units", 210: "units",
    400: "radius", 490: "length", 540: "offset",
    610: "path", 611: "path", 640: "path",
    900: "distance", 910: "distance",
    930: "feed", 940: "feed",
}  # fmt: skip

_REFUSED_G = {
    20: ("arcs are not read", "have it posted with straight moves (G1) only"),
    30: ("arcs are not read", "have it posted with straight moves (G1) only"),
    950: ("feed per revolution: the time depends on the spindle", "have it posted with G94 or G93"),
    960: ("constant surface speed: the time depends on the spindle", "have it posted with G94 or G93"),
}
_KNOWN_M = {2, 3, 4, 5, 7, 8, 9, 30}
_ENDS = {2, 30}
_STOPS = {0, 1, 60}
_LETTERS = frozenset("NGMFPS" + AXES)
_REFUSED_LETTER = {
    "O": ("O-words (sub-programs, loops) are not read", "have it posted again without sub-programs and loops"),
    "B": ("a B axis is not known: the wrist has A and C", "have it posted for an A/C wrist"),
    "I": ("I, J, K (arcs or tool vectors) are not read", "have it posted with A and C, and straight moves"),
    "J": ("I, J, K (arcs or tool vectors) are not read", "have it posted with A and C, and straight moves"),
    "K": ("I, J, K (arcs or tool vectors) are not read", "have it posted with A and C, and straight moves"),
    "T": ("a tool change needs a person", "take it out: the cell polishes with one tool"),
}


class Block(NamedTuple):
    """A line's words, sorted: one code per modal group, one number per letter."""

    codes: dict[str, int]
    """Modal group: code times ten."""
    numbers: dict[str, Word]
    ends: bool
    """It has M2 or M30."""
    tail: int
    """Where the last word ends in the line."""

    @property
    def moves(self) -> bool:
        """It names at least one axis."""
        return not self.numbers.keys().isdisjoint(AXES)


def block(place: Place) -> Block | None:
    """Sort a line's words; None for a line without words. ProgramError for what is unknown or said twice."""
    found = words(place)
    if not found:
        return None
    codes: dict[str, int] = {}
    numbers: dict[str, Word] = {}
    ends = False
    for word in found:
        letter = word.letter
        if letter == "G":
            _add_code(place, codes, word.value)
        elif letter == "M":
            ends |= _m_ends(place, word.value)
        elif letter in numbers:
            raise place.refuse(f"{letter} stands twice in one block", "split the block")
        elif letter not in _LETTERS:
            reason = (f"the word {letter} is not known", "take it out, or have it posted without it")
            raise place.refuse(*_REFUSED_LETTER.get(letter, reason))
        else:
            numbers[letter] = word
    if "N" in numbers and found[0].letter != "N":
        raise place.refuse("N is not the first word", "put it first")
    if "P" in numbers and "dwell" not in codes and codes.get("path") != 640:
        raise place.refuse("P without G4 or G64: its meaning is not known", "take it out, or write G4 into the block")
    if "dwell" in codes and codes.get("path") == 640:
        raise place.refuse("G4 and G64 in one block: whose P it is, is not known", "split the block")
    return Block(codes, numbers, ends, found[-1].end)


def _add_code(place: Place, codes: dict[str, int], value: float) -> None:
    code = round(value * 10)
    group = _GROUPS.get(code) if abs(value * 10 - code) < 1e-6 else None
    if group is None:
        reason = (f"G{value:g} is not known", "take it out, or have it posted without it")
        raise place.refuse(*_REFUSED_G.get(code, reason))
    if group in codes:
        raise place.refuse("two G codes of one group in a block contradict each other", "split the block")
    codes[group] = code


def _m_ends(place: Place, value: float) -> bool:
    if value in _STOPS:
        raise place.refuse(f"M{value:g} waits for a person, and the cell is unattended", "take it out")
    if value not in _KNOWN_M:
        raise place.refuse(f"M{value:g} is not known", "take it out, or have it posted without it")
    return value in _ENDS
