"""Pictures of the physics: a removal spot with its profiles, the compliance over the workspace and along a program."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes

from polishd.model.surface import FloatArray
from polishd.process.compliance_field import ComplianceField
from polishd.process.spot_figures import SpotFigures
from polishd.show.style import BLUE, NO_DATA, ORANGE, SEQUENTIAL, figure, png, polishd_style

PANEL_IN = 2.9


def spot_picture(figures: SpotFigures, spot: tuple[FloatArray, FloatArray], title: str) -> bytes:
    """PNG: the spot in the tool's frame, and its two profiles; ``spot`` is (m,) mm and (m, m) nm/s, row 0 the top."""
    with polishd_style():
        page = figure(7.6, 3.4)
        left, right = page.subplots(1, 2)
        x, rate = spot
        half = (x[1] - x[0]) / 2
        extent = (x[0] - half, x[-1] + half, x[0] - half, x[-1] + half)
        shown = left.imshow(rate, extent=extent, cmap=SEQUENTIAL)
        left.set(title=title, xlabel="x, mm", ylabel="y (where the spindle leans), mm")
        page.colorbar(shown, ax=left, shrink=0.85, label="nm/s")
        right.plot(figures.x_mm, figures.profile_x_nm_s, color=BLUE, label="along x")
        right.plot(figures.y_mm, figures.profile_y_nm_s, color=ORANGE, label="along y")
        right.set(title="profiles through the centre", xlabel="mm", ylabel="nm/s", ylim=(0, None))
        right.legend()
        return png(page)


def compliance_picture(field: ComplianceField, program: tuple[FloatArray, FloatArray] | None) -> bytes:
    """PNG: a panel for each plane of the workspace; below, compliance and gamma along a program (both (n,))."""
    with polishd_style():
        count = len(field.z_mm)
        page = figure(max(PANEL_IN * count, 6.0), 3.1 * (1 if program is None else 2))
        parts = page.subfigures(1 if program is None else 2, 1, squeeze=False)[:, 0]
        _planes(parts[0], field)
        if program is not None:
            _along(parts[1].subplots(), *program)
        return png(page)


def _planes(part: Any, field: ComplianceField) -> None:
    panels = part.subplots(1, len(field.z_mm), squeeze=False)[0]
    low, high = float(np.nanmin(field.compliance_um_per_n)), float(np.nanmax(field.compliance_um_per_n))
    extent = (field.x_mm[0], field.x_mm[-1], field.y_mm[0], field.y_mm[-1])
    shown = None
    for axes, plane, z in zip(panels, field.compliance_um_per_n, field.z_mm, strict=True):
        axes.set_facecolor(NO_DATA)
        shown = axes.imshow(plane, extent=extent, origin="lower", cmap=SEQUENTIAL, vmin=low, vmax=high)
        axes.set(title=f"z = {z:.0f} mm", xlabel="x, mm")
    panels[0].set_ylabel("y, mm")
    part.colorbar(shown, ax=list(panels), shrink=0.85, label="um/N")


def _along(axes: Axes, compliance_um_per_n: FloatArray, gamma: FloatArray) -> None:
    axes.plot(compliance_um_per_n, color=BLUE)
    axes.set(title="along the program", xlabel="timed point")
    axes.set_ylabel("um/N", color=BLUE)
    other = axes.twinx()
    other.plot(gamma, color=ORANGE)
    other.set_ylabel("gamma", color=ORANGE)
