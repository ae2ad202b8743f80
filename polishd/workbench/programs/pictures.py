"""Pictures of programs: where one dwells, and for how long; and the run of a path that was made."""

from __future__ import annotations

import numpy as np

from polishd.model.program import Program
from polishd.model.surface import FloatArray
from polishd.process.paths.apertures import TOWARDS, Aperture
from polishd.show.style import BLUE, INK, ORANGE, SEQUENTIAL, figure, png, polishd_style

MOST_DOTS = 20_000
"""Points drawn one by one; of more, every k-th."""


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


def path_picture(points_mm: FloatArray, normal: FloatArray, aperture: Aperture, title: str) -> bytes:
    """PNG: the path (n, 3) seen from above with the aperture's outline, and the tilt of its normals (n, 3)."""
    step = max(1, -(-len(points_mm) // MOST_DOTS))
    tilt_deg = np.degrees(np.arctan2(np.hypot(normal[:, 0], normal[:, 1]), normal[:, 2]))
    outline = aperture.outline_mm()
    with polishd_style():
        page = figure(8.2, 3.9)
        path, tilt = page.subplots(1, 2, sharex=True, sharey=True)
        thin = float(np.clip(2000 / len(points_mm), 0.15, 1.2))
        path.plot(*points_mm.T[:2], color=BLUE, linewidth=thin)
        path.plot(*points_mm[0, :2], "o", color=ORANGE, markersize=4, label="first point")
        path.plot(*points_mm[-1, :2], "s", color=ORANGE, markersize=4, label="last point")
        path.legend(loc="upper center", bbox_to_anchor=(0.5, -0.14), ncols=2)
        path.set(title=title.replace("$", r"\$"), ylabel="y, mm")
        size = max(0.5, 4000 * step / len(points_mm)) ** 0.5
        shown = tilt.scatter(*points_mm[::step].T[:2], c=tilt_deg[::step], s=size, cmap=SEQUENTIAL)
        tilt.set(title="tilt of the normal")
        page.colorbar(shown, ax=tilt, shrink=0.85, label="deg")
        for axes in (path, tilt):
            axes.plot(*np.vstack([outline, outline[:1]]).T, color=INK, linewidth=0.9)
            axes.plot(*(aperture.hole_mm * np.vstack([TOWARDS, TOWARDS[:1]])).T, color=INK, linewidth=0.9)
            axes.set(xlabel="x, mm", aspect="equal")
        return png(page)
