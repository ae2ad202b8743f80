"""Plots that the pictures are made of: heat map, spectrum, profiles, histogram, convergence, values along a path.

Lateral axes are in mm, or in pixels for a map without a lateral scale. Row 0 of an array is the top of the map.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import cycle, pairwise
from typing import Any, NamedTuple

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PathCollection
from matplotlib.image import AxesImage
from matplotlib.patheffects import withStroke
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullLocator

from polishd.model.surface import BoolArray, FloatArray
from polishd.rendering.plots import BLUE, GREEN, INK, MUTED, NO_DATA, ORANGE, ruled
from polishd.rendering.scales import DIVERGING, LEAST_NM, SEQUENTIAL, height_limit, value_limits

MAX_PX = 1000
"""Samples of a map that a panel shows along a side. More take time and cannot be seen."""
COLORS = (BLUE, ORANGE, GREEN, MUTED, "#cc79a7", "#e69f00")
"""Colors of the lines of a plot, in this order."""
MAX_NAMES = 6
"""Measurements that are named on an axis. More have numbers."""


def height_map(
    ax: Axes,
    height_nm: FloatArray,
    pitch_mm: float | None,
    title: str,
    *,
    limit_nm: float | None = None,
    edge: BoolArray | None = None,
    bar: bool = True,
) -> AxesImage:
    """Heat map of heights: red is high, blue is low, white is 0, gray is no data.

    Args:
        ax: the panel.
        height_nm: (ny, nx).
        pitch_mm: None: the axes are in pixels.
        title: of the panel.
        limit_nm: where the colors end; None: by ``height_limit``.
        edge: (ny, nx) area whose edge is drawn as a line.
        bar: with a color bar.
    """
    limit = height_limit(height_nm) if limit_nm is None else limit_nm
    image = _heat_map(ax, height_nm, pitch_mm, title, colors=DIVERGING, scale=(-limit, limit))
    if edge is not None:
        _outline(ax, edge, image.get_extent())
    if bar:
        color_bar([image], "nm")
    return image


def value_map(
    ax: Axes,
    values: FloatArray,
    pitch_mm: float | None,
    title: str,
    unit: str = "",
    *,
    scale: tuple[float, float] | None = None,
    extent_mm: tuple[float, float, float, float] | None = None,
    bar: bool = True,
) -> AxesImage:
    """Heat map of values without a sign.

    Args:
        ax: the panel.
        values: (ny, nx).
        pitch_mm: None: the axes are in pixels.
        title: of the panel.
        unit: label of the color bar.
        scale: least and greatest value of the colors; None: those of the map.
        extent_mm: left, right, bottom and top edge; None: the map is centered on 0.
        bar: with a color bar.
    """
    image = _heat_map(ax, values, pitch_mm, title, colors=SEQUENTIAL, scale=scale or (None, None), extent_mm=extent_mm)
    if bar:
        color_bar([image], unit)
    return image


def color_bar(images: Sequence[AxesImage | PathCollection], label: str, panel: Axes | None = None) -> None:
    """Draw the color bar of images with one scale. An end is pointed if values lie beyond it.

    ``panel``: of the bar, which lies along its longer side; None: beside the images.
    """
    axes: list[Any] = [image.axes for image in images]
    low, high = images[0].get_clim()
    below = any(np.nanmin(_values(image), initial=low) < low for image in images)
    above = any(np.nanmax(_values(image), initial=high) > high for image in images)
    extend = {(0, 0): "neither", (1, 0): "min", (0, 1): "max", (1, 1): "both"}[below, above]
    look: dict[str, Any] = {"extend": extend, "extendfrac": 0.03}
    if panel is None and len(axes) == 1:
        # inset: as high as the map, which may be lower than its place. A bar of the place's height covers the title
        ax = axes[0]
        width_mm, height_mm = np.ptp(ax.get_xlim()), np.ptp(ax.get_ylim())
        longer = 1.0 if ax.get_aspect() == "auto" else max(height_mm / width_mm, 1.0)
        look |= {"cax": ax.inset_axes((1 + 0.03 * longer, 0.0, 0.04 * longer, 1.0))}
    elif panel is None:
        look |= {"ax": axes, "shrink": 0.85, "aspect": 24, "pad": 0.02}
    else:
        box = panel.bbox
        look |= {"cax": panel, "orientation": "horizontal" if box.width > box.height else "vertical"}
    bar = axes[0].figure.colorbar(images[0], **look)
    bar.set_label(label)
    bar.outline.set_visible(False)


def _values(image: Any) -> FloatArray:
    return np.ma.filled(np.ma.asarray(image.get_array(), dtype=np.float64), np.nan)


def _heat_map(
    ax: Axes,
    values: FloatArray,
    pitch_mm: float | None,
    title: str,
    *,
    colors: str,
    scale: tuple[float | None, float | None],
    extent_mm: tuple[float, float, float, float] | None = None,
) -> AxesImage:
    ny, nx = values.shape
    step = max(1, math.ceil(max(ny, nx) / MAX_PX))
    half_x, half_y = (n / 2 * (pitch_mm or 1.0) for n in (nx, ny))
    image = ax.imshow(
        np.ma.masked_invalid(values[::step, ::step]),
        cmap=mpl.colormaps[colors].with_extremes(bad=NO_DATA),
        vmin=scale[0],
        vmax=scale[1],
        extent=extent_mm or (-half_x, half_x, -half_y, half_y),
        interpolation="nearest",
    )
    unit = "px" if pitch_mm is None else "mm"
    ax.set_title(title, parse_math=False)
    ax.set(xlabel=f"x, {unit}", ylabel=f"y, {unit}")
    ax.spines[:].set_visible(False)
    ax.locator_params(nbins=5)
    if nx < ny / 2:
        ax.set_xticks([-half_x, half_x], [f"{-half_x:.3g}", f"{half_x:.3g}"], rotation=90)
    if ny < nx / 2:
        ax.set_yticks([-half_y, half_y], [f"{-half_y:.3g}", f"{half_y:.3g}"])
    return image


def _outline(ax: Axes, area: BoolArray, extent: Sequence[float]) -> None:
    """Draw the edge of an area as a thin line."""
    if not area.any():
        return
    step = max(1, math.ceil(max(area.shape) / MAX_PX))
    rim = np.pad(area[::step, ::step].astype(np.float64), 1)
    left, right, bottom, top = extent
    ny, nx = (n - 2 for n in rim.shape)
    x = left + (np.arange(nx + 2) - 0.5) * (right - left) / nx
    y = top - (np.arange(ny + 2) - 0.5) * (top - bottom) / ny
    ax.contour(x, y, rim, levels=[0.5], colors=[INK], linewidths=0.7)
    ax.set(xlim=(left, right), ylim=(bottom, top))


class Spectrum(NamedTuple):
    """Radially averaged power spectral density, (n,) each."""

    frequency_per_mm: Any
    density_nm2_mm2: Any


def spectrum(
    ax: Axes,
    curves: Mapping[str, Spectrum],
    title: str = "Power spectrum",
    *,
    nyquist_per_mm: float = math.inf,
    periods_mm: Sequence[float] = (),
    colors: Sequence[Any] = COLORS,
    period_axis: bool = True,
) -> None:
    """Power spectra on logarithmic axes.

    Args:
        ax: the panel.
        curves: by name.
        title: of the panel.
        nyquist_per_mm: higher frequencies are not drawn. They lie in the corners of the square of frequencies.
        periods_mm: marked by dotted lines.
        colors: of the curves, in their order.
        period_axis: with the period on an axis at the top.
    """
    for (name, curve), color in zip(curves.items(), cycle(colors), strict=False):
        frequency, density = np.asarray(curve[0], dtype=np.float64), np.asarray(curve[1], dtype=np.float64)
        shown = (density > LEAST_NM**2) & (frequency <= nyquist_per_mm)
        if shown.any():
            ax.plot(frequency[shown], density[shown], color=color, label=name, linewidth=1.3)
    if not ax.lines:
        empty_panel(ax, "flat: no spectrum")
        return
    ax.set_xscale("log")
    ax.set_yscale("log")
    ax.set(xlabel="spatial frequency, 1/mm", ylabel="PSD, nm² mm²")
    ax.set_title(title, pad=34.0 if period_axis else None)
    low, high = ax.get_xlim()
    for period in periods_mm:
        if low < 1 / period < high:
            ax.axvline(1 / period, color=MUTED, linestyle=":", linewidth=1.0)
    plain_log(ax.xaxis)
    ax.yaxis.set_minor_locator(NullLocator())
    if period_axis:
        top = ax.secondary_xaxis("top", functions=(_inverse, _inverse))
        top.set_xlabel("period, mm", fontsize=8)
        plain_log(top.xaxis)
    if len(curves) > 1:
        ax.legend(loc="lower left")
    ruled(ax, "both")


def _inverse(value: Any) -> Any:
    """Frequency to period and back; 0 becomes a very long period."""
    return 1.0 / np.maximum(np.asarray(value, dtype=np.float64), 1e-12)


def plain_log(axis: Any) -> None:
    """Label a logarithmic axis 0.5, 1, 2, 5, 10 and not in powers."""
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_locator(NullLocator())


def profiles(
    ax: Axes,
    lines: Mapping[str, tuple[Any, Any]],
    title: str = "",
    *,
    xlabel: str = "mm",
    ylabel: str = "nm",
    colors: Sequence[str] = COLORS,
) -> None:
    """Values along lines: position and value by the name of the line; NaN is no data."""
    for (name, (position, values)), color in zip(lines.items(), cycle(colors), strict=False):
        ax.plot(position, values, color=color, label=name, linewidth=1.2)
    ax.set(title=title, xlabel=xlabel, ylabel=ylabel)
    ax.margins(x=0, y=0.16)
    if len(lines) > 1:
        ax.legend(loc="upper right", ncols=2, borderaxespad=0.0)
    ruled(ax)


def histogram(
    ax: Axes,
    values: FloatArray,
    title: str,
    *,
    xlabel: str,
    ylabel: str = "samples",
    limits: tuple[float, float] | None = None,
) -> None:
    """Histogram of values. ``limits``: ends of the axis; None: those of the values."""
    if limits is None and float(np.ptp(values)) <= LEAST_NM:
        limits = (-1.0, 1.0)
    ax.hist(values, bins=70, range=limits, color=BLUE)
    ax.set(title=title, xlabel=xlabel, ylabel=ylabel)
    ruled(ax)


class ConvergenceStep(NamedTuple):
    """A measurement of a run, and what the plan of the pass before it predicted."""

    name: str
    rms_nm: float
    """NaN: not known."""
    predicted_nm: float = math.nan
    expected_nm: tuple[float, float] | None = None
    """RMS that 9 of 10 measurements lie between."""
    interrupted: bool = False
    """The pass before this measurement was interrupted."""
    all_periods_nm: float = math.nan
    """RMS of all periods, if ``rms_nm`` is of some of them."""


def convergence(ax: Axes, steps: Sequence[ConvergenceStep], limit_nm: float | None, measured: str = "measured") -> None:
    """RMS of each measurement with its prediction and the limit, on a logarithmic axis."""
    rms = np.array([step.rms_nm for step in steps], dtype=np.float64)
    if any(math.isfinite(step.all_periods_nm) for step in steps):
        values = [step.all_periods_nm for step in steps]
        ax.plot(values, "o-", color=MUTED, markersize=3, linewidth=1.0, label="measured, all periods")
    for index, (before, after) in enumerate(pairwise(steps)):
        color, line = (MUTED, "--") if after.interrupted else (BLUE, "-")
        ax.plot([index, index + 1], [before.rms_nm, after.rms_nm], line, color=color, linewidth=1.2)
    ax.plot(rms, "o", color=BLUE, label=measured, zorder=3)
    expected = [(index, *step.expected_nm) for index, step in enumerate(steps) if step.expected_nm is not None]
    if expected:
        place, low, high = np.transpose(expected)
        ax.vlines(place, low, high, color=ORANGE, linewidth=5.0, alpha=0.4, label="expected, 9 of 10")
    predicted = [step.predicted_nm for step in steps]
    if np.isfinite(predicted).any():
        ax.plot(predicted, "D", color=ORANGE, label="predicted by the plan", markersize=6, fillstyle="none", zorder=4)
    for shown in np.flatnonzero(np.isfinite(rms)):
        point = (int(shown), float(rms[shown]))
        note = ax.annotate(f"{point[1]:.2f}", point, (6, 5), textcoords="offset points", fontsize=8)
        note.set(zorder=5, path_effects=[withStroke(linewidth=2.5, foreground="white")])
    if limit_nm is not None and limit_nm > 0:
        ax.axhline(limit_nm, color=GREEN, linewidth=1.2, linestyle=(0, (5, 3)), label=f"limit {limit_nm:g} nm")
    ax.set(title="RMS in the clear aperture", ylabel="RMS, nm", yscale="log")
    plain_log(ax.yaxis)
    bottom, top = ax.get_ylim()
    if top < 10 * bottom:
        ax.yaxis.set_major_locator(MaxNLocator(6, steps=[1, 2, 5, 10]))
    if len(steps) <= MAX_NAMES:
        ax.set_xticks(range(len(steps)), [step.name.replace("after an ", "after an\n") for step in steps])
    else:
        ax.xaxis.set_major_locator(MaxNLocator(integer=True))
        ax.set_xlabel("measurement (0 = start)")
    ax.set_xlim(-0.25, max(len(steps) - 1, 1) + 0.45)
    ax.margins(y=0.15)
    ax.legend(loc="best")
    ruled(ax)


def path_map(
    ax: Axes,
    position_mm: FloatArray,
    values: FloatArray,
    title: str,
    unit: str,
    *,
    percentile: float = 100.0,
    bar: Axes | None = None,
) -> None:
    """Values at the points of a path, seen from above: (n, 2 or more) mm and (n,).

    ``percentile``: of the values at which the colors end. ``bar``: panel of the color bar; None: beside the map.
    """
    x, y = position_mm[:, 0], position_mm[:, 1]
    panel_pt = 175.0 if bar is None else min(ax.bbox.size) * 72 / ax.figure.dpi
    low, high = value_limits(values, percentile)
    points = ax.scatter(
        x,
        y,
        c=values,
        s=_marker_area(position_mm, panel_pt),
        marker="s",
        linewidths=0,
        cmap=SEQUENTIAL,
        vmin=low,
        vmax=high,
    )
    ax.set_title(title, parse_math=False)
    ax.set(xlabel="x, mm", ylabel="y, mm", aspect="equal")
    ax.spines[:].set_visible(False)
    ax.locator_params(nbins=5)
    color_bar([points], unit, bar)


def _marker_area(position_mm: FloatArray, panel_pt: float) -> float:
    """Area of a marker, in square points, with which the points just fill the part in a panel of that side."""
    span = np.ptp(position_mm[:, :2], axis=0)
    side = max(float(span.max()), 1e-9)
    spacing = math.sqrt(max(float(span[0] * span[1]), 1e-9) / max(len(position_mm), 1))
    return float(np.clip(1.35 * panel_pt * spacing / side, 0.8, 12.0) ** 2)


def empty_panel(ax: Axes, text: str = "") -> None:
    """Write a text in place of a plot."""
    ax.set_axis_off()
    ax.text(0.5, 0.5, text, ha="center", va="center", transform=ax.transAxes)
