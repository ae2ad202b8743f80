"""A program's text as statements, each matched by a template; unmatched text is refused."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass

from polishd.api import ProgramError
from polishd.plugins.rnc_robot.gcode.refusals import refuse
from polishd.plugins.rnc_robot.languages.profile import Kind, LanguageProfile


@dataclass(frozen=True, slots=True)
class MatchedStatement:
    """A statement and its line."""

    kind: Kind
    match: re.Match[bytes]
    line: int
    """1-based line of its first byte."""
    note: str = ""
    advice: str = ""

    def text(self, field: str) -> str | None:
        """Text of a field; None where the template or the statement has no such field."""
        if field not in self.match.re.groupindex or self.match[field] is None:
            return None
        return self.match[field].decode("latin-1").strip()

    def number(self, field: str) -> float | None:
        """A field that is a number."""
        if field not in self.match.re.groupindex or self.match[field] is None:
            return None
        return float(self.match[field])


@dataclass(frozen=True, slots=True)
class ProgramSource:
    """A program's bytes and name, for messages."""

    data: bytes
    name: str
    beside: bytes = b""
    """Content of the file beside it that declares its positions."""

    def refuse(self, line: int, reason: str, advice: str) -> ProgramError:
        """Return the error that names file and line, shows the line, and gives reason and advice."""
        return refuse(self.name, line, self.data.split(b"\n")[line - 1], reason, advice)


def statements(profile: LanguageProfile, source: ProgramSource) -> Iterator[MatchedStatement]:
    """Yield the statements in file order. ProgramError for the first that is unknown or refused."""
    data = source.data
    lone = re.search(rb"\r(?!\n)", data)
    if lone:
        line = data.count(b"\n", 0, lone.start()) + 1
        raise source.refuse(line, "a carriage return without a line feed", "save it with the line ends of one system")
    require_short_lines(source)
    comments = "|".join(map(re.escape, profile.comments)).encode()
    skip = re.compile(rb"(?:[ \t\r\n]++|(?:" + comments + rb")[^\n]*+)*+" if comments else rb"[ \t\r\n]*+")
    at, line = 0, 1
    while True:
        start = skip.match(data, at).end()  # type: ignore[union-attr]
        line += data.count(b"\n", at, start)
        if start == len(data):
            return
        statement = _matched(profile, source, start, line)
        yield statement
        at = statement.match.end()
        line += data.count(b"\n", start, at)


LONGEST_LINE = 1 << 11
"""Bytes of a line: templates may go over a line as often as it has bytes.

A field that may run over line ends has no such limit: it must be possessive."""


def require_short_lines(source: ProgramSource) -> None:
    """ProgramError at the first line of more than ``LONGEST_LINE`` bytes."""
    long = re.search(rb"^[^\n]{%d}" % (LONGEST_LINE + 1), source.data, re.MULTILINE)
    if long:
        line = source.data.count(b"\n", 0, long.start()) + 1
        raise source.refuse(
            line, f"a line of more than {LONGEST_LINE} bytes", "split it, or check that the file is a program"
        )


def _matched(profile: LanguageProfile, source: ProgramSource, start: int, line: int) -> MatchedStatement:
    for pattern in profile.patterns:
        match = pattern.regex.match(source.data, start)
        if match is None:
            continue
        if pattern.kind == "refused":
            raise source.refuse(line, pattern.note, pattern.advice)
        return MatchedStatement(pattern.kind, match, line, pattern.note, pattern.advice)
    raise source.refuse(
        line,
        f"the profile {profile.name} does not know this statement",
        f"remove it, or add a template for it to your own profile (extends = {profile.name!r})",
    )
