"""Values as text: what json cannot hold by itself as something that it can, and values as TOML."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import asdict, is_dataclass
from typing import Any

_CONTROL = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ud800-\udfff]")
"""All but tab and line feed, and what turns the direction of text; lone surrogates, which no encoding takes."""


def printable(text: str) -> str:
    r"""Return text from outside with each control character as its escape, ``\u001b``.

    A terminal, a log, a mail or a table then shows it, and obeys none of it. In JSON the escape means the character.
    """
    return _CONTROL.sub(lambda found: f"\\u{ord(found[0]):04x}", text)


def plain(value: object) -> object:
    """For ``json.dumps(..., default=plain)``: numbers stay numbers, records become objects, the rest its text."""
    import numpy as np  # only where something is no JSON by itself: who asks for a status waits for no numpy

    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, np.ndarray):
        return value.tolist()
    if is_dataclass(value) and not isinstance(value, type):
        return asdict(value)
    if isinstance(value, Mapping):
        return dict(value)
    return str(value)


def toml(value: Any) -> str:
    """A value as TOML writes it on one line."""
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{key} = {toml(one)}" for key, one in value.items()) + " }"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(toml, value)) + "]"
    return json.dumps(value) if isinstance(value, bool | str) else repr(value)
