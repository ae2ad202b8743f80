"""Write the picture of a dwell's cost as a part grows: ``python -m docs.reference.cost``.

It is drawn from the page's own rows of ``make bench ARGS=size``.
"""

from __future__ import annotations

import re

import numpy as np
from matplotlib.figure import Figure

from docs.reference.performance import PAGE

ROW = re.compile(r"^\| size: (phi|hexagon) .*?, (\d+) blocks, .*?(gap \S+|memory) \| (\S+) (s|MB) ", re.MULTILINE)


def main() -> None:
    """Draw it."""
    found: dict[str, dict[str, tuple[list[float], list[float]]]] = {"s": {}, "MB": {}}
    for shape, blocks, _, value, unit in ROW.findall(PAGE.read_text()):
        label = "discs, spot 10 mm" if shape == "phi" else "hexagon of 1.4 m, spot 30 mm"
        across, up = found[unit].setdefault(label, ([], []))
        across.append(float(blocks))
        up.append(float(value))
    figure = Figure(figsize=(8, 3.2), layout="constrained")
    for axes, (unit, lines) in zip(figure.subplots(1, 2), found.items(), strict=True):
        for label, (across, up) in lines.items():
            order = np.argsort(across)
            axes.loglog(np.array(across)[order], np.array(up)[order], "o-", label=label)
        blocks, first = np.sort(lines["discs, spot 10 mm"][0]), min(lines["discs, spot 10 mm"][1])
        if unit == "s":
            growth = blocks * np.log(blocks)
            axes.loglog(blocks, first * growth / growth[0], "--", color="grey", label="n log n")
        axes.set(xlabel="blocks", ylabel="CPU seconds" if unit == "s" else "most memory, MB")
        axes.grid(alpha=0.3)
    figure.axes[0].legend(fontsize=8)
    figure.savefig(PAGE.parents[1] / "images" / "cost.png", dpi=110)


if __name__ == "__main__":
    main()
