"""The summary of many cases as tables and pictures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from rich.table import Table

from polishd.rendering.map_plots import color_bar
from polishd.rendering.plots import BLUE, DIVERGING, NO_DATA, ORANGE, figure, ruled
from polishd.rendering.terminal import figure_table
from polishd.studies.case_runner import LoopRows
from polishd.studies.pictures import Draw, drawn
from polishd.studies.summary import FIGURES, THIRDS, LabelGroup, MedianInterval, Summary

MOST_KEYS = 12
"""Size of a picture."""


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
