"""Part handling from the config: the part's seat, and the steps between passes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from polishd.config.cell import CellConfig
from polishd.config.cell_sections import StepSection, TouchOffSection
from polishd.hookspecs import ProgramFormat
from polishd.model.errors import ComputeError, PlanRefused, ProgramError
from polishd.model.instrument import Instrument
from polishd.model.outline import Outline
from polishd.model.part_handling import BetweenPasses, HandlingStep, PartSeat, SettleRule, TouchOff
from polishd.model.program import Envelope, Plan, Segments
from polishd.model.surface import FloatArray
from polishd.pipeline import steps
from polishd.pipeline.recipe import Recipe
from polishd.process import optic_surface
from polishd.process.frames import rotation_from_rpy_deg
from polishd.process.removal import contact
from polishd.process.robot import motion
from polishd.process.toolpath.apertures import tool_axes

# The seat of a part: three measured contact positions against the expected ones.

TRIED = 257
"""Points from the center to the rim, to find one that is deep enough."""
BISECTIONS = 48
"""Halvings of a part's radius, to 1e-12 mm of 300 mm."""
FLATTEST = 1e-3
"""Relative to the part's size: below it, three positions are so close to a line that the tilt is undetermined."""


def rim_points_mm(outline: Outline, edge_mm: float) -> FloatArray:
    """(3, 2) positions on the middle of the rim outside the clear aperture, a third of a turn apart."""
    turn = np.radians([90.0, 210.0, 330.0])
    towards = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    reach = [_reach_mm(outline, edge_mm / 2, x, y) for x, y in towards]
    return np.asarray(np.array(reach)[:, None] * towards, dtype=np.float64)


def _reach_mm(outline: Outline, inside_mm: float, x: float, y: float) -> float:
    """Distance from the center of the farthest point in this direction that is inside the rim by this margin."""

    def deeper(reach_mm: float) -> float:
        return float(outline.inside_mm(reach_mm * x, reach_mm * y)) - inside_mm

    tried = np.linspace(0.0, outline.radius_mm, TRIED)
    inner, outer = max((reach for reach in tried if deeper(reach) > 0), default=0.0), outline.radius_mm
    for _ in range(BISECTIONS):
        middle = (inner + outer) / 2
        inner, outer = (middle, outer) if deeper(middle) > 0 else (inner, middle)
    return (inner + outer) / 2


def seat_of(asked: TouchOff, early_mm: FloatArray) -> PartSeat:
    """Solve the part's seat from the early contact (3,) of the actuator at each position.

    A small move of a rigid body, by ``t`` along z and turned by ``w`` about x and y, lifts the surface at ``p`` along
    its normal ``n`` by ``n.(t + w x p) = n_z t + w.(p x n)``: three places give the three.

    Raises ComputeError where the positions lie on a line, so that the terms cannot be separated.
    """
    off_mm = early_mm * asked.lean
    matrix = _moves(asked)
    if not separate_seat_terms(asked):
        raise ComputeError("the three touch-off positions lie on a line, so the tilt is undetermined; move one of them")
    height_mm, about_x, about_y = np.linalg.solve(matrix, off_mm)
    rise = float(np.hypot(about_x, about_y)) * asked.rim_mm
    return PartSeat(
        height_mm=float(height_mm),
        tilt_deg=(float(np.degrees(about_x)), float(np.degrees(about_y))),
        off_mm=tuple(map(float, off_mm)),
        worst_mm=abs(float(height_mm)) + rise,
    )


def separate_seat_terms(asked: TouchOff) -> bool:
    """Whether the positions determine height and both tilts."""
    return bool(abs(np.linalg.det(_moves(asked) / [1.0, asked.rim_mm, asked.rim_mm])) > FLATTEST)


def _moves(asked: TouchOff) -> FloatArray:
    """(3, 3) motion along the normal at each position for a unit of height, and of turn about x and y in rad."""
    turned = np.cross(asked.points_mm, asked.normal)
    return np.column_stack([asked.normal[:, 2], turned[:, 0], turned[:, 1]])


NOISE = 2.0
"""Two maps of a part at rest differ by sqrt(2) times the repeatability; twice that is beyond chance."""
LEAST_SLACK_MM = 0.2
"""Margin beside the contact for errors of the positions and of the clear aperture."""


def touch_off_of(config: CellConfig, program: ProgramFormat) -> TouchOff | None:
    """Touch-off from the config; None where the cell has none. ConfigError names the key."""
    section = config.touch_off
    if section is None:
        return None
    if program.make is None:
        raise config.error(
            "touch_off", f"no programs are made in {program.name!r}; take an NC dialect, or leave it out"
        )
    places, key = _points_mm(config, section)
    optic = config.optic()
    try:
        points = np.column_stack([places, optic_surface.sag_mm(optic, places)])
        normal = optic_surface.unit_normals(optic, places)
        dip, options = config.process.dip_deg, config.compliance_options()
        axis = tool_axes(points, optic, dip, options, config.placement())
    except ComputeError as error:
        raise config.error(key, str(error)) from error
    made = TouchOff(
        force_n=section.force_n,
        position_mm=section.position_mm,
        max_offset_mm=section.max_offset_mm,
        each_pass=section.each_pass,
        points_mm=points,
        normal=normal,
        axis=axis,
        rim_mm=config.outline().radius_mm,
        force_max_n=section.force_max_n,
    )
    if not separate_seat_terms(made):
        raise config.error(key, "the three positions lie on a line, so the tilt is undetermined; move one of them")
    return made


def between_of(config: CellConfig, instrument: Instrument | None) -> BetweenPasses:
    """Steps between passes from the config; ConfigError names the key."""
    section = config.part_handling
    settle = None
    if section.settle is not None:
        noise_nm = None if instrument is None else instrument.repeatability_nm
        if noise_nm is None:
            raise config.error(
                "part_handling.settle",
                "needs the instrument's repeatability to compare two maps: write into its profile "
                "[repeatability] rms_nm = ...",
            )
        settle = SettleRule(NOISE * noise_nm, section.settle.max_maps, section.settle.wait_s)
    change = _step(config, section.change) or HandlingStep()
    return BetweenPasses(_step(config, section.clean), settle, _step(config, section.condition), change)


def _step(config: CellConfig, section: StepSection | None) -> HandlingStep | None:
    if section is None:
        return None
    return HandlingStep(section.operator or "", section.command, config.base_dir, section.timeout_s)


def _points_mm(config: CellConfig, section: TouchOffSection) -> tuple[FloatArray, str]:
    """(3, 2) positions in the part's frame, and their key; ConfigError where the tool would touch the aperture."""
    part, process = config.part, replace(config.tool_process(), force_n=section.force_n)
    room = float(contact.contact_radius_mm(process, contact.hertz_depth_mm(process))) + LEAST_SLACK_MM
    outline = config.outline()
    if section.points_mm is None:
        if part.edge_mm < 2 * room:
            raise config.error(
                "touch_off",
                f"the rim that part.edge_mm leaves out is {part.edge_mm:g} mm wide, and the tool needs "
                f"{2 * room:.2f} mm to rest on it: say where it may touch, "
                "touch_off.points_mm = [[x, y], [x, y], [x, y]]",
            )
        return rim_points_mm(outline, part.edge_mm), "touch_off"
    places = np.asarray(section.points_mm, dtype=np.float64)
    for x, y in places[outline.inside_mm(*places.T) > part.edge_mm - room]:
        raise config.error(
            "touch_off.points_mm",
            f"x {x:g}, y {y:g} mm lies in the clear aperture, {outline} less {part.edge_mm:g} mm all round, or the "
            f"contact reaches it: keep {room:.2f} mm off it",
        )
    return places, "touch_off.points_mm"


# The programs of a touch-off: approach each position with the tool up, and leave it.

FEED_MM_S = 10.0
"""Height near the part, where the machine allows it."""
RISE_MM = 1.0
"""Length of the one timed move of each program: away from the position, along the program's z."""


def plans(recipe: Recipe, asked: TouchOff) -> tuple[Plan, ...]:
    """A plan for each place: it approaches with the tool up, lands where polishing would, and rises.

    Three programs and not one: so a robot takes them that stops at its program's own stops only, as LinuxCNC does.
    Raises ProgramError where the format cannot say them.
    """
    return tuple(_plan(recipe, asked, place) for place in range(len(asked.points_mm)))


def require_allowed(recipe: Recipe, made: Sequence[Plan], check: Callable[[Plan, Envelope], Sequence[str]]) -> None:
    """PlanRefused with all objections of the plugins: a touch-off moves like any plan."""
    if found := [f"  {plan.program.name}: {line}" for plan in made for line in check(plan, recipe.envelope)]:
        raise PlanRefused("\n".join(["the touch-off was refused, nothing moved:", *found]))


def _plan(recipe: Recipe, asked: TouchOff, place: int) -> Plan:
    make = recipe.format.make
    if make is None:
        raise ProgramError(f"touch-off: no programs are made in {recipe.format.name!r}; take an NC dialect")
    turn = rotation_from_rpy_deg(0.0, 0.0, -recipe.program.rotation_deg)
    there = turn @ (asked.points_mm[place] - np.asarray(recipe.program.offset_mm))
    points = np.stack([there, there + np.array([0.0, 0.0, RISE_MM])])
    axes = np.tile(turn @ asked.axis[place], (2, 1))
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
