"""What the config says of the part's seat and of what happens between passes, made into what the daemon does."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from polishd.config.cell import CellConfig
from polishd.config.handling import StepSection, TouchOffSection
from polishd.hookspecs import ProgramFormat
from polishd.model.errors import ComputeError
from polishd.model.handling import BetweenPasses, HandlingStep, SettleRule, TouchOff
from polishd.model.instrument import Instrument
from polishd.model.surface import FloatArray
from polishd.process import contact, optics, seat
from polishd.process.paths.wrist import tool_axes

NOISE = 2.0
"""Two maps of a part at rest differ by sqrt(2) times the instrument's repeatability; as much again is chance's."""
LEAST_SLACK_MM = 0.2
"""Beside the contact: so much may the places and the clear aperture be off."""


def touch_off_of(config: CellConfig, program: ProgramFormat) -> TouchOff | None:
    """How the seat is proved; None where the cell does not ask for it. ConfigError names the key."""
    section = config.touch_off
    if section is None:
        return None
    if program.make is None:
        raise config.error(
            "touch_off", f"no programs are made in {program.name!r}; take an NC dialect, or leave it out"
        )
    places, key = _places_mm(config, section)
    optic = config.optic()
    try:
        points = np.column_stack([places, optics.sag_mm(optic, places)])
        normal = optics.unit_normals(optic, places)
        dip, options = config.process.dip_deg, config.compliance_options()
        axis = tool_axes(points, optic, dip, options, config.placement())
    except ComputeError as error:
        raise config.error(key, str(error)) from error
    made = TouchOff(
        force_n=section.force_n,
        position_mm=section.position_mm,
        most_off_mm=section.most_off_mm,
        each_pass=section.each_pass,
        places_mm=points,
        normal=normal,
        axis=axis,
        rim_mm=config.outline().radius_mm,
        force_max_n=section.force_max_n,
    )
    if not seat.separate_seat_terms(made):
        raise config.error(key, "the three places lie on a line: no tilt can be told; move one of them")
    return made


def between_of(config: CellConfig, instrument: Instrument | None) -> BetweenPasses:
    """What happens between passes; ConfigError names the key."""
    section = config.between
    settle = None
    if section.settle is not None:
        noise_nm = None if instrument is None else instrument.repeatability_nm
        if noise_nm is None:
            raise config.error(
                "between.settle",
                "nobody knows when two maps agree: write the instrument's repeatability into its profile, "
                "[repeatability] rms_nm = ...",
            )
        settle = SettleRule(NOISE * noise_nm, section.settle.maps, section.settle.wait_s)
    change = _step(config, section.change) or HandlingStep()
    return BetweenPasses(_step(config, section.clean), settle, _step(config, section.condition), change)


def _step(config: CellConfig, section: StepSection | None) -> HandlingStep | None:
    if section is None:
        return None
    return HandlingStep(section.person or "", section.command, config.base_dir, section.within_s)


def _places_mm(config: CellConfig, section: TouchOffSection) -> tuple[FloatArray, str]:
    """(3, 2) in the part's frame, and the key that says where; ConfigError where the tool would touch what counts."""
    part, process = config.part, replace(config.tool_process(), force_n=section.force_n)
    room = float(contact.contact_radius_mm(process, contact.hertz_depth_mm(process))) + LEAST_SLACK_MM
    outline = config.outline()
    if section.places_mm is None:
        if part.edge_mm < 2 * room:
            raise config.error(
                "touch_off",
                f"the rim that part.edge_mm leaves out is {part.edge_mm:g} mm wide, and the tool needs "
                f"{2 * room:.2f} mm to rest on it: say where it may touch, "
                "touch_off.places_mm = [[x, y], [x, y], [x, y]]",
            )
        return seat.rim_places_mm(outline, part.edge_mm), "touch_off"
    places = np.asarray(section.places_mm, dtype=np.float64)
    for x, y in places[outline.inside_mm(*places.T) > part.edge_mm - room]:
        raise config.error(
            "touch_off.places_mm",
            f"x {x:g}, y {y:g} mm lies in the clear aperture, {outline} less {part.edge_mm:g} mm all round, or the "
            f"contact reaches it: keep {room:.2f} mm off it",
        )
    return places, "touch_off.places_mm"
