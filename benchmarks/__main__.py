"""``python -m benchmarks [name ...]``: run the races, print a table, keep each row in ``build/bench.json`` at once.

A row replaces the one of its name: a run that is interrupted, or of a few names, loses none of the others.
"""

from __future__ import annotations

import importlib
import json
import os
import pkgutil
import sys
import time
import traceback
from collections.abc import Callable, Iterable, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

import benchmarks
from benchmarks.harness import Row

OUTPUT = Path("build/bench.json")
PREFIX = "bench_"
BY_NAME = (
    "choice", "dwell_large", "dwell_million", "effect", "long_programs", "moving", "moving_matrix", "published", "size",
    "sweeps", "watchers",
)  # fmt: skip
"""Benchmarks that run only by name: they take the longest."""
Keep = Callable[[Row], None]


def discover(folders: Iterable[str], wanted: Sequence[str] = ()) -> list[str]:
    """Return the names of the benchmark modules in these folders, or the wanted ones; without ``bench_``."""
    found = sorted(
        module.name.removeprefix(PREFIX) for module in pkgutil.iter_modules(folders) if module.name.startswith(PREFIX)
    )
    if unknown := set(wanted) - set(found):
        raise SystemExit(f"no such benchmark: {', '.join(sorted(unknown))}; there are: {', '.join(found)}")
    return [name for name in found if name in wanted or not (wanted or name in BY_NAME)]


def run(
    names: Iterable[str], console: Console, package: str = benchmarks.__name__, keep: Keep = lambda _: None
) -> tuple[list[Row], bool]:
    """Return all rows of these modules, and True if every module completed: a failure does not stop the rest.

    ``keep`` is called with each row at once.
    """
    rows: list[Row] = []
    complete = True
    for name in names:
        begun_s = time.monotonic()
        try:
            module = importlib.import_module(f"{package}.{PREFIX}{name}")
            for row in module.rows(lambda message: console.print(f"[dim]{message}[/]")):
                rows.append(row)
                keep(row)
        except Exception:  # noqa: BLE001  every error is shown, and sets the exit code
            complete = False
            console.print(f"[red]{name} failed[/]")
            console.print(traceback.format_exc(), markup=False, highlight=False)
        console.print(f"[dim]{name}: {time.monotonic() - begun_s:.0f} s in all[/]")
    return rows, complete


def table(rows: Iterable[Row]) -> Table:
    """Print the rows: the ratio is the cost of the best peer over ours."""
    result = Table("benchmark", "ours", "peers", "ratio", show_lines=True)
    for row in rows:
        peers = "\n".join(f"{name} {_cost(row, name, value)}" for name, value in row.peers.items())
        result.add_row(row.name, _cost(row, "ours", row.ours), peers, "-" if row.ratio is None else f"{row.ratio:.3g}")
    return result


def _cost(row: Row, name: str, value: float | None) -> str:
    if value is None:
        return "did not finish"
    ends = row.quartiles.get(name)
    return f"{value:.3g} {row.unit}" + ("" if ends is None else f" ({ends[0]:.3g} to {ends[1]:.3g})")


class Kept:
    """``build/bench.json``: all rows by name, each with the day and the load of the machine during its measurement."""

    def __init__(self, path: Path) -> None:
        """Rows of earlier runs."""
        self._path = path
        try:
            found = {row["name"]: row for row in json.loads(path.read_text())}
        except FileNotFoundError:
            found = {}
        self._rows: dict[str, dict[str, Any]] = found

    def add(self, row: Row) -> None:
        """Replace the row of its name, and write the file at once."""
        when = {"date": datetime.now(UTC).date().isoformat(), "load": round(os.getloadavg()[0], 1)}
        kept = {**self._rows, row.name: {**row.as_json(), **when}}
        write(kept.values(), self._path)
        self._rows = kept


def write(rows: Iterable[Mapping[str, Any]], path: Path) -> None:
    """Write the rows as JSON, all or none."""
    path.parent.mkdir(parents=True, exist_ok=True)
    draft = path.with_suffix(".tmp")
    draft.write_text(json.dumps(list(rows), indent=2, allow_nan=False) + "\n")
    draft.replace(path)


def main(wanted: Sequence[str]) -> int:
    """Run, show, keep; return 1 after a failure."""
    rows, complete = run(discover(benchmarks.__path__, wanted), Console(stderr=True), keep=Kept(OUTPUT).add)
    Console().print(table(rows))
    return 0 if complete else 1


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
