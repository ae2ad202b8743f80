"""Results of ``make rehearsals``: docs/data/rehearsals.jsonl with a line per cell, and the table in results.md."""

from __future__ import annotations

from dataclasses import asdict
from functools import cache
from pathlib import Path

from tests.campaigns import result_files
from tests.campaigns.rehearsals.rehearse import ACCEPTED, Finding, cells
from tests.campaigns.result_files import Row
from tests.system.sim_rig import ROOT

DATA = ROOT / "docs" / "data"
PAGE = ROOT / "docs" / "reference" / "results.md"
BEGIN, END = "<!-- written by make rehearsals -->\n", "<!-- end of what make rehearsals writes -->"
COLUMNS = (
    *("cell", "robot", "program", "outcome", "passes", "RMS before, nm", "RMS after, nm", "tolerance, nm"),
    *("true RMS after, nm", "time, s", "measured"),
)
HEADER = f"| {' | '.join(COLUMNS)} |\n{'|---' * len(COLUMNS)}|\n"
SOURCES = ("daemon", "drivers", "model", "pipeline", "process", "sim_backends")
"""Packages that each rehearsal depends on."""


@cache
def of_cell(name: str) -> str:
    """Return the hash of the sources that the rehearsal of that cell depends on."""
    return result_files.sources((*(f"polishd/{source}" for source in SOURCES), f"examples/{name}"))


class Kept:
    """The results of all sessions."""

    def __init__(self, folder: Path = DATA) -> None:
        self._path = folder / "rehearsals.jsonl"

    def rows(self) -> list[Row]:
        """Return the results in the order of the page, without those of removed examples."""
        found = {row["cell"]: row for row in result_files.read(self._path)}
        return [found[name] for name in cells() if name in found]

    def left(self) -> list[str]:
        """Return the cells that were never rehearsed, then those of older sources."""
        rows = {row["cell"]: row["of"] for row in self.rows()}
        never = [name for name in cells() if name not in rows]
        return never + [name for name in cells() if name in rows and rows[name] != of_cell(name)]

    def add(self, finding: Finding) -> None:
        """Save a result; it replaces an older one."""
        row = {**asdict(finding), "date": result_files.today(), "of": of_cell(finding.cell)}
        result_files.keep(self._path, [*(one for one in self.rows() if one["cell"] != finding.cell), row])


def text(kept: Kept) -> str:
    """Return the table: a row per cell."""
    rows = kept.rows()
    accepted = sum(row["outcome"] == ACCEPTED for row in rows)
    head = f"{len(rows)} of {len(cells())} cells were rehearsed, {accepted} of them to their tolerance.\n\n{HEADER}"
    return head + "".join(_line(row) for row in rows)


def write(kept: Kept) -> None:
    """Write the table to the page."""
    result_files.write(PAGE, BEGIN, END, text(kept))


def _line(row: Row) -> str:
    outcome = row["outcome"] if row["outcome"] == ACCEPTED else f"**{row['outcome']}: {row['reason']}**"
    figures = (_nm(row[key]) for key in ("first_nm", "last_nm", "tolerance_nm", "true_nm"))
    head = (row["cell"], row["robot"], row["language"], outcome, str(row["passes"]))
    return f"| {' | '.join((*head, *figures, format(row['duration_s'], '.0f'), result_files.when(row)))} |\n"


def _nm(value: float | None) -> str:
    return "-" if value is None else f"{value:.1f}"
