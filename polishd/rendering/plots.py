"""Style of the plots, with colors that color-blind people can distinguish, and PNG output."""

from __future__ import annotations

import io
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from polishd.model.errors import ConfigError
from polishd.util.files import write_atomic

INK = "#24292f"
MUTED = "#6e7781"
RULE = "#d8dee4"
NO_DATA = "#d3d6da"
# Okabe and Ito's set
BLUE = "#0072b2"
ORANGE = "#d55e00"
GREEN = "#009e73"

DPI = 110
"""Of a picture for the screen."""
PAGE_IN = 6.77
"""Width of a picture of a report: that of A4 between margins. It is printed as large as it is drawn, so that a font of
8 pt has 8 pt on paper."""
PAGE_DPI = 160
"""Of a picture of a report."""

RC: dict[Any, Any] = {
    "font.family": "DejaVu Sans",
    "font.size": 9.0,
    "text.color": INK,
    "axes.edgecolor": MUTED,
    "axes.labelcolor": INK,
    "axes.labelsize": 9.0,
    "axes.linewidth": 0.7,
    "axes.titlelocation": "left",
    "axes.titlesize": 9.5,
    "axes.titleweight": "bold",
    "axes.titlepad": 7.0,
    "axes.titley": 1.0,  # matplotlib does not search a place for it, which takes a tenth of the time of a report
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "grid.color": RULE,
    "grid.linewidth": 0.6,
    "xtick.color": MUTED,
    "ytick.color": MUTED,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "xtick.labelsize": 8.0,
    "ytick.labelsize": 8.0,
    "xtick.major.width": 0.7,
    "ytick.major.width": 0.7,
    "legend.fontsize": 8.0,
    "legend.frameon": False,
    "lines.linewidth": 1.6,
    "figure.facecolor": "white",
    "axes.facecolor": "white",
    "figure.constrained_layout.h_pad": 0.06,
    "figure.constrained_layout.w_pad": 0.06,
    "agg.path.chunksize": 20000,
}


@contextmanager
def polishd_style() -> Iterator[None]:
    """Draw in polishd's style."""
    with mpl.rc_context():
        mpl.rcParams.update(RC)
        yield


def figure(width_in: float, height_in: float) -> Figure:
    """Return an empty figure outside the global state of matplotlib. matplotlib arranges its panels."""
    fig = Figure(figsize=(width_in, height_in), dpi=DPI, layout="constrained")
    FigureCanvasAgg(fig)
    return fig


def page_figure(height_in: float) -> Figure:
    """Return an empty figure for a report, as wide as the page.

    Its panels are placed by ``add_panel``: a layout that matplotlib computes takes half of the time of a report.
    """
    fig = Figure(figsize=(PAGE_IN, height_in), dpi=PAGE_DPI)
    FigureCanvasAgg(fig)
    return fig


def add_panel(fig: Figure, left_in: float, bottom_in: float, width_in: float, height_in: float) -> Axes:
    """Add axes at a place in inches, from the lower left corner of the figure."""
    wide, high = fig.get_size_inches()
    return fig.add_axes((left_in / wide, bottom_in / high, width_in / wide, height_in / high))


def png(fig: Figure) -> bytes:
    """Return the figure as PNG bytes."""
    target = io.BytesIO()
    fig.savefig(target, format="png", dpi="figure", metadata={"Software": None})
    return target.getvalue()


def ruled(axes: Axes, axis: str = "y") -> None:
    """Draw light rules behind the data."""
    if axis in ("x", "both"):
        axes.xaxis.grid(visible=True)
    if axis in ("y", "both"):
        axes.yaxis.grid(visible=True)


def save_picture(path: Path, picture: bytes, option: str = "--out") -> None:
    """Write a PNG; ConfigError if it cannot be written. ``option``: the option that named it."""
    try:
        write_atomic(path, picture)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written: {error.strerror}. Name another file with {option}.") from error
