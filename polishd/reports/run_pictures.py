"""Pictures of what varies along the program's path: compliance, gamma, dwell, and executed time."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.patheffects import withStroke
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter

from polishd.process.metrology.spectra import radial_psd as metrics_radial_psd
from polishd.rendering.plots import (
    BLUE,
    DIVERGING,
    GREEN,
    INK,
    MUTED,
    NO_DATA,
    ORANGE,
    SEQUENTIAL,
    figure,
    png,
    polishd_style,
    ruled,
)
from polishd.reports.run_reader import Arrays, BoolArray, Cycle, FloatArray, ReportSurface
from polishd.reports.wording import interrupted
from polishd.util.files import write_atomic

PATH_WIDTH_IN = 10.6


def compliance_and_gamma(plan: Arrays) -> Figure:
    """The robot's compliance and the depth ratio that follows from it: along the path, and where on the part."""
    fig = figure(PATH_WIDTH_IN, 5.6)
    grid = fig.add_gridspec(2, 2, width_ratios=[1.9, 1.0])
    rows = (
        ("compliance_um_per_n", "Linear equivalent compliance", "compliance (µm/N)", BLUE),
        ("gamma", "Depth ratio gamma (1 = rigid robot)", "gamma (-)", GREEN),
    )
    metres = path_m(plan)
    for row, (key, title, label, colour) in enumerate(rows):
        values = np.asarray(plan[key], dtype=np.float64)
        along = fig.add_subplot(grid[row, 0])
        along.plot(metres, values, color=colour, linewidth=0.7)
        along.set(title=f"{title}, {np.nanmin(values):.3f} to {np.nanmax(values):.3f}", ylabel=label)
        along.set_xlabel("path length (m)")
        along.margins(x=0.01)
        ruled(along)
        scatter(fig.add_subplot(grid[row, 1]), plan, values, label)
    return fig


def dwell(plan: Arrays) -> Figure:
    """Where the time goes: per millimetre of path over the part, and the spread of times about their lower bound."""
    time_s = np.asarray(plan["time_s"], dtype=np.float64)
    lower_s = np.asarray(plan["lower_s"], dtype=np.float64)
    fig = figure(PATH_WIDTH_IN, 3.9)
    grid = fig.add_gridspec(1, 2, width_ratios=[1.0, 1.45])
    where = fig.add_subplot(grid[0, 0])
    scatter(where, plan, time_s, "time per point (s)", percentile=99.5)
    where.set_title(f"Dwell, {time_s.sum():,.0f} s over {time_s.size:,} points")
    spread = fig.add_subplot(grid[0, 1])
    top = max(float(np.percentile(time_s, 99.8)), float(lower_s.max()), 1e-6)
    spread.hist(np.clip(time_s, 0.0, top), bins=70, range=(0.0, top), color=BLUE)
    median = float(np.median(lower_s))
    spread.axvline(median, color=ORANGE, linewidth=1.3, label=f"least time by motion, median {median:.3g} s")
    at_bound = int(np.count_nonzero(time_s <= lower_s * (1 + 1e-9) + 1e-12))
    spread.set(title=f"Spread, {at_bound:,} points at their least time", xlabel="time per point (s)", ylabel="points")
    spread.margins(y=0.16)
    spread.legend(loc="upper right", framealpha=0.85, frameon=True, edgecolor="none")
    ruled(spread)
    return fig


def executed(plan: Arrays, done_s: FloatArray) -> Figure:
    """Executed time against the time that the plan expected, point by point and summed along the path."""
    asked = np.asarray(plan["expected_s"], dtype=np.float64)
    known = np.isfinite(done_s)
    fig = figure(PATH_WIDTH_IN, 3.6)
    grid = fig.add_gridspec(1, 2, width_ratios=[1.0, 1.9])
    each = fig.add_subplot(grid[0, 0])
    top = max(
        float(np.percentile(asked, 99.8)), float(np.percentile(done_s[known], 99.8)) if known.any() else 0.0, 1e-6
    )
    each.plot([0, top], [0, top], color=MUTED, linewidth=1.0, linestyle=(0, (4, 3)))
    each.plot(asked[known], done_s[known], ".", color=BLUE, markersize=2.4, alpha=0.5, markeredgewidth=0)
    each.set(title="Each point", xlabel="expected (s)", ylabel="executed (s)", xlim=(0, top), ylim=(0, top))
    each.set_aspect("equal")
    ruled(each, "both")
    total = fig.add_subplot(grid[0, 1])
    behind = np.cumsum(np.where(known, done_s - asked, 0.0))
    total.axhline(0.0, color=MUTED, linewidth=0.8)
    total.plot(path_m(plan), behind, color=ORANGE, linewidth=1.3)
    done = f"Executed {np.nansum(done_s):,.1f} s of {asked.sum():,.1f} s expected"
    left = int(np.count_nonzero(~known))
    total.set(title=done + (f", {left:,} points not reached" if left else ""), xlabel="path length (m)")
    total.set_ylabel("summed executed - expected (s)")
    total.margins(x=0.01)
    ruled(total)
    return fig


def path_m(plan: Arrays) -> FloatArray:
    """Path length up to the end of each block, in metres, jumps between blocks included, (n,)."""
    start, end = (np.asarray(plan[key], dtype=np.float64) for key in ("start_mm", "end_mm"))
    jumps = np.linalg.norm(start[1:] - end[:-1], axis=1)
    blocks = np.linalg.norm(end - start, axis=1)
    return np.cumsum(blocks + np.concatenate([np.zeros(1), jumps])) / 1000.0


def scatter(ax: Axes, plan: Arrays, values: FloatArray, label: str, *, percentile: float = 100.0) -> None:
    """Values at the middle of each block, seen from above the part."""
    middle = (np.asarray(plan["start_mm"], dtype=np.float64) + np.asarray(plan["end_mm"], dtype=np.float64)) / 2
    low, high = float(np.nanmin(values)), float(np.nanpercentile(values, percentile))
    points = ax.scatter(
        middle[:, 0],
        middle[:, 1],
        c=values,
        s=marker_area(middle),
        marker="s",
        linewidths=0,
        cmap=SEQUENTIAL,
        vmin=low,
        vmax=max(high, low + 1e-9),
    )
    ax.set(xlabel="x (mm)", ylabel="y (mm)")
    ax.set_aspect("equal")
    ax.spines[:].set_visible(False)
    ax.locator_params(nbins=5)
    bar = ax.figure.colorbar(points, ax=ax, aspect=22, pad=0.03, extend="max" if percentile < 100 else "neither")
    bar.set_label(label, color=INK)
    bar.outline.set_visible(False)


def marker_area(middle_mm: FloatArray, panel_pt: float = 175.0) -> float:
    """Area of a marker, in points squared, that about fills the part at this density of points."""
    span = np.ptp(middle_mm[:, :2], axis=0)
    side = max(float(span.max()), 1e-9)
    spacing = np.sqrt(max(float(span[0] * span[1]), 1e-9) / max(len(middle_mm), 1))
    return float(np.clip(1.35 * panel_pt * spacing / side, 0.8, 12.0) ** 2)


# Pictures of surface maps: heights in nm about their mean, white at 0, the clear aperture outlined.

WIDTH_IN = 10.6
HEIGHT_LABEL = "height on the process grid (nm)"


def overview(surfaces: list[tuple[str, ReportSurface]]) -> Figure:
    """All measurements side by side, on the scale of the first."""
    limit = scale_nm(surfaces[0][1])
    columns = max(len(surfaces), 3)
    fig = figure(WIDTH_IN, 0.75 + 0.8 * WIDTH_IN / columns)
    axes = fig.subplots(1, columns, squeeze=False)[0]
    image = None
    for ax, (name, surface) in zip(axes, surfaces, strict=False):
        image = show(ax, surface, surface.levelled(), limit, f"{name}: {surface.rms_nm():.2f} nm RMS")
        if ax is not axes[0]:
            ax.set_ylabel("")
    for ax in axes[len(surfaces) :]:
        ax.set_axis_off()
    if image is not None:
        colour_bar(fig, image, list(axes[: len(surfaces)]))
    return fig


def before_and_after(before: ReportSurface, after: ReportSurface, after_name: str) -> Figure:
    """Two maps on one scale, the second on its own too, and both on the horizontal line through the middle."""
    limit = scale_nm(before)
    fig = figure(WIDTH_IN * 4 / 3, 3.5)
    axes = list(fig.subplots(1, 4))
    show(axes[0], before, before.levelled(), limit, f"Before: {before.rms_nm():.2f} nm RMS")
    image = show(axes[1], after, after.levelled(), limit, f"{after_name}: {after.rms_nm():.2f} nm RMS")
    colour_bar(fig, image, [axes[0], axes[1]])
    own = show(axes[2], after, after.levelled(), scale_nm(after), f"{after_name}, on its own scale")
    colour_bar(fig, own, [axes[2]])
    profiles(axes[3], before, after, after_name)
    return fig


def measured_only(surface: ReportSurface, first: ReportSurface) -> Figure:
    """The last measurement: on the scale of the first, on its own, and the spread of its heights."""
    fig, axes = row_of_three()
    limit, own = scale_nm(first), scale_nm(surface)
    colour_bar(fig, show(axes[0], surface, surface.levelled(), limit, "On the first map's scale"), [axes[0]])
    title = f"On its own scale: {surface.rms_nm():.2f} nm RMS"
    colour_bar(fig, show(axes[1], surface, surface.levelled(), own, title), [axes[1]])
    axes[2].hist(surface.inside(), bins=60, range=(-1.3 * own, 1.3 * own), color=BLUE)
    axes[2].set(title="Heights in the clear aperture", xlabel=HEIGHT_LABEL, ylabel="samples")
    axes[2].set_box_aspect(1)
    ruled(axes[2])
    return fig


def prediction(cycle: Cycle, after: ReportSurface) -> Figure:
    """What the plan said would remain, what was measured, and the difference, on one scale."""
    predicted = residual_of(cycle)
    if predicted.shape != after.height_nm.shape:
        raise ValueError(f"the plan's grid {predicted.shape} is not the next map's {after.height_nm.shape}")
    difference = after.levelled() - after.levelled(predicted)
    limit = max(scale_nm(after), scale_nm(after, predicted))
    fig, axes = row_of_three()
    show(axes[0], after, after.levelled(predicted), limit, f"Predicted: {after.rms_nm(predicted):.2f} nm RMS")
    show(axes[1], after, after.levelled(), limit, f"Measured: {after.rms_nm():.2f} nm RMS")
    title = f"Measured - predicted: {after.rms_nm(difference):.2f} nm RMS"
    colour_bar(fig, show(axes[2], after, difference, limit, title), list(axes))
    return fig


def residual_of(cycle: Cycle) -> FloatArray:
    """The plan's predicted residual; heights where the plan has none stay NaN."""
    if cycle.plan is None:
        raise ValueError("there is no plan")
    return np.where(np.isfinite(cycle.plan["residual_nm"]), cycle.plan["residual_nm"], np.nan).astype(np.float64)


def row_of_three() -> tuple[Figure, list[Axes]]:
    """A figure with three panels."""
    fig = figure(WIDTH_IN, 3.5)
    return fig, list(fig.subplots(1, 3))


def scale_nm(surface: ReportSurface, height_nm: FloatArray | None = None) -> float:
    """Half-width of the colour scale: nearly the largest height in the clear aperture."""
    inside = np.abs(surface.inside(height_nm))
    return max(float(np.percentile(inside, 99.5)), 1e-3) if inside.size else 1.0


def show(ax: Axes, surface: ReportSurface, height_nm: FloatArray, limit_nm: float, title: str) -> AxesImage:
    """One map with the clear aperture outlined."""
    colours = mpl.colormaps[DIVERGING].with_extremes(bad=NO_DATA)
    image = ax.imshow(
        np.ma.masked_invalid(height_nm),
        cmap=colours,
        vmin=-limit_nm,
        vmax=limit_nm,
        extent=surface.extent_mm,
        interpolation="nearest",
    )
    outline(ax, surface)
    ax.set(title=title, xlabel="x (mm)", ylabel="y (mm)")
    ax.spines[:].set_visible(False)
    ax.locator_params(nbins=5)
    return image


def outline(ax: Axes, surface: ReportSurface) -> None:
    """The edge of the clear aperture, as a thin line."""
    mask = np.pad(surface.metric_mask, 1).astype(np.float64)
    if not mask.any():
        return
    left, right, bottom, top = surface.extent_mm
    half = surface.pitch_mm / 2
    x = np.linspace(left - half, right + half, mask.shape[1])
    y = np.linspace(top + half, bottom - half, mask.shape[0])
    ax.contour(x, y, mask, levels=[0.5], colors=INK, linewidths=0.7)
    ax.set_xlim(left, right)
    ax.set_ylim(bottom, top)


def colour_bar(fig: Figure, image: AxesImage, axes: list[Axes], label: str = HEIGHT_LABEL) -> None:
    """A slim scale beside the panels that share it."""
    bar = fig.colorbar(image, ax=axes, shrink=0.85, aspect=26, pad=0.02, extend="both", extendfrac=0.03)
    bar.set_label(label)
    bar.outline.set_visible(False)


def profiles(ax: Axes, before: ReportSurface, after: ReportSurface, after_name: str) -> None:
    """Heights on the row through the middle of the part."""
    for surface, name, colour in ((before, "before", MUTED), (after, after_name.lower(), ORANGE)):
        height = surface.levelled()
        left, right, _, _ = surface.extent_mm
        half = surface.pitch_mm / 2
        x = np.linspace(left + half, right - half, height.shape[1])
        ax.plot(x, height[height.shape[0] // 2], color=colour, label=name, linewidth=1.3)
    ax.set(title="Along x at y = 0", xlabel="x (mm)", ylabel=HEIGHT_LABEL)
    ax.legend(loc="upper right", ncols=2, borderaxespad=0.0)
    ax.margins(x=0, y=0.16)
    ax.set_box_aspect(1)
    ruled(ax)


# Pictures of the whole run: RMS per measurement beside the tolerance, and power spectra.

Rows = list[Mapping[str, Any]]


def rms_per_measurement(rows: Rows, tolerance_nm: float | None, period_mm: float) -> Figure:
    """Measured RMS, what the plan before it predicted, and the tolerance; logarithmic."""
    fig = figure(5.2, 3.7)
    ax = fig.add_subplot()
    judged = "band_rms_nm" if period_mm > 0 else "rms_nm"
    judged_name = f"measured, periods above {period_mm:g} mm" if period_mm > 0 else "measured"
    if period_mm > 0:
        line(ax, rows, "rms_nm", "measured, all periods", color=MUTED, marker="o", markersize=3, linewidth=1.0)
    whole = [{} if interrupted(row) else row for row in rows[:-1]]  # no plan predicted what a part of it leaves
    predicted = [math.nan, *(number(row, "predicted_rms_nm") for row in whole)]
    ax.plot(predicted, "D", color=ORANGE, label="predicted by the plan", markersize=6, fillstyle="none", zorder=4)
    values = line(ax, rows, judged, judged_name, color=BLUE, marker="o", markersize=5, zorder=3)
    for index, value in enumerate(values):
        if math.isfinite(value):
            note = ax.annotate(f"{value:.2f}", (index, value), (6, 5), textcoords="offset points", fontsize=8, zorder=5)
            note.set_path_effects([withStroke(linewidth=2.5, foreground="white")])
    if tolerance_nm is not None and tolerance_nm > 0:
        ax.axhline(
            tolerance_nm, color=GREEN, linewidth=1.2, linestyle=(0, (5, 3)), label=f"tolerance {tolerance_nm:g} nm"
        )
    ax.set(title="RMS in the clear aperture", xlabel="measurement (0 = start)", ylabel="RMS, mean removed (nm)")
    plain_log(ax, "y")
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    ax.set_xlim(-0.25, max(len(rows) - 1, 1) + 0.45)
    ax.margins(y=0.15)
    ax.legend(loc="best")
    ruled(ax)
    return fig


def residual_against_time(curve_s: Any, curve_nm: Any, plan_s: float, plan_nm: float) -> Figure:
    """The least residual for each total time, and where the plan stands."""
    fig = figure(5.2, 3.7)
    ax = fig.add_subplot()
    ax.plot(curve_s, curve_nm, color=BLUE, marker="o", markersize=4, label="least residual in that time")
    ax.plot([plan_s], [plan_nm], "D", color=ORANGE, markersize=7, fillstyle="none", label="this plan")
    ax.set(title="Residual against time", xlabel="total dwell (s)", ylabel="predicted RMS, mean removed (nm)")
    plain_log(ax, "y")
    ax.legend(loc="best")
    ruled(ax)
    return fig


def line(ax: Axes, rows: Rows, key: str, label: str, **look: Any) -> list[float]:
    """Plot one figure of each measurement; returns what was plotted."""
    values = [number(row, key) for row in rows]
    ax.plot(values, label=label, **look)
    return values


def number(row: Mapping[str, Any], key: str) -> float:
    """A positive figure of a row, NaN where there is none."""
    value = row.get(key)
    return float(value) if isinstance(value, int | float) and value > 0 else math.nan


def spectra(surfaces: list[tuple[str, ReportSurface]], lsf_period_mm: float) -> Figure:
    """Radially averaged power spectrum of each measurement: the first grey, the last strong."""
    fig = figure(5.2, 3.7)
    ax = fig.add_subplot()
    shades = mpl.colormaps["Blues"](np.linspace(0.4, 0.95, max(len(surfaces) - 1, 1)))
    colours = [MUTED, *shades]
    for (name, surface), colour in zip(surfaces, colours, strict=False):
        frequency, power = radial_psd(surface.height_nm, surface.metric_mask, surface.pitch_mm)
        ax.plot(frequency, power, color=colour, label=name, linewidth=1.5)
    ax.set_xscale("log")
    ax.set_yscale("log")
    low, high = ax.get_xlim()
    if low < 1 / lsf_period_mm < high:
        ax.axvline(1 / lsf_period_mm, color=MUTED, linewidth=0.9, linestyle=(0, (2, 2)))
    ax.set(title="Power spectrum", xlabel="spatial frequency (1/mm)", ylabel="PSD (nm² mm²)")
    plain_log(ax, "x")
    period = ax.secondary_xaxis("top", functions=(inverse, inverse))
    period.set_xlabel("period (mm)", fontsize=8)
    plain_log(period, "x", scaled=True)
    ax.legend(loc="lower left")
    ruled(ax, "both")
    return fig


def radial_psd(height_nm: FloatArray, mask: BoolArray, pitch_mm: float) -> tuple[FloatArray, FloatArray]:
    """Spatial frequency (1/mm) and ``metrics.radial_psd`` (nm^2 mm^2), its rings gathered to a sixth of an octave each.

    Raises:
        ValueError: fewer than 16 samples.
    """
    valid = mask & np.isfinite(height_nm)
    if np.count_nonzero(valid) < 16:
        raise ValueError("too few samples in the clear aperture for a spectrum")
    psd = metrics_radial_psd(height_nm, valid, pitch_mm, "taper")
    frequency, area = psd.frequency_per_mm, psd.area_per_mm2
    shown = frequency <= 0.5 / pitch_mm  # beyond it, only the corners of the square of frequencies
    band = np.floor(6 * np.log2(frequency[shown] / frequency[0])).astype(np.intp)
    whole = np.bincount(band, area[shown])
    some = whole > 0
    mean_frequency, mean = (
        np.asarray(np.bincount(band, (value * area)[shown])[some] / whole[some], dtype=np.float64)
        for value in (frequency, psd.density_nm2_mm2)
    )
    return mean_frequency, mean


def inverse(value: Any) -> Any:
    """Frequency to period and back; 0 becomes very long, not an error."""
    return 1.0 / np.maximum(np.asarray(value, dtype=np.float64), 1e-12)


def plain_log(ax: Any, axis: str, *, scaled: bool = False) -> None:
    """A logarithmic axis that is labelled 0.5, 1, 2, 5, 10 rather than in powers."""
    if not scaled:
        (ax.set_xscale if axis == "x" else ax.set_yscale)("log")
    side = ax.xaxis if axis == "x" else ax.yaxis
    side.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    side.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    side.set_minor_formatter(NullFormatter())


# The picture of a pass that the gate stopped: what was predicted, what was measured, and what explains it better.


def write_gate(folder: Path) -> None:
    """Draw ``gate.png`` of the ``gate.npz`` and ``gate.json`` in a cycle's folder."""
    with np.load(folder / "gate.npz") as stored:
        arrays = dict(stored)
    verdict = json.loads((folder / "gate.json").read_text())
    with polishd_style():
        write_atomic(folder / "gate.png", png(_draw(arrays, verdict)))


def _draw(arrays: dict[str, Any], verdict: dict[str, Any]) -> Figure:
    """Removal above, what each explanation leaves below, all on the scale of the measured one."""
    mask = arrays["metric_mask"]
    measured = ReportSurface(np.where(mask, arrays["measured_nm"], np.nan), mask, float(arrays["pitch_mm"]))
    limit = scale_nm(measured)
    best = verdict["best"]
    x, y = (round(shift, 1) + 0.0 for shift in best["shift_mm"])  # never -0.0
    page = figure(WIDTH_IN, 0.75 * WIDTH_IN)
    page.suptitle(verdict["stop"], x=0.01, ha="left", wrap=True)
    axes = page.subplots(2, 3)
    panels = (
        ("predicted_nm", f"Predicted removal: correlates {verdict['correlation']:.2f}"),
        ("measured_nm", "Measured removal"),
        ("explained_nm", f"Best: {best['name']}\n{best['correlation']:.2f} at ({x:+.1f}, {y:+.1f}) mm"),
        ("residual_nm", "Measured - predicted"),
        ("best_residual_nm", "Measured - best explanation"),
    )
    places = (axes[0, 0], axes[0, 1], axes[0, 2], axes[1, 0], axes[1, 2])
    images = [
        show(ax, measured, np.where(mask, arrays[key], np.nan), limit, title)
        for (key, title), ax in zip(panels, places, strict=True)
    ]
    axes[1, 1].set_axis_off()
    colour_bar(page, images[0], list(places), "removal (nm)")
    return page
