"""Text from outside as it may be shown: to a terminal, in a log, a mail or a table."""

from __future__ import annotations

import re

_CONTROL = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ud800-\udfff]")
"""All but tab and line feed, and what turns the direction of text; lone surrogates, which no encoding takes."""


def printable(text: str) -> str:
    r"""Return text from outside with each control character as its escape, ``\u001b``.

    A terminal, a log, a mail or a table then shows it, and obeys none of it. In JSON the escape means the character.
    """
    return _CONTROL.sub(lambda found: f"\\u{ord(found[0]):04x}", text)
