"""Write the picture of a dwell's cost as a part grows: ``python -m docs.reference.cost``.

It is drawn from the rows of ``make bench ARGS=size`` in docs/data/benchmarks.jsonl.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from docs.reference.performance import DATA, PAGE, read

NAME = re.compile(r"size: (phi|hexagon) .*?, (\d+) blocks, ")
LABELS = {"phi": "discs, spot 10 mm", "hexagon": "hexagon of 1.4 m, spot 30 mm"}
Lines = dict[str, tuple[list[float], list[float]]]


def lines_of(rows: Iterable[Mapping[str, Any]]) -> dict[str, Lines]:
    """Return (blocks, costs) by unit, s or MB, and label; SystemExit where discs were not measured."""
    found: dict[str, Lines] = {"s": {}, "MB": {}}
    for row in rows:
        if row["benchmark"] == "size" and (name := NAME.match(row["name"])):
            across, up = found[row["unit"]].setdefault(LABELS[name[1]], ([], []))
            across.append(float(name[2]))
            up.append(float(row["ours"]))
    if missing := [unit for unit, lines in found.items() if LABELS["phi"] not in lines]:
        raise SystemExit(
            f"{DATA.name}: no rows of the benchmark size for discs, in {' and '.join(missing)}: "
            "run make bench ARGS=size"
        )
    return found


def main() -> None:
    """Draw it."""
    found = lines_of(read())
    figure = Figure(figsize=(8, 3.2), layout="constrained")
    for axes, (unit, lines) in zip(figure.subplots(1, 2), found.items(), strict=True):
        for label, (across, up) in lines.items():
            order = np.argsort(across)
            axes.loglog(np.array(across)[order], np.array(up)[order], "o-", label=label)
        blocks, first = np.sort(lines[LABELS["phi"]][0]), min(lines[LABELS["phi"]][1])
        if unit == "s":
            growth = blocks * np.log(blocks)
            axes.loglog(blocks, first * growth / growth[0], "--", color="grey", label="n log n")
        axes.set(xlabel="blocks", ylabel="CPU seconds" if unit == "s" else "most memory, MB")
        axes.grid(alpha=0.3)
    figure.axes[0].legend(fontsize=8)
    figure.savefig(PAGE.parents[1] / "images" / "cost.png", dpi=110)


if __name__ == "__main__":
    main()
