"""Pictures of maps: a row each with map, level, bands, spectrum and histogram; and two maps compared."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes

from polishd.console.map_figures import Figured
from polishd.console.map_files import shown
from polishd.model.surface import BoolArray, FloatArray
from polishd.plugins.run_report.style import BLUE, DIVERGING, NO_DATA, ORANGE, figure, png, polishd_style, ruled
from polishd.process import metrics
from polishd.process.metrics import RadialPsd

PANEL_IN = 2.7
MOST_PX = 600
"""Samples of a map that a panel shows along a side: more are only slower."""


def figures_picture(maps: Sequence[Figured]) -> bytes:
    """PNG: a row each."""
    columns = max(len(found.bands_nm) for found in maps) + (4 if any(found.bands_nm for found in maps) else 3)
    with polishd_style():
        page = figure(PANEL_IN * columns, (PANEL_IN - 0.2) * len(maps))
        for row, found in zip(page.subplots(len(maps), columns, squeeze=False), maps, strict=True):
            _row(list(row), found)
        return png(page)


def _row(row: list[Axes], found: Figured) -> None:
    surface, pitch = found.surface, found.surface.pitch_mm
    name = shown("map" if surface.path is None else surface.path.name)
    answer = found.answer
    _panel(row[0], surface.height_nm, pitch, f"{_short(name)}\nRMS {answer['rms_nm']:.4g} nm")
    _panel(row[1], found.level_nm, pitch, f"tilt removed\nRMS {answer['rms_tilt_removed_nm']:.4g} nm")
    _histogram(row[-1], found.level_nm[found.mask])
    for ax, band, record in zip(row[2:], found.bands_nm, answer["bands"] or (), strict=False):
        if record["rms_nm"] is None:
            _empty(ax, f"{record['name']}\nshorter than two pixels")
        else:
            _panel(ax, band, pitch, f"{record['name']}\nRMS {record['rms_nm']:.4g} nm")
    if pitch is not None:
        _spectra(row[-2], {"": metrics.radial_psd(found.level_nm, found.mask, pitch)})
    for ax in row[2:-1] if pitch is None else ():
        _empty(ax, "no lateral scale")


def compared_picture(
    heights: Mapping[str, FloatArray], spectra: Mapping[str, RadialPsd], mask: BoolArray, pitch_mm: float | None
) -> bytes:
    """PNG: before and after on one scale, their difference on its own, and both spectra; (ny, nx) nm each."""
    level = {name: np.where(mask, height - height[mask].mean(), np.nan) for name, height in heights.items()}
    before, after = level.values()
    change = after - before
    limit = _limit(before)
    with polishd_style():
        page = figure(PANEL_IN * 4.2, PANEL_IN)
        row = page.subplots(1, 4)
        for ax, (name, height) in zip(row, level.items(), strict=False):
            _panel(ax, height, pitch_mm, f"{name}\nRMS {height[mask].std():.4g} nm", limit)
        _panel(row[2], change, pitch_mm, f"after less before\nRMS {change[mask].std():.4g} nm")
        if spectra:
            _spectra(row[3], spectra)
        else:
            _empty(row[3], "no lateral scale")
        return png(page)


def _spectra(ax: Axes, spectra: Mapping[str, RadialPsd]) -> None:
    for (name, psd), colour in zip(spectra.items(), (BLUE, ORANGE), strict=False):
        some = psd.density_nm2_mm2 > 0
        if some.any():
            ax.loglog(psd.frequency_per_mm[some], psd.density_nm2_mm2[some], color=colour, label=name, linewidth=1.1)
    ax.set(title="PSD", xlabel="1/mm", ylabel="nm$^2$ mm$^2$")
    ruled(ax, "both")
    if len(spectra) > 1:
        ax.legend()


def _panel(ax: Axes, height_nm: FloatArray, pitch_mm: float | None, title: str, limit: float | None = None) -> None:
    """A map about its mean; in mm from its centre, or in pixels where it has no scale."""
    height = height_nm - np.nanmean(height_nm)
    limit = _limit(height) if limit is None else limit
    ny, nx = height.shape
    step = max(1, int(np.ceil(max(ny, nx) / MOST_PX)))
    half_x, half_y = (n / 2 * (pitch_mm or 1.0) for n in (nx, ny))
    extent = (-half_x, half_x, -half_y, half_y)
    ax.set_facecolor(NO_DATA)
    seen = ax.imshow(height[::step, ::step], extent=extent, cmap=DIVERGING, vmin=-limit, vmax=limit)
    ax.set_title(title, parse_math=False)
    if nx < ny / 2:
        ax.set_xticks([-half_x, half_x], [f"{-half_x:g}", f"{half_x:g}"])
    ax.set_xlabel("px" if pitch_mm is None else "mm")
    ax.figure.colorbar(seen, ax=ax, shrink=0.8, label="nm")


def _limit(height_nm: FloatArray) -> float:
    """Where the colours end: a few spikes do not bleach the rest."""
    return float(np.nanpercentile(np.abs(height_nm), 99.8)) or 1.0


def _histogram(ax: Axes, inside_nm: FloatArray) -> None:
    ax.hist(inside_nm, bins=80, color=BLUE)
    ax.set(title="heights, tilt removed", xlabel="nm", yticks=[])


def _empty(ax: Axes, words: str) -> None:
    ax.set_axis_off()
    ax.text(0.5, 0.5, words, ha="center", va="center", transform=ax.transAxes)


def _short(name: str) -> str:
    return name if len(name) <= 24 else f"{name[:10]}...{name[-11:]}"
