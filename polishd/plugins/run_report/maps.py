"""Pictures of surface maps: heights in nm about their mean, white at 0, the clear aperture outlined."""

from __future__ import annotations

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.image import AxesImage

from polishd.plugins.run_report.folder import Cycle, FloatArray, ReportSurface
from polishd.show.style import BLUE, DIVERGING, INK, MUTED, NO_DATA, ORANGE, figure, ruled

WIDTH_IN = 10.6
HEIGHT_LABEL = "height on the process grid (nm)"


def overview(surfaces: list[tuple[str, ReportSurface]]) -> Figure:
    """All measurements side by side, on the scale of the first."""
    limit = scale_nm(surfaces[0][1])
    columns = max(len(surfaces), 3)
    fig = figure(WIDTH_IN, 0.75 + 0.8 * WIDTH_IN / columns)
    axes = fig.subplots(1, columns, squeeze=False)[0]
    image = None
    for ax, (name, surface) in zip(axes, surfaces, strict=False):
        image = show(ax, surface, surface.levelled(), limit, f"{name}: {surface.rms_nm():.2f} nm RMS")
        if ax is not axes[0]:
            ax.set_ylabel("")
    for ax in axes[len(surfaces) :]:
        ax.set_axis_off()
    if image is not None:
        colour_bar(fig, image, list(axes[: len(surfaces)]))
    return fig


def before_and_after(before: ReportSurface, after: ReportSurface, after_name: str) -> Figure:
    """Two maps on one scale, the second on its own too, and both on the horizontal line through the middle."""
    limit = scale_nm(before)
    fig = figure(WIDTH_IN * 4 / 3, 3.5)
    axes = list(fig.subplots(1, 4))
    show(axes[0], before, before.levelled(), limit, f"Before: {before.rms_nm():.2f} nm RMS")
    image = show(axes[1], after, after.levelled(), limit, f"{after_name}: {after.rms_nm():.2f} nm RMS")
    colour_bar(fig, image, [axes[0], axes[1]])
    own = show(axes[2], after, after.levelled(), scale_nm(after), f"{after_name}, on its own scale")
    colour_bar(fig, own, [axes[2]])
    profiles(axes[3], before, after, after_name)
    return fig


def measured_only(surface: ReportSurface, first: ReportSurface) -> Figure:
    """The last measurement: on the scale of the first, on its own, and the spread of its heights."""
    fig, axes = row_of_three()
    limit, own = scale_nm(first), scale_nm(surface)
    colour_bar(fig, show(axes[0], surface, surface.levelled(), limit, "On the first map's scale"), [axes[0]])
    title = f"On its own scale: {surface.rms_nm():.2f} nm RMS"
    colour_bar(fig, show(axes[1], surface, surface.levelled(), own, title), [axes[1]])
    axes[2].hist(surface.inside(), bins=60, range=(-1.3 * own, 1.3 * own), color=BLUE)
    axes[2].set(title="Heights in the clear aperture", xlabel=HEIGHT_LABEL, ylabel="samples")
    axes[2].set_box_aspect(1)
    ruled(axes[2])
    return fig


def prediction(cycle: Cycle, after: ReportSurface) -> Figure:
    """What the plan said would remain, what was measured, and the difference, on one scale."""
    predicted = residual_of(cycle)
    if predicted.shape != after.height_nm.shape:
        raise ValueError(f"the plan's grid {predicted.shape} is not the next map's {after.height_nm.shape}")
    difference = after.levelled() - after.levelled(predicted)
    limit = max(scale_nm(after), scale_nm(after, predicted))
    fig, axes = row_of_three()
    show(axes[0], after, after.levelled(predicted), limit, f"Predicted: {after.rms_nm(predicted):.2f} nm RMS")
    show(axes[1], after, after.levelled(), limit, f"Measured: {after.rms_nm():.2f} nm RMS")
    title = f"Measured - predicted: {after.rms_nm(difference):.2f} nm RMS"
    colour_bar(fig, show(axes[2], after, difference, limit, title), list(axes))
    return fig


def residual_of(cycle: Cycle) -> FloatArray:
    """The plan's predicted residual; heights where the plan has none stay NaN."""
    if cycle.plan is None:
        raise ValueError("there is no plan")
    return np.where(np.isfinite(cycle.plan["residual_nm"]), cycle.plan["residual_nm"], np.nan).astype(np.float64)


def row_of_three() -> tuple[Figure, list[Axes]]:
    """A figure with three panels."""
    fig = figure(WIDTH_IN, 3.5)
    return fig, list(fig.subplots(1, 3))


def scale_nm(surface: ReportSurface, height_nm: FloatArray | None = None) -> float:
    """Half-width of the colour scale: nearly the largest height in the clear aperture."""
    inside = np.abs(surface.inside(height_nm))
    return max(float(np.percentile(inside, 99.5)), 1e-3) if inside.size else 1.0


def show(ax: Axes, surface: ReportSurface, height_nm: FloatArray, limit_nm: float, title: str) -> AxesImage:
    """One map with the clear aperture outlined."""
    colours = mpl.colormaps[DIVERGING].with_extremes(bad=NO_DATA)
    image = ax.imshow(
        np.ma.masked_invalid(height_nm),
        cmap=colours,
        vmin=-limit_nm,
        vmax=limit_nm,
        extent=surface.extent_mm,
        interpolation="nearest",
    )
    outline(ax, surface)
    ax.set(title=title, xlabel="x (mm)", ylabel="y (mm)")
    ax.spines[:].set_visible(False)
    ax.locator_params(nbins=5)
    return image


def outline(ax: Axes, surface: ReportSurface) -> None:
    """The edge of the clear aperture, as a thin line."""
    mask = np.pad(surface.metric_mask, 1).astype(np.float64)
    if not mask.any():
        return
    left, right, bottom, top = surface.extent_mm
    half = surface.pitch_mm / 2
    x = np.linspace(left - half, right + half, mask.shape[1])
    y = np.linspace(top + half, bottom - half, mask.shape[0])
    ax.contour(x, y, mask, levels=[0.5], colors=INK, linewidths=0.7)
    ax.set_xlim(left, right)
    ax.set_ylim(bottom, top)


def colour_bar(fig: Figure, image: AxesImage, axes: list[Axes], label: str = HEIGHT_LABEL) -> None:
    """A slim scale beside the panels that share it."""
    bar = fig.colorbar(image, ax=axes, shrink=0.85, aspect=26, pad=0.02, extend="both", extendfrac=0.03)
    bar.set_label(label)
    bar.outline.set_visible(False)


def profiles(ax: Axes, before: ReportSurface, after: ReportSurface, after_name: str) -> None:
    """Heights on the row through the middle of the part."""
    for surface, name, colour in ((before, "before", MUTED), (after, after_name.lower(), ORANGE)):
        height = surface.levelled()
        left, right, _, _ = surface.extent_mm
        half = surface.pitch_mm / 2
        x = np.linspace(left + half, right - half, height.shape[1])
        ax.plot(x, height[height.shape[0] // 2], color=colour, label=name, linewidth=1.3)
    ax.set(title="Along x at y = 0", xlabel="x (mm)", ylabel=HEIGHT_LABEL)
    ax.legend(loc="upper right", ncols=2, borderaxespad=0.0)
    ax.margins(x=0, y=0.16)
    ax.set_box_aspect(1)
    ruled(ax)
