"""A spot on a witness part: what a shop measures of its tool before it polishes the first part."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from polishd.hookspecs import RemovalModel
from polishd.model.beliefs import Estimate
from polishd.model.process import MeasuredTif
from polishd.model.program import Program
from polishd.model.surface import FloatArray, SurfaceMap
from polishd.process.dynamic_tif import lean_azimuth_rad
from polishd.process.instrument import as_profiled
from polishd.process.measured_tif import tif_from_maps, volume_mm3_min
from polishd.recipe import steps
from polishd.recipe.recipe import Recipe
from polishd.recipe.records import EstimatesInUse
from polishd.workbench.studies.plant_process import PlantProcess

Measure = Callable[[], SurfaceMap]
"""The part that lies there, as the instrument gives it."""
DEPTH_NM = 300.0
"""How deep the spot is meant to be: a thousand times an interferometer's noise."""


@dataclass(frozen=True, slots=True)
class WitnessSpot:
    """A spot that was polished at rest at one point of a program, and what it removed."""

    point: Program
    """That point alone."""
    tif: MeasuredTif

    def rate(self, recipe: Recipe) -> EstimatesInUse:
        """The belief with which the recipe's model removes the volume of this spot."""
        first = steps.initial_estimates(recipe)
        modelled = float(_modelled_nm_s(recipe, self.point).sum()) * recipe.grid_mm**2 * 60e-6  # mm^3/min
        rate = Estimate(volume_mm3_min(self.tif) / modelled)
        return replace(first, removal=replace(first.removal, rate=rate))

    def spot(self, recipe: Recipe, measured_tif: RemovalModel) -> Recipe:
        """The recipe with this spot as its TIF, at each point as it was here."""
        return replace(recipe, model=measured_tif, tif=self.tif)


def polish_witness(plant: PlantProcess, recipe: Recipe, program: Program, measure: Measure) -> WitnessSpot:
    """A spot in the middle of the part that lies there, as the program would have it. ComputeError."""
    middle = int(np.argmin(np.hypot(*steps.in_part_frame(recipe, program).end_mm[:, :2].T)))
    point = _at_rest(program, middle)
    seconds = np.array([DEPTH_NM / float(_modelled_nm_s(recipe, point).max())])
    before = as_profiled(measure(), recipe.instrument)
    plant.polish(point, seconds, recipe.process.force_n, recipe.process.rpm)
    after = as_profiled(measure(), recipe.instrument)
    azimuth_deg = float(np.degrees(lean_azimuth_rad(steps.executed_surface(recipe, point))[0]))
    whole = _with_data(before, after)
    seen = (before.height_nm[whole], after.height_nm[whole])
    tif, _ = tif_from_maps(*seen, before.grid.pitch_mm, float(seconds[0]), azimuth_deg=azimuth_deg)
    return WitnessSpot(point, tif)


def _at_rest(program: Program, point: int) -> Program:
    """One timed point of it, where its block ends."""
    one = slice(point, point + 1)
    end = program.end_mm[one]
    along = {name: getattr(program, name)[one] for name in ("line", "block", "axis", "time_s", "feed_mm_min")}
    return replace(program, start_mm=end, end_mm=end, **along)


def _modelled_nm_s(recipe: Recipe, point: Program) -> FloatArray:
    """(ny, nx) nm/s of that one point, by the recipe's model as it begins."""
    return steps.effect_of(recipe, point, steps.process_grid(recipe)).removal_nm(np.ones(1))


def _with_data(before: SurfaceMap, after: SurfaceMap) -> tuple[slice, slice]:
    """Rows and columns that both have some of: what lies about the part is no untouched surface."""
    both = before.valid & after.valid
    rows, columns = (np.flatnonzero(both.any(axis=axis)) for axis in (1, 0))
    return slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
