"""A script under way: threads that run frame by frame, each a generator that yields when its frame is used up."""

from __future__ import annotations

import ast
import math
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass

from polishd.model.errors import ProgramError
from polishd.sim_backends.universal_robots.expressions import Quick, ScriptScope, Values
from polishd.sim_backends.universal_robots.language import (
    Assign,
    Branches,
    Do,
    End,
    Routine,
    RunThreadStatement,
    ScriptStatement,
)

Frames = Generator[None, None, None]
"""Yields at the end of each frame that it uses."""
Slow = Callable[..., Frames]
"""One that takes frames."""
ENDLESS = 10_000
"""Turns of a loop within one frame: the controller gives up."""


@dataclass(slots=True)
class Thread:
    """One that runs."""

    frames: Frames
    over: bool = False


class RunningScript:
    """A script from its first frame to its last. ``quick`` and ``slow`` are the functions that it may call."""

    def __init__(self, routine: Routine, quick: dict[str, Quick], slow: dict[str, Slow]) -> None:
        self._values, self._slow = Values({**quick, "sqrt": math.sqrt, "norm": lambda part: math.hypot(*part)}), slow
        known = {*self._values.functions, *slow, *routine.routines}
        for name, line in routine.calls.items():
            if name not in known:
                raise ProgramError(f"Compile error: name '{name}' is not defined", line)
        self.line = routine.line
        """Under way, for complaints."""
        self._threads: list[Thread] = []
        self._main = self._begin(self._body(routine.body, ScriptScope()))

    @property
    def over(self) -> bool:
        """Its main thread has come to its end: the others end with it."""
        return self._main.over

    def frame(self) -> None:
        """Run all threads until each has used up its frame. ProgramError with (words, line) for a runtime error."""
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
    """Where an assignment without ``global`` goes: to the name that is known, else here."""
    found: ScriptScope | None = scope
    while found is not None:
        if name in found.values:
            return found
        found = found.outer
    return scope
