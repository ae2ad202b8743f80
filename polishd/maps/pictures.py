"""Pictures of maps: heights, spectrum, histogram and bands of each map; comparison of two maps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import NullFormatter

from polishd.maps.figures import MapFigures
from polishd.maps.map_files import distinguish_names, printable
from polishd.model.surface import BoolArray, FloatArray, SurfaceMap
from polishd.process.metrology.spectra import RadialPsd, radial_psd
from polishd.process.metrology.statistics import remove_terms
from polishd.rendering.plots import (
    BLUE,
    DIVERGING,
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

PANEL_IN = 2.7
ACROSS = 4
"""Panels side by side; more where a map has more bands."""
MOST_PX = 600
"""Most samples of a map along a side of a panel: more are only slower."""
LEAST_NM = 1e-6
"""Heights below this are rounding errors, which are not shown."""


def figures_picture(maps: Sequence[MapFigures]) -> bytes:
    """PNG with two rows for each map: heights, spectrum and histogram; and its bands."""
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
    _panel(row[0], found.surface.height_nm, pitch, f"{_short(name)}\n{whole}")
    if found.surface.masks:
        _outlined(row[0], found.surface.valid)
    _panel(row[1], found.level_nm, pitch, f"tilt removed\n{level}")
    _histogram(row[2], found.level_nm[found.mask])
    if pitch is None:
        _empty(row[3], "no lateral scale:\nno bands, no spectrum")
    else:
        edges = [band["to_mm"] for band in answer["bands"] if band["to_mm"] is not None]
        _spectra(row[3], {"": radial_psd(found.level_nm, found.mask, pitch)}, pitch, edges)
    for ax in row[4:]:
        ax.set_axis_off()


def _bands(row: Sequence[Axes], found: MapFigures, pitch_mm: float) -> None:
    for ax, band, record in zip(row, found.bands_nm, found.answer["bands"], strict=False):
        if record["rms_nm"] is None:
            _empty(ax, f"{record['name']}\nshorter than two pixels")
        else:
            _panel(ax, band, pitch_mm, f"{record['name']}, {_periods(record)}\nRMS {_nm(record['rms_nm'])}")
    for ax in row[len(found.bands_nm) :]:
        ax.set_axis_off()


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
    """PNG of two maps on the first one's scale, the second and the difference on their own; figures and both spectra.

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
            _panel(axes[key], height, pitch_mm, f"{name}\n{_pv_rms(height, mask)}", _limit(before))
        _panel(axes["o"], after, pitch_mm, f"{list(level)[1]}, on its own scale\n{_pv_rms(after, mask)}")
        change = after - before
        _panel(axes["d"], change, pitch_mm, f"after less before\n{_pv_rms(change, mask)}")
        _bars(axes["f"], figures)
        if spectra and pitch_mm is not None:
            _spectra(axes["p"], spectra, pitch_mm)
        else:
            _empty(axes["p"], "no lateral scale")
        return png(page)


def stitch_picture(height_nm: FloatArray, uncertainty_nm: FloatArray, maps: FloatArray, pitch_mm: float) -> bytes:
    """PNG of a stitched map, (ny, nx) nm, without its tilt; its uncertainty; number of maps at each sample."""
    there = np.isfinite(height_nm)
    level = np.where(there, remove_terms(height_nm, there, "tilt"), np.nan)
    with polishd_style():
        page = figure(PANEL_IN * 4.2, PANEL_IN * 1.2)
        axes = page.subplots(1, 3)
        _panel(axes[0], level, pitch_mm, f"stitched, tilt removed\n{_pv_rms(level, there)}")
        worst = float(np.nanmax(uncertainty_nm))
        _amount(axes[1], uncertainty_nm, pitch_mm, f"uncertainty (1 sigma)\nat worst {_nm(worst)}", "nm")
        _amount(axes[2], np.where(there, maps, np.nan), pitch_mm, "maps that have\na sample", "")
        return png(page)


def _amount(ax: Axes, values: FloatArray, pitch_mm: float, title: str, unit: str) -> None:
    """Panel of a quantity that is never negative, from 0 on."""
    ny, nx = values.shape
    step = max(1, int(np.ceil(max(ny, nx) / MOST_PX)))
    half_x, half_y = nx * pitch_mm / 2, ny * pitch_mm / 2
    ax.set_facecolor(NO_DATA)
    extent = (-half_x, half_x, -half_y, half_y)
    seen = ax.imshow(values[::step, ::step], extent=extent, vmin=0.0, cmap=SEQUENTIAL)
    ax.set_title(title, parse_math=False)
    ax.set_xlabel("mm")
    ax.figure.colorbar(seen, ax=ax, shrink=0.8, label=unit)


def artefact_picture(artefact_nm: FloatArray, seen: SurfaceMap, title: str) -> bytes:
    """PNG of the expected and the measured artefact, (ny, nx) nm, on one scale."""
    limit = float(np.abs(artefact_nm).max()) or 1.0
    half_x, half_y = seen.grid.nx * seen.grid.pitch_mm / 2, seen.grid.ny * seen.grid.pitch_mm / 2
    with polishd_style():
        page = figure(8.4, 3.8)
        axes = page.subplots(1, 2)
        for ax, height, words in zip(axes, (artefact_nm, seen.height_nm), ("The artefact", title), strict=True):
            levelled = remove_terms(height, seen.valid, "tilt")
            levelled -= np.median(levelled[seen.valid])
            ax.set_facecolor(NO_DATA)
            ax.imshow(levelled, cmap=DIVERGING, vmin=-limit, vmax=limit, extent=(-half_x, half_x, -half_y, half_y))
            ax.set(title=words, xlabel="x, mm", ylabel="y, mm")
        page.colorbar(axes[0].images[0], ax=list(axes), shrink=0.85, label="nm")
        return png(page)


def _pv_rms(height_nm: FloatArray, mask: BoolArray) -> str:
    return _words(float(np.ptp(height_nm[mask])), float(height_nm[mask].std()))


def _words(pv_nm: float, rms_nm: float) -> str:
    return f"PV {_nm(pv_nm)}, RMS {_nm(rms_nm)}"


def _nm(value_nm: float) -> str:
    return f"{value_nm if value_nm > LEAST_NM else 0.0:.4g} nm"


def _bars(ax: Axes, figures: Mapping[str, tuple[float, float]]) -> None:
    """Figures before and after side by side, on a logarithmic scale where none is 0."""
    at = np.arange(len(figures))
    for side, (name, colour) in enumerate((("before", BLUE), ("after", ORANGE))):
        values = [pair[side] for pair in figures.values()]
        ax.bar(at + 0.4 * (side - 0.5), values, 0.38, color=colour, label=name)
    if all(value > 0 for pair in figures.values() for value in pair):
        ax.set_yscale("log")
    ax.set_xticks(at, list(figures), rotation=30)
    ax.set(title="figures", ylabel="nm")
    ruled(ax)


def _spectra(ax: Axes, spectra: Mapping[str, RadialPsd], pitch_mm: float, edges_mm: Sequence[float] = ()) -> None:
    """Spectra up to Nyquist's frequency: rings beyond it are corners of the square of frequencies."""
    drawn = False
    for (name, psd), colour in zip(spectra.items(), (BLUE, ORANGE), strict=False):
        some = (psd.density_nm2_mm2 > LEAST_NM**2) & (psd.frequency_per_mm <= 0.5 / pitch_mm)
        if some.any():
            drawn = True
            ax.loglog(psd.frequency_per_mm[some], psd.density_nm2_mm2[some], color=colour, label=name, linewidth=1.1)
    if not drawn:
        _empty(ax, "flat: no spectrum")
        return
    ax.set(title="PSD", xlabel="spatial frequency, 1/mm", ylabel="nm$^2$ mm$^2$")
    for axis in (ax.xaxis, ax.yaxis):
        axis.set_minor_formatter(NullFormatter())
    low, high = ax.get_xlim()
    for edge in edges_mm:
        if low < 1 / edge < high:
            ax.axvline(1 / edge, color=MUTED, linestyle=":", linewidth=1.0)
    ruled(ax, "both")
    if len(spectra) > 1:
        ax.legend()


def _panel(ax: Axes, height_nm: FloatArray, pitch_mm: float | None, title: str, limit: float | None = None) -> None:
    """A map about its mean, in mm from its center, or in pixels without a scale."""
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
        ax.set_xticks([-half_x, half_x], [f"{-half_x:.3g}", f"{half_x:.3g}"], rotation=90)
    if ny < nx / 2:
        ax.set_yticks([-half_y, half_y], [f"{-half_y:.3g}", f"{half_y:.3g}"])
    ax.set_xlabel("px" if pitch_mm is None else "mm")
    ax.figure.colorbar(seen, ax=ax, shrink=0.8, label="nm")


def _outlined(ax: Axes, mask: BoolArray) -> None:
    """Draw the edge of the masks as a thin line on a panel."""
    step = max(1, int(np.ceil(max(mask.shape) / MOST_PX)))
    rim = np.pad(mask[::step, ::step].astype(np.float64), 1)
    left, right, bottom, top = ax.images[0].get_extent()
    ny, nx = (n - 2 for n in rim.shape)
    x = left + (np.arange(nx + 2) - 0.5) * (right - left) / nx
    y = top - (np.arange(ny + 2) - 0.5) * (top - bottom) / ny
    ax.contour(x, y, rim, levels=[0.5], colors=[INK], linewidths=0.8)
    ax.set(xlim=(left, right), ylim=(bottom, top))


def _limit(height_nm: FloatArray) -> float:
    """Limit of the color scale: a few spikes do not bleach the rest, and rounding errors have no color."""
    most = float(np.nanpercentile(np.abs(height_nm), 99.8))
    return most if most > LEAST_NM else 1.0


def _histogram(ax: Axes, inside_nm: FloatArray) -> None:
    flat = float(np.abs(inside_nm).max()) <= LEAST_NM
    ax.hist(inside_nm, bins=80, range=(-1.0, 1.0) if flat else None, color=BLUE)
    ax.set(title="histogram", xlabel="nm, tilt removed", ylabel="samples", yticks=[])


def _empty(ax: Axes, words: str) -> None:
    ax.set_axis_off()
    ax.text(0.5, 0.5, words, ha="center", va="center", transform=ax.transAxes)


def _short(name: str) -> str:
    return printable(name) if len(name) <= 24 else f"{name[:10]}...{name[-11:]}"
