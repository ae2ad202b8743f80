"""Lines that a robot's driver adds to a program, read as the program's dialect reads them."""

from __future__ import annotations

import re

from polishd.api import OwnLines
from polishd.plugins.rnc_robot.dialect import AnyDialect, GcodeDialect
from polishd.plugins.rnc_robot.languages.profile import LanguageProfile

_UNIT_S = {"s": 1.0, "ms": 1e-3}
_OFF_S = 1e-6
_WORD = r"[A-Z]\s*[-+]?(?:\d+\.?\d*|\.\d+)"
_NC = re.compile(rf"(?:\s*{_WORD})+\s*|%", re.IGNORECASE)
"""A block of letters with numbers."""
_STOP = re.compile(r"(?:N\d+\s*)?M0*(?:0|2|30)|%", re.IGNORECASE)
_DWELL = re.compile(
    r"(?:N\d+\s*)?G\s*0*(?P<code>\d+(?:\.\d+)?)\s*(?P<word>[A-Z#=]+)\s*(?P<number>\d+\.?\d*|\.\d+)", re.IGNORECASE
)


def misread(dialect: AnyDialect, lines: OwnLines) -> str:
    """Return the first line that means something else in this dialect, and what; empty where none does."""
    for seconds, line in lines.dwells.items():
        rests = _nc_dwell_s(dialect, line) if isinstance(dialect, GcodeDialect) else _language_dwell_s(dialect, line)
        if rests is None:
            return f"{line!r} is no dwell in {dialect.name}"
        if abs(rests - seconds) > _OFF_S:
            return f"{line!r} rests for {rests:g} s in {dialect.name}, not for {seconds:g} s"
    for line in filter(None, lines.stops):
        if isinstance(dialect, GcodeDialect):
            if not _STOP.fullmatch(_bare(dialect, line)):
                return f"{line!r} is no stop and no end of a program in {dialect.name}"
        elif _NC.fullmatch(line) or _NC.fullmatch(re.sub(r"\(.*?\)|;.*", "", line)):
            return f"{line!r} is G-code, and {dialect.name} is none"
    return ""


def _bare(dialect: GcodeDialect, line: str) -> str:
    """Return the line without the comments that this dialect knows."""
    for comment in dialect.text.comments:
        line = re.sub(r"\([^()]*\)" if comment == "()" else r";.*", "", line)
    return line.strip()


def _nc_dwell_s(dialect: GcodeDialect, line: str) -> float | None:
    """Seconds of a block that is nothing but a dwell; None: it is something else."""
    if (found := _DWELL.fullmatch(_bare(dialect, line))) is None or float(found["code"]) not in dialect.dwell.codes:
        return None
    word = dialect.dwell.words.get(found["word"].upper())
    unit = None if word is None else word.decimal if "." in found["number"] else word.whole
    return None if unit is None or unit not in _UNIT_S else float(found["number"]) * _UNIT_S[unit]


def _language_dwell_s(profile: LanguageProfile, line: str) -> float | None:
    """Seconds of a statement that is a dwell of this language; None: it is something else."""
    for pattern in profile.patterns:
        if pattern.kind.startswith("dwell") and (found := pattern.regex.fullmatch(line.strip().encode())):
            return float(found["time"]) * profile.dwell.unit_s
    return None
