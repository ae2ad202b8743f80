"""KRL of the simulated controller: reads modules and data lists, and compiles their expressions. Runs nothing.

It reads a subset and refuses every other line by its number: LIN, SLIN, PTP and SPTP to Cartesian poses, WAIT SEC and
WAIT FOR, TRIGGER with an assignment, assignments, IF, LOOP, WHILE, calls without results, data lists. ``BAS``,
interrupt declarations and digital outputs are read and change nothing.
"""

from __future__ import annotations

import operator
import re
from collections.abc import Callable, Generator
from dataclasses import dataclass, field
from typing import Any

from polishd.model.errors import ProgramError

KrlValue = Any
"""int, float, bool, text (an enumeration begins with #), or an aggregate: dict of components."""
Lookup = Callable[[str], KrlValue]
"""Value of a variable by its name in upper case, with its index: ``$TIMER[16]``."""
Compiled = Callable[[Lookup], KrlValue]

_TOKEN = re.compile(
    r"""\s*(?:(?P<number>\d+\.?\d*(?:[eE][+-]?\d+)?|\.\d+(?:[eE][+-]?\d+)?)|(?P<text>"[^"]*")"""
    r"""|(?P<name>[$A-Za-z_][$\w]*)|(?P<enum>\#\w+)|(?P<sign>==|<>|<=|>=|[-+*/()<>{},:.\[\]]))"""
)
_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_POSE = re.compile(
    r"\{(?:(?:E6POS|POS|FRAME)\s*:)?\s*" + r"\s*,\s*".join(rf"{axis}\s+({_NUMBER})" for axis in "XYZABC") + r"\s*\}",
    re.IGNORECASE,
)
_BINARY: dict[str, tuple[int, Callable[[Any, Any], Any]]] = {
    "OR": (1, lambda a, b: a or b),
    "EXOR": (1, operator.xor),
    "AND": (2, lambda a, b: a and b),
    **{sign: (4, compare) for sign, compare in (("==", operator.eq), ("<>", operator.ne), ("<", operator.lt))},
    **{sign: (4, compare) for sign, compare in ((">", operator.gt), ("<=", operator.le), (">=", operator.ge))},
    "+": (5, operator.add),
    "-": (5, operator.sub),
    "*": (6, operator.mul),
    "/": (6, operator.truediv),
}


class _Expression:
    """Parser of one expression, by precedence."""

    def __init__(self, text: str, line: int, used: dict[str, int]) -> None:
        self._line, self._used = line, used
        self._tokens: list[tuple[str, str]] = []
        at = 0
        while at < len(text.rstrip()):
            match = _TOKEN.match(text, at)
            if match is None or match.lastgroup is None:
                raise ProgramError(f"syntax error at {text[at:].strip()[:40]!r}", line)
            self._tokens.append((match.lastgroup, match[match.lastgroup]))
            at = match.end()
        self._at = 0

    def whole(self) -> Compiled:
        """Compile all of the text."""
        found = self._binary(0)
        if self._at < len(self._tokens):
            raise ProgramError(f"syntax error at {self._tokens[self._at][1]!r}", self._line)
        return found

    def _next(self) -> tuple[str, str]:
        if self._at >= len(self._tokens):
            raise ProgramError("an expression breaks off", self._line)
        self._at += 1
        return self._tokens[self._at - 1]

    def _takes(self, sign: str) -> bool:
        if self._at < len(self._tokens) and self._tokens[self._at] == ("sign", sign):
            self._at += 1
            return True
        return False

    def _require(self, sign: str) -> None:
        if not self._takes(sign):
            raise ProgramError(f"{sign} is missing", self._line)

    def _binary(self, least: int) -> Compiled:
        left = self._unary()
        while self._at < len(self._tokens):
            sign = self._tokens[self._at][1].upper()
            binding, act = _BINARY.get(sign, (0, operator.eq))
            if binding <= least:
                break
            self._at += 1
            left = _joined(act, left, self._binary(binding))
        return left

    def _unary(self) -> Compiled:
        kind, text = self._next()
        if text == "-":
            part = self._unary()
            return lambda find: -part(find)
        if text == "+":
            return self._unary()
        if kind == "name" and text.upper() == "NOT":
            part = self._binary(3)
            return lambda find: not part(find)
        if text == "(":
            inner = self._binary(0)
            self._require(")")
            return inner
        if text == "{":
            return self._aggregate()
        if kind == "number":
            value: KrlValue = float(text) if re.search(r"[.eE]", text) else int(text)
            return lambda _find: value
        if kind in ("enum", "text"):
            shown = text.upper() if kind == "enum" else text[1:-1]
            return lambda _find: shown
        if kind == "name":
            return self._variable(text.upper())
        raise ProgramError(f"syntax error at {text!r}", self._line)

    def _variable(self, name: str) -> Compiled:
        if name in ("TRUE", "FALSE"):
            return lambda _find: name == "TRUE"
        self._used.setdefault(name, self._line)
        if self._takes("["):
            if self._takes("]"):
                name += "[]"
            else:
                index = self._binary(0)
                self._require("]")
                return lambda find: find(f"{name}[{index(find)}]")
        if self._takes("."):
            component = self._next()[1].upper()
            return lambda find: find(name)[component]
        return lambda find: find(name)

    def _aggregate(self) -> Compiled:
        parts: dict[str, Compiled] = {}
        if self._tokens[self._at + 1 : self._at + 2] == [("sign", ":")]:
            self._at += 2
        while True:
            name = self._next()[1].upper()
            if self._takes("["):
                self._require("]")
                name += "[]"
            parts[name] = self._binary(0)
            if not self._takes(","):
                break
        self._require("}")
        return lambda find: {name: part(find) for name, part in parts.items()}


def _joined(act: Callable[[Any, Any], Any], left: Compiled, right: Compiled) -> Compiled:
    def value(find: Lookup) -> KrlValue:
        a, b = left(find), right(find)
        if act is operator.truediv and isinstance(a, int) and isinstance(b, int):
            return int(a / b)  # INT by INT is INT
        result = act(a, b)
        if isinstance(result, int) and int32(result) != result:
            raise ProgramError(f"{result} is beyond INT", 0)
        return result

    return value


def int32(number: int) -> int:
    """Return a counter's value in the 32 bits of INT."""
    return (number + (1 << 31)) % (1 << 32) - (1 << 31)


def compiled(text: str, line: int = 0, used: dict[str, int] | None = None) -> Compiled:
    """Compile an expression; adds its variables to ``used``. ProgramError with (message, line) where it is invalid."""
    if pose := _POSE.fullmatch(text.strip()):
        constant = dict(zip("XYZABC", map(float, pose.groups()), strict=True))
        return lambda _find: constant
    return _Expression(text, line, {} if used is None else used).whole()


def shown(value: KrlValue) -> str:
    """Return a value as KRL text, as the proxy answers it."""
    if isinstance(value, bool):
        return "TRUE" if value else "FALSE"
    if isinstance(value, float):
        return f"{value:.7g}"
    if isinstance(value, dict):
        head = "E6POS: " if {"X", "A"} <= value.keys() else ""
        return "{" + head + ", ".join(f"{name} {shown(part)}" for name, part in value.items()) + "}"
    if isinstance(value, str) and not value.startswith("#"):
        return f'"{value}"'
    return str(value)


# The statements of a module.


@dataclass(frozen=True, slots=True)
class KrlStatement:
    """Position: 1-based line."""

    line: int


@dataclass(frozen=True, slots=True)
class KrlMove(KrlStatement):
    """A motion to a pose."""

    target: Compiled
    is_linear: bool
    approximates: bool
    """It may be blended into the next motion."""


@dataclass(frozen=True, slots=True)
class KrlWait(KrlStatement):
    """``WAIT SEC``, or ``WAIT FOR``."""

    value: Compiled
    is_condition: bool


@dataclass(frozen=True, slots=True)
class KrlTrigger(KrlStatement):
    """An assignment at the start of the next motion, or at its end."""

    at_end: bool
    target: KrlTarget
    value: Compiled


@dataclass(frozen=True, slots=True)
class KrlAssign(KrlStatement):
    """An assignment, in the advance run."""

    target: KrlTarget
    value: Compiled


@dataclass(frozen=True, slots=True)
class KrlBranch(KrlStatement):
    """IF with its ELSE; a loop where ``repeats``, without end where it has no condition."""

    condition: Compiled | None
    body: list[KrlStatement]
    otherwise: list[KrlStatement]
    repeats: bool = False


@dataclass(frozen=True, slots=True)
class KrlCall(KrlStatement):
    """A call of a routine, or of CWRITE with its last argument."""

    name: str
    argument: Compiled | None = None


@dataclass(frozen=True, slots=True)
class KrlLeave(KrlStatement):
    """EXIT of a loop, or RETURN."""

    returns: bool


@dataclass(frozen=True, slots=True)
class KrlTarget:
    """The variable that an assignment sets."""

    name: str
    index: Compiled | None = None
    component: str = ""


@dataclass(slots=True)
class KrlModule:
    """Routines by name, in upper case, and the initial values of declared variables."""

    routines: dict[str, list[KrlStatement]] = field(default_factory=dict)
    data: dict[str, KrlValue] = field(default_factory=dict)
    used: dict[str, int] = field(default_factory=dict)
    """Variables of its routines, without index, each with the line of its first use."""
    list_of: str = ""
    """Of a data list: name of its module."""


TURN = 100
"""Lines in one turn of reading."""
_SKIPPED = re.compile(
    r"""(?:&.*|INI|(?:GLOBAL\s+)?INTERRUPT\s.*|(?:BAS|SET_CD_PARAMS)\s*\(.*\)|EXT(?:FCT)?\s.*"""
    r"""|\$(?:OUT|ANOUT)\[\d+\]\s*=.*)""",
    re.IGNORECASE,
)
_SPEED = re.compile(r"BAS\s*\(\s*#(?:VEL_CP|CP_PARAMS)\s*,(.+)\)", re.IGNORECASE)
_DATA_LIST = re.compile(r"DEFDAT\s+(\w+)(?:\s+PUBLIC)?", re.IGNORECASE)
_DEF = re.compile(r"(?:GLOBAL\s+)?DEF\s+(\w+)\s*\(\s*\)", re.IGNORECASE)
_DECLARE = re.compile(
    r"(?:GLOBAL\s+)?(?:DECL\s+)?(?:GLOBAL\s+)?(INT|REAL|BOOL|CHAR|E6POS|POS|FRAME|FDAT|LDAT|PDAT|E6AXIS|AXIS|LOAD|BASIS_SUGG_T|STATE_T|MODUS_T)\s+(.+)",
    re.IGNORECASE,
)
_MOVE = re.compile(r"(S?LIN|S?PTP)\s+(.+?)((?:\s+C_(?:DIS|VEL|ORI|PTP|SPL))*)\s*", re.IGNORECASE)
_WAIT = re.compile(r"WAIT\s+(SEC|FOR)\s+(.+)", re.IGNORECASE)
_TRIGGER = re.compile(
    r"TRIGGER\s+WHEN\s+(?:DISTANCE\s*=\s*([01])|PATH\s*=\s*0(?:\.0*)?\s*(ONSTART)?)\s+DELAY\s*=\s*0(?:\.0*)?\s+DO\s+(.+)",
    re.IGNORECASE,
)
_ASSIGN = re.compile(r"([$A-Z_][$\w]*)(?:\[([^\]]*)\])?(?:\.(\w+))?\s*=(?!=)\s*(.+)", re.IGNORECASE)
_IF = re.compile(r"IF\s+(.+?)\s+THEN", re.IGNORECASE)
_WHILE = re.compile(r"WHILE\s+(.+)", re.IGNORECASE)
_CALL = re.compile(r"(\w+)\s*\((.*)\)", re.IGNORECASE)
_ARRAY = re.compile(r"(\w+)\[(\d+)\]")
_DEFAULTS: dict[str, KrlValue] = {"INT": 0, "REAL": 0.0, "BOOL": False, "CHAR": "", "MODUS_T": "#SYNC"}


def read_krl(text: str) -> KrlModule:
    """Read a module or a data list at once. ProgramError with (message, line) where it is invalid."""
    reading = reading_krl(text)
    while True:
        try:
            next(reading)
        except StopIteration as end:
            module: KrlModule = end.value
            return module


def reading_krl(text: str) -> Generator[None, None, KrlModule]:
    """Read a module, some lines in each turn."""
    lines = [(number, bare) for number, line in enumerate(text.splitlines(), start=1) if (bare := _bare(line))]
    return (yield from _Reader(lines).module())


def _bare(line: str) -> str:
    """Return the line without its comment and the blanks around it."""
    if ";" not in line:
        return line.strip()
    quoted = False
    for at, char in enumerate(line):
        quoted ^= char == '"'
        if char == ";" and not quoted:
            return line[:at].strip()
    return line.strip()


@dataclass(slots=True)
class _Reader:
    lines: list[tuple[int, str]]
    at: int = 0
    found: KrlModule = field(default_factory=KrlModule)

    def module(self) -> Generator[None, None, KrlModule]:
        while self.at < len(self.lines):
            number, line = self.lines[self.at]
            self.at += 1
            if self.at % TURN == 0:
                yield
            if _SKIPPED.fullmatch(line) or line.upper() == "ENDDAT":
                continue
            if match := _DATA_LIST.fullmatch(line):
                self.found.list_of = match[1].upper()
            elif match := _DEF.fullmatch(line):
                self.found.routines[match[1].upper()] = yield from self._body("END")
            elif match := _DECLARE.fullmatch(line):
                self._declare(number, match)
            elif match := _ASSIGN.fullmatch(line):
                self.found.data[match[1].upper()] = compiled(match[4], number)(_constant)
            else:
                raise ProgramError(f"outside of a routine: {line[:40]!r}", number)
        return self.found

    def _declare(self, number: int, match: re.Match[str]) -> None:
        name, _, value = match[2].partition("=")
        if value:
            self.found.data[name.strip().upper()] = compiled(value, number)(_constant)
            return
        for one in name.split(","):
            key, default = one.strip().upper(), _DEFAULTS.get(match[1].upper(), {})
            array = _ARRAY.fullmatch(key)
            keys = [f"{array[1]}[{at}]" for at in range(1, int(array[2]) + 1)] if array else [key]
            self.found.data |= dict.fromkeys(keys, default)

    def _body(self, *ends: str) -> Generator[None, None, list[KrlStatement]]:
        body: list[KrlStatement] = []
        while self.at < len(self.lines):
            number, line = self.lines[self.at]
            self.at += 1
            if self.at % TURN == 0:
                yield
            if line.upper() in ends:
                return body
            if match := _IF.fullmatch(line):
                condition = self._compiled(match[1], number)
                taken = yield from self._body("ELSE", "ENDIF")
                more = self.lines[self.at - 1][1].upper() == "ELSE"
                otherwise = (yield from self._body("ENDIF")) if more else []
                body.append(KrlBranch(number, condition, taken, otherwise))
            elif line.upper() == "LOOP":
                body.append(KrlBranch(number, None, (yield from self._body("ENDLOOP")), [], repeats=True))
            elif match := _WHILE.fullmatch(line):
                condition = self._compiled(match[1], number)
                body.append(KrlBranch(number, condition, (yield from self._body("ENDWHILE")), [], repeats=True))
            elif (statement := self._statement(number, line)) is not None:
                body.append(statement)
        raise ProgramError(f"{ends[-1]} is missing", self.lines[-1][0])

    def _compiled(self, text: str, number: int) -> Compiled:
        return compiled(text, number, self.found.used)

    def _statement(self, number: int, line: str) -> KrlStatement | None:
        if match := _MOVE.fullmatch(line):
            return KrlMove(number, self._compiled(match[2], number), match[1].upper().endswith("LIN"), bool(match[3]))
        if match := _TRIGGER.fullmatch(line):
            return self._trigger(match, number)
        if match := _WAIT.fullmatch(line):
            return KrlWait(number, self._compiled(match[2], number), match[1].upper() == "FOR")
        if match := _SPEED.fullmatch(line):
            return KrlAssign(number, KrlTarget("$VEL", None, "CP"), self._compiled(match[1], number))
        if _SKIPPED.fullmatch(line):
            return None
        if match := _DECLARE.fullmatch(line):
            self._declare(number, match)
            return None
        if match := _ASSIGN.fullmatch(line):
            return KrlAssign(number, self._target(match, number), self._compiled(match[4], number))
        return _jump(number, line)

    def _trigger(self, match: re.Match[str], number: int) -> KrlTrigger:
        inner = _ASSIGN.fullmatch(match[3].strip())
        if inner is None:
            raise ProgramError("this controller's TRIGGER takes an assignment only", number)
        at_end = match[1] == "1" or (match[1] is None and match[2] is None)
        return KrlTrigger(number, at_end, self._target(inner, number), self._compiled(inner[4], number))

    def _target(self, match: re.Match[str], number: int) -> KrlTarget:
        self.found.used.setdefault(match[1].upper(), number)
        index = self._compiled(match[2], number) if match[2] else None
        return KrlTarget(match[1].upper(), index, (match[3] or "").upper())


def _jump(number: int, line: str) -> KrlStatement:
    if line.upper() in ("EXIT", "RETURN"):
        return KrlLeave(number, line.upper() == "RETURN")
    match = _CALL.fullmatch(line)
    if match is not None and match[1].upper() == "CWRITE":
        return KrlCall(number, "CWRITE", compiled(match[2].rpartition(",")[2], number))
    if match is None or match[2].strip():
        raise ProgramError(f"syntax error at {line[:40]!r}", number)
    return KrlCall(number, match[1].upper())


def _constant(name: str) -> KrlValue:
    raise ProgramError(f"{name} is no constant", 0)
