"""``python -m benchmarks [name ...]``: run the races, print a table, write ``build/bench.json``."""

from __future__ import annotations

import importlib
import json
import pkgutil
import sys
import traceback
from collections.abc import Iterable, Sequence
from pathlib import Path

from rich.console import Console
from rich.table import Table

import benchmarks
from benchmarks.harness import Row

OUTPUT = Path("build/bench.json")
PREFIX = "bench_"


def discover(folders: Iterable[str], wanted: Sequence[str] = ()) -> list[str]:
    """Names of the benchmark modules in these folders, those wanted if any are; without the ``bench_``."""
    found = sorted(
        module.name.removeprefix(PREFIX) for module in pkgutil.iter_modules(folders) if module.name.startswith(PREFIX)
    )
    if unknown := set(wanted) - set(found):
        raise SystemExit(f"no such benchmark: {', '.join(sorted(unknown))}; there are: {', '.join(found)}")
    return [name for name in found if name in wanted or not wanted]


def run(names: Iterable[str], console: Console, package: str = benchmarks.__name__) -> tuple[list[Row], bool]:
    """All rows of these modules, and whether every module came to its end: one that fails does not stop the rest."""
    rows: list[Row] = []
    complete = True
    for name in names:
        try:
            module = importlib.import_module(f"{package}.{PREFIX}{name}")
            for row in module.rows(lambda message: console.print(f"[dim]{message}[/]")):
                rows.append(row)  # noqa: PERF402  one by one: what came before a failure counts
        except Exception:  # noqa: BLE001  whatever it was, it is shown, and the exit code tells
            complete = False
            console.print(f"[red]{name} failed[/]")
            console.print(traceback.format_exc(), markup=False, highlight=False)
    return rows, complete


def table(rows: Iterable[Row]) -> Table:
    """The rows for people: the ratio is how many times less we cost than the best peer."""
    result = Table("benchmark", "ours", "peers", "ratio", show_lines=True)
    for row in rows:
        peers = "\n".join(f"{name} {_cost(value, row.unit)}" for name, value in row.peers.items())
        result.add_row(row.name, _cost(row.ours, row.unit), peers, "-" if row.ratio is None else f"{row.ratio:.3g}")
    return result


def _cost(value: float | None, unit: str) -> str:
    return "did not finish" if value is None else f"{value:.3g} {unit}"


def write(rows: Iterable[Row], path: Path) -> None:
    """Write the rows as JSON, whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    draft = path.with_suffix(".tmp")
    draft.write_text(json.dumps([row.as_json() for row in rows], indent=2, allow_nan=False) + "\n")
    draft.replace(path)


def main(wanted: Sequence[str]) -> int:
    """Run, show, write; 1 where a benchmark failed."""
    rows, complete = run(discover(benchmarks.__path__, wanted), Console(stderr=True))
    Console().print(table(rows))
    write(rows, OUTPUT)
    return 0 if complete else 1


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
