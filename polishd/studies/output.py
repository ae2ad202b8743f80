"""Tables, sentences and pictures of studies, for people: of single studies, of many cases, and of diagnoses.

Programs read the output of ``--json``. A picture is drawn when it is called.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from rich.table import Table

from polishd.config.study import PassesStudy, SpotsStudy
from polishd.process.metrology.spectra import radial_psd
from polishd.rendering.map_plots import (
    COLORS,
    Spectrum,
    color_bar,
    height_map,
    plain_log,
    profiles,
    spectrum,
    value_map,
)
from polishd.rendering.plots import BLUE, NO_DATA, ORANGE, figure, png, polishd_style, ruled
from polishd.rendering.scales import DIVERGING
from polishd.rendering.terminal import figure_table, key_table
from polishd.studies.case_runner import LoopRow, LoopRows
from polishd.studies.corrections import (
    DIVERGENCE_BASE,
    PLANTS,
    TABLE_IV,
    TABLE_IV_RATIO,
    CorrectionComparison,
    CorrectionRow,
    tie_words,
)
from polishd.studies.path_families import PathComparison
from polishd.studies.spots import READINGS, Passes, SpotRow, shape_words
from polishd.studies.summary import FIGURES, THIRDS, LabelGroup, MedianInterval, Summary

MOST_NOTES = 12
PLANT_WORDS = {"eq49": "plant eq. 49: R0 diag(gamma)", "depth": "plant depth: each point's spot at its own depth"}

MOST_KEYS = 12
"""Size of a picture."""


def correction_tables(title: str, compared: CorrectionComparison) -> list[Table]:
    """Return one table for each plant, the paper's Table IV beside it."""
    return [_correction_table(f"{title}, {PLANT_WORDS[plant]}", compared, plant) for plant in PLANTS]


def _correction_table(title: str, compared: CorrectionComparison, plant: str) -> Table:
    columns = ("correction", "PV nm", "RMS nm", "/ none", "less piston", "LSF nm", "dwell s", "wall s")
    rows = [
        (row.correction, *_correction_cells(row, compared.ratio(plant, row.correction)))
        for row in compared.rows
        if row.plant == plant
    ]
    return figure_table(title, (*columns, "paper PV", "RMS"), rows)


def _correction_cells(row: CorrectionRow, ratio: float) -> list[str]:
    paper = TABLE_IV.get(row.correction)
    return [
        f"{row.pv_nm:.3f}",
        f"{row.rms_nm:.4f}",
        f"{ratio:.4f}",
        f"{row.rms_piston_removed_nm:.4f}",
        f"{row.band_rms_nm:.4f}",
        f"{row.dwell_s:.1f}",
        f"{row.wall_s:.1f}",
        *(("", "") if paper is None else (f"{paper[0]:.2f}", f"{paper[1]:.2f}")),
    ]


def correction_notes(compared: CorrectionComparison) -> list[str]:
    """Return the ties, our ratio beside the paper's, and notes on the solutions."""
    ours = ", ".join(f"{name} {compared.ratio('depth', name):.3g}" for name in ("linear", "power", "exact"))
    return [
        *tie_words(compared),
        f"RMS over that of none, plant depth: {ours}; the paper's Table IV has {TABLE_IV_RATIO:g} for linear",
        "the paper publishes neither its start nor its plant: its rows are printed beside ours, not reproduced",
        *compared.notes,
    ]


def path_table(title: str, compared: PathComparison) -> Table:
    """Return a row for each family and disturbance."""
    columns = ("family", "true", "RMS nm", "low", "MSF", "of first", "forecast", "line", "peak", "s", "mm", "mm/s2")
    rows = [
        (
            row.family,
            row.disturbance,
            f"{row.rms_nm:.2f}",
            f"{row.low_nm:.2f}",
            f"{row.msf_nm:.2f}",
            f"{compared.msf_ratio(row):.2f}",
            f"{row.forecast_nm:.2f}",
            f"{row.line_peak:.3g}",
            f"{row.highest_peak:.3g}",
            f"{row.time_s:.0f}",
            f"{row.path_mm:.0f}",
            f"{row.acceleration_mm_s2:.0f}",
        )
        for row in compared.rows
    ]
    return figure_table(title, columns, rows)


def spot_tables(study: SpotsStudy, rows: tuple[SpotRow, ...]) -> list[Table]:
    """Return one table for each reading of the size, the paper's figures beside ours."""
    return [
        _spot_table(f"{study.title}, {study.seconds:g} s, size = {reading}", [r for r in rows if r.size_is == reading])
        for reading in READINGS
    ]


def _spot_table(title: str, rows: list[SpotRow]) -> Table:
    ours = ("#", "mm", "rpm", "N", "dip", "depth um", "a mm", "peak nm", "mm3", "pole/a", "x", "JSD x-y")
    return figure_table(title, (*ours, "D-PE %", "V-PE %", "JSD"), map(_spot_cells, rows))


def _spot_cells(row: SpotRow) -> list[str]:
    spot, figures = row.section, row.figures
    paper = (spot.paper_depth_error_percent, spot.paper_volume_error_percent, spot.paper_jsd)
    return [
        row.name,
        f"{spot.size_mm:g}",
        f"{spot.rpm:g}",
        f"{spot.force_n:g}",
        f"{spot.dip_deg:g}",
        f"{figures.depth_mm * 1e3:.1f}",
        f"{figures.contact_radius_mm:.3f}",
        f"{row.removal_depth_nm:.0f}",
        f"{row.volume_mm3:.5f}",
        f"{figures.pole_mm / figures.contact_radius_mm:.2f}",
        "M" if figures.m_shaped else "bell",
        f"{row.divergence:.2g}",
        *("" if value is None else f"{value:g}" for value in paper),
    ]


def spot_notes(rows: tuple[SpotRow, ...]) -> list[str]:
    """Explain the columns that could be misread."""
    return [
        *shape_words(rows),
        f"JSD x-y is the Jensen-Shannon divergence of our x profile from our y profile, log base {DIVERGENCE_BASE:g}",
        "D-PE, V-PE and JSD are the paper's, of its measured spots from its own model; it does not state its log base",
        "it prints no depth, volume or profile of a spot: nothing here can be held against those three",
    ]


def passes_table(study: PassesStudy, passes: Passes) -> Table:
    """Return removal and its correlation with gamma."""
    inside = passes.gamma[passes.metric_mask]
    uneven = f"PV {passes.pv_nm:.3f} nm ({passes.pv_nm / passes.mean_nm:.2%}), RMS {passes.rms_nm:.3f} nm"
    rows = [
        ("passes", f"{passes.passes} of {study.dwell_s:g} s at each point"),
        ("gamma", f"{inside.min():.4f} to {inside.max():.4f} over the clear aperture"),
        ("removal", f"mean {passes.mean_nm:.2f} nm, where equal dwell should remove evenly"),
        ("nonuniformity", uneven),
        ("correlation with gamma", f"{passes.correlation:.6f}"),
        ("slope of log removal on log gamma", f"{passes.slope:.4f} (Hertz 1.5; eq. 48-49 take it for 1)"),
    ]
    return key_table(f"{study.title}: equal dwell", rows)


def loop_table(title: str, looped: LoopRows) -> Table:
    """Return one row for each scenario and loop."""
    columns = ("scenario", "loop", "jobs", "accepted", "passes", "after pass 1 nm", "true RMS nm")
    return figure_table(
        title, (*columns, "falsely", "named rightly", "as expected", "CPU s"), map(_loop_cells, looped.rows)
    )


def _loop_cells(row: LoopRow) -> list[str]:
    return [
        row.scenario,
        row.loop,
        str(row.runs),
        str(row.accepted),
        "not reached" if row.passes_median is None else f"{row.passes_median:g}",
        "" if row.first_pass_nm_median is None else f"{row.first_pass_nm_median:.2f}",
        "" if row.true_rms_nm_median is None else f"{row.true_rms_nm_median:.2f}",
        str(row.false_accepts),
        str(row.named_rightly),
        f"{row.held} of {row.forecasts}" if row.forecasts else "",
        f"{row.cpu_s_median:.1f}",
    ]


def _as_forecast(looped: LoopRows) -> str:
    held, of = (sum(getattr(row, name) for row in looped.rows) for name in ("held", "forecasts"))
    return f"{held / of:.0%} of {of}" if of else "none came so far"


def _ripple_note(looped: LoopRows) -> list[str]:
    """Compare the forecast ripple with that of the plants' fine patches."""
    found = [
        (run.ripple_nm, run.ripple_high_nm, run.true_ripple_nm)
        for run in looped.runs
        if run.ripple_nm is not None and run.ripple_high_nm is not None and run.true_ripple_nm is not None
    ]
    if not found:
        return []
    ratio = float(np.median([true / nominal for nominal, _, true in found]))
    within = sum(true <= high for _, high, true in found)
    of_high = f"at most the forecast's 95 % value in {within} of {len(found)} jobs"
    return [f"ripple: the plant's is {ratio:.2f} times the forecast in the median, and {of_high}"]


def loop_notes(looped: LoopRows) -> list[str]:
    """Explain the columns, and list why loops stopped."""
    stopped = {f"{run.scenario}, {run.loop}, seed {run.seed}: {run.why}": None for run in looped.runs if run.why}
    shown = list(stopped)[:MOST_NOTES]
    more = [f"... and {len(stopped) - len(shown)} more that were stopped"] if len(stopped) > len(shown) else []
    return [
        "passes, RMS and CPU are medians; passes count to tolerance, true RMS is the part's own at the job's end",
        "falsely: accepted, and the part itself is out of tolerance; named rightly: what is wrong, and nothing else",
        f"as expected: passes that left what their plan had expected with a chance of 9 in 10 ({_as_forecast(looped)})",
        *_ripple_note(looped),
        *shown,
        *more,
    ]


def error_notes(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return why cases have no figures, and how many of each."""
    why = Counter(str(row["error"]) for row in rows if row.get("error"))
    lines = [f"{count} of them: {words}" for words, count in why.most_common(MOST_NOTES)]
    return [f"{sum(why.values())} of {len(rows)} cases have an error instead of figures:", *lines] if why else []


def summary_tables(title: str, summary: Summary) -> list[Table]:
    """Return groups, paired differences, sensitivity, and shares of failure."""
    figures = FIGURES[summary.kind]
    groups = [
        (
            words(one.label),
            str(one.cases),
            str(one.errors or ""),
            _share(one.share),
            *(_middle(one.figures[name]) for name in figures),
        )
        for one in summary.groups
    ]
    pairs = [
        (words(one.label), one.against, one.figure, str(one.pairs), str(one.lower), str(one.same), str(one.higher),
         _middle(one.difference))
        for one in summary.paired
    ]  # fmt: skip
    found = [figure_table(f"{title}: medians, 95 % intervals", ("of", "cases", "errors", "failed", *figures), groups)]
    if pairs:
        columns = ("of", "less", "figure", "pairs", "lower", "same", "higher", "difference")
        found.append(figure_table(f"{title}: on the same draws", columns, pairs))
    keys = list(dict.fromkeys(one.key for one in summary.sensitivity))
    if keys:
        found += [_sensitivity(title, summary, keys), _fails(title, summary, keys)]
    return found


def summary_pictures(summary: Summary) -> Mapping[str, Draw]:
    """Return medians and shares of failure; with swept keys, sensitivity and shares of failure over their values."""
    found = {"medians.png": drawn(_medians, summary)}
    if summary.sensitivity:
        found |= {"sensitivity.png": drawn(_heat, summary), "fails.png": drawn(_failing, summary)}
    return found


def words(label: Mapping[str, str]) -> str:
    """A label in one cell."""
    return ", ".join(label.values()) or "all"


def short(key: str) -> str:
    """Return the last part of a dotted key."""
    return key.rsplit(".", 1)[-1]


def _sensitivity(title: str, summary: Summary, keys: Sequence[str]) -> Table:
    by = {(words(one.label), one.key): one for one in summary.sensitivity}
    labels = [words(group.label) for group in summary.groups]
    rows = [(label, *(_figure(by[label, key].figure) for key in keys)) for label in labels]
    title = f"{title}: rank correlation of {FIGURES[summary.kind][0]} with"
    return figure_table(title, ("of", *map(short, keys)), rows)


def _fails(title: str, summary: Summary, keys: Sequence[str]) -> Table:
    """Return a row for each label, over the parts of each key's values."""
    rows = []
    for label in (words(group.label) for group in summary.groups):
        mine = [one for one in summary.fails if words(one.label) == label]
        cells = ("  ".join(f"{one.share[0]:.0%}" for one in mine if one.key == key) for key in keys)
        rows.append((label, *cells))
    title = f"{title}: share that fails, from the lowest third of a key to the highest, or by value"
    return figure_table(title, ("of", *map(short, keys)), rows)


def _share(found: tuple[float, float, float]) -> str:
    value, low, high = found
    return f"{value:.1%} ({low:.1%} to {high:.1%})"


def _middle(one: MedianInterval) -> str:
    if one.median is None:
        return "-"
    if one.low is None:
        return _figure(one.median)
    ends = f"{_figure(one.low)} to {'...' if one.high is None else _figure(one.high)}"
    return f"{_figure(one.median)} ({ends})"


def _figure(value: float | None) -> str:
    return "" if value is None else f"{value:.3g}"


def _medians(summary: Summary) -> Figure:
    """Draw a panel for each figure, and one of the share of failure."""
    names = FIGURES[summary.kind]
    page = figure(3.4 * (len(names) + 1) + 1.2, 0.32 * len(summary.groups) + 1.4)
    axes = page.subplots(1, len(names) + 1, sharey=True, squeeze=False)[0]
    place = np.arange(len(summary.groups))
    for ax, name in zip(axes, names, strict=False):
        _bars(ax, place, [_ends(group, name) for group in summary.groups], BLUE)
        ax.set(xlabel=name)
    _bars(axes[-1], place, [group.share for group in summary.groups], ORANGE)
    axes[-1].set(xlabel="share that fails", xlim=(0, 1))
    axes[0].set_yticks(place, [words(group.label) for group in summary.groups])
    axes[0].invert_yaxis()
    return page


def _ends(group: LabelGroup, name: str) -> tuple[float, float, float]:
    one = group.figures[name]
    known = [np.nan if value is None else value for value in (one.median, one.low, one.high)]
    return known[0], known[1], known[2]


def _bars(ax: mpl.axes.Axes, place: np.ndarray, values: Sequence[tuple[float, float, float]], colour: str) -> None:
    middle, low, high = np.array(values, dtype=float).T
    ax.hlines(place, low, high, color=colour, alpha=0.5)
    ax.plot(middle, place, "o", color=colour, markersize=4)
    ruled(ax, "x")


def _heat(summary: Summary) -> Figure:
    keys = list(dict.fromkeys(one.key for one in summary.sensitivity))[:MOST_KEYS]
    groups = [words(group.label) for group in summary.groups]
    by = {(words(one.label), one.key): one.figure for one in summary.sensitivity}
    values = np.array([[by[group, key] for key in keys] for group in groups], dtype=float)
    page = figure(0.9 * len(keys) + 3.4, 0.32 * len(groups) + 2.4)
    ax = page.subplots()
    image = ax.imshow(values, cmap=mpl.colormaps[DIVERGING].with_extremes(bad=NO_DATA), vmin=-1, vmax=1, aspect="auto")
    ax.set_xticks(np.arange(len(keys)), [short(key) for key in keys], rotation=40, ha="right")
    ax.set_yticks(np.arange(len(groups)), groups)
    ax.set(title=f"rank correlation of {FIGURES[summary.kind][0]}")
    for (row, column), value in np.ndenumerate(values):
        if np.isfinite(value):
            ax.text(column, row, f"{value:.2f}", ha="center", va="center", fontsize=7)
    color_bar([image], "")
    return page


def _failing(summary: Summary) -> Figure:
    """Draw a panel for each key: the share of failure over its thirds, a line for each label."""
    keys = list(dict.fromkeys(one.key for one in summary.fails))[:MOST_KEYS]
    columns = min(len(keys), 3)
    lines = -(-len(keys) // columns)
    page = figure(3.6 * columns, 2.5 * lines + 0.6)
    panels = page.subplots(lines, columns, sharey=True, squeeze=False).ravel()
    for ax, key in zip(panels, keys, strict=False):
        wheres = list(dict.fromkeys(one.where for one in summary.fails if one.key == key))
        for group in summary.groups:
            mine = {one.where: one.share[0] for one in summary.fails if one.key == key and one.label == group.label}
            ax.plot(wheres, [mine.get(where, np.nan) for where in wheres], "o-", markersize=3, label=words(group.label))
        ax.set(title=short(key), ylim=(0, 1))
        if tuple(wheres) == THIRDS:
            ax.set_xticks(range(3), ["low", "middle", "high"])
        ruled(ax)
    for ax in panels[len(keys) :]:
        ax.set_visible(False)
    panels[0].set_ylabel("share that fails")
    panels[0].legend(fontsize=6)
    return page


# True causes against the loops' diagnoses: a confusion matrix, on the screen and as a file for the docs.

FILE = "confusion.md"


def confusion_table(title: str, looped: LoopRows) -> Table:
    """A row is a scenario and loop, a column a diagnosis; jobs that ended in an error have none."""
    header, rows = _cells(looped)
    return figure_table(f"{title}: diagnoses", header, rows)


def confusion_page(looped: LoopRows) -> str:
    """Return the same as a table in Markdown."""
    header, rows = _cells(looped)
    lines = [header, ["---"] * len(header), *rows]
    return "".join(f"| {' | '.join(cells)} |\n" for cells in lines)


def _cells(looped: LoopRows) -> tuple[list[str], list[list[str]]]:
    causes = list(dict.fromkeys(name for row in looped.rows for name in row.named))
    causes.sort(key=lambda name: -max(row.named.get(name, 0) for row in looped.rows))
    rows = [
        [
            row.scenario,
            row.loop,
            *(str(row.named[name]) if name in row.named else "" for name in causes),
            f"{row.named_rightly} of {row.runs}",
            f"{100 * row.named_rightly / row.runs:.1f} %",
        ]
        for row in looped.rows
    ]
    return ["wrong is", "loop", *causes, "rightly", "share"], rows


# Pictures: maps, dwell, gamma, spectra, profiles and loops.

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


def of_paths(compared: PathComparison) -> Mapping[str, Draw]:
    """Return the paths, and the spectra with the largest error of the spot's radius."""
    return {"paths.png": drawn(_paths, compared), "path_spectra.png": drawn(_path_spectra, compared)}


def of_loops(looped: LoopRows) -> Mapping[str, Draw]:
    """Return the true RMS over the passes: a panel for each scenario, a color for each loop."""
    return {"controllers.png": drawn(_loops, looped)}


def drawn(draw: Callable[..., Figure], *what: object) -> Draw:
    """Return a function that draws a picture in polishd's style."""

    def in_style() -> bytes:
        with polishd_style():
            return png(draw(*what))

    return in_style


def _paths(compared: PathComparison) -> Figure:
    """Draw the middle of each path."""
    columns = min(len(compared.paths), PANELS)
    lines = -(-len(compared.paths) // columns)
    page = figure(2.7 * columns, 2.8 * lines)
    panels = page.subplots(lines, columns, squeeze=False).ravel()
    for ax, (name, points) in zip(panels, compared.paths.items(), strict=False):
        ax.plot(*points[:, :2].T, color=BLUE, lw=0.4)
        ax.set(title=name, aspect="equal", xlim=compared.shown_mm, ylim=compared.shown_mm)
    for ax in panels[len(compared.paths) :]:
        ax.set_axis_off()
    return page


def _path_spectra(compared: PathComparison) -> Figure:
    page = figure(7.0, 4.4)
    ax = page.subplots()
    curves = {name: Spectrum(one.frequency_per_mm, one.density_nm2_mm2) for name, one in compared.spectra.items()}
    spectrum(ax, curves, f"residual, {compared.spectra_of}", nyquist_per_mm=compared.nyquist_per_mm, colors=COLORS)
    return page


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
