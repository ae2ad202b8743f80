"""Faults: replacements of an expression or a statement."""

from __future__ import annotations

import ast
import itertools
import re
from collections.abc import Callable, Iterator, Sequence
from typing import Any

COMPARED: dict[type[ast.cmpop], type[ast.cmpop]] = {
    ast.Lt: ast.LtE,
    ast.LtE: ast.Lt,
    ast.Gt: ast.GtE,
    ast.GtE: ast.Gt,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot,
    ast.IsNot: ast.Is,
    ast.In: ast.NotIn,
    ast.NotIn: ast.In,
}
ORDERED = (ast.Lt, ast.LtE, ast.Gt, ast.GtE)
COMPUTED: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.FloorDiv: ast.Mult,
    ast.Mod: ast.Mult,
}
CALLED = {"max": "min", "min": "max", "any": "all", "all": "any"}
SQL = {
    r" DESC\b": "",
    r" IS NULL": " IS NOT NULL",
    r" IS NOT NULL": " IS NULL",
    r" NOT IN ": " IN ",
    r" AND ": " OR ",
    r" OR (?!IGNORE)": " AND ",
    r" OR IGNORE": " OR REPLACE",
    r"\bmax\(": "min(",
    r" - ": " + ",
    r" < ": " <= ",
    r" > ": " >= ",
    r" != ": " = ",
    r"=FULL": "=OFF",
    r"IMMEDIATE": "",
    r" LIMIT 1": "",
    r"ORDER BY [a-z]+$": "",
}
"""Replacements in an SQL statement that leave it valid."""
IS_SQL = re.compile(r"\s*(SELECT|INSERT|UPDATE|DELETE|PRAGMA|BEGIN|ALTER|CREATE|[a-z!= ']* (IS|IN|AND) )")


def faults_of_expression(node: ast.AST, holder: ast.AST, field: str) -> Iterator[ast.AST]:
    """Yield the replacements of an expression that is a field of ``holder``."""
    yield from _EXPRESSIONS.get(type(node), _none)(node)
    asked = field == "test" and isinstance(holder, ast.If | ast.IfExp | ast.While)
    if asked and isinstance(node, ast.expr) and _negated_is_new(node):
        yield ast.UnaryOp(ast.Not(), node)


def faults_of_statement(node: ast.AST) -> Iterator[ast.AST]:
    """Yield the replacements of a statement."""
    yield from _STATEMENTS.get(type(node), _none)(node)


def _none(_: Any) -> Iterator[ast.AST]:
    return iter(())


def _left_out(_: Any) -> Iterator[ast.AST]:
    yield ast.Pass()


def _compared(node: ast.Compare) -> Iterator[ast.AST]:
    for k, op in enumerate(node.ops):
        yield ast.Compare(node.left, [*node.ops[:k], COMPARED[type(op)](), *node.ops[k + 1 :]], node.comparators)


def _without_one(node: ast.BoolOp) -> Iterator[ast.AST]:
    for left in itertools.combinations(node.values, len(node.values) - 1):
        yield left[0] if len(left) == 1 else ast.BoolOp(node.op, list(left))


def _without_sign(node: ast.UnaryOp) -> Iterator[ast.AST]:
    if isinstance(node.op, ast.Not) or (isinstance(node.op, ast.USub) and not isinstance(node.operand, ast.Constant)):
        yield node.operand


def _computed(node: ast.BinOp) -> Iterator[ast.AST]:
    if isinstance(node.op, ast.BitOr):
        yield from (node.left, node.right)
    elif type(node.op) in COMPUTED:
        yield ast.BinOp(node.left, COMPUTED[type(node.op)](), node.right)


def _filtered(node: ast.comprehension) -> Iterator[ast.AST]:
    for k in range(len(node.ifs)):
        yield ast.comprehension(node.target, node.iter, node.ifs[:k] + node.ifs[k + 1 :], node.is_async)


def _caught(node: ast.ExceptHandler) -> Iterator[ast.AST]:
    for kinds in _one_left_out(node.type) if node.type is not None else ():
        yield ast.ExceptHandler(kinds, node.name, node.body)


def _matched(node: ast.match_case) -> Iterator[ast.AST]:
    if not isinstance(node.pattern, ast.MatchAs):
        yield ast.match_case(node.pattern, ast.Constant(value=False), node.body)


def _said(node: ast.Expr) -> Iterator[ast.AST]:
    if not isinstance(node.value, ast.Yield | ast.YieldFrom):
        yield ast.Pass()


def _kept(node: ast.Assign | ast.AnnAssign) -> Iterator[ast.AST]:
    """Omit an assignment to an attribute or element; tests detect a missing local name at once."""
    targets = node.targets if isinstance(node, ast.Assign) else [node.target]
    if node.value is not None and not all(isinstance(target, ast.Name | ast.Tuple) for target in targets):
        yield ast.Pass()


def _added(node: ast.AugAssign) -> Iterator[ast.AST]:
    yield ast.Pass()
    if type(node.op) in COMPUTED:
        yield ast.AugAssign(node.target, COMPUTED[type(node.op)](), node.value)


def _returned(node: ast.Return) -> Iterator[ast.AST]:
    if node.value is None:
        yield ast.Pass()
    elif not (isinstance(node.value, ast.Constant) and node.value.value in {None, False, ""}):
        yield ast.Return(ast.Constant(None))


def _raised(node: ast.Raise) -> Iterator[ast.AST]:
    yield ast.Pass()
    if isinstance(node.exc, ast.Call):
        yield ast.Raise(ast.Call(ast.Name("Exception", ast.Load()), node.exc.args, []), node.cause)


def _entered(node: ast.With | ast.AsyncWith) -> Iterator[ast.AST]:
    for k, item in enumerate(node.items):
        if item.optional_vars is None:
            left = node.items[:k] + node.items[k + 1 :]
            yield type(node)(left, node.body) if left else ast.If(ast.Constant(value=True), node.body, [])


def _other_constants(node: ast.Constant) -> Iterator[ast.AST]:
    return map(ast.Constant, _other_values(node.value))


def _other_values(value: object) -> Iterator[Any]:
    match value:
        case bool():
            yield not value
        case int() | float():
            yield value + 1
        case str() if IS_SQL.match(value):
            for found, other in SQL.items():
                for place in re.finditer(found, value):
                    yield value[: place.start()] + other + value[place.end() :]
        case str() if " " not in value.strip():
            yield f"other{value}"


def _other_calls(node: ast.Call) -> Iterator[ast.Call]:
    if isinstance(node.func, ast.Name) and node.func.id in CALLED:
        yield ast.Call(ast.Name(CALLED[node.func.id], ast.Load()), node.args, node.keywords)
    for k, keyword in enumerate(node.keywords):
        if keyword.arg not in {None, "name"}:
            yield ast.Call(node.func, node.args, node.keywords[:k] + node.keywords[k + 1 :])
    if ast.unparse(node.func) == "isinstance" and isinstance(node.args[1], ast.Tuple):
        for kinds in _one_left_out(node.args[1]):
            yield ast.Call(node.func, [node.args[0], kinds], [])


def _one_left_out(kinds: ast.expr) -> Sequence[ast.Tuple]:
    """Return tuples of types in which one type is missing; of a single type an empty tuple."""
    each = kinds.elts if isinstance(kinds, ast.Tuple) else [kinds]
    return [ast.Tuple(each[:k] + each[k + 1 :], ast.Load()) for k in range(len(each))]


def _negated_is_new(node: ast.AST) -> bool:
    """Return whether no other fault equals the negation."""
    if isinstance(node, ast.UnaryOp):
        return not isinstance(node.op, ast.Not)
    if isinstance(node, ast.Compare):
        return len(node.ops) > 1 or isinstance(node.ops[0], ORDERED)
    return not isinstance(node, ast.Constant)


_EXPRESSIONS: dict[type[ast.AST], Callable[[Any], Iterator[ast.AST]]] = {
    ast.Compare: _compared,
    ast.BoolOp: _without_one,
    ast.UnaryOp: _without_sign,
    ast.BinOp: _computed,
    ast.Constant: _other_constants,
    ast.Call: _other_calls,
    ast.comprehension: _filtered,
    ast.ExceptHandler: _caught,
    ast.match_case: _matched,
}
_STATEMENTS: dict[type[ast.AST], Callable[[Any], Iterator[ast.AST]]] = {
    **dict.fromkeys((ast.Delete, ast.Break, ast.Continue), _left_out),
    ast.Expr: _said,
    ast.Assign: _kept,
    ast.AnnAssign: _kept,
    ast.AugAssign: _added,
    ast.Return: _returned,
    ast.Raise: _raised,
    ast.With: _entered,
    ast.AsyncWith: _entered,
}
