"""What is known before a map, and of a map before its dwell is solved: what would be refused in the end."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from polishd.config.cell import CellConfig
from polishd.hookspecs import RemovalAnswer
from polishd.model.errors import ComputeError, PlanRefused
from polishd.model.program import Envelope, Plan, Program
from polishd.model.surface import FloatArray
from polishd.pipeline import steps
from polishd.pipeline.recipe import Recipe
from polishd.pipeline.records import MeasureResult
from polishd.pipeline.steps import envelope_of
from polishd.process.dwell.quadratic import choose_piston_nm
from polishd.process.metrology.tolerance import only_beyond
from polishd.process.removal import contact
from polishd.process.robot import motion
from polishd.process.robot.compliance import path_compliance
from polishd.process.toolpath.apertures import PathCoverage, coverage

SURE = 0.9
"""Of the time that the volume to be removed takes at the largest rate: an optimum may leave a little of it."""
ROOM = 1.2
"""What a limit that is advised leaves above what is known to be needed."""


def precheck_plan(recipe: Recipe, program: Program, check_plan: Callable[[Plan, Envelope], Sequence[str]]) -> list[str]:
    """Why `plan` or `run` would refuse a program whatever the map says: reach, landing, limits at the largest feed."""
    plan = shortest_time_s(recipe, program)
    found = [*steps.violations(recipe, plan), *check_plan(plan, recipe.envelope)]
    part = steps.executed_surface(recipe, program)
    try:
        path_compliance(
            part, recipe.process, recipe.robot, recipe.placement, options=recipe.options, optic=recipe.optic
        )
    except ComputeError as error:
        found.append(f"{program.name}: {error}")
    return found


def shortest_time_s(recipe: Recipe, program: Program) -> Plan:
    """The program at the largest feed that the machine has, or at its own where dwells carry the time."""
    envelope = envelope_of(recipe, program)
    asked = np.zeros(program.n) if program.encoding == "dwell" else program.length_mm / envelope.max_feed_mm_s
    feed = program.max_feed_mm_min if program.encoding == "dwell" else 60 * envelope.max_feed_mm_s
    return Plan(
        program=replace(program, time_s=asked, max_feed_mm_min=feed),
        approach_blocks=int(program.block[0]),
        contact_blocks=int(program.block[-1]) + 1,
        expected_time_s=motion.least_time_s(program, envelope),
        predicted_removal_nm=np.zeros((1, 1)),
        segments=(),
    )


def check_pass(config: CellConfig, recipe: Recipe, program: Program) -> None:
    """ConfigError where no plan of this program can end within ``limits.max_pass_s``."""
    least = _least_s(recipe, program)
    if not least <= recipe.envelope.max_pass_s:
        raise config.error("limits.max_pass_s", _too_long(recipe, f"{program.name} at the largest feed takes", least))


def pass_words(recipe: Recipe, program: Program, answer: RemovalAnswer) -> str:
    """What a pass takes as far as it is known without a map, beside its limit."""
    limit = recipe.envelope.max_pass_s
    clear = recipe.outline.contains(*steps.process_grid(recipe).axes_mm, recipe.part.edge_mm)
    mean = float(answer.removal_nm(np.full(program.n, limit / program.n))[clear].mean())
    own = float(motion.delivered_time_s(program, program.time_s, envelope_of(recipe, program)).sum())
    return (
        f"{_least_s(recipe, program):.0f} s at the largest feed, {own:.0f} s as programmed; "
        f"limits.max_pass_s = {limit:g} s removes {mean:.1f} nm everywhere"
    )


def tolerance_words(recipe: Recipe, answer: RemovalAnswer) -> str:
    """Each line of the tolerance with its limit, and which of them this spot can only leave as they are."""
    said = [f"{line.what} <= {line.limit:g} {line.unit}" for line in recipe.lines]
    if answer.transfer is not None:
        cutoff = answer.transfer.cutoff_period_mm
        said += [
            f"{line.what} can only be left as it is: this spot corrects no period below {cutoff:.2f} mm"
            for line in only_beyond(recipe.lines, cutoff)
        ]
    return "; ".join(said)


def require_path_time(recipe: Recipe, program: Program) -> None:
    """PlanRefused where the path alone takes longer than a pass may."""
    least = _least_s(recipe, program)
    if not least <= recipe.envelope.max_pass_s:
        raise PlanRefused(_too_long(recipe, f"{program.name} at the largest feed takes", least))


def require_removal_time(recipe: Recipe, measured: MeasureResult, answer: RemovalAnswer, lower_s: FloatArray) -> None:
    """PlanRefused where the volume to be removed, at the largest rate on the path, takes longer than a pass may.

    Only where the least residual is asked for: the other choices of a dwell may take less time than that.
    """
    if recipe.dwell.choose != "least":
        return
    least = SURE * removal_time_s(measured, answer, lower_s)
    if not least <= recipe.envelope.max_pass_s:
        raise PlanRefused(_too_long(recipe, "what this map wants removed takes at least", least))


def removal_time_s(measured: MeasureResult, answer: RemovalAnswer, lower_s: FloatArray) -> float:
    """Seconds in which the point that removes most would remove what the surface wants of the clear aperture."""
    clear = measured.metric_mask
    piston = choose_piston_nm(measured.height_nm, clear, answer.removal_nm(lower_s))
    rate = answer.effect.adjoint(clear.astype(np.float64))  # nm/s, summed over the samples
    most = float((rate if answer.divide_by is None else rate * answer.divide_by).max())
    return float((measured.height_nm[clear] + piston).sum()) / most


def _least_s(recipe: Recipe, program: Program) -> float:
    return float(motion.least_time_s(program, envelope_of(recipe, program)).sum())


def _too_long(recipe: Recipe, what: str, seconds: float) -> str:
    return (
        f"{what} {seconds:.0f} s, more than limits.max_pass_s = {recipe.envelope.max_pass_s:g} s; "
        f"set it to {math.ceil(ROOM * seconds):d} or more, or take a shorter path, a larger spot, or a budget "
        "(dwell.choose)"
    )


# Does a program belong to this part? A program of another part would polish it without supervision.

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
