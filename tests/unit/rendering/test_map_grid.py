"""Maps side by side: legible on paper for parts of any shape, one color scale and one bar for each group."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.figure import Figure

from polishd.rendering.map_grid import MapGroup, MapPanel, map_grid
from polishd.rendering.plots import polishd_style
from tests.unit.rendering.printed import require_legible


def drawn(shape: tuple[int, int], groups: list[int], pitch_mm: float | None = 0.5) -> Figure:
    heights = np.random.default_rng(1).normal(0.0, 5.0, shape)
    edge = np.ones(shape, dtype=bool)
    maps = [[MapPanel(f"After pass {k}, own scale\n18.12 nm RMS", heights, edge) for k in range(n)] for n in groups]
    with polishd_style():
        return map_grid([MapGroup(some, 1.5 / 10**k) for k, some in enumerate(maps)], pitch_mm)


@pytest.mark.parametrize("shape", [(40, 40), (12, 120), (120, 12), (30, 44)], ids=["round", "wide", "tall", "oblong"])
@pytest.mark.parametrize("groups", [[2, 1], pytest.param([1], marks=pytest.mark.full),
                                    pytest.param([5], marks=pytest.mark.full)], ids=str)  # fmt: skip
def test_every_text_is_legible(shape: tuple[int, int], groups: list[int]) -> None:
    with polishd_style():
        require_legible(drawn(shape, groups))


def test_a_group_has_one_scale_and_one_bar_in_nm() -> None:
    fig = drawn((40, 40), [2, 1])
    maps, bars = ([ax for ax in fig.axes if bool(ax.images) is has] for has in (True, False))
    assert [ax.images[0].get_clim()[1] for ax in maps] == [1.5, 1.5, 0.15]
    assert [bar.get_xlabel() for bar in bars] == ["height, nm"] * 2
    assert [ax.get_xlabel() for ax in maps] == ["x, mm"] * 3
    assert maps[0].get_ylabel() == "y, mm"


def test_maps_of_a_slender_part_lie_below_each_other() -> None:
    tops = [ax.get_position().y1 for ax in drawn((12, 120), [2]).axes if ax.images]
    assert tops[0] > tops[1]


def test_a_long_heading_stays_on_the_page() -> None:
    heights = np.zeros((40, 40))
    words = "another orientation explains the map better than the last pass does " * 4
    with polishd_style():
        fig = map_grid([MapGroup([MapPanel("Measured", heights)], 1.0)], 0.5, heading=words)
        require_legible(fig)
    (text,) = fig.texts
    assert text.get_window_extent().x1 < fig.bbox.x1
    assert text.get_window_extent().y0 > fig.axes[0].title.get_window_extent().y1


def test_a_map_without_a_lateral_scale_is_in_pixels() -> None:
    assert drawn((40, 40), [1], None).axes[0].get_xlabel() == "x, px"
