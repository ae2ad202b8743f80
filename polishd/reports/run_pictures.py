"""Pictures of the run report: maps, convergence, spectra, and what varies along the path of a program."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from polishd.process.metrology.spectra import radial_psd
from polishd.rendering.map_plots import (
    ConvergenceStep,
    Spectrum,
    color_bar,
    convergence,
    empty_panel,
    height_map,
    histogram,
    path_map,
    plain_log,
    profiles,
    spectrum,
)
from polishd.rendering.plots import BLUE, GREEN, MUTED, ORANGE, figure, png, polishd_style, ruled
from polishd.rendering.scales import PERCENTILE, height_limit
from polishd.reports import wording
from polishd.reports.run_reader import Arrays, BoolArray, Cycle, FloatArray, ReportSurface
from polishd.util.files import write_atomic

WIDTH_IN = 10.6
HALF_IN = (5.2, 3.7)
"""Width and height of a picture that takes half the page."""
HEIGHT_LABEL = "height on the process grid, nm"

Rows = Sequence[Mapping[str, Any]]

# Along the path.


def compliance_picture(plan: Arrays) -> Figure:
    """Compliance of the robot and depth ratio: along the path, and over the part."""
    fig = figure(WIDTH_IN, 5.6)
    panels = fig.subplots(2, 2, width_ratios=[1.9, 1.0])
    rows = (
        ("compliance_um_per_n", "Linear equivalent compliance", "compliance, µm/N", BLUE),
        ("gamma", "Depth ratio gamma (1 = rigid robot)", "gamma", GREEN),
    )
    for (along, over), (key, title, label, color) in zip(panels, rows, strict=True):
        values = np.asarray(plan[key], dtype=np.float64)
        along.plot(path_m(plan), values, color=color, linewidth=0.7)
        along.set(title=f"{title}, {np.nanmin(values):.3f} to {np.nanmax(values):.3f}", ylabel=label)
        along.set_xlabel("path length, m")
        along.margins(x=0.01)
        ruled(along)
        path_map(over, _middle_mm(plan), values, "", label)
    return fig


def dwell_picture(plan: Arrays) -> Figure:
    """Dwell time over the part, and its distribution above the lower bound."""
    time_s = np.asarray(plan["time_s"], dtype=np.float64)
    lower_s = np.asarray(plan["lower_s"], dtype=np.float64)
    fig = figure(WIDTH_IN, 3.9)
    over, spread = fig.subplots(1, 2, width_ratios=[1.0, 1.45])
    title = f"Dwell, {time_s.sum():,.0f} s over {time_s.size:,} points"
    path_map(over, _middle_mm(plan), time_s, title, "time per point, s", percentile=PERCENTILE)
    top = max(float(np.percentile(time_s, PERCENTILE)), float(lower_s.max()), 1e-6)
    at_bound = int(np.count_nonzero(time_s <= lower_s * (1 + 1e-9) + 1e-12))
    title = f"Distribution, {at_bound:,} points at their lower bound"
    limits = (0.0, top)
    histogram(spread, np.clip(time_s, *limits), title, xlabel="time per point, s", ylabel="points", limits=limits)
    median = float(np.median(lower_s))
    spread.axvline(median, color=ORANGE, linewidth=1.3, label=f"lower bound by motion, median {median:.3g} s")
    spread.margins(y=0.16)
    spread.legend(loc="upper right", framealpha=0.85, frameon=True, edgecolor="none")
    return fig


def executed_picture(plan: Arrays, executed_s: FloatArray) -> Figure:
    """Executed time against expected time: of each point, and summed along the path."""
    expected_s = np.asarray(plan["expected_s"], dtype=np.float64)
    known = np.isfinite(executed_s)
    fig = figure(WIDTH_IN, 3.6)
    each, total = fig.subplots(1, 2, width_ratios=[1.0, 1.9])
    ends = [float(np.percentile(times, 99.8)) for times in (expected_s, executed_s[known]) if times.size]
    top = max(*ends, 1e-6)
    each.plot([0, top], [0, top], color=MUTED, linewidth=1.0, linestyle=(0, (4, 3)))
    each.plot(expected_s[known], executed_s[known], ".", color=BLUE, markersize=2.4, alpha=0.5, markeredgewidth=0)
    each.set(title="Each point", xlabel="expected, s", ylabel="executed, s", xlim=(0, top), ylim=(0, top))
    each.set_aspect("equal")
    ruled(each, "both")
    total.axhline(0.0, color=MUTED, linewidth=0.8)
    behind_s = np.cumsum(np.where(known, executed_s - expected_s, 0.0))
    total.plot(path_m(plan), behind_s, color=ORANGE, linewidth=1.3)
    title = f"Executed {np.nansum(executed_s):,.1f} s of {expected_s.sum():,.1f} s expected"
    missing = int(np.count_nonzero(~known))
    total.set(title=title + (f", {missing:,} points not reached" if missing else ""), xlabel="path length, m")
    total.set_ylabel("summed executed - expected, s")
    total.margins(x=0.01)
    ruled(total)
    return fig


def path_m(plan: Arrays) -> FloatArray:
    """Path length to the end of each block, with the jumps between blocks, m, (n,)."""
    start, end = (np.asarray(plan[key], dtype=np.float64) for key in ("start_mm", "end_mm"))
    jumps = np.linalg.norm(start[1:] - end[:-1], axis=1)
    blocks = np.linalg.norm(end - start, axis=1)
    return np.cumsum(blocks + np.concatenate([np.zeros(1), jumps])) / 1000.0


def _middle_mm(plan: Arrays) -> FloatArray:
    """Middle of each block, (n, 3)."""
    return (np.asarray(plan["start_mm"], dtype=np.float64) + np.asarray(plan["end_mm"], dtype=np.float64)) / 2


# Surface maps: heights about their mean, with the edge of the clear aperture.


def overview_picture(surfaces: Sequence[tuple[str, ReportSurface]]) -> Figure:
    """All measurements side by side, on the color scale of the first."""
    limit_nm = _limit_nm(surfaces[0][1])
    columns = max(len(surfaces), 3)
    fig = figure(WIDTH_IN, 0.75 + 0.8 * WIDTH_IN / columns)
    axes = fig.subplots(1, columns, squeeze=False)[0]
    images = []
    for ax, (name, surface) in zip(axes, surfaces, strict=False):
        title = f"{name}: {surface.rms_nm():.2f} nm RMS"
        images.append(_show(ax, surface, surface.levelled(), limit_nm, title, bar=False))
        if ax is not axes[0]:
            ax.set_ylabel("")
    for ax in axes[len(surfaces) :]:
        empty_panel(ax)
    color_bar(images, HEIGHT_LABEL)
    return fig


def pass_picture(before: ReportSurface, after: ReportSurface, after_name: str) -> Figure:
    """Maps before and after a pass on one scale, the second on its own scale too, and their profiles along x."""
    limit_nm = _limit_nm(before)
    fig = figure(WIDTH_IN * 4 / 3, 3.5)
    axes = list(fig.subplots(1, 4))
    shared = zip(axes, (("Before", before), (after_name, after)), strict=False)
    color_bar(
        [
            _show(ax, surface, surface.levelled(), limit_nm, f"{name}: {surface.rms_nm():.2f} nm RMS", bar=False)
            for ax, (name, surface) in shared
        ],
        HEIGHT_LABEL,
    )
    _show(axes[2], after, after.levelled(), _limit_nm(after), f"{after_name}, on its own scale")
    lines = {
        name: (surface.x_mm, surface.levelled()[surface.height_nm.shape[0] // 2])
        for name, surface in (("before", before), (after_name.lower(), after))
    }
    profiles(axes[3], lines, "Along x at y = 0", xlabel="x, mm", ylabel=HEIGHT_LABEL, colors=(MUTED, ORANGE))
    axes[3].set_box_aspect(1)
    return fig


def last_map_picture(surface: ReportSurface, first: ReportSurface) -> Figure:
    """The last map on the scale of the first and on its own, and the histogram of its heights."""
    fig = figure(WIDTH_IN, 3.5)
    axes = list(fig.subplots(1, 3))
    own_nm = _limit_nm(surface)
    _show(axes[0], surface, surface.levelled(), _limit_nm(first), "On the first map's scale")
    _show(axes[1], surface, surface.levelled(), own_nm, f"On its own scale: {surface.rms_nm():.2f} nm RMS")
    limits = (-1.3 * own_nm, 1.3 * own_nm)
    histogram(axes[2], surface.inside(), "Heights in the clear aperture", xlabel=HEIGHT_LABEL, limits=limits)
    axes[2].set_box_aspect(1)
    return fig


def prediction_picture(cycle: Cycle, after: ReportSurface) -> Figure:
    """Residual that the plan predicted, the next map, and their difference, on one scale."""
    predicted = residual_of(cycle)
    if predicted.shape != after.height_nm.shape:
        raise ValueError(f"the plan's grid {predicted.shape} is not the next map's {after.height_nm.shape}")
    difference = after.levelled() - after.levelled(predicted)
    limit_nm = max(_limit_nm(after), height_limit(after.inside(predicted)))
    fig = figure(WIDTH_IN, 3.5)
    axes = list(fig.subplots(1, 3))
    panels = (
        ("Predicted", after.levelled(predicted)),
        ("Measured", after.levelled()),
        ("Measured - predicted", difference),
    )
    images = [
        _show(ax, after, height, limit_nm, f"{name}: {after.rms_nm(height):.2f} nm RMS", bar=False)
        for ax, (name, height) in zip(axes, panels, strict=True)
    ]
    color_bar(images, HEIGHT_LABEL)
    return fig


def residual_of(cycle: Cycle) -> FloatArray:
    """Residual that the plan predicted, NaN outside its grid."""
    if cycle.plan is None:
        raise ValueError("there is no plan")
    return np.where(np.isfinite(cycle.plan["residual_nm"]), cycle.plan["residual_nm"], np.nan).astype(np.float64)


def _limit_nm(surface: ReportSurface) -> float:
    return height_limit(surface.inside())


def _show(
    ax: Any, surface: ReportSurface, height_nm: FloatArray, limit_nm: float, title: str, *, bar: bool = True
) -> Any:
    look: dict[str, Any] = {"limit_nm": limit_nm, "edge": surface.metric_mask, "bar": bar}
    return height_map(ax, height_nm, surface.pitch_mm, title, **look)


# The whole run.


def convergence_picture(rows: Rows, limit_nm: float | None, period_mm: float) -> Figure:
    """Measured RMS, what each plan predicted, and the tolerance."""
    fig = figure(*HALF_IN)
    measured = f"measured, periods above {period_mm:g} mm" if period_mm > 0 else "measured"
    convergence(fig.add_subplot(), convergence_steps(rows, period_mm), limit_nm, measured)
    return fig


def convergence_steps(rows: Rows, period_mm: float) -> list[ConvergenceStep]:
    """Each measurement with the prediction of the pass before it. Nothing is predicted for an interrupted pass."""
    key = "band_rms_nm" if period_mm > 0 else "rms_nm"
    steps = []
    for index, (before, row) in enumerate(zip([{}, *rows], rows, strict=False)):
        interrupted = wording.interrupted(before)
        plan = {} if interrupted else before
        ends = number(plan, "expected_low_nm"), number(plan, "expected_high_nm")
        steps.append(
            ConvergenceStep(
                name=wording.measurement(rows, index),
                rms_nm=number(row, key),
                predicted_nm=number(plan, "predicted_rms_nm"),
                expected_nm=ends if all(map(math.isfinite, ends)) else None,
                interrupted=interrupted,
                all_periods_nm=number(row, "rms_nm") if period_mm > 0 else math.nan,
            )
        )
    return steps


def number(row: Mapping[str, Any], key: str) -> float:
    """Positive figure of a row; NaN if there is none."""
    value = row.get(key)
    return float(value) if isinstance(value, int | float) and value > 0 else math.nan


def trade_off_picture(plan: Arrays, predicted_nm: float) -> Figure:
    """Least residual for each total time, and where the plan lies."""
    fig = figure(*HALF_IN)
    ax = fig.add_subplot()
    ax.plot(plan["curve_s"], plan["curve_nm"], "o-", color=BLUE, markersize=4, label="least residual in that time")
    plan_s = float(plan["time_s"].sum())
    ax.plot([plan_s], [predicted_nm], "D", color=ORANGE, markersize=7, fillstyle="none", label="this plan")
    ax.set(title="Residual against time", xlabel="total dwell, s", ylabel="predicted RMS, nm", yscale="log")
    plain_log(ax.yaxis)
    ax.legend(loc="best")
    ruled(ax)
    return fig


def spectra_picture(surfaces: Sequence[tuple[str, ReportSurface]], periods_mm: Sequence[float]) -> Figure:
    """Power spectrum of each measurement: the first gray, the last dark. Periods are marked by dotted lines."""
    fig = figure(*HALF_IN)
    shades = mpl.colormaps["Blues"](np.linspace(0.4, 0.95, max(len(surfaces) - 1, 1)))
    curves = {
        name: smooth_spectrum(surface.height_nm, surface.metric_mask, surface.pitch_mm) for name, surface in surfaces
    }
    spectrum(fig.add_subplot(), curves, periods_mm=periods_mm, colors=[MUTED, *shades])
    return fig


def smooth_spectrum(height_nm: FloatArray, mask: BoolArray, pitch_mm: float) -> Spectrum:
    """Radial PSD up to the Nyquist frequency, averaged over a sixth of an octave.

    Raises:
        ValueError: fewer than 16 samples.
    """
    valid = mask & np.isfinite(height_nm)
    if np.count_nonzero(valid) < 16:
        raise ValueError("too few samples in the clear aperture for a spectrum")
    psd = radial_psd(height_nm, valid, pitch_mm, "taper")
    frequency, area = psd.frequency_per_mm, psd.area_per_mm2
    shown = frequency <= 0.5 / pitch_mm
    band = np.floor(6 * np.log2(frequency[shown] / frequency[0])).astype(np.intp)
    whole = np.bincount(band, area[shown])
    some = whole > 0
    return Spectrum(
        *(
            np.asarray(np.bincount(band, (value * area)[shown])[some] / whole[some], dtype=np.float64)
            for value in (frequency, psd.density_nm2_mm2)
        )
    )


# A pass that the removal check refused.


def write_removal_check(folder: Path) -> None:
    """Draw ``gate.png`` from ``gate.npz`` and ``gate.json`` in the folder of a cycle."""
    with np.load(folder / "gate.npz") as stored:
        arrays = dict(stored)
    result = json.loads((folder / "gate.json").read_text())
    with polishd_style():
        write_atomic(folder / "gate.png", png(_removal_check_picture(arrays, result)))


def _removal_check_picture(arrays: Arrays, result: Mapping[str, Any]) -> Figure:
    """Removal above, residuals below, all on the scale of the measured removal."""
    mask = arrays["metric_mask"]
    measured = ReportSurface(np.where(mask, arrays["measured_nm"], np.nan), mask, float(arrays["pitch_mm"]))
    best = result["best"]
    x, y = (round(shift, 1) + 0.0 for shift in best["shift_mm"])  # never -0.0
    page = figure(WIDTH_IN, 0.75 * WIDTH_IN)
    page.suptitle(result["stop"], x=0.01, ha="left", wrap=True)
    axes = page.subplots(2, 3)
    panels = (
        (axes[0, 0], "predicted_nm", f"Predicted removal: correlates {result['correlation']:.2f}"),
        (axes[0, 1], "measured_nm", "Measured removal"),
        (axes[0, 2], "explained_nm", f"Best: {best['name']}\n{best['correlation']:.2f} at ({x:+.1f}, {y:+.1f}) mm"),
        (axes[1, 0], "residual_nm", "Measured - predicted"),
        (axes[1, 2], "best_residual_nm", "Measured - best explanation"),
    )
    images = [
        _show(ax, measured, np.where(mask, arrays[key], np.nan), _limit_nm(measured), title, bar=False)
        for ax, key, title in panels
    ]
    empty_panel(axes[1, 1])
    color_bar(images, "removal, nm")
    return page
