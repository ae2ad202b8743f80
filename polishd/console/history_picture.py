"""The picture of ``polishd history``: how parts converged, the removal rate, and faults over the weeks."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.dates import AutoDateLocator, ConciseDateFormatter
from matplotlib.ticker import MaxNLocator

from polishd.daemon.history import JobHistory
from polishd.show.style import BLUE, GREEN, MUTED, ORANGE, figure, png, polishd_style, ruled

KINDS, OTHERS = 6, "others"
"""Kinds of faults that have a colour of their own; the rest are one."""
DAY_S = 86400.0
"""Dates are days since 1970, as matplotlib has them."""


def draw(name: str, jobs: Sequence[JobHistory]) -> bytes:
    """A PNG of three panels, one above the other."""
    with polishd_style():
        fig = figure(8.0, 9.0)
        converged, rates, faults = fig.subplots(3, 1)
        _converged(converged, jobs)
        _rates(rates, jobs)
        _faults(faults, jobs)
        fig.suptitle(f"{name}: {len(jobs)} jobs")
        return png(fig)


def _converged(ax: Axes, jobs: Sequence[JobHistory]) -> None:
    """RMS of each part, measurement by measurement: the older ones pale."""
    shades = mpl.colormaps["Blues"](np.linspace(0.3, 0.95, len(jobs)))
    for job, shade in zip(jobs, shades, strict=True):
        good = job.outcome == "in_tolerance"
        figures = [one.rms_nm for one in job.measured]
        ax.plot(figures, color=shade, linewidth=1.0, marker="o", markersize=2.5)
        if figures and job.outcome:
            ax.plot(len(figures) - 1, figures[-1], "o", color=GREEN if good else ORANGE, markersize=5, zorder=3)
    for word, colour in (("in tolerance", GREEN), ("ended otherwise", ORANGE), ("each part, the latest dark", BLUE)):
        ax.plot([], [], "o" if colour != BLUE else "-", color=colour, label=word)
    ax.set(title="Convergence", xlabel="measurement (0 = start)", ylabel="RMS (nm)", yscale="log")
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    ax.legend(loc="best")
    ruled(ax)


def _rates(ax: Axes, jobs: Sequence[JobHistory]) -> None:
    """The removal rate that each pass showed, with its standard error."""
    shown = [(one.at_s / DAY_S, one.rate, one.rate_sigma or 0.0) for job in jobs for one in job.measured if one.rate]
    ax.axhline(1.0, color=MUTED, linewidth=1.0)
    if shown:
        times, rates, errors = np.transpose(shown)
        ax.errorbar(times, rates, errors, fmt="o", color=BLUE, markersize=3, linewidth=1.0)
    ax.set(title="Removal rate", ylabel="relative to the model's own")
    _dated(ax, empty=not shown)
    ruled(ax)


def _faults(ax: Axes, jobs: Sequence[JobHistory]) -> None:
    """What somebody had to see to, a bar a week, the most frequent kinds below."""
    faults = [(fault.kind, _monday(fault.at_s)) for job in jobs for fault in job.faults]
    named = [kind for kind, _ in Counter(kind for kind, _ in faults).most_common(KINDS)]
    counts = Counter((kind if kind in named else OTHERS, week) for kind, week in faults)
    weeks = sorted({week for _, week in counts})
    base = np.zeros(len(weeks))
    for place, kind in enumerate([*named, OTHERS]):
        own = np.array([counts[kind, week] for week in weeks])
        if own.any():
            ax.bar(weeks, own, 6.0, base, label=kind, color=f"C{place}", align="edge")
            base += own
    ax.set(title="Faults a week", ylabel="times")
    ax.yaxis.set_major_locator(MaxNLocator(integer=True))
    _dated(ax, empty=not weeks)
    if weeks:
        ax.legend(loc="best")
    ruled(ax)


def _dated(ax: Axes, *, empty: bool) -> None:
    if empty:
        ax.set_xticks([])
        ax.text(0.5, 0.5, "none", transform=ax.transAxes, ha="center", color=MUTED)
        return
    locator = AutoDateLocator(minticks=2, maxticks=8)  # type: ignore[no-untyped-call]
    ax.xaxis.set_major_locator(locator)
    ax.xaxis.set_major_formatter(ConciseDateFormatter(locator))  # type: ignore[no-untyped-call]


def _monday(at_s: float) -> float:
    """Day number of the week's first day, UTC: day 0 was a Thursday."""
    day = at_s // DAY_S
    return day - (day + 3) % 7
