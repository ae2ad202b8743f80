"""Insert one small fault at a time into the syntax tree of a module.

Not touched: annotations, decorators, docstrings, f-strings, log calls, what an error says, and other text with spaces
that is no SQL. Faults of names and of syntax are left to mypy.
"""

from __future__ import annotations

import ast
import itertools
import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

from tests.campaigns.mutation.faults import faults_of_expression, faults_of_statement

Function = ast.FunctionDef | ast.AsyncFunctionDef
SHOWN, AROUND = 70, 24
"""Number of characters of a change, and of the equal text before it."""
SKIPPED = {"annotation", "returns", "decorator_list", "ctx", "op", "ops", "type_params"}


@dataclass(frozen=True, slots=True)
class Edit:
    """Position in a tree: a field of a node, or an element of the field."""

    holder: ast.AST
    field: str
    index: int | None

    def put(self, node: Any) -> Any:
        """Replace the node at this position and return the old one."""
        if self.index is None:
            old = getattr(self.holder, self.field)
            setattr(self.holder, self.field, node)
            return old
        values = getattr(self.holder, self.field)
        old, values[self.index] = values[self.index], node
        return old


@dataclass(frozen=True, slots=True)
class Mutant:
    """Module with one fault."""

    path: str
    where: str
    """Qualified name of the innermost function or class; empty in the module."""
    change: str
    unit_line: int | None
    """First line of the outermost function; None where the module must be imported again."""
    lines: tuple[int, ...]
    """Lines of the fault: only a test that runs one of them can detect it."""
    edit: Edit
    new: ast.AST

    @property
    def key(self) -> str:
        """Name in ``survivors.toml``, which does not depend on other lines."""
        return f"{self.where}: {self.change}"


@dataclass(frozen=True, slots=True)
class _Place:
    """Position during the walk through the tree."""

    where: str = ""
    unit_line: int | None = None
    statement: int = 1
    generator: bool = False


class Module:
    """Source of a module with all its mutants."""

    def __init__(self, path: str, source: str) -> None:
        self.path = path
        self.tree = ast.parse(source)
        self._seen: Counter[str] = Counter()

    def mutants(self) -> Iterator[Mutant]:
        """Yield the mutants in the order of the lines."""
        self._seen.clear()
        yield from self._within(self.tree, _Place())

    def sound(self, mutant: Mutant) -> Mutant:
        """Return the mutant without a fault."""
        first = self.tree.body[0]
        return replace(mutant, change="nothing", edit=Edit(self.tree, "body", 0), new=first)

    def code(self, mutant: Mutant) -> Any:
        """Return the module's code with the fault."""
        old = mutant.edit.put(mutant.new)
        try:
            return compile(ast.fix_missing_locations(self.tree), self.path, "exec", dont_inherit=True)
        finally:
            mutant.edit.put(old)

    def _within(self, holder: ast.AST, place: _Place) -> Iterator[Mutant]:
        inside = place
        for field, value in ast.iter_fields(holder):
            place = inside
            if field in SKIPPED:
                continue
            if field == "args" and isinstance(holder, Function) and _first_line(holder) == place.unit_line:
                place = replace(place, unit_line=None)  # its defaults are the module's
            for index, child in enumerate(list(value)) if isinstance(value, list) else [(None, value)]:
                if isinstance(child, ast.AST) and not _text(child, holder):
                    yield from self._of(Edit(holder, field, index), child, _entered(child, place))

    def _of(self, edit: Edit, child: ast.AST, place: _Place) -> Iterator[Mutant]:
        statement = isinstance(child, ast.stmt)
        found = faults_of_statement(child) if statement else faults_of_expression(child, edit.holder, edit.field)
        for new in found:
            if place.generator and isinstance(child, ast.Return):
                continue
            yield self._mutant(edit, child, new, place)
        yield from self._within(child, place)

    def _mutant(self, edit: Edit, child: ast.AST, new: ast.AST, place: _Place) -> Mutant:
        new = ast.copy_location(new, child)
        change = _change(edit, child, new)
        self._seen[f"{place.where}: {change}"] += 1
        number = self._seen[f"{place.where}: {change}"]
        last = child.lineno if isinstance(child, ast.stmt) else getattr(child, "end_lineno", place.statement)
        lines = {place.statement, *range(getattr(child, "lineno", last), last + 1)}
        change += f" #{number}" if number > 1 else ""
        return Mutant(
            self.path, place.where, change, place.unit_line, tuple(sorted(lines)), edit, ast.copy_location(new, child)
        )


def _first_line(function: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    """Return the first line as the code object has it, which includes decorators."""
    return min([function.lineno, *(one.lineno for one in function.decorator_list)])


def _entered(child: ast.AST, place: _Place) -> _Place:
    """Return the position inside a node."""
    if not isinstance(child, ast.stmt):
        return place
    where, unit_line, generator = place.where, place.unit_line, place.generator
    if isinstance(child, Function | ast.ClassDef):
        where = f"{where}.{child.name}".lstrip(".")
    if isinstance(child, Function):
        generator = any(isinstance(node, ast.Yield | ast.YieldFrom) for node in ast.walk(child))
        unit_line = unit_line or _first_line(child)
    return _Place(where, unit_line, child.lineno, generator)


def _text(child: ast.AST, holder: ast.AST) -> bool:
    """Return whether a node is text for people, or code that does not run."""
    if isinstance(child, (ast.JoinedStr, ast.Import, ast.ImportFrom)):
        return True
    if isinstance(child, ast.Call) and (isinstance(holder, ast.Raise) or ast.unparse(child.func) == "TypeVar"):
        return True
    if isinstance(child, ast.Subscript) and ast.unparse(child.value) == "Literal":
        return True
    if isinstance(child, ast.keyword) and child.arg == "name":
        return isinstance(child.value, ast.Constant)  # of a task or a thread
    if isinstance(child, ast.Expr):
        value = child.value
        if isinstance(value, ast.Constant):
            return True
        return isinstance(value, ast.Call) and ast.unparse(value.func).startswith("log.")
    return isinstance(child, ast.arguments) and not (child.defaults or any(child.kw_defaults))


def _change(edit: Edit, old: ast.AST, new: ast.AST) -> str:
    """Return both texts with enough context to recognize them; long texts are cut to the difference."""
    if isinstance(old, ast.Constant) and isinstance(edit.holder, ast.expr | ast.keyword | ast.arguments):
        before = ast.unparse(edit.holder)
        edit.put(new)
        after = ast.unparse(edit.holder)
        edit.put(old)
    else:
        before, after = ast.unparse(old), ast.unparse(new)
    before, after = (re.sub(r"\s+", " ", text).strip() for text in (before, after))
    same = sum(1 for _ in itertools.takewhile(lambda pair: pair[0] == pair[1], zip(before, after, strict=False)))
    if len(before) > SHOWN and same > AROUND:
        before, after = (f"...{text[same - AROUND :]}" for text in (before, after))
    return " -> ".join(text if len(text) <= SHOWN else f"{text[: SHOWN - 3]}..." for text in (before, after))
