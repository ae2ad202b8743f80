"""What ``make pits`` came to: docs/data/pits.jsonl, a line a case, and the table in docs/explanation/pits.md."""

from __future__ import annotations

import threading
from dataclasses import asdict
from functools import cache
from pathlib import Path

from tests.campaigns import beside
from tests.campaigns.beside import Row
from tests.campaigns.pits.cases import CASES, LINKS
from tests.campaigns.pits.judge import Finding
from tests.system.sim_rig import ROOT

DOCS = ROOT / "docs"
PAGE = DOCS / "pits.md"
BEGIN, END = "<!-- written by make pits -->\n", "<!-- end of what make pits writes -->"
COLUMNS = (
    *("link", "fault", "s to notice", "s to no force", "removed beyond plan, nm", "bound of check, nm"),
    *("of the bound", "noticed as", "load", "measured"),
)
HEADER = f"| {' | '.join(COLUMNS)} |\n{'|---' * len(COLUMNS)}|\n"
LONGEST = 90
COMMON = (
    "polishd/daemon",
    "polishd/model",
    "polishd/drivers/transport",
    "polishd/sim_backends/common/faults.py",
    "polishd/sim_backends/plant",
    "tests/campaigns/pits/cases.py",
    "tests/campaigns/pits/judge.py",
)
"""Sources that each case depends on."""


@cache
def of_case(link: str) -> str:
    """Hash of the sources that a case on that link depends on."""
    return beside.sources((*COMMON, *LINKS[link].parts))


class Kept:
    """The results of all sittings. Several threads may add."""

    def __init__(self, folder: Path = DOCS) -> None:
        self._path = folder / "pits.jsonl"
        self._lock = threading.Lock()

    def rows(self) -> list[Row]:
        """Results in the order of the page."""
        found = {(row["link"], row["fault"]): row for row in beside.read(self._path)}
        return [found[case] for case in CASES if case in found]

    def left(self, *, again: bool = False) -> list[tuple[str, str]]:
        """Cases that were never measured, then those of other sources; ``again``: all the rest, too."""
        rows = {(row["link"], row["fault"]): row["of"] for row in self.rows()}
        never = [case for case in CASES if case not in rows]
        old = [case for case in CASES if case in rows and rows[case] != of_case(case[0])]
        same = [case for case in CASES if case in rows and rows[case] == of_case(case[0])]
        return never + old + (same if again else [])

    def add(self, finding: Finding) -> None:
        """Keep a result, in the place of an older one."""
        row = {**asdict(finding), "date": beside.today(), "of": of_case(finding.link)}
        with self._lock:
            kept = [one for one in self.rows() if (one["link"], one["fault"]) != (finding.link, finding.fault)]
            beside.keep(self._path, [*kept, row])


def text(kept: Kept) -> str:
    """The table."""
    rows = kept.rows()
    bad = sum(bool(row["wrong"]) for row in rows)
    told = f"{len(rows)} of {len(CASES)} cases were measured, {bad} of them not as required.\n\n"
    return f"{told}{HEADER}{''.join(map(_line, rows))}"


def write(kept: Kept) -> None:
    """Put it into the page."""
    beside.write(PAGE, BEGIN, END, text(kept))


def _line(row: Row) -> str:
    noticed = " ".join(row["noticed"].split()).replace("|", "/")[:LONGEST]
    if row["notice_s"] is None:
        noticed = "not noticed"
    wrong = f" **{'; '.join(row['wrong'])}**" if row["wrong"] else ""
    share = f"{100.0 * row['removed_nm'] / row['bound_nm']:.0f} %{wrong}"
    figures = (f"{row['removed_nm']:.1f}", f"{row['bound_nm']:.1f}", share)
    cells = (row["link"], row["fault"], _s(row["notice_s"]), _s(row["no_force_s"]), *figures)
    whole = (*cells, noticed, f"{row['load']:.1f}", beside.when(row))
    return f"| {' | '.join(whole)} |\n"


def _s(seconds: float | None) -> str:
    return "" if seconds is None else f"{seconds:.2f}"
