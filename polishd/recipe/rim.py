"""The part's rim where nothing was measured: heights that stand for it, so that the dwell there is somebody's."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy

from polishd.hookspecs import RemovalAnswer
from polishd.model.surface import BoolArray, FloatArray
from polishd.process.edge.extension import extend
from polishd.recipe.recipe import Recipe
from polishd.recipe.records import MeasureResult

EXTENDED_WEIGHT = 0.01
"""What an extended sample counts beside a measured one: enough to hold the rim, too little to cost the data."""
LEAST_SAMPLES = 3.0
"""The extension's cut-off spans this many samples at least."""


class FilledSurface(NamedTuple):
    """A surface to solve for: what was measured, and what stands for the part's rim where nothing was."""

    height_nm: FloatArray
    mask: BoolArray
    weight: FloatArray | None


def with_rim(recipe: Recipe, measured: MeasureResult, answer: RemovalAnswer) -> FilledSurface:
    """The part's samples without data get extended heights at a small weight: else the dwell there is nobody's.

    Only as far as the part goes: beyond it nothing has to be right, and asking for it costs time.
    """
    mask, pitch = measured.solve_mask, measured.grid.pitch_mm
    gap = recipe.outline.contains(*measured.grid.axes_mm) & ~mask
    if recipe.dwell.extension == "none" or not gap.any():
        return FilledSurface(measured.height_nm, mask, None)
    reach = max(float(scipy.ndimage.distance_transform_edt(~mask)[gap].max()) * pitch, pitch)
    own = 0.0 if answer.transfer is None else answer.transfer.cutoff_period_mm
    cutoff = max(own, LEAST_SAMPLES * pitch)
    wider = extend(measured.height_nm, mask, pitch, reach, recipe.dwell.extension, cutoff_period_mm=cutoff)
    whole = mask | (wider.mask & gap)
    return FilledSurface(np.where(whole, wider.height_nm, 0.0), whole, np.where(mask, 1.0, EXTENDED_WEIGHT))
