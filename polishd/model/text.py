"""Text from outside, made safe to show, and values with their errors."""

from __future__ import annotations

import math
import re

_CONTROL = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ud800-\udfff]")
"""All but tab and line feed, and what turns the direction of text; lone surrogates, which no encoding takes."""
_MOST_DIGITS = 7


def printable(text: str) -> str:
    r"""Return text from outside with each control character as its escape, ``\u001b``.

    A terminal, a log, a mail or a table then shows it, and obeys none of it. In JSON the escape means the character.
    """
    return _CONTROL.sub(lambda found: f"\\u{ord(found[0]):04x}", text)


def with_error(value: float, error: float, sign: str = "") -> str:
    """``value +- error`` in words: the error to two digits, and the value at least as fine as those."""
    digits = 3
    if 0.0 < error < abs(value) < math.inf:
        digits = max(digits, math.floor(math.log10(abs(value))) - math.floor(math.log10(error)) + 2)
    return f"{value:{sign}.{min(digits, _MOST_DIGITS)}g} +- {error:.2g}"
