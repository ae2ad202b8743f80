"""A reader of URScript without arcs, force and lists of joints: statements as a tree, expressions as Python's.

URScript writes expressions as Python does; a pose ``p[...]`` reads there as an index into ``p``.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Generator, Mapping
from dataclasses import dataclass, field, replace

from polishd.model.errors import ProgramError

Expression = ast.expr
_NAME = r"[A-Za-z_]\w*"
_ROUTINE = re.compile(rf"(def|thread)\s+({_NAME})\s*\(([^)]*)\)\s*:")
_BRANCH = re.compile(r"(while|if|elif)\b(.*):")
_KILL = re.compile(rf"(kill|join)\s+({_NAME})")
_RUN = re.compile(rf"(?:(?:global|local)\s+)?({_NAME})\s*=\s*run\s+({_NAME})\s*\(\s*\)")
_ASSIGN = re.compile(rf"(?:(global|local)\s+)?({_NAME})\s*=(?!=)(.*)")
ALLOWED = (
    ast.Expression, ast.BoolOp, ast.And, ast.Or, ast.UnaryOp, ast.Not, ast.USub, ast.UAdd, ast.BinOp, ast.Add, ast.Sub,
    ast.Mult, ast.Div, ast.Compare, ast.Eq, ast.NotEq, ast.Lt, ast.LtE, ast.Gt, ast.GtE, ast.Call, ast.keyword,
    ast.Name, ast.Load, ast.Constant, ast.List, ast.Tuple, ast.Subscript,
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class ScriptStatement:
    """Where it stands: 1-based line."""

    line: int


@dataclass(frozen=True, slots=True)
class Do(ScriptStatement):
    """A call."""

    call: ast.Call


@dataclass(frozen=True, slots=True)
class Assign(ScriptStatement):
    """``x = ...``."""

    name: str
    value: Expression
    everywhere: bool


@dataclass(frozen=True, slots=True)
class Branches(ScriptStatement):
    """``if`` and its ``elif`` and ``else``, or ``while``."""

    cases: list[tuple[Expression | None, list[ScriptStatement]]]
    repeats: bool


@dataclass(frozen=True, slots=True)
class RunThreadStatement(ScriptStatement):
    """``handle = run thread()``."""

    handle: str
    thread: str


@dataclass(frozen=True, slots=True)
class End(ScriptStatement):
    """``kill`` a thread, or ``join`` it."""

    handle: str
    waits: bool


@dataclass(frozen=True, slots=True)
class Routine(ScriptStatement):
    """A function or a thread."""

    name: str
    parameters: tuple[str, ...]
    body: list[ScriptStatement] = field(repr=False)
    calls: Mapping[str, int] = field(default_factory=dict, repr=False)
    """Of the script: all that is called in it, and the line where it is first."""
    routines: frozenset[str] = frozenset()
    """Of the script: names of those that it defines."""


TURN = 20
"""Statements that are read at a time."""


def parse(text: str) -> Routine:
    """The one program in a script. ProgramError with (words, line) where it cannot be read."""
    reading = parsing(text)
    while True:
        try:
            next(reading)
        except StopIteration as end:
            routine: Routine = end.value
            return routine


def parsing(text: str) -> Generator[None, None, Routine]:
    """The same, a few statements at a turn."""
    lines: list[tuple[int, str]] = []
    for number, line in enumerate(text.splitlines(), start=1):
        if bare := _bare(line):
            lines.append((number, bare))
        if number % (20 * TURN) == 0:
            yield
    found = _Reader(lines)
    statements = yield from found.body(stops=())
    if len(statements) != 1 or not isinstance(statements[0], Routine):
        raise ProgramError("a script is one def", 1)
    return replace(statements[0], calls=found.calls, routines=frozenset(found.routines))


def _bare(line: str) -> str:
    """Without comment and blanks."""
    if "#" not in line:
        return line.strip()
    quoted = False
    for at, char in enumerate(line):
        quoted ^= char == '"'
        if char == "#" and not quoted:
            return line[:at].strip()
    return line.strip()


@dataclass(slots=True)
class _Reader:
    lines: list[tuple[int, str]]
    at: int = 0
    calls: dict[str, int] = field(default_factory=dict)
    routines: set[str] = field(default_factory=set)

    def body(self, stops: tuple[str, ...]) -> Generator[None, None, list[ScriptStatement]]:
        """Statements up to a line that begins with one of those words, which is left; without any: to the end."""
        found: list[ScriptStatement] = []
        while self.at < len(self.lines):
            number, line = self.lines[self.at]
            if re.split(r"\W", line, maxsplit=1)[0] in stops:
                return found
            self.at += 1
            if self.at % TURN == 0:
                yield
            found.append((yield from self._statement(number, line)))
        if stops:
            raise ProgramError("the script breaks off: an end is missing", self.lines[-1][0])
        return found

    def _statement(self, number: int, line: str) -> Generator[None, None, ScriptStatement]:
        if match := _ROUTINE.fullmatch(line):
            self.routines.add(match[2])
            body = yield from self.body(stops=("end",))
            self.at += 1
            return Routine(number, match[2], tuple(filter(None, map(str.strip, match[3].split(",")))), body)
        if match := _BRANCH.fullmatch(line):
            return (yield from self._branches(number, match))
        if match := _KILL.fullmatch(line):
            return End(number, match[2], match[1] == "join")
        if match := _RUN.fullmatch(line):
            self.calls.setdefault(match[2], number)
            return RunThreadStatement(number, match[1], match[2])
        if match := _ASSIGN.fullmatch(line):
            return Assign(number, match[2], self._expression(number, match[3]), match[1] == "global")
        call = self._expression(number, line)
        if not isinstance(call, ast.Call):
            raise ProgramError(f"syntax error at {line[:40]!r}", number)
        return Do(number, call)

    def _branches(self, number: int, match: re.Match[str]) -> Generator[None, None, Branches]:
        if match[1] == "elif":
            raise ProgramError("elif without if", number)
        cases: list[tuple[Expression | None, list[ScriptStatement]]] = []
        condition: Expression | None = self._expression(number, match[2])
        while True:
            body = yield from self.body(stops=("end", "elif", "else"))
            cases.append((condition, body))
            at, line = self.lines[self.at]
            self.at += 1
            if line == "end":
                return Branches(number, cases, match[1] == "while")
            more = _BRANCH.fullmatch(line)
            condition = self._expression(at, more[2]) if more else None

    def _expression(self, line: int, text: str) -> Expression:
        try:
            found = ast.parse(text.strip(), mode="eval")
        except (SyntaxError, ValueError, RecursionError):
            raise ProgramError(f"syntax error at {text.strip()[:40]!r}", line) from None
        for node in ast.walk(found):
            if not isinstance(node, ALLOWED):
                raise ProgramError(f"syntax error at {text.strip()[:40]!r}", line)
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
                self.calls.setdefault(node.func.id, line)
        return found.body
