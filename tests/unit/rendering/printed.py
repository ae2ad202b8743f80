"""Check that a picture of a report is legible on paper."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.text import Text

from polishd.rendering.plots import PAGE_IN

LEAST_PT = 8.0


def require_legible(fig: Figure) -> None:
    """Require the width of the page, fonts of 8 pt or more in print, and no text that is cut or covered."""
    assert fig.get_size_inches()[0] == PAGE_IN
    fig.draw_without_rendering()
    found = [(ax, text, text.get_window_extent()) for ax in fig.axes for text in texts_of(ax)]
    assert found
    page = fig.bbox
    for _, text, box in found:
        assert float(text.get_fontsize()) >= LEAST_PT, text
        inside = box.x0 >= -1 and box.y0 >= -1 and box.x1 <= page.x1 + 1 and box.y1 <= page.y1 + 1
        assert inside, f"{text.get_text()!r} is cut at the edge"
    for (one, text, a), (other, covered, b) in combinations(found, 2):
        apart = a.x0 > b.x1 or b.x0 > a.x1 or a.y0 > b.y1 or b.y0 > a.y1
        assert one is other or apart, f"{text.get_text()!r} lies over {covered.get_text()!r}"


def texts_of(ax: Axes) -> Iterator[Text]:
    """Yield the texts that are drawn: titles, labels, ticks within the view, notes and legend."""
    axes = (ax, *ax.child_axes) if ax.axison else ()
    texts = [*ax.texts, *(ax.legend_.texts if ax.legend_ else ())]
    for one in axes:
        texts += [one.title, one._left_title, one.xaxis.label, one.yaxis.label]
        ticks = [tick for axis in (one.xaxis, one.yaxis) if axis.get_visible() for tick in axis._update_ticks()]
        texts += [label for tick in ticks for label in (tick.label1, tick.label2)]
    return (text for text in texts if text.get_visible() and text.get_text().strip())
