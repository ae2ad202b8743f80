"""A reader of RAPID: modules with data, procedures and traps; statements as a tree, expressions as closures' nodes.

Records and arrays are lists. Functions with a value of the program's own, error handlers and strings' operators are not
read: a module with them is refused with its line.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Generator, Mapping
from dataclasses import dataclass, field
from typing import Any

from polishd.model.errors import ProgramError

_TOKEN = re.compile(
    r"(?P<blank>[ \t\r]+|![^\n]*)|(?P<line>\n)|(?P<number>(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)"
    r'|(?P<name>[A-Za-z_]\w*)|(?P<text>"(?:[^"\n]|"")*")|(?P<sign>:=|<>|<=|>=|[-+*/=<>()\[\]{},;.\\%:?])'
)
COMPONENTS: Mapping[str, int] = {
    "x": 0, "y": 1, "z": 2, "trans": 0, "rot": 1, "robconf": 2, "extax": 3, "robax": 0,
    "q1": 0, "q2": 1, "q3": 2, "q4": 3,
    "v_tcp": 0, "v_ori": 1, "v_leax": 2, "v_reax": 3, "robhold": 0, "tframe": 1, "tload": 2, "finep": 0,
}  # fmt: skip
"""Place of each component in its record."""
DEFAULTS: Mapping[str, Any] = {
    "num": 0.0, "dnum": 0.0, "bool": False, "string": "", "pos": [0.0] * 3, "orient": [1.0, 0.0, 0.0, 0.0],
}  # fmt: skip
"""Value of data that is declared without one."""
TURN = 4000
"""Tokens that are read in one turn."""


def single(value: Any) -> Any:
    """Return a value as RAPID keeps it: num has 24 bits."""
    if isinstance(value, float):
        return struct.unpack("f", struct.pack("f", value))[0]
    return [single(part) for part in value] if isinstance(value, list) else value


def shown(value: Any) -> str:
    """Return a value as RAPID writes it."""
    match value:
        case bool():
            return str(value).upper()
        case float():
            return f"{value:.7g}"
        case list():
            return "[" + ",".join(map(shown, value)) + "]"
    return '"' + str(value) + '"'


@dataclass(frozen=True, slots=True)
class Token:
    """A word of the text, and its 1-based line."""

    kind: str
    text: str
    line: int


@dataclass(frozen=True, slots=True)
class Literal:
    """A number, a text, TRUE or FALSE."""

    value: Any


@dataclass(frozen=True, slots=True)
class DataReference:
    """Data, with components and indices: a name or an expression for each."""

    name: str
    path: tuple[Any, ...]
    line: int


@dataclass(frozen=True, slots=True)
class Aggregate:
    """``[a, b, ...]``."""

    parts: tuple[Any, ...]


@dataclass(frozen=True, slots=True)
class FunctionCall:
    """``f(a, b)``."""

    name: str
    arguments: tuple[Any, ...]
    line: int


@dataclass(frozen=True, slots=True)
class Operation:
    """An operator with one or two operands."""

    operator: str
    operands: tuple[Any, ...]
    line: int


@dataclass(frozen=True, slots=True)
class Instruction:
    r"""``Name\Switch:=x, a, b;``: an instruction of the language, or a call of a procedure."""

    line: int
    name: str
    arguments: tuple[Any, ...]
    switches: Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Assignment:
    """``data := expression;``."""

    line: int
    target: DataReference
    value: Any


@dataclass(frozen=True, slots=True)
class Conditional:
    """``IF``, with its ELSEIF and ELSE; ``WHILE`` has one case and repeats."""

    line: int
    cases: tuple[tuple[Any, tuple[Any, ...]], ...]
    repeats: bool


@dataclass(frozen=True, slots=True)
class Declaration:
    """``PERS num x:=1;``."""

    line: int
    storage: str
    type: str
    name: str
    value: Any
    is_own: bool
    """LOCAL or TASK: not shared with other tasks."""


@dataclass(frozen=True, slots=True)
class RapidRoutine:
    """A procedure or a trap."""

    line: int
    name: str
    parameters: tuple[str, ...]
    body: tuple[Any, ...] = field(repr=False)
    is_trap: bool = False


@dataclass(frozen=True, slots=True)
class RapidSource:
    """A module."""

    name: str
    declarations: tuple[Declaration, ...] = field(repr=False)
    routines: Mapping[str, RapidRoutine] = field(repr=False)
    calls: Mapping[str, int] = field(repr=False)
    """Instructions, procedures and functions that it calls, in lower case, with the first line of each."""


def reading(text: str) -> Generator[None, None, RapidSource]:
    """Read a module, some tokens at a turn. ProgramError with (message, line) where it is invalid."""
    tokens: list[Token] = []
    at, line = 0, 1
    while at < len(text):
        match = _TOKEN.match(text, at)
        if match is None:
            raise ProgramError(f"syntax error at {text[at : at + 20]!r}", line)
        kind, at = str(match.lastgroup), match.end()
        if kind == "line":
            line += 1
        elif kind != "blank":
            tokens.append(Token(kind, match[0], line))
        if len(tokens) % TURN == TURN - 1:
            yield
    reader = _ModuleReader(tokens)
    return (yield from reader.module())


_BLOCK_ENDS = ("endproc", "endtrap", "endif", "endwhile", "else", "elseif", "error", "undo", "backward")
_UNREAD = ("for", "test", "goto", "return", "raise", "retry", "trynext", "exit", "func", "record", "alias")
_LEVELS: tuple[tuple[str, ...], ...] = (
    ("or", "xor"), ("and",), ("=", "<>", "<", ">", "<=", ">="), ("+", "-"), ("*", "/", "div", "mod"),
)  # fmt: skip


@dataclass(slots=True)
class _ModuleReader:
    tokens: list[Token]
    at: int = 0
    calls: dict[str, int] = field(default_factory=dict)

    # tokens

    def peek(self) -> str:
        return self.tokens[self.at].text.lower() if self.at < len(self.tokens) else ""

    @property
    def line(self) -> int:
        return self.tokens[min(self.at, len(self.tokens) - 1)].line if self.tokens else 1

    def take(self) -> Token:
        if self.at >= len(self.tokens):
            raise ProgramError("the module breaks off", self.line)
        self.at += 1
        return self.tokens[self.at - 1]

    def has(self, text: str) -> bool:
        if self.peek() == text:
            self.at += 1
            return True
        return False

    def need(self, text: str) -> None:
        if not self.has(text):
            raise ProgramError(f"{text!r} is expected, not {self.peek() or 'the end'!r}", self.line)

    def name(self) -> str:
        token = self.take()
        if token.kind != "name":
            raise ProgramError(f"a name is expected, not {token.text!r}", token.line)
        return token.text

    # the module

    def module(self) -> Generator[None, None, RapidSource]:
        if self.peek() == "%":
            while self.peek() not in {"module", ""}:
                self.at += 1
        self.need("module")
        name = self.name()
        if self.has("("):
            while not self.has(")"):
                self.take()
        declarations: list[Declaration] = []
        routines: dict[str, RapidRoutine] = {}
        turn_at = self.at
        while not self.has("endmodule"):
            is_own = self.has("local") | self.has("task")
            word = self.peek()
            if word in {"const", "pers", "var"}:
                declarations.append(self.declaration(is_own=is_own))
            elif word in {"proc", "trap"}:
                routine = yield from self.routine()
                if routine.name.lower() in routines:
                    raise ProgramError(f"{routine.name} is declared twice", routine.line)
                routines[routine.name.lower()] = routine
            else:
                raise ProgramError(f"syntax error at {word or 'the end'!r}", self.line)
            if self.at - turn_at > TURN:
                turn_at = self.at
                yield
        return RapidSource(name, tuple(declarations), routines, self.calls)

    def declaration(self, *, is_own: bool = False) -> Declaration:
        line, storage = self.line, self.take().text.lower()
        kind, name = self.name().lower(), self.name()
        if self.has("{"):
            self.expression()
            self.need("}")
        value = self.expression() if self.has(":=") else None
        self.need(";")
        return Declaration(line, storage, kind, name, value, is_own)

    def routine(self) -> Generator[None, None, RapidRoutine]:
        line, is_trap = self.line, self.take().text.lower() == "trap"
        name, parameters = self.name(), []
        if not is_trap:
            self.need("(")
            while not self.has(")"):
                self.name()
                parameters.append(self.name().lower())
                if self.peek() != ")":
                    self.need(",")
        body = yield from self.body()
        self.need("endtrap" if is_trap else "endproc")
        return RapidRoutine(line, name, tuple(parameters), body, is_trap)

    def body(self) -> Generator[None, None, tuple[Any, ...]]:
        found: list[Any] = []
        turn_at = self.at
        while self.peek() not in _BLOCK_ENDS:
            found.append((yield from self.statement()))
            if self.at - turn_at > TURN:
                turn_at = self.at
                yield
        return tuple(found)

    def statement(self) -> Generator[None, None, Any]:
        line, word = self.line, self.peek()
        if word in {"var", "const", "pers"}:
            return self.declaration()
        if word in _UNREAD:
            raise ProgramError(f"{word.upper()} is not simulated", line)
        if word == "if":
            return (yield from self.branches(line))
        if word == "while":
            self.take()
            condition = self.expression()
            self.need("do")
            body = yield from self.body()
            self.need("endwhile")
            return Conditional(line, ((condition, body),), repeats=True)
        name = self.name()
        if name.lower() == "connect":
            target = self.reference(self.name())
            self.need("with")
            trap = self.name()
            self.need(";")
            return Instruction(line, "connect", (target, Literal(trap)), {})
        if self.peek() in {":=", ".", "{"}:
            target = self.reference(name)
            self.need(":=")
            value = self.expression()
            self.need(";")
            return Assignment(line, target, value)
        return self.instruction(line, name)

    def branches(self, line: int) -> Generator[None, None, Conditional]:
        self.take()
        cases: list[tuple[Any, tuple[Any, ...]]] = []
        condition: Any = self.expression()
        self.need("then")
        while True:
            cases.append((condition, (yield from self.body())))
            if self.has("endif"):
                return Conditional(line, tuple(cases), repeats=False)
            if self.has("elseif"):
                condition = self.expression()
                self.need("then")
            else:
                self.need("else")
                condition = Literal(True)

    def instruction(self, line: int, name: str) -> Instruction:
        arguments: list[Any] = []
        switches: dict[str, Any] = {}
        while not self.has(";"):
            if self.has("\\"):
                switch = self.name().lower()
                switches[switch] = self.expression() if self.has(":=") else Literal(True)
            elif (arguments or switches) and not self.has(","):
                raise ProgramError(f"syntax error at {self.peek() or 'the end'!r}", self.line)
            elif self.peek() != "\\":
                arguments.append(self.expression())
        self.calls.setdefault(name.lower(), line)
        return Instruction(line, name.lower(), tuple(arguments), switches)

    # expressions

    def expression(self, level: int = 0) -> Any:
        if level == len(_LEVELS):
            return self.unary()
        left = self.expression(level + 1)
        while (operator := self.peek()) in _LEVELS[level]:
            line = self.take().line
            left = Operation(operator, (left, self.expression(level + 1)), line)
        return left

    def unary(self) -> Any:
        line = self.line
        if self.has("not"):
            return Operation("not", (self.unary(),), line)
        if self.has("-"):
            part = self.unary()
            return Literal(-part.value) if isinstance(part, Literal) else Operation("-", (part,), line)
        if self.has("+"):
            return self.unary()
        return self.primary()

    def primary(self) -> Any:
        token = self.take()
        match token.kind:
            case "number":
                return Literal(float(token.text))
            case "text":
                return Literal(token.text[1:-1].replace('""', '"'))
            case "name":
                return self._named(token)
        if token.text == "(":
            inner = self.expression()
            self.need(")")
            return inner
        if token.text == "[":
            parts = self._list("]")
            values = [part.value for part in parts if isinstance(part, Literal)]
            return Literal(values) if len(values) == len(parts) else Aggregate(parts)
        raise ProgramError(f"syntax error at {token.text!r}", token.line)

    def _named(self, token: Token) -> Any:
        word = token.text.lower()
        if word in {"true", "false"}:
            return Literal(word == "true")
        if self.has("("):
            self.calls.setdefault(word, token.line)
            return FunctionCall(word, self._list(")"), token.line)
        return self.reference(token.text)

    def _list(self, end: str) -> tuple[Any, ...]:
        parts: list[Any] = []
        while not self.has(end):
            if parts:
                self.need(",")
            parts.append(self.expression())
        return tuple(parts)

    def reference(self, name: str) -> DataReference:
        line, path = self.line, []
        while self.peek() in {".", "{"}:
            if self.has("."):
                path.append(self.name().lower())
            else:
                self.need("{")
                path.append(self.expression())
                self.need("}")
        return DataReference(name.lower(), tuple(path), line)
