"""docs/explanation/fault-matrix.md, of what is kept beside it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from tests.campaigns import beside
from tests.campaigns.beside import Row
from tests.campaigns.faults.kept import CASES, DOCS, Kept

PAGE = DOCS / "fault-matrix.md"
BEGIN, END = "<!-- written by make faults -->\n", "<!-- end of what make faults writes -->"
HEADER = """\
| link | fault | noticed as | s to that | limit, s | force off after, s | outcome | load | measured |
|---|---|---|---|---|---|---|---|---|
"""
LONGEST = 110
LOSSES = """\
| link | how | losses | s to detection: 50, 95, 100 % | limit, s | s to force off: 50, 95, 100 % | load | measured |
|---|---|---|---|---|---|---|---|
"""


def text(kept: Kept) -> str:
    """Both tables."""
    cases, losses = kept.cases(), [row for told in kept.losses() for row in _losses(told)]
    told = f"{len(cases)} of {len(CASES)} cases were measured.\n\n{HEADER}{''.join(map(_case, cases))}"
    return f"{told}\n{LOSSES}{''.join(losses)}" if losses else told


def write(kept: Kept) -> None:
    """Put them into the page."""
    beside.write(PAGE, BEGIN, END, text(kept))


def _case(row: Row) -> str:
    noticed = " ".join(row["noticed"].split()).replace("|", "/")[:LONGEST] or "not at all"
    times = (_s(row["detection_s"]), f"{row['limit_s']:g}", _s(row["force_off_s"]))
    outcome = row["outcome"] + ("; " + _bold("wrong: " + "; ".join(row["wrong"])) if row["wrong"] else "")
    return _line(row["link"], row["fault"], noticed, *times, outcome, _load(row), beside.when(row))


def _losses(row: Row) -> Iterator[str]:
    """Those by silence and those by the plug; what went wrong in a line of its own."""
    for how in (how for how in ("hangs", "unplugged") if row[how]):
        spreads = [_spread(pair[k] for pair in row[how]) for k in (0, 1)]
        yield _line(
            row["link"], how, str(len(row[how])), spreads[0], f"{row['limit_s']:g}", spreads[1], _load(row),
            beside.when(row),
        )  # fmt: skip
    if row["wrong"]:
        yield _line(row["link"], _bold(f"{row['wrong']} wrong: {'; '.join(row['examples'])}"), *[""] * 6)


def _line(*cells: str) -> str:
    return f"| {' | '.join(cells)} |\n"


def _bold(words: str) -> str:
    return f"**{words}**"


def _s(seconds: float | None) -> str:
    return "" if seconds is None else f"{seconds:.2f}"


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
