r"""The notation of statement templates: ``MoveL <target>,<speed>,<zone>,<tool><? \WObj:=<frame>?>;``.

    text      itself; blanks are free around anything that is no letter or digit
    a blank   any blanks: at least one between words, numbers and fields
    <name>    a field: what the profile's ``[fields]`` says, else a number or a name
    <a|b>     one of these words
    <? ... ?> may be there or not

A template that ends with ``;`` is a statement that ends there; any other ends with its line, a comment left out.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

NUMBER = r"[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?"
NAME = r"[A-Za-z_][A-Za-z0-9_]*"

_TOKEN = re.compile(
    r"(?P<open><\?)|(?P<close>\?>)|<(?P<field>[a-z_][a-z0-9_]*)>|<(?P<choice>\w+(?:\|\w+)+)>"
    r"|(?P<blank>[ ]+)|(?P<word>\w+)|(?P<mark>.)"
)
_WORDY = ("field", "choice", "word")


@dataclass(frozen=True, slots=True)
class Writing:
    """How a language is written, as far as all its templates share it."""

    ignore_case: bool
    span_lines: bool
    comments: Sequence[str]
    numbers: frozenset[str]
    """Names of the fields that are numbers."""
    fields: Mapping[str, str]
    """Regular expressions of fields that are neither numbers nor names."""


def compiled(template: str, writing: Writing) -> re.Pattern[bytes]:
    """The regular expression of one template, a group for each field. re.error where it or a field is none."""
    blank = r"[ \t\r\n]" if writing.span_lines else r"[ \t]"
    tokens = [(match.lastgroup or "", match[match.lastgroup or 0]) for match in _TOKEN.finditer(template.strip())]
    parts = [_part(index, tokens, blank, writing) for index in range(len(tokens))]
    if tokens[-1:] != [("mark", ";")]:
        ends = "|".join([r"\r?\n", r"\Z", *map(re.escape, writing.comments)])
        parts.append(rf"[ \t]*+(?={ends})")
    flags = re.IGNORECASE if writing.ignore_case else re.NOFLAG
    return re.compile("".join(parts).encode(), flags)


def _part(index: int, tokens: Sequence[tuple[str, str]], blank: str, writing: Writing) -> str:
    kind, text = tokens[index]
    match kind:
        case "open":
            return "(?:"
        case "close":
            return ")?"
        case "blank":
            between = _wordy(tokens[index - 1 :: -1]) and _wordy(tokens[index + 1 :])
            return f"{blank}{'++' if between else '*+'}"
        case "field":
            default = NUMBER if text in writing.numbers else NAME
            return f"(?P<{text}>{writing.fields.get(text, default)})"
        case "choice":
            return f"(?:{text})"
        case "word":
            return text
    if text in "<>":
        raise re.error(f"{text} belongs to no field, choice or <? ... ?>")
    last = index == len(tokens) - 1
    return f"{blank}*+{re.escape(text)}" + ("" if last else f"{blank}*+")


def _wordy(tokens: Sequence[tuple[str, str]]) -> bool:
    """Whether the nearest token is a word, number or field, whatever may be there or not in between."""
    nearest = next((kind for kind, _ in tokens if kind not in {"open", "close"}), "mark")
    return nearest in _WORDY
