"""Pictures of the run report: what varies along the path of a program, maps and spectra of a run."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from polishd.process.metrology.spectra import radial_psd
from polishd.rendering.map_grid import MapGroup, MapPanel, map_grid
from polishd.rendering.map_plots import (
    ConvergenceStep,
    Spectrum,
    histogram,
    path_map,
    plain_log,
)
from polishd.rendering.plots import (
    BLUE,
    GREEN,
    MUTED,
    ORANGE,
    PAGE_IN,
    add_panel,
    page_figure,
    png,
    polishd_style,
    ruled,
)
from polishd.rendering.scales import PERCENTILE, height_limit
from polishd.reports import wording
from polishd.reports.pictures import RIGHT_IN, chart
from polishd.reports.run_reader import Arrays, BoolArray, Cycle, FloatArray, ReportSurface
from polishd.util.files import write_atomic

Rows = Sequence[Mapping[str, Any]]

# Along the path: a map of the values over the part, and a chart beside it.

ROW_IN, SIDE_IN, LEFT_IN, BOTTOM_IN = 2.75, 1.85, 0.58, 0.46
"""Height of a row, side of a map, and room left of it and below it."""
CHART_IN = 4.0
"""Left edge of the chart beside a map."""


def _map_and_chart(fig: Figure, row: int = 0) -> tuple[Axes, Axes, Axes]:
    """Add a row: a square map, its color bar, and a chart. Row 0 is the lowest."""
    bottom_in = row * ROW_IN + BOTTOM_IN
    return (
        add_panel(fig, LEFT_IN, bottom_in, SIDE_IN, SIDE_IN),
        add_panel(fig, LEFT_IN + SIDE_IN + 0.12, bottom_in, 0.1, SIDE_IN),
        add_panel(fig, CHART_IN, bottom_in, PAGE_IN - CHART_IN - RIGHT_IN, SIDE_IN),
    )


def compliance_picture(plan: Arrays) -> Figure:
    """Compliance of the robot and depth ratio: over the part, and along the path."""
    fig = page_figure(2 * ROW_IN)
    rows = (
        ("gamma", "Depth ratio (1 = rigid)", "gamma", GREEN),
        ("compliance_um_per_n", "Compliance, linearized", "µm/N", BLUE),
    )
    for row, (key, title, label, color) in enumerate(rows):
        values = np.asarray(plan[key], dtype=np.float64)
        over, bar, along = _map_and_chart(fig, row)
        path_map(over, _middle_mm(plan), values, title, label, bar=bar)
        along.plot(path_m(plan), values, color=color, linewidth=0.7)
        along.set(title=f"{np.nanmin(values):.3f} to {np.nanmax(values):.3f}", xlabel="path length, m", ylabel=label)
        along.margins(x=0.01)
        ruled(along)
    return fig


def dwell_picture(plan: Arrays) -> Figure:
    """Dwell time over the part, and its distribution above the lower bound."""
    time_s = np.asarray(plan["time_s"], dtype=np.float64)
    lower_s = np.asarray(plan["lower_s"], dtype=np.float64)
    fig = page_figure(ROW_IN)
    over, bar, spread = _map_and_chart(fig)
    title = f"Dwell, {time_s.sum():,.0f} s over {time_s.size:,} points"
    path_map(over, _middle_mm(plan), time_s, title, "time per point, s", percentile=PERCENTILE, bar=bar)
    top = max(float(np.percentile(time_s, PERCENTILE)), float(lower_s.max()), 1e-6)
    at_bound = int(np.count_nonzero(time_s <= lower_s * (1 + 1e-9) + 1e-12))
    title = f"{at_bound:,} points at their lower bound"
    limits = (0.0, top)
    histogram(spread, np.clip(time_s, *limits), title, xlabel="time per point, s", ylabel="points", limits=limits)
    median = float(np.median(lower_s))
    spread.axvline(median, color=ORANGE, linewidth=1.3, label=f"bound, median {median:.3g} s")
    spread.margins(y=0.16)
    spread.legend(loc="upper right", framealpha=0.85, frameon=True, edgecolor="none")
    return fig


def executed_picture(plan: Arrays, executed_s: FloatArray) -> Figure:
    """Executed time against expected time: of each point, and summed along the path."""
    expected_s = np.asarray(plan["expected_s"], dtype=np.float64)
    known = np.isfinite(executed_s)
    fig = page_figure(ROW_IN)
    each = add_panel(fig, LEFT_IN, BOTTOM_IN, SIDE_IN, SIDE_IN)
    total = add_panel(fig, LEFT_IN + SIDE_IN + 0.8, BOTTOM_IN, PAGE_IN - LEFT_IN - SIDE_IN - 0.8 - RIGHT_IN, SIDE_IN)
    ends = [float(np.percentile(times, 99.8)) for times in (expected_s, executed_s[known]) if times.size]
    top = max(*ends, 1e-6)
    each.plot([0, top], [0, top], color=MUTED, linewidth=1.0, linestyle=(0, (4, 3)))
    each.plot(expected_s[known], executed_s[known], ".", color=BLUE, markersize=2.4, alpha=0.5, markeredgewidth=0)
    each.set(title="Each point", xlabel="expected, s", ylabel="executed, s", xlim=(0, top), ylim=(0, top))
    ruled(each, "both")
    total.axhline(0.0, color=MUTED, linewidth=0.8)
    behind_s = np.cumsum(np.where(known, executed_s - expected_s, 0.0))
    total.plot(path_m(plan), behind_s, color=ORANGE, linewidth=1.3)
    missing = int(np.count_nonzero(~known))
    title = f"Executed {np.nansum(executed_s):,.1f} s of {expected_s.sum():,.1f} s expected"
    total.set(title=title + (f",\n{missing:,} points not reached" if missing else ""), xlabel="path length, m")
    total.set_ylabel("executed - expected, sum, s")
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


def trade_off_picture(plan: Arrays, predicted_nm: float) -> Figure:
    """Least residual for each total time, and where the plan lies."""
    fig, ax = chart(2.4)
    ax.plot(plan["curve_s"], plan["curve_nm"], "o-", color=BLUE, markersize=4, label="least residual in that time")
    plan_s = float(plan["time_s"].sum())
    ax.plot([plan_s], [predicted_nm], "D", color=ORANGE, markersize=7, fillstyle="none", label="this plan")
    ax.set(xlabel="total dwell, s", ylabel="predicted RMS, nm", yscale="log")
    plain_log(ax.yaxis)
    ax.legend(loc="best")
    ruled(ax)
    return fig


# Maps: heights about their mean, with the edge of the clear aperture.


def prediction_picture(cycle: Cycle, after: ReportSurface) -> Figure:
    """Residual that the plan predicted, the next map, and their difference, on one scale."""
    predicted = residual_of(cycle)
    if predicted.shape != after.height_nm.shape:
        raise ValueError(f"the plan's grid {predicted.shape} is not the next map's {after.height_nm.shape}")
    difference = after.levelled() - after.levelled(predicted)
    limit_nm = max(height_limit(after.inside()), height_limit(after.inside(predicted)))
    maps = (
        after.named("Predicted", predicted),
        after.named("Measured after"),
        after.named("Measured - predicted", difference),
    )
    return map_grid([MapGroup([one.panel() for one in maps], limit_nm)], after.pitch_mm)


def residual_of(cycle: Cycle) -> FloatArray:
    """Residual that the plan predicted, NaN outside its grid."""
    if cycle.plan is None:
        raise ValueError("there is no plan")
    return np.where(np.isfinite(cycle.plan["residual_nm"]), cycle.plan["residual_nm"], np.nan).astype(np.float64)


# The whole run.


def convergence_steps(rows: Rows, period_mm: float) -> list[ConvergenceStep]:
    """Each measurement with the prediction of the pass before it. Nothing is predicted for an interrupted pass."""
    key = "band_rms_nm" if period_mm > 0 else "rms_nm"
    steps = []
    for index, (before, row) in enumerate(zip([{}, *rows], rows, strict=False)):
        interrupted = wording.interrupted(before)
        plan = {} if interrupted else before
        ends = wording.number(plan, "expected_low_nm"), wording.number(plan, "expected_high_nm")
        steps.append(
            ConvergenceStep(
                name=wording.measurement(rows, index),
                rms_nm=wording.number(row, key),
                predicted_nm=wording.number(plan, "predicted_rms_nm"),
                expected_nm=ends if all(map(math.isfinite, ends)) else None,
                interrupted=interrupted,
                all_periods_nm=wording.number(row, "rms_nm") if period_mm > 0 else math.nan,
            )
        )
    return steps


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
    mask, best = arrays["metric_mask"], result["best"]
    measured = ReportSurface(np.where(mask, arrays["measured_nm"], np.nan), mask, float(arrays["pitch_mm"]))
    x, y = (round(shift, 1) + 0.0 for shift in best["shift_mm"])  # never -0.0
    panels = (
        ("predicted_nm", f"Predicted removal:\ncorrelates {result['correlation']:.2f}"),
        ("measured_nm", "Measured removal"),
        ("explained_nm", f"{best['name']}:\n{best['correlation']:.2f} at ({x:+.1f}, {y:+.1f}) mm"),
        ("residual_nm", "Measured - predicted"),
        ("best_residual_nm", "Measured - best\nexplanation"),
    )
    maps = [MapPanel(title, np.where(mask, arrays[key], np.nan), mask) for key, title in panels]
    return map_grid([MapGroup(maps, height_limit(measured.inside()))], measured.pitch_mm, "removal, nm", result["stop"])
