"""One line of RS274 text as words, each with the place of its number in the line."""

from __future__ import annotations

import re
from typing import NamedTuple

from polishd.api import ProgramError

LONGEST_LINE = 255
"""RS274 interpreters refuse longer ones."""
LARGEST_NUMBER = 1e9

_TOKEN = re.compile(
    rb"[ \t]+"
    rb"|\([^()]*\)"
    rb"|;.*"
    rb"|([A-Za-z])[ \t]*([-+]?[ \t]*(?:[0-9][0-9 \t]*(?:\.[0-9 \t]*)?|\.[ \t]*[0-9][0-9 \t]*))",
    re.DOTALL,
)
_BLANKS = b" \t"
_NO_VARIABLES = "have it posted again without variables, expressions and loops"
_WHY = {
    ord("#"): ("variables are not read", _NO_VARIABLES),
    ord("["): ("expressions are not read", _NO_VARIABLES),
    ord("="): ("assignments are not read", _NO_VARIABLES),
    ord("<"): ("named variables and sub-programs are not read", _NO_VARIABLES),
    ord("("): ("a comment is not closed, or holds another", "close it with ) on the same line"),
    ord(")"): ("a ) without its (", "mend the comment"),
    ord("/"): ("block delete: whether the block runs is up to a switch", "delete the block or its /"),
    ord("*"): ("checksums are not read", "have it posted again without checksums"),
    ord("%"): ("% stands alone on its line or not at all", "put it on a line of its own"),
}


class Word(NamedTuple):
    """A letter (upper case) and its number, with the number's place in the line."""

    letter: str
    value: float
    start: int
    end: int


class Place(NamedTuple):
    """A line of a program, for words and for messages."""

    name: str
    number: int
    text: bytes

    def refuse(self, reason: str, advice: str) -> ProgramError:
        """The error that names this line, what is wrong with it, and what to do."""
        shown = self.text.decode("ascii", "backslashreplace").strip()
        shown = shown if len(shown) <= 80 else shown[:77] + "..."
        return ProgramError(f'{self.name}, line {self.number}: {reason}: "{shown}". To do: {advice}.')


def words(place: Place) -> list[Word]:
    """The words of a line, comments left out. ProgramError where anything in the line is not understood."""
    text = place.text
    if len(text) > LONGEST_LINE:
        raise place.refuse(f"longer than {LONGEST_LINE} bytes", "split the line")
    found = []
    at = 0
    for token in _TOKEN.finditer(text):
        if token.start() != at:
            raise _unknown(place, at)
        at = token.end()
        letter, number = token.groups()
        if letter is None:
            continue
        number = number.rstrip(_BLANKS)
        start = token.start(2)
        value = float(number.translate(None, _BLANKS))
        if not -LARGEST_NUMBER <= value <= LARGEST_NUMBER:
            raise place.refuse("a number beyond any machine", "correct it")
        found.append(Word(letter.decode().upper(), value, start, start + len(number)))
    if at != len(text):
        raise _unknown(place, at)
    return found


def _unknown(place: Place, at: int) -> ProgramError:
    code = place.text[at]
    if chr(code) in "oO" or place.text.lstrip(_BLANKS)[:1] in (b"o", b"O"):
        return place.refuse("O-words (sub-programs, loops) are not read", _NO_VARIABLES)
    rest = place.text[at + 1 :].lstrip(_BLANKS + b"+-")
    if chr(code).isascii() and chr(code).isalpha():
        if rest[:1] in (b"#", b"["):
            return place.refuse(*_WHY[rest[0]])
        return place.refuse(f"{chr(code)} without a number", "correct the word")
    reason = f"column {at + 1} holds {place.text[at : at + 1]!r}, which is no RS274"
    return place.refuse(*_WHY.get(code, (reason, "remove it, or put it into a comment")))
