"""Passes of equal dwell against gamma: the paper's fig. 12, in which the spot follows the depth."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from polishd.config.study import PassesStudy, SpotSection, SpotsStudy
from polishd.model.errors import ComputeError
from polishd.model.surface import BoolArray, FloatArray, Grid
from polishd.process.removal.dynamic_tif import tif_at_point
from polishd.process.removal.measured_tif import SpotFigures, profile_divergence, spot_figures
from polishd.studies.corrections import DIVERGENCE_BASE
from polishd.studies.scene import Scene, make_scene


@dataclass(frozen=True, slots=True)
class Passes:
    """Removal by passes of equal dwell; figures over the clear aperture."""

    passes: int
    grid: Grid
    metric_mask: BoolArray = field(repr=False)
    removal_nm: FloatArray = field(repr=False)
    """(ny, nx) after all passes."""
    gamma: FloatArray = field(repr=False)
    """(ny, nx) gamma of the dwell points that reach a sample, each weighted with its rigid spot there."""
    mean_nm: float
    pv_nm: float
    rms_nm: float
    """Of the nonuniformity: mean removed."""
    correlation: float
    """Pearson's, of removal with gamma."""
    slope: float
    """Slope of log removal against log gamma, least squares: 1.5 for a Hertz contact."""
    notes: tuple[str, ...]

    def as_json(self) -> dict[str, Any]:
        """Return the figures, without maps."""
        inside = self.gamma[self.metric_mask]
        plain = ("passes", "mean_nm", "pv_nm", "rms_nm", "correlation", "slope")
        return {
            **{name: getattr(self, name) for name in plain},
            "pv_share": self.pv_nm / self.mean_nm,
            "gamma_min": float(inside.min()),
            "gamma_max": float(inside.max()),
        }


def polish_evenly(study: PassesStudy, report_progress: Callable[[str], None]) -> Passes:
    """Dwell equally long at every point, pass after pass. ConfigError for invalid input."""
    report_progress("compliance along the path")
    scene = make_scene(study)
    report_progress("removing")
    time_s = np.full(scene.program.n, study.dwell_s * study.passes)
    removal = scene.effect(tif_at_point("exact", scene.gamma)).removal_nm(time_s)
    gamma = gamma_map(scene)
    clear = study.outline().contains(*scene.grid.axes_mm, study.part.edge_mm)
    with study.blame("path"):
        correlation, slope = against_gamma(removal[clear], gamma[clear])
    inside = removal[clear]
    return Passes(
        passes=study.passes,
        grid=scene.grid,
        metric_mask=clear,
        removal_nm=removal,
        gamma=gamma,
        mean_nm=float(inside.mean()),
        pv_nm=float(np.ptp(inside)),
        rms_nm=float(inside.std()),
        correlation=correlation,
        slope=slope,
        notes=scene.notes,
    )


def gamma_map(scene: Scene) -> FloatArray:
    """(ny, nx) gamma at the samples: the mean of the points that reach one; NaN without a point."""
    rigid = scene.effect(tif_at_point("none", scene.gamma))
    reach = rigid.removal_nm(np.ones(scene.program.n))
    with np.errstate(invalid="ignore"):
        return np.where(reach > 0, rigid.removal_nm(scene.gamma) / reach, np.nan)


def against_gamma(removal_nm: FloatArray, gamma: FloatArray) -> tuple[float, float]:
    """Correlation of (m,) removals with (m,) gammas, and the slope of their logarithms.

    Raises ComputeError where a sample was not reached, or gamma is the same everywhere.
    """
    if not ((removal_nm > 0).all() and np.isfinite(gamma).all()):
        raise ComputeError("no dwell point reaches some samples of the clear aperture. Set a smaller step_mm")
    if np.ptp(gamma) < 1e-9:
        raise ComputeError(f"gamma is {gamma[0]:.6g} everywhere: no correlation with removal exists")
    slope = np.polyfit(np.log(gamma), np.log(removal_nm), 1)[0]
    return float(np.corrcoef(removal_nm, gamma)[0, 1]), float(slope)


# Spots polished at rest: the rows of the paper's Table III, computed.

READINGS = ("radius", "diameter")
"""Reading of a spot's size; the paper does not define it."""


@dataclass(frozen=True, slots=True)
class SpotRow:
    """One spot, with one reading of its size, after the study's seconds."""

    name: str
    size_is: str
    section: SpotSection = field(repr=False)
    figures: SpotFigures = field(repr=False)
    removal_depth_nm: float
    """Deepest removal."""
    volume_mm3: float
    divergence: float
    """Jensen-Shannon divergence of the computed x profile from the computed y profile, to `DIVERGENCE_BASE`."""

    def as_json(self) -> dict[str, Any]:
        """Return all fields, with the profiles."""
        figures = self.figures
        plain = ("depth_mm", "contact_radius_mm", "peak_pressure_mpa", "peak_nm_s", "volume_mm3_min")
        return {
            "name": self.name,
            "size_is": self.size_is,
            **self.section.model_dump(),
            **{key: getattr(figures, key) for key in (*plain, "dissipative_fraction", "pole_mm", "m_shaped")},
            "removal_depth_nm": self.removal_depth_nm,
            "volume_mm3": self.volume_mm3,
            "jsd_x_y": self.divergence,
            "jsd_base": DIVERGENCE_BASE,
            "profile_x": {"x_mm": figures.x_mm.tolist(), "rate_nm_s": figures.profile_x_nm_s.tolist()},
            "profile_y": {"y_mm": figures.y_mm.tolist(), "rate_nm_s": figures.profile_y_nm_s.tolist()},
        }


def compute_spots(study: SpotsStudy, report_progress: Callable[[str], None]) -> tuple[SpotRow, ...]:
    """Return a row for each spot and reading of its size; ConfigError for an invalid spot."""
    rows = []
    for reading in READINGS:
        for name in study.spots:
            report_progress(f"spot {name}, size is the {reading}")
            with study.blame(f"spots.{name}"):
                rows.append(compute_spot(study, name, reading))
    return tuple(rows)


def compute_spot(study: SpotsStudy, name: str, reading: str) -> SpotRow:
    """Return one row; ``reading`` is the meaning of its size."""
    section = study.spots[name]
    process = replace(
        study.tool_process(),
        tool_radius_mm=section.size_mm / (1 if reading == "radius" else 2),
        **section.model_dump(include={"rpm", "force_n", "dip_deg"}),
    )
    figures = spot_figures(process)
    return SpotRow(
        name=name,
        size_is=reading,
        section=section,
        figures=figures,
        removal_depth_nm=figures.peak_nm_s * study.seconds,
        volume_mm3=figures.volume_mm3_min * study.seconds / 60,
        divergence=profile_divergence(figures.profile_x_nm_s, figures.profile_y_nm_s, DIVERGENCE_BASE),
    )


def shape_words(rows: tuple[SpotRow, ...]) -> list[str]:
    """Name the M-shaped x profiles, one sentence for each reading of the size."""
    words = []
    for reading in READINGS:
        mine = [row for row in rows if row.size_is == reading]
        shaped = [row.name for row in mine if row.figures.m_shaped]
        nearest = min(mine, key=lambda row: row.figures.pole_mm / row.figures.contact_radius_mm)
        share = nearest.figures.pole_mm / nearest.figures.contact_radius_mm
        says = f"the x profile is M-shaped in {', '.join(shaped)}" if shaped else "no x profile is M-shaped"
        words.append(
            f"size = {reading}: {says}; it needs (R - d) tan(dip) < a, and the least is {share:.2f} a ({nearest.name})"
        )
    return words
