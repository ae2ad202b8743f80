"""A picture of a program: where it dwells, and for how long."""

from __future__ import annotations

import numpy as np

from polishd.model.program import Program
from polishd.show.style import BLUE, SEQUENTIAL, figure, png, polishd_style

MOST_DOTS = 20_000
"""Points drawn; of more, every k-th."""


def program_picture(program: Program) -> bytes:
    """PNG: the points seen from above, coloured by their time, and the time along the program."""
    step = max(1, -(-program.n // MOST_DOTS))
    place, time_s = program.end_mm[::step], program.time_s[::step]
    with polishd_style():
        page = figure(7.6, 3.6)
        above, along = page.subplots(1, 2)
        shown = above.scatter(place[:, 0], place[:, 1], c=time_s, s=max(0.5, 4000 / len(place)) ** 0.5, cmap=SEQUENTIAL)
        above.set(title=program.name.replace("$", r"\$"), xlabel="x, mm", ylabel="y, mm", aspect="equal")
        page.colorbar(shown, ax=above, shrink=0.85, label="s")
        along.plot(np.arange(1, program.n + 1, step), time_s, color=BLUE, linewidth=0.8)
        along.set(title="time along the program", xlabel="point", ylabel="s", ylim=(0, None))
        return png(page)
