"""The surface that a study starts from: drawn from a seed, or a measured map."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from polishd.config.study import CorrectionsStudy, PartStudy
from polishd.model.surface import FloatArray, Grid, SurfaceMap
from polishd.process.conditioning import MARGIN_MM, MIN_SAMPLES, ConditionedMap, condition, process_grid
from polishd.process.metrics import fitted
from polishd.process.nominal import less_nominal
from polishd.process.registration.record import Registration

WAVES = 96
"""Plane waves of a drawn surface: enough for heights that are nearly normal."""

ReadMap = Callable[[Path], SurfaceMap]


def study_grid(study: PartStudy, pitch_mm: float) -> Grid:
    """The grid of this pitch over the aperture, its extension and a margin: samples and dwell points share it."""
    return process_grid(study.outline(), pitch_mm, max(MARGIN_MM, study.path.extension_mm))


def start_surface(study: CorrectionsStudy, read: ReadMap) -> ConditionedMap:
    """The surface on the process grid with its masks; ConfigError where the map cannot be used."""
    part, wanted = study.part, study.surface
    if wanted.rms_nm is not None and wanted.period_mm is not None:
        return drawn_surface(study, wanted.rms_nm, wanted.period_mm)
    with study.blame("surface.file"):
        surface = read(study.resolve(wanted.file or ""))
        if part.nominal is not None:
            with study.blame("part.nominal"):
                surface = less_nominal(surface, read(study.resolve(part.nominal)), Registration())
        return condition(
            surface,
            outline=study.outline(),
            edge_mm=part.edge_mm,
            grid_mm=study.process.grid_mm,
            removal=part.alignment,
            margin_mm=max(MARGIN_MM, study.path.extension_mm),
        )


def drawn_surface(study: CorrectionsStudy, rms_nm: float, period_mm: tuple[float, float]) -> ConditionedMap:
    """A surface of this RMS over the clear aperture, without what the part's maps are levelled by."""
    part = study.part
    grid = study_grid(study, study.process.grid_mm)
    solve, metric = (study.outline().contains(*grid.axes_mm, edge) for edge in (0.0, part.edge_mm))
    if np.count_nonzero(metric) < MIN_SAMPLES:
        samples = f"{np.count_nonzero(metric)} samples of process.grid_mm = {grid.pitch_mm:g}"
        raise study.error("part", f"the clear aperture has {samples}; at least {MIN_SAMPLES} are needed")
    height = random_waves(grid, period_mm, study.surface.seed)
    height -= fitted(height, metric, part.alignment)
    height *= rms_nm / height[metric].std()
    return ConditionedMap(grid, np.where(solve, height, np.nan), solve, metric)


def random_waves(grid: Grid, period_mm: tuple[float, float], seed: int) -> FloatArray:
    """(ny, nx) sum of plane waves with periods in the band, longer ones higher: amplitude as the period.

    A function of place alone: a finer grid samples the same surface.
    """
    rng = np.random.default_rng(seed)
    period = np.exp(rng.uniform(np.log(period_mm[0]), np.log(period_mm[1]), WAVES))
    direction, phase = rng.uniform(0, 2 * np.pi, (2, WAVES))
    x, y = grid.x_mm[None, :], grid.y_mm[:, None]
    height = np.zeros(grid.shape)
    for length, way, start in zip(period, direction, phase, strict=True):
        height += length * np.cos(2 * np.pi / length * (np.cos(way) * x + np.sin(way) * y) + start)
    return height
