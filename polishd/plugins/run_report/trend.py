"""Pictures of the whole run: RMS per measurement beside the tolerance, and power spectra."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter

from polishd.plugins.run_report.folder import BoolArray, FloatArray, ReportSurface
from polishd.process import metrics
from polishd.show.style import BLUE, GREEN, MUTED, ORANGE, figure, ruled
from polishd.show.words import interrupted

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
    psd = metrics.radial_psd(height_nm, valid, pitch_mm, "taper")
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
