"""The benchmarks of docs/reference/results.md, from their data: ``python -m docs.reference.performance``."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from docs.reference.naming import put

PAGE = Path(__file__).with_name("results.md")
DATA = PAGE.parents[1] / "data" / "benchmarks.jsonl"
"""Which ``make bench`` keeps (`benchmarks.__main__.Kept`)."""
MARKS = "<!-- written by make performance -->\n", "<!-- end of what make performance writes -->"
Row = Mapping[str, Any]


def read(path: Path = DATA) -> list[dict[str, Any]]:
    """Return all rows; ValueError where a line is not one, with the file and the line."""
    rows: list[dict[str, Any]] = []
    for number, line in enumerate(path.read_text().splitlines(), 1):
        try:
            row = json.loads(line)
            row["benchmark"], row["name"]
        except (ValueError, TypeError, KeyError) as error:
            raise ValueError(f"{path}:{number}: no row of a benchmark ({error}): restore the line from git") from error
        rows.append(row)
    return rows


def table(rows: Sequence[Row]) -> str:
    """All rows that are kept, by name; half of the runs between the two in brackets."""
    lines = ["| | ours | peers | best peer over ours | measured, load |", "|---|---|---|---|---|"]
    for row in sorted(rows, key=lambda row: str(row["name"])):
        peers = "; ".join(f"{name} {_cost(row, name, value)}" for name, value in row["peers"].items()) or "-"
        ratio = "-" if row["ratio"] is None else f"{row['ratio']:.3g}"
        when = f"{row.get('date', '-')}, {row.get('load', '-')}"
        lines.append(f"| {row['name']} | {_cost(row, 'ours', row['ours'])} | {peers} | {ratio} | {when} |")
    return "\n".join(lines) + "\n"


def _cost(row: Row, name: str, value: float | None) -> str:
    if value is None:
        return "did not finish"
    ends = row.get("quartiles", {}).get(name)
    return f"{value:.3g} {row['unit']}" + ("" if ends is None else f" ({ends[0]:.3g} to {ends[1]:.3g})")


if __name__ == "__main__":
    PAGE.write_text(put(PAGE.read_text(), table(read()), MARKS))
