"""Cost of a random path of 104,004 points, and of the forecast of its ripple and of a raster's. CPU seconds."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np

from benchmarks.bench_dwell import FEED_MM_S, path
from benchmarks.harness import Progress, Row, race
from polishd.model.process import ToolProcess
from polishd.model.surface import FloatArray, Grid
from polishd.process.removal.ripple import ActingSpots
from polishd.process.removal.ripple_forecast import ripple_of
from polishd.process.removal.tif import HertzSpot
from polishd.process.removal.tif_family import PathBlocks
from polishd.process.toolpath.apertures import circle
from polishd.process.toolpath.bent_rasters import random_raster
from polishd.process.toolpath.paths import raster

DIAMETER_MM = 300.0
PITCH_MM = 0.7
GRID = Grid(311, 311, 1.0)


def rows(progress: Progress) -> Iterator[Row]:
    """The path, and the forecast for a random path and a raster of the same length."""
    disc = circle(DIAMETER_MM)
    bent = random_raster(disc, PITCH_MM, 1.0)
    make = partial(random_raster, disc, PITCH_MM, 1.0)
    yield race(f"ripple: make a random path of {len(bent)} points", make, {}, progress=progress)
    for name, points in (("random path", bent), ("raster", raster(disc, PITCH_MM, 1.0))):
        yield race(
            f"ripple: forecast of a {name} of {len(points)} points", partial(forecast, points), {}, progress=progress
        )


def forecast(points_mm: FloatArray) -> object:
    """Return the ripple of a feed of 50 mm/s at a constant depth ratio."""
    program = path(points_mm)
    blocks = PathBlocks(
        program.start_mm[:, :2],
        program.end_mm[:, :2],
        np.full(program.n, np.pi / 2),
        np.full(program.n, 0.875),
        np.ones(program.n),
    )
    clear = GRID.radius_mm() <= DIAMETER_MM / 2 - 3
    return ripple_of(ActingSpots(HertzSpot(ToolProcess()), blocks), program.length_mm / FEED_MM_S, GRID, clear)
