"""Positions, speeds, tools and frames that a program declares, or the file beside it (.dat, .dtx)."""

from __future__ import annotations

import math
import re

from polishd.plugins.rnc_robot.languages.columns import Context
from polishd.plugins.rnc_robot.languages.profile import DataFile
from polishd.plugins.rnc_robot.languages.program_scan import (
    NOWHERE,
    ModalFeed,
    Scan,
    context_at,
    feed_unit_mm_min,
    is_number,
    place_of,
    pose_of,
)
from polishd.plugins.rnc_robot.languages.statements import MatchedStatement, ProgramSource, require_short_lines


def take_position(found: Scan, statement: MatchedStatement) -> None:
    """Keep a declared position; ProgramError where the program declares it twice, or moved to another value of it."""
    name = statement.text("target") or ""
    if found.section != found.profile.position_section:
        take_unread_position(found, statement)
        return
    if found.folded(name) in found.positions:
        number = found.positions.number[found.folded(name)]
        if number >= found.positions_beside:
            other = found.positions.line[number]
            raise found.refuse(statement, f"the position {name} is declared in line {other} too", "keep one of them")
        if found.folded(name) in found.used:
            raise found.refuse(
                statement,
                f"the position {name} gets another value after a move to its value in the file beside the program",
                "use two positions",
            )
    context: Context = statement.text("tool"), statement.text("frame")
    if found.profile.modal_positions:
        context = context_at(found, statement)
    found.declared += 1
    found.positions.add(found.folded(name), place_of(found, statement), statement.line, context)


def take_unread_position(found: Scan, statement: MatchedStatement) -> None:
    """Keep the name of a position that is declared, but not in mm and angles of the tool."""
    found.declared += 1
    found.unread[found.folded(statement.text("target") or "")] = statement.line, found.section


def take_speed(found: Scan, statement: MatchedStatement) -> None:
    """A speed declared under a name."""
    factor = feed_unit_mm_min(found, statement.text("feed_unit"))
    found.speeds[found.folded(statement.text("feed_name") or "")] = (statement.number("rate") or math.nan) * factor


def take_context(found: Scan, statement: MatchedStatement) -> None:
    """A tool and a frame declared under a name."""
    name = found.folded(statement.text("context_name") or "")
    if statement.text("held_part") is not None:
        raise found.refuse(
            statement,
            "a tool and a frame of a part that the robot holds: they swap their roles",
            "have it posted for a tool at the flange",
        )
    found.named_contexts[name] = statement.text("tool"), statement.text("frame")


# The file beside the program: all else in it does not count.

_DATA = re.compile(rb"<(/?)(Data|Value)\b([^<>]*)>")
_ATTRIBUTE = re.compile(rb"(?<![\w:.-])([A-Za-z_][\w:.-]*+)\s*+=\s*+(?:\"([^\"<]*)\"|'([^'<]*)')")


def take_declarations_beside(found: Scan) -> None:
    """Keep positions, speeds, tools and frames of the file beside the program."""
    rules = found.profile.data_file
    if rules is None:
        return
    source = ProgramSource(found.source.beside, f"{found.source.name}: {rules.title}")
    other = Scan(found.profile, source)
    if rules.form == "xml":
        _from_elements(other, rules)
    else:
        _from_statements(other)
    found.positions, found.positions_beside = other.positions, len(other.positions.line)
    found.speeds, found.named_contexts = other.speeds, other.named_contexts
    found.feeds, found.zones = other.feeds, other.zones


def _from_statements(other: Scan) -> None:
    """Declarations at the begin of a line."""
    wanted = {"position": take_position, "speed": take_speed, "context": take_context}
    patterns = [pattern for pattern in other.profile.patterns if pattern.kind in wanted]
    require_short_lines(other.source)
    at = 0
    for line, text in enumerate(other.source.data.splitlines(keepends=True), 1):
        start = at + len(text) - len(text.lstrip())
        at += len(text)
        for pattern in patterns:
            if match := pattern.regex.match(other.source.data, start):
                wanted[pattern.kind](other, MatchedStatement(pattern.kind, match, line))
                break


def _from_elements(other: Scan, rules: DataFile) -> None:
    """Elements of XML arrays, each under ``name[key]``."""
    name = kind = ""
    at, line = 0, 1
    data = _without_comments(other.source.data)
    for match in _DATA.finditer(data):
        line += data.count(b"\n", at, match.start())
        at = match.start()
        named = {
            key.decode("latin-1"): (one or two).decode("latin-1") for key, one, two in _ATTRIBUTE.findall(match[3])
        }
        if match[2] == b"Data":
            name, kind = ("", "") if match[1] else (named.get("name", ""), named.get("type", ""))
            continue
        key = named.get("key", "")
        if match[1] or not name or not key.isdigit():
            continue
        if kind in rules.positions:
            _element_position(other, rules, f"{name}[{key}]", named, line)
        elif kind in rules.speeds:
            _element_speed(other, rules, f"{name}[{key}]", named)


def _without_comments(data: bytes) -> bytes:
    """XML with its comments blanked, line by line as long as before."""
    pieces, at = [], 0
    while (start := data.find(b"<!--", at)) >= 0:
        end = data.find(b"-->", start)
        end = len(data) if end < 0 else end
        pieces += [data[at:start], b"\n" * data.count(b"\n", start, end)]
        at = end
    return b"".join([*pieces, data[at:]])


def _element_position(other: Scan, rules: DataFile, name: str, named: dict[str, str], line: int) -> None:
    fields = ("x", "y", "z", *other.profile.orientation.fields)
    texts = [named.get(field, "0") for field in fields]
    if not all(map(is_number, texts)):
        raise other.refuse_line(line, f"a value of {name} is no number", "correct it")
    pose = pose_of(other, line, [float(text) for text in texts])
    if other.folded(name) in other.positions:
        raise other.refuse_line(line, f"the position {name} is declared twice", "keep one of them")
    other.positions.add(other.folded(name), pose, line, (None, named.get(rules.frame)))


def _element_speed(other: Scan, rules: DataFile, name: str, named: dict[str, str]) -> None:
    """A speed that cannot be rewritten, as it is not in the program: until the program sets another."""
    if is_number(named.get(rules.feed, "")):
        other.feeds[other.folded(name)] = ModalFeed(named[rules.feed], "", NOWHERE)
    if rules.zone in named:
        other.zones[other.folded(name)] = named[rules.zone]
