"""Whether a program is this part's: one of another part would polish it all the same, with nobody there."""

from __future__ import annotations

from typing import Literal

import numpy as np

from polishd.config.cell import CellConfig
from polishd.model.program import Program
from polishd.process import contact
from polishd.process.coverage import PathCoverage, coverage
from polishd.recipe import steps
from polishd.recipe.recipe import Recipe

MOST_UNREACHED = 0.05
"""Of the clear aperture: one whose spots end at 97 % of a round one's radius misses more."""
LANDING_MM = 10.0
"""Beyond the rim: turns and landing points lie there, and are much of a small part's path."""
MOST_OUTSIDE = 0.5
"""Of the path. A square raster round a round part, a quarter of its radius too large, has less beyond the rim."""

Covers = Literal["aperture", "zone"]
"""What a program is for."""


def require_fit(config: CellConfig, recipe: Recipe, program: Program) -> str:
    """How far the program reaches, and over what; ConfigError where it is another part's."""
    said, problem = judged(recipe, program, config.program.covers)
    if problem:
        raise config.error("program.path", f"{said}{problem}")
    return said


def judged(recipe: Recipe, program: Program, covers: Covers) -> tuple[str, str]:
    """How far a program reaches, and over what; and why it is another part's, empty where it may be this one's.

    ``zone`` says that some of the clear aperture is left alone on purpose.
    """
    found = program_coverage(recipe, program)
    said = (
        f"{program.name} reaches {found.reach_mm:.1f} mm from the part's centre, the part is {recipe.outline}; "
        f"no point reaches {100 * found.unreached:.1f} % of the clear aperture"
    )
    mend = "name the program of this part, or mend the part's outline ([part]) or program.offset_mm"
    if found.outside > MOST_OUTSIDE:
        away = f"{100 * found.outside:.0f} % of its path lies more than {LANDING_MM:g} mm beyond the part's rim"
        return said, f", and {away}: {mend}"
    if found.unreached > MOST_UNREACHED and covers == "aperture":
        zone = 'post it with closer lines where it leaves gaps; where it is for a zone only, say covers = "zone"'
        return said, f": {mend}; {zone}"
    return said, ""


def program_coverage(recipe: Recipe, program: Program) -> PathCoverage:
    """What the program covers of the recipe's part."""
    placed = steps.executed_surface(recipe, program)
    return coverage(
        placed.start_mm,
        placed.end_mm,
        spot_mm=_spot_mm(recipe),
        outline=recipe.outline,
        edge_mm=recipe.part.edge_mm,
        landing_mm=LANDING_MM,
    )


def _spot_mm(recipe: Recipe) -> float:
    """Radius of the spot: of the measured one's area, or of the contact on a rigid robot."""
    if recipe.tif is not None:
        return recipe.tif.pitch_mm * float(np.sqrt(np.count_nonzero(recipe.tif.rate_nm_s) / np.pi))
    return float(contact.contact_radius_mm(recipe.process, contact.hertz_depth_mm(recipe.process)))
