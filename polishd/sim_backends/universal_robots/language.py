"""A reader of URScript without arcs, force and lists of joints: statements as a tree, expressions as Python's.

URScript writes expressions as Python does; a pose ``p[...]`` reads there as an index into ``p``.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

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
class Statement:
    """Where it stands: 1-based line."""

    line: int


@dataclass(frozen=True, slots=True)
class Do(Statement):
    """A call."""

    call: ast.Call


@dataclass(frozen=True, slots=True)
class Assign(Statement):
    """``x = ...``."""

    name: str
    value: Expression
    everywhere: bool


@dataclass(frozen=True, slots=True)
class Branches(Statement):
    """``if`` and its ``elif`` and ``else``, or ``while``."""

    cases: list[tuple[Expression | None, list[Statement]]]
    repeats: bool


@dataclass(frozen=True, slots=True)
class Run(Statement):
    """``handle = run thread()``."""

    handle: str
    thread: str


@dataclass(frozen=True, slots=True)
class End(Statement):
    """``kill`` a thread, or ``join`` it."""

    handle: str
    waits: bool


@dataclass(frozen=True, slots=True)
class Routine(Statement):
    """A function or a thread."""

    name: str
    parameters: tuple[str, ...]
    body: list[Statement] = field(repr=False)


def parse(text: str) -> Routine:
    """The one program in a script. ProgramError with (words, line) where it cannot be read."""
    lines = ((number, _bare(line)) for number, line in enumerate(text.splitlines(), start=1))
    found = _Reader([(number, line) for number, line in lines if line])
    statements = found.body(stops=())
    if len(statements) != 1 or not isinstance(statements[0], Routine):
        raise ProgramError("a script is one def", 1)
    return statements[0]


def calls(routine: Routine) -> Iterator[tuple[int, str]]:
    """(line, name) of all that is called in it."""
    for statement in _all(routine.body):
        for node in _nodes(statement):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
                yield statement.line, node.func.id
        if isinstance(statement, Run):
            yield statement.line, statement.thread


def routines(routine: Routine) -> set[str]:
    """Names of those that it defines."""
    return {statement.name for statement in _all(routine.body) if isinstance(statement, Routine)}


def _all(body: Sequence[Statement]) -> Iterator[Statement]:
    for statement in body:
        yield statement
        if isinstance(statement, Routine):
            yield from _all(statement.body)
        elif isinstance(statement, Branches):
            for _, inner in statement.cases:
                yield from _all(inner)


def _nodes(statement: Statement) -> Iterator[ast.AST]:
    expressions: list[Expression | None] = []
    if isinstance(statement, Do):
        expressions = [statement.call]
    elif isinstance(statement, Assign):
        expressions = [statement.value]
    elif isinstance(statement, Branches):
        expressions = [condition for condition, _ in statement.cases]
    for expression in expressions:
        if expression is not None:
            yield from ast.walk(expression)


def _bare(line: str) -> str:
    """Without comment and blanks."""
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

    def body(self, stops: tuple[str, ...]) -> list[Statement]:
        """Statements up to a line that begins with one of those words, which is left; without any: to the end."""
        found: list[Statement] = []
        while self.at < len(self.lines):
            number, line = self.lines[self.at]
            if re.split(r"\W", line, maxsplit=1)[0] in stops:
                return found
            self.at += 1
            found.append(self._statement(number, line))
        if stops:
            raise ProgramError("the script breaks off: an end is missing", self.lines[-1][0])
        return found

    def _statement(self, number: int, line: str) -> Statement:
        if match := _ROUTINE.fullmatch(line):
            body = self.body(stops=("end",))
            self.at += 1
            return Routine(number, match[2], tuple(filter(None, map(str.strip, match[3].split(",")))), body)
        if match := _BRANCH.fullmatch(line):
            return self._branches(number, match)
        if match := _KILL.fullmatch(line):
            return End(number, match[2], match[1] == "join")
        if match := _RUN.fullmatch(line):
            return Run(number, match[1], match[2])
        if match := _ASSIGN.fullmatch(line):
            return Assign(number, match[2], _expression(number, match[3]), match[1] == "global")
        call = _expression(number, line)
        if not isinstance(call, ast.Call):
            raise ProgramError(f"syntax error at {line[:40]!r}", number)
        return Do(number, call)

    def _branches(self, number: int, match: re.Match[str]) -> Branches:
        if match[1] == "elif":
            raise ProgramError("elif without if", number)
        cases: list[tuple[Expression | None, list[Statement]]] = []
        condition: Expression | None = _expression(number, match[2])
        while True:
            cases.append((condition, self.body(stops=("end", "elif", "else"))))
            at, line = self.lines[self.at]
            self.at += 1
            if line == "end":
                return Branches(number, cases, match[1] == "while")
            more = _BRANCH.fullmatch(line)
            condition = _expression(at, more[2]) if more else None


def _expression(line: int, text: str) -> Expression:
    try:
        found = ast.parse(text.strip(), mode="eval")
    except (SyntaxError, ValueError, RecursionError):
        raise ProgramError(f"syntax error at {text.strip()[:40]!r}", line) from None
    for node in ast.walk(found):
        if not isinstance(node, ALLOWED):
            raise ProgramError(f"syntax error at {text.strip()[:40]!r}", line)
    return found.body
