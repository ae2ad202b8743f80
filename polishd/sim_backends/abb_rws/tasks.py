"""Tasks of the controller: their modules and data, and the routine under way as a generator that yields its waits."""

from __future__ import annotations

import operator
from collections.abc import Callable, Generator, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, field
from typing import Any

from polishd.model.errors import ProgramError
from polishd.sim_backends.abb_rws.rapid import (
    COMPONENTS,
    DEFAULTS,
    Aggregate,
    Assignment,
    Conditional,
    DataReference,
    Declaration,
    FunctionCall,
    Instruction,
    Literal,
    Operation,
    RapidRoutine,
    RapidSource,
    single,
)

Wait = Callable[[], float | None]
"""The controller's time at which the wait ended; None while it lasts."""
Steps = Generator[Wait, None, None]
ENDLESS = 200_000
"""Statements without a wait after which the controller gives up."""
_OPERATORS: Mapping[str, Callable[[Any, Any], Any]] = {
    "+": operator.add, "-": operator.sub, "*": operator.mul, "/": operator.truediv, "div": operator.floordiv,
    "mod": operator.mod, "=": operator.eq, "<>": operator.ne, "<": operator.lt, ">": operator.gt, "<=": operator.le,
    ">=": operator.ge, "xor": operator.ne,
}  # fmt: skip
SPEEDS = (
    5,
    10,
    20,
    30,
    40,
    50,
    60,
    80,
    100,
    150,
    200,
    300,
    400,
    500,
    600,
    800,
    1000,
    1500,
    2000,
    2500,
    3000,
    4000,
    5000,
)
ZONES = (0, 1, 5, 10, 15, 20, 30, 40, 50, 60, 80, 100, 150, 200)
PREDEFINED: Mapping[str, Any] = {
    **{f"v{speed}": [float(speed), 500.0, 5000.0, 1000.0] for speed in (*SPEEDS, 6000, 7000)},
    "vmax": [5000.0, 500.0, 5000.0, 1000.0],
    **{f"z{zone}": [False, float(zone), 0.0, 0.0, 0.0, 0.0, 0.0] for zone in ZONES},
    "fine": [True, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
    "tool0": [True, [[0.0] * 3, [1.0, 0.0, 0.0, 0.0]], []],
    "wobj0": [False, True, "", [], []],
    "load0": [],
}


@dataclass(slots=True)
class RapidData:
    """Data of a module, or of a routine."""

    storage: str
    value: Any


@dataclass(slots=True)
class StopWatch:
    """A ``clock``."""

    passed_s: float = 0.0
    since_s: float | None = None

    def read(self, now_s: float) -> float:
        """Seconds so far, in steps of 1 ms."""
        running_s = 0.0 if self.since_s is None else max(now_s - self.since_s, 0.0)
        return round(self.passed_s + running_s, 3)


BuiltIn = Callable[["RapidTask", Instruction], Steps | None]
"""An instruction of the language: (task, statement). One that waits returns its steps."""
Function = Callable[["RapidTask", Sequence[Any]], Any]
"""A function of the language: (task, values)."""


@dataclass(slots=True)
class RapidTask:
    """A task. Instructions get their arguments unevaluated: see ``of`` and ``cell_of``."""

    name: str
    instructions: Mapping[str, BuiltIn]
    functions: Mapping[str, Function]
    shared: dict[str, RapidData]
    """Persistent data of all tasks, by name."""
    time_s: float = 0.0
    """The controller's time at which it is."""
    line: int = 0
    """Line under way, and ..."""
    module: str = ""
    """... its module."""
    modules: dict[str, RapidSource] = field(default_factory=dict)
    data: dict[str, RapidData] = field(default_factory=dict)
    traps: dict[int, str] = field(default_factory=dict)
    """Trap of each interrupt number."""
    _homes: dict[str, str] = field(default_factory=dict)
    """Module of each of its data."""
    _scopes: list[dict[str, RapidData]] = field(default_factory=list)
    _statements: int = 0

    def load(self, source: RapidSource) -> None:
        """Take a module in place of the one with its name. ProgramError with (message, line); then nothing changes."""
        others = {name: module for name, module in self.modules.items() if name != source.name.lower()}
        taken = {name for module in others.values() for name in module.routines}
        for name, routine in source.routines.items():
            if name in taken:
                raise ProgramError(f"{routine.name} is declared in another module, too", routine.line)
        known = {*taken, *source.routines, *self.instructions, *self.functions}
        for name, line in source.calls.items():
            if name not in known:
                raise ProgramError(f"reference to unknown entity {name}", line)
        before = (self.data, self._homes)
        self._drop_data(source.name)
        try:
            for declared in source.declarations:
                self._declare(declared)
                self._homes[declared.name.lower()] = source.name.lower()
        except ProgramError:
            self.data, self._homes = before
            raise
        self.modules = {**others, source.name.lower(): source}

    def unload(self, name: str) -> None:
        """Drop a module."""
        self.modules.pop(name.lower(), None)
        self._drop_data(name)

    def _drop_data(self, module: str) -> None:
        self._homes = {name: home for name, home in self._homes.items() if home != module.lower()}
        self.data = {name: cell for name, cell in self.data.items() if name in self._homes}

    def _declare(self, declared: Declaration) -> None:
        name = declared.name.lower()
        if name in self.data:
            raise ProgramError(f"{declared.name} is declared twice", declared.line)
        persists = declared.storage == "pers" and not declared.is_own
        if persists and declared.value is None:
            if name not in self.shared:
                raise ProgramError(f"persistent {declared.name} has no value in any task", declared.line)
            self.data[name] = self.shared[name]
            return
        self.data[name] = RapidData(declared.storage, self._initial(declared))
        if persists:
            self.shared[name] = self.data[name]

    def _initial(self, declared: Declaration) -> Any:
        if declared.value is not None:
            return single(self.of(declared.value))
        return StopWatch() if declared.type == "clock" else deepcopy(DEFAULTS.get(declared.type))

    # running

    def main(self) -> Steps:
        """Run ``main``. ProgramError with (message, line) for a runtime error."""
        routine = self.routine("main")
        if routine is None:
            raise ProgramError("the task has no main", 0)
        self._scopes, self._statements = [], 0
        return self._run(routine, ())

    def routine(self, name: str) -> RapidRoutine | None:
        """Return a routine."""
        return next((module.routines[name] for module in self.modules.values() if name in module.routines), None)

    def trap(self, number: int) -> None:
        """Run the trap of an interrupt, which must not wait."""
        routine = self.routine(self.traps.get(number, "").lower())
        if routine is not None:
            scopes, line = self._scopes, self.line
            self._scopes = []
            for _ in self._run(routine, ()):
                raise ProgramError("a trap that waits is not simulated", self.line)
            self._scopes, self.line = scopes, line

    def _run(self, routine: RapidRoutine, arguments: Sequence[Any]) -> Steps:
        if len(arguments) != len(routine.parameters):
            raise ProgramError(f"{routine.name} takes {len(routine.parameters)} arguments", self.line)
        scope = {name: RapidData("var", value) for name, value in zip(routine.parameters, arguments, strict=True)}
        self._scopes.append(scope)
        yield from self._body(routine.body)
        self._scopes.pop()

    def _body(self, body: Sequence[Any]) -> Steps:
        for statement in body:
            self.line = statement.line
            self._statements += 1
            if self._statements > ENDLESS:
                raise ProgramError("too many statements without a wait", self.line)
            match statement:
                case Instruction():
                    yield from self._instruct(statement)
                case Assignment():
                    self._assign(statement)
                case Conditional():
                    yield from self._branch(statement)
                case Declaration():
                    self._scopes[-1][statement.name.lower()] = RapidData("var", self._initial(statement))

    def _instruct(self, statement: Instruction) -> Steps:
        built = self.instructions.get(statement.name)
        if built is not None:
            steps = built(self, statement)
            if steps is not None:
                self._statements = 0
                yield from steps
            return
        routine = self.routine(statement.name)
        if routine is None or routine.is_trap:
            raise ProgramError(f"no procedure {statement.name}", statement.line)
        yield from self._run(routine, [self.of(argument) for argument in statement.arguments])

    def _branch(self, statement: Conditional) -> Steps:
        while True:
            taken = next((body for test, body in statement.cases if self.of(test)), None)
            if taken is None:
                return
            yield from self._body(taken)
            if not statement.repeats:
                return

    def _assign(self, statement: Assignment) -> None:
        cell, target = self.cell_of(statement.target), statement.target
        if cell.storage == "const":
            raise ProgramError(f"{target.name} is constant", statement.line)
        value = single(self.of(statement.value))
        if not target.path:
            cell.value = value
            return
        whole = deepcopy(cell.value)
        part = whole
        for step in target.path[:-1]:
            part = part[self._index(step)]
        part[self._index(target.path[-1])] = value
        cell.value = whole

    # expressions

    def cell_of(self, reference: Any) -> RapidData:
        """Return the data that an argument names."""
        if not isinstance(reference, DataReference):
            raise ProgramError("the argument is no data", self.line)
        name = reference.name
        cell = (self._scopes[-1].get(name) if self._scopes else None) or self.data.get(name)
        if cell is None:
            raise ProgramError(f"{name} is not declared", reference.line)
        return cell

    def of(self, node: Any) -> Any:
        """Return the value of an expression."""
        match node:
            case Literal():
                return node.value
            case DataReference():
                return self._read(node)
            case Aggregate():
                return [self.of(part) for part in node.parts]
            case FunctionCall():
                return self.functions[node.name](self, [self.of(part) for part in node.arguments])
            case Operation():
                return self._operate(node)
        raise ProgramError("an expression that is not known", self.line)

    def _read(self, node: DataReference) -> Any:
        if node.name in PREDEFINED and node.name not in self.data:
            return PREDEFINED[node.name]
        value = self.cell_of(node).value
        for step in node.path:
            try:
                value = value[self._index(step)]
            except (LookupError, TypeError):
                raise ProgramError(f"{node.name} has no such component", node.line) from None
        return value

    def _index(self, step: Any) -> int:
        if isinstance(step, str):
            if step not in COMPONENTS:
                raise ProgramError(f"component {step} is not known", self.line)
            return COMPONENTS[step]
        return int(self.of(step)) - 1

    def _operate(self, node: Operation) -> Any:
        first = self.of(node.operands[0])
        try:
            if node.operator == "not":
                return not first
            if len(node.operands) == 1:
                return -first
            if node.operator in {"and", "or"}:
                return bool(self.of(node.operands[1])) if bool(first) == (node.operator == "and") else bool(first)
            return _OPERATORS[node.operator](first, self.of(node.operands[1]))
        except (TypeError, ZeroDivisionError) as error:
            raise ProgramError(f"{node.operator}: {error}", node.line) from None
