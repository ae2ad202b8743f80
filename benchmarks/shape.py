"""Size of the source: lines of each package, and length of files, functions and classes.

``python -m benchmarks.shape [ROOT]``; ROOT is a checkout, this one by default.
"""

from __future__ import annotations

import ast
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path

from polishd.rendering.terminal import record_table, stdout

EMPTY = 3
"""Lines: a shorter file only marks a package, and is not counted."""


def spans(tree: ast.AST, kinds: tuple[type[ast.AST], ...]) -> Iterator[int]:
    """Lines of each definition of these kinds, docstring included."""
    for node in ast.walk(tree):
        if isinstance(node, kinds):
            yield node.end_lineno - node.lineno + 1  # type: ignore[attr-defined]


def quantiles(lengths: Sequence[int]) -> tuple[int, int, int, int]:
    """Median, 90th percentile, longest, and how many there are."""
    ordered = sorted(lengths)
    return ordered[len(ordered) // 2], ordered[int(0.9 * len(ordered))], ordered[-1], len(ordered)


def main(root: Path) -> None:
    """Print both tables."""
    lines: Counter[str] = Counter()
    lengths: dict[str, list[int]] = {"files": [], "functions": [], "classes": []}
    for path in sorted((root / "polishd").rglob("*.py")):
        text = path.read_text()
        tree, size = ast.parse(text), text.count("\n")
        place = path.relative_to(root / "polishd").parts
        lines[place[0] if place[1:] else "(top)"] += size
        lengths["files"] += [size] if size > EMPTY else []
        lengths["functions"] += spans(tree, (ast.FunctionDef, ast.AsyncFunctionDef))
        lengths["classes"] += spans(tree, (ast.ClassDef,))
    rows = [*lines.most_common(), ("all", lines.total())]
    stdout.print(record_table("lines", ("package", "lines"), rows))
    of = [(what, *quantiles(found)) for what, found in lengths.items()]
    stdout.print(record_table("lines of each", ("", "p50", "p90", "max", "count"), of))


if __name__ == "__main__":
    main(Path(sys.argv[1]) if sys.argv[1:] else Path(__file__).parents[1])
