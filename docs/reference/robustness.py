"""Write the tables of the study of robustness: ``python -m docs.reference.robustness DIR``, its ``--out`` so far."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from statistics import fmean

from docs.reference.naming import put
from polishd.studies.result_store import Rows, read_table
from polishd.studies.summary import MedianInterval, Summary, summarise

PAGE = Path(__file__).with_name("results.md")
MARKS = "<!-- written by make robustness -->\n", "<!-- end of what make robustness writes -->"
JOBS = 2200
"""Of the whole study."""


def table(rows: Rows) -> str:
    """How many jobs ran, what each loop came to, and what its error goes with."""
    found = summarise(rows)
    points = len({row["point"] for row in rows})
    cpu_s = fmean(row["cpu_s"] for row in rows if row["cpu_s"])
    errors = sum(bool(row["error"]) for row in rows)
    head = (
        f"{len(rows)} of its {JOBS} jobs, over {points} machines; {cpu_s:.2f} s of CPU a job, without its plant; "
        f"{errors} ended by an error. Medians and shares with their 95 % intervals.\n\n"
    )
    return head + _groups(found) + "\n" + _keys(found)


def _groups(found: Summary) -> str:
    lines = [["loop", "jobs", "does not come into tolerance", "passes to tolerance", "true RMS at the end, nm"]]
    for one in found.groups:
        value, low, high = one.share
        share = f"{value:.1%} ({low:.1%} to {high:.1%})"
        passes, rms = (_middle(one.figures[name]) for name in ("passes_to_tolerance", "true_rms_end_nm"))
        lines.append([f"`{one.label['loop']}`", str(one.cases), share, passes, rms])
    return _markdown(lines)


def _keys(found: Summary) -> str:
    """Rank correlation of true RMS, and in brackets the share that fails in a key's lowest and highest third."""
    keys = list(dict.fromkeys(one.key for one in found.sensitivity))
    lines = [
        ["true RMS goes with (fails in the lowest, highest third)", *(f"`{key.rpartition('.')[2]}`" for key in keys)]
    ]
    for group in found.groups:
        cells = []
        for key in keys:
            (rank,) = (one.figure for one in found.sensitivity if (one.key, one.label) == (key, group.label))
            shares = [one.share[0] for one in found.fails if (one.key, one.label) == (key, group.label)]
            cells.append(f"{rank or 0.0:+.2f} ({shares[0]:.0%}, {shares[-1]:.0%})")
        lines.append([f"`{group.label['loop']}`", *cells])
    return _markdown(lines)


def _middle(one: MedianInterval) -> str:
    if one.median is None:
        return "-"
    high = "..." if one.high is None else f"{one.high:.3g}"
    return f"{one.median:.3g}" if one.low is None else f"{one.median:.3g} ({one.low:.3g} to {high})"


def _markdown(lines: Sequence[Sequence[str]]) -> str:
    head, *rows = lines
    return "".join(f"| {' | '.join(cells)} |\n" for cells in (head, ["---"] * len(head), *rows))


if __name__ == "__main__":
    PAGE.write_text(put(PAGE.read_text(), table(read_table(Path(sys.argv[1]))[0]), MARKS))
