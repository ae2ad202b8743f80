"""Pictures of studies: maps, dwell, gamma, spectra, profiles and loops. Each is drawn when it is called."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure

from polishd.process.metrology.spectra import radial_psd
from polishd.rendering.map_plots import COLORS, Spectrum, height_map, plain_log, profiles, spectrum, value_map
from polishd.rendering.plots import BLUE, figure, png, polishd_style, ruled
from polishd.studies.case_runner import LoopRows
from polishd.studies.corrections import PLANTS, CorrectionComparison, CorrectionRow
from polishd.studies.spots import READINGS, Passes, SpotRow

Draw = Callable[[], bytes]
PANELS = 4
"""Panels side by side."""


def of_corrections(compared: CorrectionComparison) -> Mapping[str, Draw]:
    """Return the setting, the residuals of each plant, and the spectra."""
    residuals = {f"residuals_{plant}.png": drawn(_residuals, compared, plant) for plant in PLANTS}
    return {"setting.png": drawn(_setting, compared), **residuals, "psd.png": drawn(_spectra, compared)}


def of_spots(rows: Sequence[SpotRow]) -> Mapping[str, Draw]:
    """Return the profiles along x and y, a page for each meaning of the spot size."""
    return {
        f"profiles_{reading}.png": drawn(_profiles, [row for row in rows if row.size_is == reading])
        for reading in READINGS
    }


def of_passes(passes: Passes) -> Mapping[str, Draw]:
    """Return gamma and removal side by side, and removal against gamma."""
    return {"passes.png": drawn(_passes, passes)}


def of_loops(looped: LoopRows) -> Mapping[str, Draw]:
    """Return the true RMS over the passes: a panel for each scenario, a color for each loop."""
    return {"controllers.png": drawn(_loops, looped)}


def drawn(draw: Callable[..., Figure], *what: object) -> Draw:
    """Return a function that draws a picture in polishd's style."""

    def in_style() -> bytes:
        with polishd_style():
            return png(draw(*what))

    return in_style


def _setting(compared: CorrectionComparison) -> Figure:
    """Draw start, gamma and the dwell of the exact correction."""
    page = figure(10.6, 3.6)
    axes = page.subplots(1, 3)
    start, scene = compared.start, compared.scene
    inside = start.height_nm[start.metric_mask]
    title = f"start: {inside.std():.2f} nm RMS"
    height_map(axes[0], start.height_nm, start.grid.pitch_mm, title)
    pitch_mm = scene.lattice.pitch_mm
    value_map(axes[1], scene.on_lattice(scene.gamma), pitch_mm, "gamma along the path")
    value_map(axes[2], scene.on_lattice(compared.time_s["exact"]), pitch_mm, "dwell of exact", "s a point")
    return page


def _residuals(compared: CorrectionComparison, plant: str) -> Figure:
    """Draw the residual of each correction, each on its own scale: they differ by factors of thousands."""
    page = figure(10.6, 6.6)
    rows = [row for row in compared.rows if row.plant == plant]
    for ax, row in zip(page.subplots(2, 3).ravel(), rows, strict=True):
        title = f"{row.correction}: {row.rms_nm:.3g} nm RMS, PV {row.pv_nm:.3g}"
        metric = np.where(compared.start.metric_mask, row.residual_nm, np.nan)
        height_map(ax, metric, compared.start.grid.pitch_mm, title)
    return page


def _spectra(compared: CorrectionComparison) -> Figure:
    """Draw the spectra of the start and of the residual of each correction, for the plant "depth"."""
    page = figure(7.0, 4.4)
    start = compared.start
    rows: list[CorrectionRow] = [row for row in compared.rows if row.plant == "depth"]
    curves = {}
    for name, height in {"start": start.height_nm, **{row.correction: row.residual_nm for row in rows}}.items():
        psd = radial_psd(np.where(start.metric_mask, height, 0.0), start.metric_mask, start.grid.pitch_mm)
        curves[name] = Spectrum(psd.frequency_per_mm, psd.density_nm2_mm2)
    ax = page.subplots()
    nyquist_per_mm = 0.5 / start.grid.pitch_mm
    spectrum(ax, curves, "plant depth: spectra", nyquist_per_mm=nyquist_per_mm, colors=("black", *COLORS))
    for line in ax.lines:
        if line.get_label() == "linear":  # the same as pointwise
            line.set_linestyle("--")
    return page


def _profiles(rows: Sequence[SpotRow]) -> Figure:
    """Draw the profiles of each spot through its center."""
    columns = min(len(rows), 3)
    lines = -(-len(rows) // columns)
    page = figure(3.4 * columns, 2.7 * lines)
    axes = page.subplots(lines, columns, squeeze=False).ravel()
    for ax, row in zip(axes, rows, strict=False):
        spot, figures = row.section, row.figures
        lines_of = {
            "along x": (figures.x_mm, figures.profile_x_nm_s),
            "along y": (figures.y_mm, figures.profile_y_nm_s),
        }
        title = f"{row.name}: {spot.size_mm:g} mm, {spot.rpm:g} rpm, {spot.force_n:g} N, {spot.dip_deg:g} deg"
        profiles(ax, lines_of, title, ylabel="nm/s")
        ax.set_ylim(0, None)
    for ax in axes[len(rows) :]:
        ax.set_axis_off()
    return page


def _passes(passes: Passes) -> Figure:
    page = figure(10.6, 3.6)
    axes = page.subplots(1, 3)
    gamma = np.where(passes.metric_mask, passes.gamma, np.nan)
    removal = np.where(passes.metric_mask, passes.removal_nm, np.nan)
    pitch_mm = passes.grid.pitch_mm
    value_map(axes[0], gamma, pitch_mm, "gamma")
    value_map(axes[1], removal, pitch_mm, f"removal of {passes.passes} passes", "nm")
    inside = passes.metric_mask
    axes[2].plot(passes.gamma[inside], passes.removal_nm[inside], ".", color=BLUE, markersize=2)
    axes[2].set(title=f"slope of the logarithms {passes.slope:.3f}")
    axes[2].set(xlabel="gamma", ylabel="removal, nm", box_aspect=1)
    ruled(axes[2], "both")
    return page


def _loops(looped: LoopRows) -> Figure:
    """Draw the true RMS at each map: the median as a thick line, each job as a thin line."""
    scenarios = list(dict.fromkeys(run.scenario for run in looped.runs))
    loops = list(dict.fromkeys(run.loop for run in looped.runs))
    rows = -(-len(scenarios) // PANELS)
    page = figure(11.0, 2.6 * rows + 0.6)
    panels = page.subplots(rows, PANELS, sharex=True, sharey=True, squeeze=False).ravel()
    for panel in panels[len(scenarios) :]:
        panel.set_visible(False)
    for panel, scenario in zip(panels, scenarios, strict=False):
        panel.set_title(scenario, fontsize=9)
        for color, loop in zip(COLORS, loops, strict=False):
            mine = [run.true_rms_nm for run in looped.runs if (run.scenario, run.loop) == (scenario, loop)]
            for rms in mine:
                panel.plot(rms, color=color, alpha=0.2, lw=0.6)
            longest = max((len(rms) for rms in mine), default=0)
            middle = [np.median([rms[min(k, len(rms) - 1)] for rms in mine if rms]) for k in range(longest)]
            panel.plot(middle, color=color, lw=1.6, label=loop)
        panel.set_yscale("log")
        plain_log(panel.yaxis)
    for panel in panels[::PANELS]:
        panel.set_ylabel("true RMS nm")
    for panel in panels[-PANELS:]:
        panel.set_xlabel("passes")
    panels[0].legend(fontsize=8)
    return page
