"""What the box's answers mean. Raises ProtocolError on what the protocol does not have."""

from __future__ import annotations

import re

from polishd.api import ProtocolError

_STATES = {"ON": True, "OFF": False, "?": None}
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,39}", re.ASCII)
_NUMBER = re.compile(r"[+-]?\d{1,9}(\.\d{1,6})?", re.ASCII)


def listed(number: int, body: str) -> str:
    """The answer to ``LS?,number``: the name of that signal; empty after the last one."""
    start, name = body[: len(f"LS,{number}")], body.removeprefix(f"LS,{number}")
    if start != f"LS,{number}" or not (name == "" or (name[0] == "," and _NAME.fullmatch(name[1:]))):
        raise ProtocolError(f"no answer to LS?,{number}: {body!r}")
    return name[1:]


def parse_value(name: str, body: str) -> float | bool | None:
    """The answer to ``V?,name``: a number, a state, or None where the box does not know it."""
    text = body.removeprefix(f"V,{name},")
    if text == body or not (text in _STATES or _NUMBER.fullmatch(text)):
        raise ProtocolError(f"no answer to V?,{name}: {body!r}")
    return _STATES[text] if text in _STATES else float(text)
