"""Pictures of what varies along the program's path: compliance, gamma, dwell, and executed time."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from polishd.plugins.run_report.folder import Arrays, FloatArray
from polishd.show.style import BLUE, GREEN, INK, MUTED, ORANGE, SEQUENTIAL, figure, ruled

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
