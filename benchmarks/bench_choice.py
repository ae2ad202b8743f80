"""Effect and dwell of plans that `init` writes: the removal model's own choice beside a matrix, and beside none.

Each with its default solver. By name only: some minutes a case.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.dwell_cases import surface
from benchmarks.harness import Progress, Row, Runner, race
from polishd.commissioning.init.answers import answers_of
from polishd.commissioning.init.write_cell import new_cell, write_cell
from polishd.model.program import Program
from polishd.model.surface import Grid, SurfaceMap
from polishd.pipeline import dwell_step, steps
from polishd.pipeline.build_recipe import make_recipe
from polishd.pipeline.recipe import Recipe
from polishd.pipeline.records import MeasureResult
from polishd.plugin_loader import load_cell
from polishd.plugins import removal_models

RMS_NM = 100.0
CHOSEN = removal_models.WORTH_S, removal_models.WIDE
MATRIX, NONE = (float("inf"), 0), (-1.0, 0)
"""The effect with a forced matrix, and with a forced attempt without one."""


@dataclass(frozen=True, slots=True)
class Case:
    """Answers to `init`; all else is its default, on a UR10e."""

    diameter_mm: float
    tool_radius_mm: float
    curvature_radius_mm: float = 0.0
    make: str = "raster"

    @property
    def name(self) -> str:
        form = f"R {self.curvature_radius_mm:g} mm" if self.curvature_radius_mm else "flat"
        return f"phi {self.diameter_mm:g} mm, {form}, {self.make}, tool radius {self.tool_radius_mm:g} mm"

    @property
    def answers(self) -> str:
        curved = f"curvature_radius_mm = {self.curvature_radius_mm}\n" if self.curvature_radius_mm else ""
        return (
            f'[kinematics]\narm = "ur10e"\n[part]\naperture_mm = {self.diameter_mm}\n{curved}'
            f'[program]\nmake = "{self.make}"\n[process]\ntool_radius_mm = {self.tool_radius_mm}\n'
        )


CASES = (
    Case(100.0, 20.0),
    Case(100.0, 160.0),
    Case(200.0, 20.0),
    Case(200.0, 80.0, 800.0),
    Case(200.0, 160.0),
    Case(300.0, 20.0),
    Case(300.0, 80.0),
    Case(300.0, 160.0),
    Case(500.0, 20.0),
    Case(500.0, 80.0),
    Case(300.0, 20.0, 800.0, "spiral"),
)


def rows(progress: Progress) -> Iterator[Row]:
    """CPU seconds of the solve step; the ratio is that of the best peer over ours: at 1 the choice is right."""
    for case in CASES:
        progress(f"choice: preparing {case.name}")
        with tempfile.TemporaryDirectory() as scratch:
            part = prepared(case, Path(scratch))
        peers: dict[str, Runner] = {"a matrix": partial(solved, part, MATRIX), "without": partial(solved, part, NONE)}
        name = f"choice of the effect, {case.name}, {part.program.n} points"
        yield race(name, partial(solved, part, CHOSEN), peers, progress=progress)


@dataclass(frozen=True, slots=True)
class Part:
    """Input of a solve step."""

    recipe: Recipe
    program: Program
    measured: MeasureResult


def prepared(case: Case, folder: Path) -> Part:
    """Return the cell that `init` writes, its program, and a map of it."""
    answers = answers_of(case.answers, folder / "answers.toml")
    write_cell(new_cell(answers, folder / "cell"), force=False)
    config, hooks = load_cell(folder / "cell" / "cell.toml")
    recipe = make_recipe(config, hooks)
    pitch = recipe.grid_mm
    side = int(case.diameter_mm / pitch) + 1
    grid = Grid(side, side, pitch)
    inside = grid.radius_mm() <= case.diameter_mm / 2 - pitch
    height = surface(grid, inside, 1)
    height *= RMS_NM / height[inside].std()
    shown = SurfaceMap(np.where(inside, height, np.nan), pitch, part_id=config.part.id, sha256="0" * 64)
    return Part(recipe, steps.read_program(recipe, config.program_path), steps.condition(recipe, shown))


def solved(part: Part, choice: tuple[float, int]) -> None:
    """Run the whole solve step. It runs in a fork: its settings end with it."""
    removal_models.WORTH_S, removal_models.WIDE = choice
    dwell_step.solve(part.recipe, part.program, part.measured)
