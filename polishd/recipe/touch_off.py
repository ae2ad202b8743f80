"""The programs of a touch-off: to each place with the tool up, and away again."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import scipy

from polishd.model.errors import PlanRefused, ProgramError
from polishd.model.handling import TouchOff
from polishd.model.limits import Envelope
from polishd.model.program import Plan, Segments
from polishd.process import motion
from polishd.recipe import steps
from polishd.recipe.recipe import Recipe

FEED_MM_S = 10.0
"""Near the part, where the machine allows it."""
RISE_MM = 1.0
"""The one timed move of each program: off the place, along the program's z."""


def plans(recipe: Recipe, asked: TouchOff) -> tuple[Plan, ...]:
    """A plan for each place: it approaches with the tool up, lands where polishing would, and rises.

    Three programs and not one: so a robot takes them that stops at its program's own stops only, as LinuxCNC does.
    Raises ProgramError where the format cannot say them.
    """
    return tuple(_plan(recipe, asked, place) for place in range(len(asked.places_mm)))


def require_allowed(recipe: Recipe, made: Sequence[Plan], check: Callable[[Plan, Envelope], Sequence[str]]) -> None:
    """PlanRefused with all that the plugins find against them: a touch-off moves like any plan."""
    if found := [f"  {plan.program.name}: {line}" for plan in made for line in check(plan, recipe.envelope)]:
        raise PlanRefused("\n".join(["the touch-off was refused, nothing moved:", *found]))


def _plan(recipe: Recipe, asked: TouchOff, place: int) -> Plan:
    make = recipe.format.make
    if make is None:
        raise ProgramError(f"touch-off: no programs are made in {recipe.format.name!r}; take an NC dialect")
    turn = scipy.spatial.transform.Rotation.from_euler("z", -recipe.program.rotation_deg, degrees=True)
    there = turn.apply(asked.places_mm[place] - np.asarray(recipe.program.offset_mm))
    points = np.stack([there, there + np.array([0.0, 0.0, RISE_MM])])
    axes = np.tile(turn.apply(asked.axis[place]), (2, 1))
    envelope = recipe.envelope
    feed_mm_s = min(max(FEED_MM_S, envelope.min_feed_mm_s), envelope.max_feed_mm_s)
    name = f"touch-off, place {place + 1}"
    text = make(points, axes, 60.0 * feed_mm_s, name)
    program = recipe.format.read(text, name)
    return Plan(
        program=program,
        approach_blocks=int(program.block[0]),
        contact_blocks=int(program.block[-1]) + 1,
        expected_time_s=motion.delivered_time_s(program, program.time_s, envelope),
        predicted_removal_nm=np.zeros(steps.process_grid(recipe).shape),
        segments=Segments(program.text),
    )
