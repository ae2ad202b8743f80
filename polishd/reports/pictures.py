"""Pictures that all reports have: maps before and after, RMS of each map, and spectra with limits and ripple."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from polishd.model.surface import BoolArray, FloatArray
from polishd.rendering.map_grid import MapGroup, MapPanel, map_grid
from polishd.rendering.map_plots import ConvergenceStep, Spectrum, convergence, spectrum
from polishd.rendering.plots import BLUE, MUTED, ORANGE, PAGE_IN, add_panel, page_figure
from polishd.rendering.scales import PERCENTILE, height_limit

LEFT_IN, RIGHT_IN = 0.68, 0.14
"""Room for the labels of y and for half of the last label of x, of a chart."""
LEGEND_IN = 2.45
"""Room for a legend beside a chart."""

MAPS_CAPTION = (
    "Left: both maps on one color scale. Right: the last map on its own scale. Red is high. The colors end at the "
    f"{PERCENTILE:g}th percentile of the first map, or of the map itself. Line: the clear aperture. Gray: no data."
)
ONE_MAP_CAPTION = "Red is high. Line: the clear aperture. Gray: no data."
CONVERGENCE_CAPTION = (
    "RMS of each map. Bars: the range that the plan expected in 9 of 10 cases. Dashed: an interrupted pass, for which "
    "nothing is expected."
)
SPECTRA_CAPTION = (
    "Radially averaged two-dimensional PSD over the clear aperture. Straight lines: limits of the drawing. Dotted: "
    "periods of the path's ripple. A ripple shorter than two samples appears at a longer period."
)


class NamedMap(NamedTuple):
    """A map of a report."""

    name: str
    height_nm: FloatArray
    """(ny, nx) about its mean, NaN: no data."""
    clear: BoolArray
    """(ny, nx) clear aperture."""
    rms_nm: float
    """In the clear aperture."""

    def panel(self, note: str = "") -> MapPanel:
        """Return the panel with name and RMS."""
        return MapPanel(f"{self.name}{note}\n{self.rms_nm:.2f} nm RMS", self.height_nm, self.clear)

    @property
    def limit_nm(self) -> float:
        """End of the map's color scale."""
        return height_limit(np.where(self.clear, self.height_nm, np.nan))


def maps_figure(maps: Sequence[NamedMap], pitch_mm: float) -> Figure:
    """Draw maps on the color scale of the first, and the last also on its own.

    Args:
        maps: one, or those before and after.
        pitch_mm: distance of samples.
    """
    groups = [MapGroup([one.panel() for one in maps], maps[0].limit_nm)]
    if len(maps) > 1:
        groups.append(MapGroup([maps[-1].panel(", own scale")], maps[-1].limit_nm))
    return map_grid(groups, pitch_mm)


def chart(high_in: float, top_in: float = 0.12) -> tuple[Figure, Axes]:
    """Return a figure with one chart; ``top_in``: room above it."""
    fig = page_figure(high_in)
    return fig, add_panel(fig, LEFT_IN, 0.5, PAGE_IN - LEFT_IN - RIGHT_IN, high_in - 0.5 - top_in)


def convergence_figure(steps: Sequence[ConvergenceStep], limit_nm: float | None, measured: str = "measured") -> Figure:
    """Draw the RMS of each map, what was predicted of it, and the limit."""
    fig = page_figure(1.9)
    ax = add_panel(fig, LEFT_IN, 0.4, PAGE_IN - LEFT_IN - LEGEND_IN, 1.4)
    convergence(ax, steps, limit_nm, measured)
    ax.set_title("")
    ax.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
    return fig


def spectra_figure(
    curves: Mapping[str, Spectrum], limits: Sequence[Mapping[str, Any]] = (), ripple_mm: Sequence[float] = ()
) -> Figure:
    """Draw power spectra on logarithmic axes: the first gray, the last blue.

    Args:
        curves: by name.
        limits: PSD lines of the drawing: ``limit``, ``exponent``, ``above_mm``, ``below_mm``.
        ripple_mm: periods of the path's ripple.
    """
    shades = mpl.colormaps["Blues"](np.linspace(0.4, 0.8, max(len(curves) - 2, 0)))
    fig, ax = chart(2.8, 0.46)
    spectrum(ax, curves, "", colors=[*([MUTED] if len(curves) > 1 else ()), *shades, BLUE])
    for line in limits:
        ends = np.array([1 / (line["below_mm"] or math.inf), 1 / line["above_mm"]])
        label = f"limit {line['limit']:g}" + (f" / f^{line['exponent']:g}" if line["exponent"] else "")
        ax.plot(ends, line["limit"] / ends ** line["exponent"], color=ORANGE, linewidth=1.8, label=label)
    highest = max((float(np.max(curve.frequency_per_mm)) for curve in curves.values()), default=0.0)
    shown = sorted({round(period, 3) for period in ripple_mm if period * highest >= 1}, reverse=True)
    for at, period in enumerate(shown):
        name = f"ripple, {', '.join(f'{one:.2f}' for one in shown)} mm" if at == 0 else None
        ax.axvline(1 / period, color=ORANGE, linestyle=":", linewidth=1.2, label=name)
    if len(ax.get_legend_handles_labels()[1]) > 1:
        ax.legend(loc="upper right")
    return fig
