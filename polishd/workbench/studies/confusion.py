"""What was wrong against what the loops said of it: a confusion matrix, on the screen and as a file for the docs."""

from __future__ import annotations

from rich.table import Table

from polishd.show.tables import figure_table
from polishd.workbench.studies.loops import LoopRows

FILE = "confusion.md"


def confusion_table(title: str, looped: LoopRows) -> Table:
    """A row is a scenario and loop, a column what was said; jobs that ended in an error said nothing."""
    header, rows = _cells(looped)
    return figure_table(f"{title}: what was said", header, rows)


def confusion_page(looped: LoopRows) -> str:
    """The same as a table in Markdown."""
    header, rows = _cells(looped)
    lines = [header, ["---"] * len(header), *rows]
    return "".join(f"| {' | '.join(cells)} |\n" for cells in lines)


def _cells(looped: LoopRows) -> tuple[list[str], list[list[str]]]:
    said = list(dict.fromkeys(name for row in looped.rows for name in row.named))
    said.sort(key=lambda name: -max(row.named.get(name, 0) for row in looped.rows))
    rows = [
        [
            row.scenario,
            row.loop,
            *(str(row.named[name]) if name in row.named else "" for name in said),
            f"{row.named_rightly} of {row.runs}",
            f"{100 * row.named_rightly / row.runs:.1f} %",
        ]
        for row in looped.rows
    ]
    return ["wrong is", "loop", *said, "rightly", "share"], rows
