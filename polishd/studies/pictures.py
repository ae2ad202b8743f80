"""Pictures of studies: maps on one scale, dwell, gamma, spectra and profiles, each as PNG bytes when asked."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from polishd.model.surface import FloatArray, Grid
from polishd.process.metrology.spectra import radial_psd
from polishd.rendering.plots import (
    BLUE,
    DIVERGING,
    GREEN,
    MUTED,
    NO_DATA,
    ORANGE,
    SEQUENTIAL,
    figure,
    png,
    polishd_style,
    ruled,
)
from polishd.studies.case_runner import LoopRows
from polishd.studies.corrections import PLANTS, CorrectionComparison, CorrectionRow
from polishd.studies.spots import READINGS, Passes, SpotRow

Draw = Callable[[], bytes]
PANELS = 4
"""Side by side."""
LOOP_COLOURS = (BLUE, ORANGE, GREEN, MUTED, "#cc79a7", "#e69f00")
COLOURS = (MUTED, BLUE, GREEN, "#cc79a7", "#e69f00", ORANGE)


def of_corrections(compared: CorrectionComparison) -> Mapping[str, Draw]:
    """The setting, a page of residuals for each plant, and their spectra."""
    residuals = {f"residuals_{plant}.png": drawn(_residuals, compared, plant) for plant in PLANTS}
    return {"setting.png": drawn(_setting, compared), **residuals, "psd.png": drawn(_spectra, compared)}


def of_spots(rows: Sequence[SpotRow]) -> Mapping[str, Draw]:
    """Profiles along x and y, a page for each reading of the size."""
    return {
        f"profiles_{reading}.png": drawn(_profiles, [row for row in rows if row.size_is == reading])
        for reading in READINGS
    }


def of_passes(passes: Passes) -> Mapping[str, Draw]:
    """Gamma and removal side by side, and one against the other."""
    return {"passes.png": drawn(_passes, passes)}


def of_loops(looped: LoopRows) -> Mapping[str, Draw]:
    """True RMS over the passes, a panel each scenario, a colour each loop."""
    return {"controllers.png": drawn(_loops, looped)}


def drawn(draw: Callable[..., Figure], *what: object) -> Draw:
    """A picture that is drawn when it is asked for, in polishd's style."""

    def in_style() -> bytes:
        with polishd_style():
            return png(draw(*what))

    return in_style


def _setting(compared: CorrectionComparison) -> Figure:
    """Start, gamma and the exact correction's dwell."""
    page = figure(10.6, 3.6)
    axes = page.subplots(1, 3)
    start, scene = compared.start, compared.scene
    inside = start.height_nm[start.metric_mask]
    title = f"start: {inside.std():.2f} nm RMS"
    _map(axes[0], start.grid, start.height_nm, title, "nm", diverging=True)
    _map(axes[1], scene.lattice, scene.on_lattice(scene.gamma), "gamma along the path")
    _map(axes[2], scene.lattice, scene.on_lattice(compared.time_s["exact"]), "dwell of exact", "s a point")
    return page


def _residuals(compared: CorrectionComparison, plant: str) -> Figure:
    """What each correction leaves, about zero; a scale of its own for each, as they differ by thousands."""
    page = figure(10.6, 6.6)
    rows = [row for row in compared.rows if row.plant == plant]
    for ax, row in zip(page.subplots(2, 3).ravel(), rows, strict=True):
        title = f"{row.correction}: {row.rms_nm:.3g} nm RMS, PV {row.pv_nm:.3g}"
        metric = np.where(compared.start.metric_mask, row.residual_nm, np.nan)
        _map(ax, compared.start.grid, metric, title, "nm", diverging=True)
    return page


def _spectra(compared: CorrectionComparison) -> Figure:
    """Radial spectra of the start and of what each correction leaves on the plant "depth"."""
    page = figure(7.0, 4.4)
    ax = page.subplots()
    start = compared.start
    maps = {"start": (start.height_nm, "black")}
    rows: list[CorrectionRow] = [row for row in compared.rows if row.plant == "depth"]
    maps |= {row.correction: (row.residual_nm, colour) for row, colour in zip(rows, COLOURS, strict=True)}
    for name, (height, colour) in maps.items():
        spectrum = radial_psd(np.where(start.metric_mask, height, 0.0), start.metric_mask, start.grid.pitch_mm)
        dashed = "--" if name == "linear" else "-"  # it lies on pointwise
        seen = spectrum.frequency_per_mm <= 0.5 / start.grid.pitch_mm  # beyond Nyquist: only the square's corners
        ax.loglog(spectrum.frequency_per_mm[seen], spectrum.density_nm2_mm2[seen], dashed, color=colour, label=name)
    ax.set(title="plant depth: spectra", xlabel="frequency, 1/mm", ylabel="PSD, nm2 mm2")
    ax.legend(ncols=2)
    ruled(ax, "both")
    return page


def _profiles(rows: Sequence[SpotRow]) -> Figure:
    """Profiles of each spot through its centre."""
    columns = min(len(rows), 3)
    lines = -(-len(rows) // columns)
    page = figure(3.4 * columns, 2.7 * lines)
    axes = page.subplots(lines, columns, squeeze=False).ravel()
    for ax, row in zip(axes, rows, strict=False):
        spot, figures = row.section, row.figures
        ax.plot(figures.x_mm, figures.profile_x_nm_s, color=BLUE, label="along x")
        ax.plot(figures.y_mm, figures.profile_y_nm_s, color=ORANGE, label="along y")
        title = f"{row.name}: {spot.size_mm:g} mm, {spot.rpm:g} rpm, {spot.force_n:g} N, {spot.dip_deg:g} deg"
        ax.set(title=title, xlabel="mm", ylabel="nm/s", ylim=(0, None))
    for ax in axes[len(rows) :]:
        ax.set_axis_off()
    axes[0].legend()
    return page


def _passes(passes: Passes) -> Figure:
    page = figure(10.6, 3.6)
    axes = page.subplots(1, 3)
    gamma = np.where(passes.metric_mask, passes.gamma, np.nan)
    removal = np.where(passes.metric_mask, passes.removal_nm, np.nan)
    _map(axes[0], passes.grid, gamma, "gamma")
    _map(axes[1], passes.grid, removal, f"removal of {passes.passes} passes", "nm")
    inside = passes.metric_mask
    axes[2].plot(passes.gamma[inside], passes.removal_nm[inside], ".", color=BLUE, markersize=2)
    axes[2].set(title=f"slope of the logarithms {passes.slope:.3f}")
    axes[2].set(xlabel="gamma", ylabel="removal, nm", box_aspect=1)
    ruled(axes[2], "both")
    return page


def _map(ax: Axes, grid: Grid, values: FloatArray, title: str, unit: str = "", *, diverging: bool = False) -> None:
    """A map in mm with its bar; diverging about zero, with a scale that nearly the largest size sets."""
    half_x, half_y = grid.nx * grid.pitch_mm / 2, grid.ny * grid.pitch_mm / 2
    limit = max(float(np.nanpercentile(np.abs(values), 99.5)), 1e-9) if diverging else None
    image = ax.imshow(
        np.ma.masked_invalid(values),
        cmap=mpl.colormaps[DIVERGING if diverging else SEQUENTIAL].with_extremes(bad=NO_DATA),
        vmin=None if limit is None else -limit,
        vmax=limit,
        extent=(-half_x, half_x, -half_y, half_y),
        interpolation="nearest",
    )
    ax.set(title=title, xlabel="x, mm")
    ax.spines[:].set_visible(False)
    bar = ax.figure.colorbar(image, ax=[ax], shrink=0.8, aspect=24, pad=0.02)
    bar.set_label(unit)
    bar.outline.set_visible(False)


def _loops(looped: LoopRows) -> Figure:
    """The part's own RMS at each map: medians, and each job as a thin line."""
    scenarios = list(dict.fromkeys(run.scenario for run in looped.runs))
    loops = list(dict.fromkeys(run.loop for run in looped.runs))
    rows = -(-len(scenarios) // PANELS)
    page = figure(11.0, 2.6 * rows + 0.6)
    panels = page.subplots(rows, PANELS, sharex=True, sharey=True, squeeze=False).ravel()
    for panel in panels[len(scenarios) :]:
        panel.set_visible(False)
    for panel, scenario in zip(panels, scenarios, strict=False):
        panel.set_title(scenario, fontsize=9)
        for colour, loop in zip(LOOP_COLOURS, loops, strict=False):
            mine = [run.true_rms_nm for run in looped.runs if (run.scenario, run.loop) == (scenario, loop)]
            for rms in mine:
                panel.plot(rms, color=colour, alpha=0.2, lw=0.6)
            longest = max((len(rms) for rms in mine), default=0)
            middle = [np.median([rms[min(k, len(rms) - 1)] for rms in mine if rms]) for k in range(longest)]
            panel.plot(middle, color=colour, lw=1.6, label=loop)
        panel.set_yscale("log")
    for panel in panels[::PANELS]:
        panel.set_ylabel("true RMS nm")
    for panel in panels[-PANELS:]:
        panel.set_xlabel("passes")
    panels[0].legend(fontsize=8)
    return page
