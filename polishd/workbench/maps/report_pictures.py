"""Pictures of a map's report: heights with marked peak and valley, lines through them, slope, spectrum and its line."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from polishd.model.surface import FloatArray
from polishd.model.tolerance import ToleranceLine
from polishd.show.sheet import Picture
from polishd.show.style import (
    BLUE,
    DIVERGING,
    INK,
    NO_DATA,
    ORANGE,
    SEQUENTIAL,
    figure,
    png,
    polishd_style,
    ruled,
)
from polishd.workbench.maps.pictures import LEAST_NM
from polishd.workbench.maps.report_figures import MapReportData

WIDE_IN = 9.0
DPI = 160
"""A report is printed, too."""
COLOURS = {"peak": ORANGE, "valley": BLUE}
MARKS = {"peak": "^", "valley": "v"}


def height_picture(found: MapReportData) -> Picture:
    """The level map with its peak and valley, and the lines through them, along x and y."""
    caption = (
        "Piston and tilt removed; red is high. Marked: peak (triangle up) and valley (triangle down); the dashed lines "
        "are the profiles beside it. Grey: no data, or outside the mask."
    )
    with polishd_style():
        page = figure(WIDE_IN, 4.2)
        axes = page.subplot_mosaic([["map", "x"], ["map", "y"]], width_ratios=[1.15, 1.0])
        level = found.figured.level_nm
        limit = float(np.nanmax(np.abs(level)))
        limit = limit if limit > LEAST_NM else 1.0
        _map(axes["map"], found, level, "nm", cmap=DIVERGING, vmin=-limit, vmax=limit)
        for name, colour in COLOURS.items():
            mark = found.answer[name]
            axes["map"].axhline(mark["y"], color=colour, linewidth=0.7, linestyle="--")
            axes["map"].axvline(mark["x"], color=colour, linewidth=0.7, linestyle="--")
            axes["map"].plot(mark["x"], mark["y"], MARKS[name], color=colour, markeredgecolor=INK, markersize=7)
        for line in found.answer["profiles"]:
            ax, name = axes[line["along"]], line["through"]
            nm = np.array([np.nan if value is None else value for value in line["nm"]])
            ax.plot(line["place"], nm, color=COLOURS[name], linewidth=0.9, label=f"through the {name}")
            ax.plot(found.answer[name][line["along"]], found.answer[name]["nm"], MARKS[name], color=COLOURS[name])
        for along in "xy":
            axes[along].set(xlabel=f"{along}, {found.unit}", ylabel="nm")
            ruled(axes[along])
        axes["x"].legend(loc="best")
        return Picture("heights", caption, png(page, DPI))


def slopes(found: MapReportData, slope_urad: FloatArray) -> Picture:
    """The magnitude of the slope."""
    caption = "Magnitude of the slope over two samples' distance; the last colour is the 99.8th percentile and above."
    with polishd_style():
        page = figure(WIDE_IN * 0.6, 3.8)
        most = float(np.nanpercentile(slope_urad, 99.8)) or 1.0
        _map(page.add_subplot(), found, slope_urad, "µrad", cmap=SEQUENTIAL, vmin=0.0, vmax=most)
        return Picture("slope", caption, png(page, DPI), wide=False)


def spectrum_picture(found: MapReportData) -> Picture:
    """The radially averaged PSD up to Nyquist, with the lines that the drawing has for it."""
    psd = found.answer["psd"]
    lines = [line for line in found.lines if line.figure == "psd"]
    caption = "Radially averaged two-dimensional PSD, up to the frequency of two samples a period."
    caption += " The straight lines are the drawing's: the PSD must be below." if lines else ""
    frequency, density = (np.asarray(psd[key]) for key in ("frequency_per_mm", "density_nm2_mm2"))
    some = density > LEAST_NM**2
    with polishd_style():
        page = figure(WIDE_IN * 0.6, 3.8)
        ax = page.add_subplot()
        ax.loglog(frequency[some], density[some], color=BLUE, linewidth=1.0, label="measured")
        for line, at in _ends(lines):
            label = f"{line.limit:g} / f^{line.exponent:g}" if line.exponent else f"{line.limit:g}"
            ax.loglog(at, line.limit / at**line.exponent, color=ORANGE, linewidth=1.8, label=label)
        ax.set(xlabel="spatial frequency f, 1/mm", ylabel="PSD, nm² mm²")
        ruled(ax, "both")
        if lines:
            ax.legend()
        return Picture("spectrum", caption, png(page, DPI), wide=False)


def _ends(lines: list[ToleranceLine]) -> Iterator[tuple[ToleranceLine, FloatArray]]:
    """Each line of a PSD with the frequencies between which it holds."""
    for line in lines:
        yield line, np.array([1 / (line.below_mm or np.inf), 1 / line.above_mm])


def _map(ax: Axes, found: MapReportData, values: FloatArray, unit: str, **colours: Any) -> None:
    half_x, half_y = found.grid.nx * found.grid.pitch_mm / 2, found.grid.ny * found.grid.pitch_mm / 2
    ax.set_facecolor(NO_DATA)
    seen = ax.imshow(values, extent=(-half_x, half_x, -half_y, half_y), interpolation="none", **colours)
    ax.set(xlabel=f"x, {found.unit}", ylabel=f"y, {found.unit}")
    ax.figure.colorbar(seen, ax=ax, label=unit, shrink=0.9)
