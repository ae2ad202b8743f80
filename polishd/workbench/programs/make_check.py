"""Whether `plan` and `run` would take a program that was made: asked of the cell, before anything is written."""

from __future__ import annotations

from polishd.config.cell import CellConfig
from polishd.config.sections import InstrumentSection
from polishd.hooks.loader import Hooks
from polishd.model.errors import ProgramError
from polishd.plugins.rnc_robot.dialect import dialect as dialect_named
from polishd.plugins.rnc_robot.formats import read
from polishd.recipe import foresight
from polishd.recipe.making import make_recipe

UNCHECKED = (
    "the robot's reach and singular poses",
    "the machine's range and feeds",
    "whether the landing points lie beside the part",
)
"""What nobody can say of a program without the cell that it is for."""


def require_cell_takes(config: CellConfig, hooks: Hooks, text: bytes, named: tuple[str, str]) -> None:
    """ProgramError with everything for which the cell's `plan` or `run` would refuse this text, whatever the map.

    ``named`` are the program's name and its dialect.
    """
    without_map = {"instrument": InstrumentSection(), "part": config.part.model_copy(update={"nominal": None})}
    recipe = make_recipe(config.model_copy(update=without_map), hooks)
    program = read(dialect_named(named[1]), text, named[0])
    found = foresight.refusals(recipe, program, hooks.check_plan)
    if found:
        says = "\n".join(f"  {line}" for line in found)
        raise ProgramError(
            f"nothing was written: plan or run would refuse it in {config.path}:\n{says}\n"
            "To do: other --aperture, --landing, --dip or --azimuth, or move the part (part.origin_mm) in the cell"
        )
