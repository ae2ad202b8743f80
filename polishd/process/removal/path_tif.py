"""A spot laid down along a program: how it sinks over the part's rim, and its effect. Cells and studies share it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from polishd.model.outline import Outline
from polishd.model.process import Optic, Placement, ToolProcess
from polishd.model.program import Program
from polishd.model.surface import FloatArray, Grid
from polishd.process.checks import refuse_where, require_number
from polishd.process.frames import axes_on_level_surface, surface_normals
from polishd.process.removal import contact
from polishd.process.removal.contact import CurvedContact
from polishd.process.removal.convolution import ConvolutionEffect, convolution_effect
from polishd.process.removal.dynamic_tif import CorrectedSpot, effect_matrix, lean_azimuth_rad
from polishd.process.removal.effect import SparseEffect
from polishd.process.removal.spread_effect import TOLERANCE, SpreadEffect, spread_effect
from polishd.process.removal.tif import Spot, WiderSpot

# The spot that overhangs a free rim (one without a flush ring round it).

MOST_SUNK = 2.0
"""Depth of a contact over its undisturbed one, at most: what the actuator follows (1.59 with the centre on the rim)."""
FORCE_KEPT = 0.999
"""Below this share of its force a contact at the rim has lost some."""


@dataclass(frozen=True, slots=True)
class RimContact:
    """Contacts at a free rim."""

    inside: FloatArray
    """(n,) the undisturbed contact's centre from the rim, positive on the part, over its radius: overhangs below 1."""
    depth_ratio: FloatArray
    """(n,) of the sunk contact, to be given to a Spot."""
    force: FloatArray
    """(n,) share of the force that the part carries: 1 but where the bonnet may sink no further."""


def rim_contact(
    process: ToolProcess, rim: Outline, centre_mm: FloatArray, depth_ratio: FloatArray, most_sunk: float = MOST_SUNK
) -> RimContact:
    """How far contacts sink over a free rim.

    The rim is taken as straight within a contact: the force is right within 1 % where the part's radius is above 11
    contact radii. At a corner the contact is taken to reach over one side only: less of it is on the part.

    Args:
        process: the tool.
        rim: the part's outline.
        centre_mm: (n, 2) centres of the contacts (`contact_centres_mm`).
        depth_ratio: (n,) gamma of the undisturbed contacts.
        most_sunk: the depth at most, over the undisturbed one. Beyond it the force falls to nothing.

    Raises:
        ComputeError: a limit below 1, a depth ratio that is not above 0, or a centre that is not finite.
    """
    require_number("the depth that the bonnet may sink to", most_sunk, "", above=1 - 1e-12)
    refuse_where(~((depth_ratio > 0) & np.isfinite(depth_ratio)), depth_ratio, "gamma", "", "it must be above 0")
    radius = contact.contact_radius_mm(process, depth_ratio * contact.hertz_depth_mm(process))
    inside = rim.inside_mm(*centre_mm.T) / radius
    refuse_where(~np.isfinite(inside), inside, "the distance from the rim over the contact's radius", "", "no number")
    sunk = np.minimum(rim_sink_mm(inside), most_sunk)
    return RimContact(inside, depth_ratio * sunk, load_share(inside, sunk))


def rim_depth_mm(
    spots: CorrectedSpot, rim: Outline, process: ToolProcess, spot: Spot, program: Program
) -> tuple[CorrectedSpot, str]:
    """The spots along a program, deeper where the bonnet hangs over a free rim; and a note that says how many.

    ``spot`` is the rigid robot's; the program's axes are as seen where the surface lies level.
    """
    found = rim_contact(process, rim, contact_centres_mm(spot, program, spots.depth_ratio), spots.depth_ratio)
    over, lost = int((found.inside < 1).sum()), int((found.force < FORCE_KEPT).sum())
    note = f"free rim: the bonnet hangs over it at {over} of {program.n} points, and presses with less force at {lost}"
    return replace(spots, depth_ratio=found.depth_ratio), note


def rim_sink_mm(inside: FloatArray) -> FloatArray:
    """(n,) depth over the undisturbed one at which the contact carries its whole force; 1 where ``inside >= 1``."""
    c = np.minimum(inside, 1.0)
    s = 2.0 + 1.5 * np.abs(c)
    # Newton from above on what is convex and rising there: it comes down to the one root above |c| and cannot pass it
    for _ in range(60):
        s = s - (2 * s**3 + 3 * c * s**2 - c**3 - 4) / (6 * s * (s + c))
    return np.asarray(np.where(c >= 1, 1.0, s**2), dtype=np.float64)


def load_share(inside: FloatArray, sunk: FloatArray) -> FloatArray:
    """(n,) force on the part over the whole, of contacts ``inside`` undisturbed radii from the rim and sunk so far."""
    x = np.clip(inside / np.sqrt(sunk), -1.0, 1.0)
    return np.asarray(np.where(inside >= 1, 1.0, sunk**1.5 * (2 + 3 * x - x**3) / 4), dtype=np.float64)


def contact_centres_mm(spot: Spot, program: Program, depth_ratio: FloatArray) -> FloatArray:
    """(n, 2) where the spot's centre is half way through each block."""
    middle = (program.start_mm[:, :2] + program.end_mm[:, :2]) / 2
    return np.asarray(middle + spot.offset_mm(depth_ratio, lean_azimuth_rad(program)), dtype=np.float64)


@dataclass(frozen=True, slots=True)
class SpotPath:
    """Removal of a tool along its path on a part."""

    program: Program
    """n timed points in the part's frame, the axes as seen where the surface lies level (`levelled_axes`)."""
    spot: Spot
    """The rigid robot's."""
    process: ToolProcess
    rim: Outline | None
    """The part's, where it is free."""
    curved: CurvedContact | None
    """Change of the spot by the part's curvature at each point; None on a flat."""

    @property
    def even(self) -> Spot:
        """The spot of all points, where each cannot have its own: as wide as they are in the mean."""
        if self.curved is None:
            return self.spot
        return WiderSpot(self.spot, float(np.sqrt(self.curved.wider.mean(axis=0).prod())))

    def on_part(self, spots: CorrectedSpot) -> tuple[CorrectedSpot, tuple[str, ...]]:
        """The spots as a map sees them where the part slopes, and as they sink over a free rim; and notes on both."""
        notes: tuple[str, ...] = ()
        if self.curved is not None:
            spots, notes = replace(spots, factor=spots.factor * self.curved.seen), (self.curved.note,)
        if self.rim is not None:
            spots, note = rim_depth_mm(spots, self.rim, self.process, self.spot, self.program)
            notes = (*notes, note)
        return spots, notes

    def matrix(self, grid: Grid, spots: CorrectedSpot) -> SparseEffect:
        """The effect of these spots, each laid down on its own."""
        own = {} if self.curved is None else {"wider": self.curved.wider, "correlation": self.curved.askew}
        return SparseEffect(grid, effect_matrix(grid, self.spot, self.program, spots.depth_ratio, spots.factor, **own))

    def entries(self, grid: Grid, spots: CorrectedSpot) -> float:
        """About how many the matrix has: samples under each disc, and under what it sweeps."""
        width = 2 * self.spot.half_width_mm(spots.depth_ratio) + grid.pitch_mm
        return float((np.pi / 4 * width**2 + width * self.program.length_mm).sum()) / grid.pitch_mm**2

    def without_matrix(self, grid: Grid, spots: CorrectedSpot, tolerance: float = TOLERANCE) -> SpreadEffect:
        """Return the effect without a matrix. ComputeError where its error is above the tolerance."""
        bent = None if self.curved is None else np.column_stack([self.curved.wider, self.curved.askew])
        return spread_effect(
            grid, self.spot, self.program, spots.depth_ratio, spots.factor, tolerance=tolerance, bent=bent
        )

    def convolutions(self, grid: Grid, spots: CorrectedSpot) -> ConvolutionEffect:
        """Return the effect as a sum of convolutions. ComputeError unless all points rest on nodes of the grid."""
        return convolution_effect(grid, self.even, self.program, spots.depth_ratio, spots.factor)


def levelled_axes(program: Program, optic: Optic) -> Program:
    """The program, in the part's frame, with its axes as seen where the surface lies level."""
    here = Placement((0.0, 0.0, 0.0), np.eye(3))
    return replace(program, axis=axes_on_level_surface(program.axis, surface_normals(here, program.end_mm, optic)))
