"""The instrument's own error in a loop: found by turning and shifting the part before its first pass."""

from __future__ import annotations

from dataclasses import replace

from polishd.config.loop_study import Poses
from polishd.model.errors import ComputeError
from polishd.model.surface import SurfaceMap
from polishd.process.absolute import AbsoluteTestResult, PartPose, SystemMap, separate
from polishd.process.instrument import as_profiled
from polishd.recipe.recipe import Recipe
from polishd.workbench.studies.plant_process import PlantProcess

WHOLE = 1e-6
"""Of a sample, by which a shift may be off one: the plant moves a part by whole ones."""


def with_absolute_test(recipe: Recipe, plant: PlantProcess, poses: Poses) -> Recipe:
    """The recipe with the system map that those poses tell. BadMap, ComputeError."""
    lay = [PartPose(*pose) for pose in poses]
    maps = [_measured(recipe, plant, pose) for pose in lay]
    pitch_mm = maps[0].grid.pitch_mm
    found = separate([one.height_nm for one in maps], lay, pitch_mm)
    instrument = maps[0].with_height(found.instrument_nm)
    return replace(recipe, system=SystemMap(instrument, AbsoluteTestResult.of(found)))


def with_certified_map(recipe: Recipe) -> Recipe:
    """By which the true part is judged: without an instrument, and without what the certificate says it leaves out."""
    without = recipe.accept == "bound_without_power"
    part = recipe.part.model_copy(update={"alignment": "power"}) if without else recipe.part
    job = recipe.job.model_copy(update={"accept": "figure"})
    return replace(recipe, part=part, job=job, instrument=None, system=None)


def _measured(recipe: Recipe, plant: PlantProcess, pose: PartPose) -> SurfaceMap:
    pitch_mm = float(plant.truth()[0]["pitch_mm"])
    shift = (pose.x_mm / pitch_mm, pose.y_mm / pitch_mm)
    if any(abs(one - round(one)) > WHOLE for one in shift):
        raise ComputeError(f"the pose {pose}: a simulated part is shifted by whole samples of {pitch_mm:g} mm")
    height, _ = plant.measure(angle_deg=pose.angle_deg, shift_px=(round(shift[0]), round(shift[1])))
    return as_profiled(SurfaceMap(height, pitch_mm), recipe.instrument)
