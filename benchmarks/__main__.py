"""``python -m benchmarks [name ...]``: run the races, print a table, keep the rows.

Each goes into docs/data/benchmarks.jsonl at once and replaces the row of its benchmark and name. Rows that a benchmark
no longer yields go once it completes: a run that fails, is interrupted, or is of a few names loses none of the others.
"""

from __future__ import annotations

import importlib
import json
import os
import pkgutil
import sys
import time
import traceback
from collections.abc import Iterable, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

import benchmarks
from benchmarks.harness import Row
from docs.reference.performance import DATA, read
from polishd.util.files import write_atomic

PREFIX = "bench_"
BY_NAME = (
    "choice", "dwell_large", "dwell_million", "effect", "long_programs", "moving", "moving_matrix", "published",
    "segment", "size", "sweeps", "watchers",
)  # fmt: skip
"""Benchmarks that run only by name: they take the longest."""


def discover(folders: Iterable[str], wanted: Sequence[str] = ()) -> list[str]:
    """Return the names of the benchmark modules in these folders, or the wanted ones; without ``bench_``."""
    found = sorted(
        module.name.removeprefix(PREFIX) for module in pkgutil.iter_modules(folders) if module.name.startswith(PREFIX)
    )
    if unknown := set(wanted) - set(found):
        raise SystemExit(f"no such benchmark: {', '.join(sorted(unknown))}; there are: {', '.join(found)}")
    return [name for name in found if name in wanted or not (wanted or name in BY_NAME)]


def run(
    names: Iterable[str], console: Console, package: str = benchmarks.__name__, kept: Kept | None = None
) -> tuple[list[Row], bool]:
    """Return all rows of these modules, and True if every module completed: a failure does not stop the rest.

    ``kept`` gets each row at once.
    """
    rows: list[Row] = []
    complete = True
    for name in names:
        begun_s = time.monotonic()
        try:
            module = importlib.import_module(f"{package}.{PREFIX}{name}")
            for row in module.rows(lambda message: console.print(f"[dim]{message}[/]")):
                rows.append(row)
                if kept is not None:
                    kept.add(name, row)
            if kept is not None:
                kept.complete(name)
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
    """``docs/data/benchmarks.jsonl``: a JSON object a line, ``Row.as_json()`` and three more keys.

    ``benchmark``, the ``date`` and the ``load`` of the machine during its measurement.
    """

    def __init__(self, path: Path) -> None:
        """Rows of earlier runs; ValueError with file and line where one is not readable."""
        self._path = path
        self._rows = {(row["benchmark"], row["name"]): row for row in read(path)} if path.exists() else {}
        self._new: set[tuple[str, str]] = set()

    def add(self, benchmark: str, row: Row) -> None:
        """Replace the row of that benchmark and name, and write the file at once."""
        when = {"date": datetime.now(UTC).date().isoformat(), "load": round(os.getloadavg()[0], 1)}
        key = benchmark, row.name
        self._put({**self._rows, key: {"benchmark": benchmark, **row.as_json(), **when}})
        self._new.add(key)

    def complete(self, benchmark: str) -> None:
        """Remove the rows of that benchmark that it did not yield."""
        self._put({key: row for key, row in self._rows.items() if key[0] != benchmark or key in self._new})

    def _put(self, rows: dict[tuple[str, str], dict[str, Any]]) -> None:
        """Write the rows in the order of their keys, all or none."""
        self._path.parent.mkdir(parents=True, exist_ok=True)
        write_atomic(
            self._path, "".join(json.dumps(rows[key], allow_nan=False) + "\n" for key in sorted(rows)).encode()
        )
        self._rows = rows


def main(wanted: Sequence[str]) -> int:
    """Run, show, keep; return 1 after a failure."""
    rows, complete = run(discover(benchmarks.__path__, wanted), Console(stderr=True), kept=Kept(DATA))
    Console().print(table(rows))
    return 0 if complete else 1


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
