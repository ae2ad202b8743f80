"""Passes of equal dwell against gamma: the paper's fig. 12, where the spot follows the depth."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from polishd.config.study import PassesStudy
from polishd.model.errors import ComputeError
from polishd.model.surface import BoolArray, FloatArray, Grid
from polishd.process.dynamic_tif import tif_at_point
from polishd.workbench.studies.scene import Scene, make_scene


@dataclass(frozen=True, slots=True)
class Passes:
    """What passes of equal dwell removed; figures over the clear aperture."""

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
    """Of log removal against log gamma, least squares: 1.5 for a Hertz contact."""
    notes: tuple[str, ...]

    def as_json(self) -> dict[str, Any]:
        """The figures, without maps."""
        inside = self.gamma[self.metric_mask]
        plain = ("passes", "mean_nm", "pv_nm", "rms_nm", "correlation", "slope")
        return {
            **{name: getattr(self, name) for name in plain},
            "pv_share": self.pv_nm / self.mean_nm,
            "gamma_min": float(inside.min()),
            "gamma_max": float(inside.max()),
        }


def polish_evenly(study: PassesStudy, tell: Callable[[str], None]) -> Passes:
    """Dwell equally long at every point, pass after pass. ConfigError for what cannot be."""
    tell("compliance along the path")
    scene = make_scene(study)
    tell("removing")
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
    """(ny, nx) gamma at the samples: the mean of the points that reach one; NaN where none does."""
    rigid = scene.effect(tif_at_point("none", scene.gamma))
    reach = rigid.removal_nm(np.ones(scene.program.n))
    with np.errstate(invalid="ignore"):
        return np.where(reach > 0, rigid.removal_nm(scene.gamma) / reach, np.nan)


def against_gamma(removal_nm: FloatArray, gamma: FloatArray) -> tuple[float, float]:
    """Correlation of (m,) removals with (m,) gammas, and the slope of their logarithms.

    Raises ComputeError where a sample was not reached, or gamma is the same everywhere.
    """
    if not ((removal_nm > 0).all() and np.isfinite(gamma).all()):
        raise ComputeError("no dwell point reaches some samples of the clear aperture; take a smaller step_mm")
    if np.ptp(gamma) < 1e-9:
        raise ComputeError(f"gamma is {gamma[0]:.6g} everywhere: removal cannot be held against it")
    slope = np.polyfit(np.log(gamma), np.log(removal_nm), 1)[0]
    return float(np.corrcoef(removal_nm, gamma)[0, 1]), float(slope)
