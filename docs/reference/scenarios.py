"""The tables of docs/reference/results.md: ``python -m docs.reference.scenarios DIR``, the study's ``--out``."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from docs.reference.naming import put

PAGE = Path(__file__).with_name("results.md")
MARKS = "<!-- written by make scenarios -->\n", "<!-- end of what make scenarios writes -->"
TODAY = "rate"
"""The loop that the others are held against."""
NEVER = "-"
Row = Mapping[str, Any]


def tables(rows: Sequence[Row]) -> str:
    """What each loop came to in all, then scenario by scenario: of all loops, with a slash between them."""
    loops = list(dict.fromkeys(row["loop"] for row in rows))
    return f"{_sums(rows, loops)}\n{_each(rows, loops)}"


def _sums(rows: Sequence[Row], loops: Sequence[str]) -> str:
    lines = [
        f"| loop | jobs | accepted | falsely | as expected | first passes | a pass slower than `{TODAY}`, and more |",
        "|---|---|---|---|---|---|---|",
    ]
    for loop in loops:
        mine = [row for row in rows if row["loop"] == loop]
        jobs, accepted, falsely = (sum(row[key] for row in mine) for key in ("runs", "accepted", "false_accepts"))
        of_all, of_first = _share(mine, "held", "forecasts"), _share(mine, "first_held", "first_forecasts")
        slower = ", ".join(f"`{name}`" for name in _slower(rows, loop)) or "none"
        lines.append(f"| `{loop}` | {jobs} | {accepted} | {falsely} | {of_all} | {of_first} | {slower} |")
    return "\n".join(lines) + "\n"


def _each(rows: Sequence[Row], loops: Sequence[str]) -> str:
    names = " / ".join(f"`{loop}`" for loop in loops)
    lines = [
        f"Of {names}:\n",
        "| scenario | jobs | accepted | passes | after pass 1, nm | true RMS, nm | falsely | first pass as expected |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for scenario in dict.fromkeys(row["scenario"] for row in rows):
        mine = [row for row in rows if row["scenario"] == scenario]
        cells = [
            str(max(row["runs"] for row in mine)),
            _side_by_side(mine, lambda row: str(row["accepted"])),
            _side_by_side(mine, lambda row: _number(row["passes_median"], "g")),
            _side_by_side(mine, lambda row: _number(row["first_pass_nm_median"], ".2f")),
            _side_by_side(mine, lambda row: _number(row["true_rms_nm_median"], ".2f")),
            _side_by_side(mine, lambda row: str(row["false_accepts"])),
            _side_by_side(mine, lambda row: f"{row['first_held']} of {row['first_forecasts']}"),
        ]
        lines.append(f"| `{scenario}` | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def _slower(rows: Sequence[Row], loop: str) -> list[str]:
    """Scenarios in which half of that loop's jobs take more than a pass more than half of today's, or never end."""
    today, mine = (
        {row["scenario"]: row["passes_median"] for row in rows if row["loop"] == name} for name in (TODAY, loop)
    )
    ended = {name: passes for name, passes in today.items() if passes is not None}
    return [name for name, passes in ended.items() if mine[name] is None or mine[name] > passes + 1]


def _share(rows: Sequence[Row], part: str, whole: str) -> str:
    some, all_of_it = (sum(row[key] for row in rows) for key in (part, whole))
    return f"{some} of {all_of_it}, {some / all_of_it:.0%}" if all_of_it else NEVER


def _side_by_side(rows: Sequence[Row], cell: Callable[[Row], str]) -> str:
    return " / ".join(map(cell, rows))


def _number(value: float | None, form: str) -> str:
    return NEVER if value is None else f"{value:{form}}"


if __name__ == "__main__":
    found = json.loads((Path(sys.argv[1]) / "table.json").read_text())
    PAGE.write_text(put(PAGE.read_text(), tables(found), MARKS))
