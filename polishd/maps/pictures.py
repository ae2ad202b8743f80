"""Pictures of maps: heights, spectrum, histogram and bands of each map; two maps compared; a stitched map."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from polishd.maps.figures import MapFigures
from polishd.maps.map_files import distinguish_names, printable
from polishd.model.surface import BoolArray, FloatArray, SurfaceMap
from polishd.process.metrology.spectra import RadialPsd, radial_psd
from polishd.process.metrology.statistics import remove_terms
from polishd.rendering.map_plots import Spectrum, color_bar, empty_panel, height_map, histogram, spectrum, value_map
from polishd.rendering.plots import BLUE, ORANGE, figure, png, polishd_style, ruled
from polishd.rendering.scales import LEAST_NM, height_limit

PANEL_IN = 2.7
ACROSS = 4
"""Panels side by side; more if a map has more bands."""


def figures_picture(maps: Sequence[MapFigures]) -> bytes:
    """Return a PNG: for each map a row with heights, spectrum and histogram, and a row with its bands."""
    names = distinguish_names(["map" if found.surface.path is None else found.surface.path for found in maps])
    across = max(ACROSS, *(len(found.bands_nm) for found in maps))
    rows = [1 if found.surface.pitch_mm is None else 2 for found in maps]
    with polishd_style():
        page = figure(PANEL_IN * across, (PANEL_IN - 0.1) * sum(rows))
        axes = iter(page.subplots(sum(rows), across, squeeze=False))
        for name, found in zip(names, maps, strict=True):
            _heights(list(next(axes)), found, name)
            if found.surface.pitch_mm is not None:
                _bands(list(next(axes)), found, found.surface.pitch_mm)
        return png(page)


def _heights(row: Sequence[Axes], found: MapFigures, name: str) -> None:
    answer, pitch = found.answer, found.surface.pitch_mm
    whole, level = (_words(answer[f"pv{what}_nm"], answer[f"rms{what}_nm"]) for what in ("", "_tilt_removed"))
    edge = found.surface.valid if found.surface.masks else None
    _panel(row[0], found.surface.height_nm, pitch, f"{_short(name)}\n{whole}", edge=edge)
    _panel(row[1], found.level_nm, pitch, f"tilt removed\n{level}")
    histogram(row[2], found.level_nm[found.mask], "histogram", xlabel="nm, tilt removed")
    if pitch is None:
        empty_panel(row[3], "no lateral scale:\nno bands, no spectrum")
    else:
        edges = [band["to_mm"] for band in answer["bands"] if band["to_mm"] is not None]
        _spectrum(row[3], {"": radial_psd(found.level_nm, found.mask, pitch)}, pitch, edges)
    for ax in row[4:]:
        empty_panel(ax)


def _bands(row: Sequence[Axes], found: MapFigures, pitch_mm: float) -> None:
    for ax, band, record in zip(row, found.bands_nm, found.answer["bands"], strict=False):
        if record["rms_nm"] is None:
            empty_panel(ax, f"{record['name']}\nshorter than two pixels")
        else:
            _panel(ax, band, pitch_mm, f"{record['name']}, {_periods(record)}\nRMS {_nm(record['rms_nm'])}")
    for ax in row[len(found.bands_nm) :]:
        empty_panel(ax)


def _periods(record: Mapping[str, Any]) -> str:
    longest, shortest = record["from_mm"], record["to_mm"]
    if longest is None:
        return f"> {shortest:g} mm"
    return f"< {longest:g} mm" if shortest is None else f"{longest:g} to {shortest:g} mm"


def comparison_picture(
    heights: Mapping[str, FloatArray],
    spectra: Mapping[str, RadialPsd],
    mask: BoolArray,
    pitch_mm: float | None,
    figures: Mapping[str, tuple[float, float]],
) -> bytes:
    """Return a PNG: two maps on the scale of the first, the second and their difference on their own, figures, spectra.

    Args:
        heights: by name, before and after: (ny, nx) nm.
        spectra: by name, of both; none without a lateral scale.
        mask: (ny, nx) samples that count.
        pitch_mm: of the grid; None: no lateral scale.
        figures: by name, before and after, nm; as Table V and fig. 15 of the paper have PV and RMS.
    """
    level = {name: np.where(mask, height - height[mask].mean(), np.nan) for name, height in heights.items()}
    before, after = level.values()
    with polishd_style():
        page = figure(PANEL_IN * (ACROSS + 1), PANEL_IN * 2.2)
        axes = page.subplot_mosaic([["b", "a", "o", "d"], ["f", "f", "p", "p"]])
        for key, (name, height) in zip("ba", level.items(), strict=True):
            _panel(axes[key], height, pitch_mm, f"{name}\n{_pv_rms(height, mask)}", limit_nm=height_limit(before))
        _panel(axes["o"], after, pitch_mm, f"{list(level)[1]}, on its own scale\n{_pv_rms(after, mask)}")
        change = after - before
        _panel(axes["d"], change, pitch_mm, f"after less before\n{_pv_rms(change, mask)}")
        _bars(axes["f"], figures)
        if spectra and pitch_mm is not None:
            _spectrum(axes["p"], spectra, pitch_mm)
        else:
            empty_panel(axes["p"], "no lateral scale")
        return png(page)


def stitch_picture(height_nm: FloatArray, uncertainty_nm: FloatArray, maps: FloatArray, pitch_mm: float) -> bytes:
    """Return a PNG: a stitched map, (ny, nx) nm, without tilt; its uncertainty; the number of maps of each sample."""
    there = np.isfinite(height_nm)
    level = np.where(there, remove_terms(height_nm, there, "tilt"), np.nan)
    with polishd_style():
        page = figure(PANEL_IN * 4.2, PANEL_IN * 1.2)
        axes = page.subplots(1, 3)
        _panel(axes[0], level, pitch_mm, f"stitched, tilt removed\n{_pv_rms(level, there)}")
        worst = float(np.nanmax(uncertainty_nm))
        title = f"uncertainty (1 sigma)\nat most {_nm(worst)}"
        value_map(axes[1], uncertainty_nm, pitch_mm, title, "nm", scale=(0.0, worst or 1.0))
        count = np.where(there, maps, np.nan)
        value_map(axes[2], count, pitch_mm, "maps per sample\n", scale=(0.0, float(np.nanmax(count))))
        return png(page)


def artefact_picture(artefact_nm: FloatArray, seen: SurfaceMap, title: str) -> bytes:
    """Return a PNG: the artefact as expected, (ny, nx) nm, and as measured, on one scale."""
    limit = float(np.abs(artefact_nm).max()) or 1.0
    with polishd_style():
        page = figure(8.4, 3.8)
        axes = page.subplots(1, 2)
        images = []
        for ax, height, name in zip(axes, (artefact_nm, seen.height_nm), ("The artefact", title), strict=True):
            level = remove_terms(height, seen.valid, "tilt")
            level -= np.median(level[seen.valid])
            images.append(height_map(ax, level, seen.grid.pitch_mm, name, limit_nm=limit, bar=False))
        color_bar(images, "nm")
        return png(page)


def _pv_rms(height_nm: FloatArray, mask: BoolArray) -> str:
    return _words(float(np.ptp(height_nm[mask])), float(height_nm[mask].std()))


def _words(pv_nm: float, rms_nm: float) -> str:
    return f"PV {_nm(pv_nm)}, RMS {_nm(rms_nm)}"


def _nm(value_nm: float) -> str:
    return f"{value_nm if value_nm > LEAST_NM else 0.0:.4g} nm"


def _bars(ax: Axes, figures: Mapping[str, tuple[float, float]]) -> None:
    """Draw before and after side by side, on a logarithmic scale if no figure is 0."""
    at = np.arange(len(figures))
    for side, (name, colour) in enumerate((("before", BLUE), ("after", ORANGE))):
        values = [pair[side] for pair in figures.values()]
        ax.bar(at + 0.4 * (side - 0.5), values, 0.38, color=colour, label=name)
    if all(value > 0 for pair in figures.values() for value in pair):
        ax.set_yscale("log")
    ax.set_xticks(at, list(figures), rotation=30)
    ax.set(title="figures", ylabel="nm")
    ruled(ax)


def _spectrum(ax: Axes, spectra: Mapping[str, RadialPsd], pitch_mm: float, edges_mm: Sequence[float] = ()) -> None:
    curves = {name: Spectrum(psd.frequency_per_mm, psd.density_nm2_mm2) for name, psd in spectra.items()}
    spectrum(ax, curves, "PSD", nyquist_per_mm=0.5 / pitch_mm, periods_mm=edges_mm, period_axis=False)


def _panel(
    ax: Axes,
    height_nm: FloatArray,
    pitch_mm: float | None,
    title: str,
    *,
    limit_nm: float | None = None,
    edge: BoolArray | None = None,
) -> None:
    """Draw a map about its mean."""
    height_map(ax, height_nm - np.nanmean(height_nm), pitch_mm, title, limit_nm=limit_nm, edge=edge)
    ax.set_ylabel("")


def _short(name: str) -> str:
    return printable(name) if len(name) <= 24 else f"{name[:10]}...{name[-11:]}"
