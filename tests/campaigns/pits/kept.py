"""What ``make pits`` came to: docs/data/pits.jsonl, a line a case, and the table in docs/reference/results.md."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from dataclasses import asdict
from functools import cache
from pathlib import Path

from tests.campaigns import result_files
from tests.campaigns.pits.cases import CASES, LINKS
from tests.campaigns.pits.judge import Finding
from tests.campaigns.result_files import ACTING, Row
from tests.system.sim_rig import ROOT

DATA = ROOT / "docs" / "data"
PAGE = ROOT / "docs" / "reference" / "results.md"
BEGIN, END = "<!-- written by make pits -->\n", "<!-- end of what make pits writes -->"
COLUMNS = (
    *("link", "cases", "longest to notice, s", "longest to no force, s", "most removed beyond plan, nm"),
    *("of the bound, most", "not noticed", "not as required", "measured"),
)
HEADER = f"| {' | '.join(COLUMNS)} |\n{'|---' * len(COLUMNS)}|\n"
COMMON = (
    *ACTING,
    "polishd/drivers/transport",
    "polishd/sim_backends/common",
    "polishd/sim_backends/plant",
    "tests/campaigns/pits",
)
"""Sources that each case depends on."""


@cache
def of_case(link: str) -> str:
    """Hash of the sources that a case on that link depends on."""
    return result_files.sources((*COMMON, *LINKS[link].parts))


class Kept:
    """The results of all sessions. Several threads may add."""

    def __init__(self, folder: Path = DATA) -> None:
        self._path = folder / "pits.jsonl"
        self._lock = threading.Lock()

    def rows(self) -> list[Row]:
        """Results in the order of the page."""
        found = {(row["link"], row["fault"]): row for row in result_files.read(self._path)}
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
        row = {**asdict(finding), "date": result_files.today(), "of": of_case(finding.link)}
        with self._lock:
            kept = [one for one in self.rows() if (one["link"], one["fault"]) != (finding.link, finding.fault)]
            result_files.keep(self._path, [*kept, row])


def text(kept: Kept) -> str:
    """Return the table: a row per link."""
    rows = kept.rows()
    bad = sum(bool(row["wrong"]) for row in rows)
    head = f"{len(rows)} of {len(CASES)} cases were measured, {bad} of them not as required.\n\n{HEADER}"
    links = dict.fromkeys(row["link"] for row in rows)
    return head + "".join(_line([row for row in rows if row["link"] == link]) for link in links)


def write(kept: Kept) -> None:
    """Put it into the page."""
    result_files.write(PAGE, BEGIN, END, text(kept))


def _line(rows: Sequence[Row]) -> str:
    """Return the row of a link; cases that no device noticed, or that are not as required, are named."""
    unnoticed = ", ".join(row["fault"] for row in rows if row["notice_s"] is None)
    wrong = "; ".join(f"**{row['fault']}: {'; '.join(row['wrong'])}**" for row in rows if row["wrong"])
    share = max(row["removed_nm"] / row["bound_nm"] for row in rows)
    first, last = min(row["date"] for row in rows), max(row["date"] for row in rows)
    cells = (
        *(rows[0]["link"], str(len(rows)), _most(rows, "notice_s"), _most(rows, "no_force_s")),
        *(f"{max(row['removed_nm'] for row in rows):.1f}", f"{100.0 * share:.0f} %", unnoticed or "none"),
        *(wrong or "none", first if first == last else f"{first} to {last}"),
    )
    return f"| {' | '.join(cells)} |\n"


def _most(rows: Sequence[Row], key: str) -> str:
    known = [row[key] for row in rows if row[key] is not None]
    return f"{max(known):.2f}" if known else "-"
