"""The steps of an order: ``"command = 1"`` on Modbus, the request itself on lines."""

from __future__ import annotations

import re
from dataclasses import dataclass
from string import Formatter
from typing import Literal

_WRITE = re.compile(r"\s*([A-Za-z]\w*)\s*=\s*(asked|count|[-+]?\d+(?:\.\d+)?|0[xX][0-9A-Fa-f]+)\s*")
SLOTS = {"asked": 1.5, "count": 1}
"""What a request may have in braces, with a value to try its format with."""


@dataclass(frozen=True, slots=True)
class Write:
    """One write to a register."""

    register: str
    value: float | Literal["asked", "count"]


def write_of(step: str) -> Write:
    """A step on Modbus. ValueError says what is wrong with it."""
    match = _WRITE.fullmatch(step)
    if match is None:
        raise ValueError(f'{step!r} is no write; write "register = 1", "register = asked" or "register = count"')
    name, text = match.groups()
    if text in {"asked", "count"}:
        return Write(name, text)  # type: ignore[arg-type]
    return Write(name, float(int(text, 16)) if text[:2].lower() == "0x" else float(text))


def slots_of(step: str) -> set[str]:
    """What stands in braces in a step on lines. ValueError says what is wrong with it."""
    try:
        found = {name for _, name, _, _ in Formatter().parse(step) if name is not None}
        if unknown := found - set(SLOTS):
            raise ValueError(f"{{{min(unknown)}}} is none of {{asked}}, {{count}}")
        step.format(**SLOTS).encode("ascii")
    except (ValueError, IndexError, KeyError, AttributeError) as error:
        raise ValueError(f"{step!r} cannot be sent: {error}") from error
    return found
