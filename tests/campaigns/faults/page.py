"""docs/reference/results.md: a row per link, from docs/data."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from tests.campaigns import result_files
from tests.campaigns.faults.kept import CASES, Kept
from tests.campaigns.result_files import Row
from tests.system.sim_rig import ROOT

PAGE = ROOT / "docs" / "reference" / "results.md"
BEGIN, END = "<!-- written by make faults -->\n", "<!-- end of what make faults writes -->"
COLUMNS = (
    *("link", "cases", "continued", "contact left", "permitted silence, s", "longest to the first reaction, s"),
    *("longest to force off, s", "load, most", "not as required", "measured"),
)
HEADER = f"| {' | '.join(COLUMNS)} |\n{'|---' * len(COLUMNS)}|\n"
LOSSES = """\
| link | how | losses | s to detection: 50, 95, 100 % | limit, s | s to force off: 50, 95, 100 % | load | measured |
|---|---|---|---|---|---|---|---|
"""


def text(kept: Kept) -> str:
    """Both tables."""
    cases, losses = kept.cases(), [row for told in kept.losses() for row in _losses(told)]
    wrong = sum(bool(row["wrong"]) for row in cases)
    head = f"{len(cases)} of {len(CASES)} cases were measured, {wrong} of them not as required.\n\n{HEADER}"
    links = dict.fromkeys(row["link"] for row in cases)
    body = head + "".join(_link([row for row in cases if row["link"] == link]) for link in links)
    return f"{body}\n{LOSSES}{''.join(losses)}" if losses else body


def write(kept: Kept) -> None:
    """Put them into the page."""
    result_files.write(PAGE, BEGIN, END, text(kept))


def _link(rows: Sequence[Row]) -> str:
    """Return the row of a link; cases that are not as required are named."""
    goes_on = sum(row["outcome"] == "goes on" for row in rows)
    detected = [row["detection_s"] for row in rows if row["limit_s"] == rows[0]["limit_s"]]
    wrong = "; ".join(_bold(f"{row['fault']}: {'; '.join(row['wrong'])}") for row in rows if row["wrong"])
    return _line(
        rows[0]["link"], str(len(rows)), str(goes_on), str(len(rows) - goes_on), f"{rows[0]['limit_s']:g}",
        _most(detected), _most(row["force_off_s"] for row in rows),
        _most((row["load"] for row in rows), 1), wrong or "none", _days(rows),
    )  # fmt: skip


def _most(values: Iterable[float | None], digits: int = 2) -> str:
    known = [value for value in values if value is not None]
    return f"{max(known):.{digits}f}" if known else "-"


def _days(rows: Sequence[Row]) -> str:
    first, last = min(row["date"] for row in rows), max(row["date"] for row in rows)
    return first if first == last else f"{first} to {last}"


def _losses(row: Row) -> Iterator[str]:
    """Those by silence and those by the plug; what went wrong in a separate line."""
    for how in (how for how in ("hangs", "unplugged") if row[how]):
        spreads = [_spread(pair[k] for pair in row[how]) for k in (0, 1)]
        yield _line(
            row["link"], how, str(len(row[how])), spreads[0], f"{row['limit_s']:g}", spreads[1], _load(row),
            result_files.when(row),
        )  # fmt: skip
    if row["wrong"]:
        yield _line(row["link"], _bold(f"{row['wrong']} wrong: {'; '.join(row['examples'])}"), *[""] * 6)


def _line(*cells: str) -> str:
    return f"| {' | '.join(cells)} |\n"


def _bold(words: str) -> str:
    return f"**{words}**"


def _load(row: Row) -> str:
    load = "not noted" if row["load"] is None else f"{row['load']:.1f}"
    return load if row["cells"] == 1 else f"{load}, {row['cells']} cells"


def _spread(values: Iterable[float | None]) -> str:
    """Of those that there are; how many there are not."""
    told = list(values)
    known: Sequence[float] = [value for value in told if value is not None]
    never = f", {len(told) - len(known)} never" if len(known) < len(told) else ""
    if not known:
        return never.removeprefix(", ")
    return ", ".join(f"{value:.2f}" for value in np.percentile(known, [50.0, 95.0, 100.0])) + never
