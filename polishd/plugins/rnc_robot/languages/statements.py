"""A program's text as statements, each matched by a template; what none matches is refused."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass

from polishd.api import ProgramError
from polishd.plugins.rnc_robot.languages.profile import Kind, LanguageProfile
from polishd.plugins.rnc_robot.nc.refusals import refuse


@dataclass(frozen=True, slots=True)
class MatchedStatement:
    """A statement and where it stands."""

    kind: Kind
    match: re.Match[bytes]
    line: int
    """1-based line of its first byte."""
    note: str = ""
    advice: str = ""

    def text(self, field: str) -> str | None:
        """What a field holds; None where the template has no such field, or it is not there."""
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

    def refuse(self, line: int, reason: str, advice: str) -> ProgramError:
        """The error that names file and line, shows the line, says what is wrong with it and what to do."""
        return refuse(self.name, line, self.data.split(b"\n")[line - 1], reason, advice)


def statements(profile: LanguageProfile, source: ProgramSource) -> Iterator[MatchedStatement]:
    """The statements in file order. ProgramError for the first that is unknown, or known to be refused."""
    data = source.data
    lone = re.search(rb"\r(?!\n)", data)
    if lone:
        line = data.count(b"\n", 0, lone.start()) + 1
        raise source.refuse(line, "a carriage return without a line feed", "save it with the line ends of one system")
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
        f"remove it, or add a template for it to a profile of your own (extends = {profile.name!r})",
    )
