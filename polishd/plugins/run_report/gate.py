"""The picture of a pass that the gate stopped: what was predicted, what was measured, and what explains it better."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from polishd.files import write_atomic
from polishd.plugins.run_report.folder import ReportSurface
from polishd.plugins.run_report.maps import WIDTH_IN, colour_bar, scale_nm, show
from polishd.show.style import figure, png, polishd_style


def write_gate(folder: Path) -> None:
    """Draw ``gate.png`` of the ``gate.npz`` and ``gate.json`` in a cycle's folder."""
    with np.load(folder / "gate.npz") as stored:
        arrays = dict(stored)
    verdict = json.loads((folder / "gate.json").read_text())
    with polishd_style():
        write_atomic(folder / "gate.png", png(_draw(arrays, verdict)))


def _draw(arrays: dict[str, Any], verdict: dict[str, Any]) -> Figure:
    """Removal above, what each explanation leaves below, all on the scale of the measured one."""
    mask = arrays["metric_mask"]
    measured = ReportSurface(np.where(mask, arrays["measured_nm"], np.nan), mask, float(arrays["pitch_mm"]))
    limit = scale_nm(measured)
    best = verdict["best"]
    x, y = (round(shift, 1) + 0.0 for shift in best["shift_mm"])  # never -0.0
    page = figure(WIDTH_IN, 0.75 * WIDTH_IN)
    page.suptitle(verdict["stop"], x=0.01, ha="left", wrap=True)
    axes = page.subplots(2, 3)
    panels = (
        ("predicted_nm", f"Predicted removal: correlates {verdict['correlation']:.2f}"),
        ("measured_nm", "Measured removal"),
        ("explained_nm", f"Best: {best['name']}\n{best['correlation']:.2f} at ({x:+.1f}, {y:+.1f}) mm"),
        ("residual_nm", "Measured - predicted"),
        ("best_residual_nm", "Measured - best explanation"),
    )
    places = (axes[0, 0], axes[0, 1], axes[0, 2], axes[1, 0], axes[1, 2])
    images = [
        show(ax, measured, np.where(mask, arrays[key], np.nan), limit, title)
        for (key, title), ax in zip(panels, places, strict=True)
    ]
    axes[1, 1].set_axis_off()
    colour_bar(page, images[0], list(places), "removal (nm)")
    return page
