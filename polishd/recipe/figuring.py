"""The surface that figures are of: a map on its own samples over the clear aperture, without what is alignment.

Measuring and certifying take it from here, so that a surface has one figure wherever it is told.
"""

from __future__ import annotations

import numpy as np
import scipy

from polishd.model.instrument import Instrument
from polishd.model.surface import BoolArray, FloatArray, Grid, SurfaceMap
from polishd.process import metrics
from polishd.process.absolute import SystemMap
from polishd.process.instrument import as_profiled
from polishd.process.nominal import less_nominal
from polishd.process.registration.record import Registration
from polishd.process.spikes import cleaned

ROUNDING = 1e-3
"""Of a share of samples: files keep a pitch in seven digits, and a rim must not move with the last of them."""


def map_on_part(surface: SurfaceMap, instrument: Instrument | None, system: SystemMap | None) -> SurfaceMap:
    """The map as it lies on the part, less the instrument's own error where that was told; BadMap as `as_profiled`."""
    lying = as_profiled(surface, instrument)
    return lying if system is None else system.off(lying)


def of_part(
    lying: SurfaceMap, spike_mads: float, nominal: SurfaceMap | None, lies: Registration
) -> tuple[SurfaceMap, int]:
    """That map without spikes and less the form wanted, and how many samples were taken for spikes."""
    clean, spikes = cleaned(lying, spike_mads)
    return (clean if nominal is None else less_nominal(clean, nominal, lies)), spikes


def figure_of(
    clean: SurfaceMap, grid: Grid, metric_mask: BoolArray, lies: Registration, alignment: metrics.Removal
) -> tuple[FloatArray, BoolArray]:
    """What is judged, and over which samples.

    Args:
        clean: the map as ``of_part`` gives it.
        grid: the process grid, on which the clear aperture is frozen.
        metric_mask: (ny, nx) on it: the clear aperture.
        lies: where the part lies in the map.
        alignment: what is alignment, and no figure.

    Returns:
        (rows, columns) of the map itself: height in nm less the alignment, NaN outside the aperture; and the clear
        aperture there.
    """
    clear = on_map(clean, grid, metric_mask, lies)
    return metrics.without(clean.height_nm, clear, alignment), clear


def on_map(surface: SurfaceMap, grid: Grid, mask: BoolArray, lies: Registration) -> BoolArray:
    """The frozen clear aperture on the map's own pixels: figures are stated there, where the raster's ripple shows."""
    x, y = lies.on_part_mm(surface.grid)
    places = [(grid.y_mm[0] - y) / grid.pitch_mm, (x - grid.x_mm[0]) / grid.pitch_mm]
    # the two grids may lie half a sample apart: the nearest one would move the rim by that much
    share = scipy.ndimage.map_coordinates(mask.astype(np.float64), places, order=1)
    return np.asarray(share >= 0.5 - ROUNDING, dtype=np.bool_) & surface.valid
