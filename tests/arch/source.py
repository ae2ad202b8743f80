"""The Python sources of a tree, parsed once, and what the rules ask about them."""

from __future__ import annotations

import ast
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

Function = ast.FunctionDef | ast.AsyncFunctionDef
Documented = ast.Module | ast.ClassDef | Function
Rule = Callable[[Path], list[str]]


@dataclass(frozen=True)
class Source:
    """One file: ``name`` is its path from the root, with slashes."""

    name: str
    text: str

    @cached_property
    def tree(self) -> ast.Module:
        """The file's syntax."""
        return ast.parse(self.text, self.name)

    @cached_property
    def nodes(self) -> list[ast.AST]:
        """All of its syntax, level by level."""
        return list(ast.walk(self.tree))

    @property
    def lines(self) -> int:
        """Number of lines, blank ones and comments too."""
        return len(self.text.splitlines())

    @property
    def module(self) -> str:
        """Dotted name of the module, as in an import."""
        return self.name.removesuffix(".py").removesuffix("/__init__").replace("/", ".")

    def at(self, node: ast.AST, message: str) -> str:
        """A violation, as the compilers write it."""
        return f"{self.name}:{getattr(node, 'lineno', 1)}: {message}"

    def within(self, *folders: str) -> bool:
        """True where the file is one of these or in one of these, as named from polishd/."""
        return any(self.name.startswith(f"polishd/{folder}") for folder in folders)

    def functions(self) -> Iterator[Function]:
        """Every function and method, nested ones too."""
        return (node for node in self.nodes if isinstance(node, Function))

    def classes(self) -> Iterator[ast.ClassDef]:
        """Every class."""
        return (node for node in self.nodes if isinstance(node, ast.ClassDef))

    def imports(self) -> Iterator[tuple[ast.stmt, str]]:
        """Each import statement with the dotted module it names, wherever it stands in the file."""
        for node in self.nodes:
            if isinstance(node, ast.Import):
                yield from ((node, alias.name) for alias in node.names)
            elif isinstance(node, ast.ImportFrom) and node.level == 0:
                yield node, node.module or ""

    def calls(self) -> Iterator[tuple[ast.Call, str]]:
        """Each call with its dotted callee; ``get_loop().create_task`` reads ``get_loop().create_task``."""
        return ((node, ast.unparse(node.func)) for node in self.nodes if isinstance(node, ast.Call))


_parsed: dict[Path, Source] = {}


def sources(root: Path, folder: str = "polishd") -> list[Source]:
    """All sources below ``root/folder``. A tree without any is an error: no rule may pass on nothing."""
    paths = sorted((root / folder).rglob("*.py"))
    assert paths, f"no Python files below {folder}/"
    return [_source(root, path) for path in paths]


def _source(root: Path, path: Path) -> Source:
    if path not in _parsed:
        _parsed[path] = Source(path.relative_to(root).as_posix(), path.read_text())
    return _parsed[path]


def forget() -> None:
    """Drop what was parsed: close to a million objects."""
    _parsed.clear()


def public(node: ast.AST, inside: str = "") -> Iterator[tuple[Documented, str]]:
    """The node itself and every public definition in it that a reader can reach, with its dotted name."""
    if isinstance(node, Documented):
        yield node, inside
    if isinstance(node, Function):
        return  # what is inside a function is not an interface
    for child in ast.iter_child_nodes(node):
        name = getattr(child, "name", "")
        if isinstance(child, ast.If | ast.Try):
            yield from public(child, inside)
        elif isinstance(child, ast.ClassDef | Function) and not name.startswith("_"):
            yield from public(child, f"{inside}.{name}".lstrip("."))
