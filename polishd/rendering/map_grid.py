"""Height maps of a report beside each other: panels of one size, a color bar in nm for each group of maps."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure
from matplotlib.image import AxesImage

from polishd.model.surface import BoolArray, FloatArray
from polishd.rendering.map_plots import color_bar, height_map
from polishd.rendering.plots import PAGE_IN, add_panel, page_figure

COLUMNS = 3
LEFT_IN, GAP_IN, RIGHT_IN = 0.58, 0.32, 0.16
"""Room for the labels of y, between two panels, and for half of the last label of x."""
TITLE_IN, LABELS_IN, BAR_IN = 0.42, 0.46, 0.54
"""Room for two lines of title above a panel, for the labels of x below it, and for the color bar below those."""
WIDEST_IN, LOWEST_IN, HIGHEST_IN = 2.8, 0.45, 3.2
"""Size of a panel: at most, and its height at least."""
HEADING_LETTERS = 90
"""Of a line of the heading."""
SLENDER = 0.5
"""Height over width of a part below which its maps are drawn below each other."""


class MapPanel(NamedTuple):
    """A map, (ny, nx), its title of at most two lines, and the area whose edge is drawn as a line."""

    title: str
    height_nm: FloatArray
    edge: BoolArray | None = None


class MapGroup(NamedTuple):
    """Maps with one color scale, which ends at ``limit_nm`` on both sides."""

    panels: Sequence[MapPanel]
    limit_nm: float


def map_grid(
    groups: Sequence[MapGroup], pitch_mm: float | None, label: str = "height, nm", heading: str = ""
) -> Figure:
    """Draw groups of maps: x and y in mm, red is high.

    Args:
        groups: the first map decides on the shape of the panels.
        pitch_mm: None: x and y are in pixels.
        label: of the color bars.
        heading: a sentence above the maps.
    """
    ny, nx = groups[0].panels[0].height_nm.shape
    aspect = ny / nx
    count = sum(len(group.panels) for group in groups)
    columns = 1 if aspect < SLENDER else min(count, COLUMNS)
    room_in = PAGE_IN - LEFT_IN - RIGHT_IN - (columns - 1) * GAP_IN
    wide_in = room_in if aspect < SLENDER else min(room_in / columns, WIDEST_IN)
    high_in = float(np.clip(wide_in * aspect, LOWEST_IN, HIGHEST_IN))
    rows = list(_rows(groups, columns))
    last = {group: at for at, row in enumerate(rows) for group, _ in row}
    bars = [at in last.values() for at in range(len(rows))]
    lines = textwrap.wrap(heading, HEADING_LETTERS)
    top_in = sum(TITLE_IN + high_in + LABELS_IN + BAR_IN * bar for bar in bars)
    fig = page_figure(top_in + 0.2 * len(lines))
    fig.text(0.02, 0.99, "\n".join(lines), va="top", parse_math=False)
    images: list[list[AxesImage]] = [[] for _ in groups]
    for at, row in enumerate(rows):
        bottom_in = top_in - TITLE_IN - high_in
        for column, (group, panel) in enumerate(row):
            ax = add_panel(fig, LEFT_IN + column * (wide_in + GAP_IN), bottom_in, wide_in, high_in)
            ax.set_anchor("NW")  # the title of a narrow map has the whole panel
            limit_nm = groups[group].limit_nm
            image = height_map(
                ax, panel.height_nm, pitch_mm, panel.title, limit_nm=limit_nm, edge=panel.edge, bar=False
            )
            images[group].append(image)
            if column:
                ax.set_ylabel("")
                ax.tick_params(labelleft=False)
        for group in dict.fromkeys(group for group, _ in row):
            if last[group] == at:
                places = [column for column, (one, _) in enumerate(row) if one == group]
                left_in = LEFT_IN + places[0] * (wide_in + GAP_IN)
                long_in = len(places) * (wide_in + GAP_IN) - GAP_IN
                bar = add_panel(fig, left_in, bottom_in - LABELS_IN - 0.12, long_in, 0.1)
                color_bar(images[group], label, bar)
        top_in = bottom_in - LABELS_IN - BAR_IN * bars[at]
    return fig


def _rows(groups: Sequence[MapGroup], columns: int) -> Iterator[list[tuple[int, MapPanel]]]:
    """Yield the panels of each row with the index of their group. A group that does not fit begins a row."""
    row: list[tuple[int, MapPanel]] = []
    for index, group in enumerate(groups):
        if row and len(row) + len(group.panels) > columns:
            yield row
            row = []
        for panel in group.panels:
            if len(row) == columns:
                yield row
                row = []
            row.append((index, panel))
    yield row
