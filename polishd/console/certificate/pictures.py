"""Pictures of a certificate: before and after on one scale and on their own, both spectra, RMS from map to map."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter

from polishd.console.certificate.model import CertificateMeasurement, CertificatePass, CertificateSurface
from polishd.console.certificate.surfaces import ReconstructedMap
from polishd.model.surface import FloatArray
from polishd.show.sheet import Picture
from polishd.show.style import BLUE, DIVERGING, GREEN, MUTED, NO_DATA, ORANGE, figure, png, polishd_style, ruled

WIDE_IN = 9.0
DPI = 160
SHARE = 99.5
"""Percentile of the heights at which the colours end."""
LEAST_NM = 1e-3


def before_and_after(before: ReconstructedMap, after: ReconstructedMap) -> Picture:
    """Both on the scale of the one before; then each on its own."""
    caption = (
        "Above: both maps on one colour scale, that of the map before. Below: each on its own scale. Red is high; the "
        "colours end at the 99.5th percentile. Grey: outside the clear aperture, or no data. The RMS over each picture "
        "is that of the tables: the same samples, over the same aperture."
    )
    with polishd_style():
        page = figure(WIDE_IN, 8.2)
        axes = page.subplots(2, 2)
        shared = _limit_nm(before.figure_nm)
        for column, (name, found) in enumerate((("Before", before), ("After", after))):
            rms = found.reported.answer["rms_nm"]
            _map(axes[0][column], found, f"{name}: {rms:.2f} nm RMS", shared)
            _map(axes[1][column], found, f"{name}, on its own scale", _limit_nm(found.figure_nm))
        return Picture("maps", caption, png(page, DPI))


def spectra_picture(before: CertificateSurface, after: CertificateSurface) -> Picture | None:
    """Both PSDs; None where a map does not carry it."""
    if before.psd is None or after.psd is None:
        return None
    caption = "Radially averaged two-dimensional PSD of both maps over the clear aperture."
    with polishd_style():
        page = figure(WIDE_IN * 0.7, 3.9)
        ax = page.add_subplot()
        for surface, name, colour in ((before, "before", MUTED), (after, "after", BLUE)):
            if surface.psd is None:
                continue
            frequency, density = (
                np.asarray(values) for values in (surface.psd.frequency_per_mm, surface.psd.density_nm2_mm2)
            )
            some = density > LEAST_NM**2
            ax.loglog(frequency[some], density[some], color=colour, linewidth=1.1, label=name)
        ax.set(xlabel="spatial frequency, 1/mm", ylabel="PSD, nm² mm²")
        ruled(ax, "both")
        ax.legend()
        return Picture("spectra", caption, png(page, DPI), wide=False)


def convergence(
    measured: Sequence[CertificateMeasurement], passes: Sequence[CertificatePass], limit_nm: float | None
) -> Picture:
    """RMS of each map, what was expected of it, and interrupted passes as broken lines."""
    caption = (
        "RMS of each map. Bars: where the map was expected in 9 of 10 cases, as its pass was planned. Dashed: a pass "
        "that was interrupted, for which nothing was expected."
    )
    with polishd_style():
        page = figure(WIDE_IN * 0.8, 3.4)
        ax = page.add_subplot()
        rms = [one.rms_nm for one in measured]
        _steps(ax, measured, passes)
        ax.plot(rms, "o", color=BLUE, label="measured", zorder=3)
        for index, value in enumerate(rms):
            ax.annotate(f"{value:.2f}", (index, value), (6, 5), textcoords="offset points", fontsize=8)
        if limit_nm is not None:
            ax.axhline(limit_nm, color=GREEN, linewidth=1.2, linestyle=(0, (5, 3)), label=f"limit {limit_nm:g} nm")
        ax.set_yscale("log")
        ax.set_xticks(range(len(measured)), [one.name.replace("after an ", "after an\n") for one in measured])
        near = max(rms) < 3 * min(rms)
        ax.yaxis.set_major_locator(MaxNLocator(6, steps=[1, 2, 5, 10]) if near else LogLocator(subs=(1.0, 2.0, 5.0)))
        ax.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
        ax.yaxis.set_minor_formatter(NullFormatter())
        ax.set(ylabel="RMS, nm")
        ax.margins(x=0.08, y=0.15)
        ruled(ax)
        ax.legend(loc="best")
        return Picture("convergence", caption, png(page, DPI))


def _steps(ax: Axes, measured: Sequence[CertificateMeasurement], passes: Sequence[CertificatePass]) -> None:
    """From map to map, and what each whole pass was to leave."""
    by_cycle = {one.cycle: one for one in passes if one.did.how == "done"}
    label: str | None = "expected, 9 of 10"
    for index, (was, now) in enumerate(pairwise(measured)):
        done = by_cycle.get(was.cycle)
        colour, line = (MUTED, "--") if done is None else (BLUE, "-")
        ax.plot([index, index + 1], [was.rms_nm, now.rms_nm], color=colour, linestyle=line, linewidth=1.2)
        if done is None or done.planned.expected_low_nm is None or done.planned.expected_high_nm is None:
            continue
        ends = [done.planned.expected_low_nm, done.planned.expected_high_nm]
        at = [index + 1, index + 1]
        ax.plot(at, ends, color=ORANGE, linewidth=5.0, alpha=0.4, solid_capstyle="butt", label=label)
        label = None


def _limit_nm(height_nm: FloatArray) -> float:
    """Half-width of the colours."""
    inside = np.abs(height_nm[np.isfinite(height_nm)])
    return max(float(np.percentile(inside, SHARE)), LEAST_NM)


def _map(ax: Axes, found: ReconstructedMap, title: str, limit_nm: float) -> None:
    ny, nx = found.figure_nm.shape
    half_x, half_y = nx * found.pitch_mm / 2, ny * found.pitch_mm / 2
    ax.set_facecolor(NO_DATA)
    level = found.figure_nm - np.nanmean(found.figure_nm)
    extent = (-half_x, half_x, -half_y, half_y)
    seen = ax.imshow(level, extent=extent, interpolation="none", cmap=DIVERGING, vmin=-limit_nm, vmax=limit_nm)
    ax.set(title=title, xlabel="x, mm", ylabel="y, mm")
    ax.spines[:].set_visible(False)
    bar = ax.figure.colorbar(seen, ax=ax, shrink=0.85, aspect=24, pad=0.02, extend="both", extendfrac=0.03)
    bar.set_label("nm")
    bar.outline.set_visible(False)
