"""A reader of URScript without arcs, force and lists of joints: statements as a tree, expressions by Python's parser.

URScript writes expressions as Python does; a pose ``p[...]`` is read as an index into ``p``.
"""

from __future__ import annotations

import ast
import math
import operator
import re
from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

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
    """Position: 1-based line."""

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
    """Of the script: all names that are called in it, with the first line of each."""
    routines: frozenset[str] = frozenset()
    """Of the script: all names that it defines."""


TURN = 20
"""Statements in one turn of reading."""


def parse(text: str) -> Routine:
    """Read the only program in a script. ProgramError with (message, line) where it is invalid."""
    reading = parsing(text)
    while True:
        try:
            next(reading)
        except StopIteration as end:
            routine: Routine = end.value
            return routine


def parsing(text: str) -> Generator[None, None, Routine]:
    """Read a program, a few statements at a turn."""
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
    """Return the line without comment and blanks."""
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
        """Return the statements before a line that begins with one of those words; without any: to the end."""
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


# Evaluation of a script's expressions.

Quick = Callable[..., Any]
"""A function of the language that takes no time."""
_TWO: dict[type, Callable[[Any, Any], Any]] = {
    ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: operator.mul, ast.Div: operator.truediv,
    ast.Eq: operator.eq, ast.NotEq: operator.ne, ast.Lt: operator.lt, ast.LtE: operator.le, ast.Gt: operator.gt,
    ast.GtE: operator.ge,
}  # fmt: skip
_ONE: dict[type, Callable[[Any], Any]] = {ast.Not: operator.not_, ast.USub: operator.neg, ast.UAdd: operator.pos}


@dataclass(slots=True)
class ScriptScope:
    """Names and their values; a routine sees those of the enclosing one."""

    outer: ScriptScope | None = None
    values: dict[str, Any] = field(default_factory=dict)

    def find(self, name: str) -> Any:
        """Return a value."""
        scope: ScriptScope | None = self
        while scope is not None:
            if name in scope.values:
                return scope.values[name]
            scope = scope.outer
        raise ProgramError(f"name '{name}' is not defined", 0)

    def everywhere(self) -> ScriptScope:
        """Return the outermost scope."""
        return self if self.outer is None else self.outer.everywhere()


@dataclass(slots=True)
class Values:
    """Evaluate expressions. ProgramError with (message, line) where one has no value."""

    functions: dict[str, Quick]

    def of(self, node: Expression, scope: ScriptScope) -> Any:
        """Return the value."""
        match node:
            case ast.Constant():
                return node.value
            case ast.Name():
                return scope.find(node.id)
            case ast.List() | ast.Tuple():
                return [self.of(item, scope) for item in node.elts]
            case ast.Call():
                return self._called(node, scope)
            case ast.Subscript():
                return self._indexed(node, scope)
        return self._worked_out(node, scope)

    def arguments(self, call: ast.Call, scope: ScriptScope) -> tuple[str, list[Any], dict[str, Any]]:
        """Return the called name and the arguments."""
        name = call.func.id if isinstance(call.func, ast.Name) else ""
        named = {keyword.arg or "": self.of(keyword.value, scope) for keyword in call.keywords}
        return name, [self.of(argument, scope) for argument in call.args], named

    def _worked_out(self, node: Expression, scope: ScriptScope) -> Any:
        match node:
            case ast.BoolOp():
                each = (self.of(part, scope) for part in node.values)
                return any(each) if isinstance(node.op, ast.Or) else all(each)
            case ast.UnaryOp():
                return _ONE[type(node.op)](self.of(node.operand, scope))
            case ast.BinOp():
                return _TWO[type(node.op)](self.of(node.left, scope), self.of(node.right, scope))
            case ast.Compare():
                values = [self.of(part, scope) for part in (node.left, *node.comparators)]
                pairs = zip(node.ops, values[:-1], values[1:], strict=True)
                return all(_TWO[type(test)](a, b) for test, a, b in pairs)
        raise ProgramError("an expression that is not known", node.lineno)

    def _called(self, node: ast.Call, scope: ScriptScope) -> Any:
        name, arguments, named = self.arguments(node, scope)
        if name not in self.functions:
            raise ProgramError(f"{name}() gives no value", 0)
        return self.functions[name](*arguments, **named)

    def _indexed(self, node: ast.Subscript, scope: ScriptScope) -> Any:
        index = self.of(node.slice, scope)
        if isinstance(node.value, ast.Name) and node.value.id == "p":
            return _pose(index)
        return self.of(node.value, scope)[index]


def _pose(values: Sequence[float]) -> list[float]:
    if not isinstance(values, list) or len(values) != 6:
        raise ProgramError("a pose has six numbers", 0)
    return [float(value) for value in values]


# A running script: threads in frames, each a generator that yields when its frame is used up.

Frames = Generator[None, None, None]
"""Yields at the end of each frame that it uses."""
Slow = Callable[..., Frames]
"""A function that takes frames."""
ENDLESS = 10_000
"""Turns of a loop within one frame after which the controller gives up."""


@dataclass(slots=True)
class Thread:
    """A running thread."""

    frames: Frames
    over: bool = False


class RunningScript:
    """A script from its first frame to its last. ``quick`` and ``slow`` are its functions."""

    def __init__(self, routine: Routine, quick: dict[str, Quick], slow: dict[str, Slow]) -> None:
        self._values, self._slow = Values({**quick, "sqrt": math.sqrt, "norm": lambda part: math.hypot(*part)}), slow
        known = {*self._values.functions, *slow, *routine.routines}
        for name, line in routine.calls.items():
            if name not in known:
                raise ProgramError(f"Compile error: name '{name}' is not defined", line)
        self.line = routine.line
        """Line under way, for error messages."""
        self._threads: list[Thread] = []
        self._main = self._begin(self._body(routine.body, ScriptScope()))

    @property
    def over(self) -> bool:
        """True if its main thread has ended: the others end with it."""
        return self._main.over

    def frame(self) -> None:
        """Run all threads until each has used up its frame. ProgramError with (message, line) for a runtime error."""
        for thread in list(self._threads):
            if self._main.over:
                return
            if not thread.over and next(thread.frames, self) is self:
                thread.over = True
        self._threads = [thread for thread in self._threads if not thread.over]

    def _begin(self, frames: Frames) -> Thread:
        self._threads.append(Thread(frames))
        return self._threads[-1]

    def _body(self, body: Sequence[ScriptStatement], scope: ScriptScope) -> Frames:
        for statement in body:
            self.line = statement.line
            match statement:
                case Do():
                    yield from self._do(statement.call, scope)
                case Assign():
                    where = scope.everywhere() if statement.everywhere else _home(scope, statement.name)
                    where.values[statement.name] = self._values.of(statement.value, scope)
                case Branches():
                    yield from self._branches(statement, scope)
                case Routine():
                    scope.values[statement.name] = (statement, scope)
                case RunThreadStatement():
                    routine, outer = scope.find(statement.thread)
                    scope.values[statement.handle] = self._begin(self._body(routine.body, ScriptScope(outer)))
                case End():
                    yield from self._end(scope.find(statement.handle), waits=statement.waits)

    def _branches(self, statement: Branches, scope: ScriptScope) -> Frames:
        turns = 0
        while True:
            taken = next((body for test, body in statement.cases if test is None or self._values.of(test, scope)), None)
            if taken is None:
                return
            used = False
            for _ in self._body(taken, scope):
                used = True
                yield
            if not statement.repeats:
                return
            turns = 0 if used else turns + 1
            if turns > ENDLESS:
                raise ProgramError("infinite loop detected in program", statement.line)

    def _end(self, thread: Thread, *, waits: bool) -> Frames:
        while waits and not thread.over:
            yield
        if not thread.over:
            thread.over = True
            thread.frames.close()

    def _do(self, call: ast.Call, scope: ScriptScope) -> Frames:
        name, arguments, named = self._values.arguments(call, scope)
        if name in self._slow:
            yield from self._slow[name](*arguments, **named)
        elif name in self._values.functions:
            self._values.functions[name](*arguments, **named)
        else:
            routine, outer = scope.find(name)
            yield from self._body(
                routine.body, ScriptScope(outer, dict(zip(routine.parameters, arguments, strict=True)))
            )


def _home(scope: ScriptScope, name: str) -> ScriptScope:
    """Return the target of an assignment without ``global``: the scope that defines the name, else this one."""
    found: ScriptScope | None = scope
    while found is not None:
        if name in found.values:
            return found
        found = found.outer
    return scope
