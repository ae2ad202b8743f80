"""A raster that suits a cell: over its part and a little more, quiet for its spot, dipped as its tool dips."""

from __future__ import annotations

from polishd.config.cell import CellConfig
from polishd.model.surface import FloatArray
from polishd.plugins.rnc_robot.make import path_program
from polishd.process.paths.apertures import over_outline
from polishd.process.paths.raster import quiet_step_mm, raster
from polishd.process.paths.wrist import tool_axes
from polishd.workbench.programs.contact import contact_radius_mm

RASTER_MM = 1.0
"""Length of a block, and most distance of the lines: the step that leaves no ripple is a little less."""
OVERRUN_MM = 1.0
"""How far the raster is larger than the part: its turns, where the machine stops, lie on the ring around it."""
LANDING_MM = 6.0
"""How far outside the part the tool lands, on the ring that the part sits in."""
FEED_MM_MIN = 900.0


def own_program(config: CellConfig, name: str) -> bytes:
    """That raster as RNC text, timed by feeds."""
    return path_program(*own_path(config), FEED_MM_MIN, name)


def own_path(config: CellConfig, dwells_mm: float | None = None) -> tuple[FloatArray, FloatArray]:
    """(n, 3) points of that raster, mm, and the tool axes there.

    ``dwells_mm``: most distance of the points where each has a dwell: they are then quiet along the lines, too.
    """
    covered = over_outline(config.outline()).larger(OVERRUN_MM)
    step = quiet_step_mm(contact_radius_mm(config), dwells_mm or RASTER_MM)
    along = step if dwells_mm else RASTER_MM
    points = raster(covered, step, along, optic=config.optic(), landing_mm=LANDING_MM - OVERRUN_MM)
    axes = tool_axes(points, config.optic(), config.process.dip_deg, config.compliance_options(), config.placement())
    return points, axes
