"""What expressions of a script are worth."""

from __future__ import annotations

import ast
import operator
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

from polishd.model.errors import ProgramError
from polishd.sim_backends.universal_robots.language import Expression

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
    """Names and their values; a routine sees those of the one that it stands in."""

    outer: ScriptScope | None = None
    values: dict[str, Any] = field(default_factory=dict)

    def find(self, name: str) -> Any:
        """A value."""
        scope: ScriptScope | None = self
        while scope is not None:
            if name in scope.values:
                return scope.values[name]
            scope = scope.outer
        raise ProgramError(f"name '{name}' is not defined", 0)

    def everywhere(self) -> ScriptScope:
        """The outermost."""
        return self if self.outer is None else self.outer.everywhere()


@dataclass(slots=True)
class Values:
    """Works expressions out. ProgramError with (words, line) where one has no value."""

    functions: dict[str, Quick]

    def of(self, node: Expression, scope: ScriptScope) -> Any:
        """The value."""
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
        """What is called, and with what."""
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
