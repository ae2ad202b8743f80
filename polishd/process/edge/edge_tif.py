"""The spot that overhangs a free rim (one without a flush ring round it).

The actuator keeps the force, so over the rim the bonnet sinks until what is left of the contact carries it all: Hertz's
pressure at the greater depth, cut off at the rim. What of a Hertz contact lies on a half plane carries
``(2 + 3 x - x^3) / 4`` of its force, x the centre's distance inside the rim over the contact's radius. With
s = sqrt(depth over undisturbed depth) and c = x at the undisturbed depth the force is kept where
``2 s^3 + 3 c s^2 - c^3 = 4``. The pressure is nowhere negative, and the spindle, which is held, takes the moment.

Models for laps on a free joint balance the moment by a linear pressure (Jones 1986), which turns negative where the lap
overhangs by much; hence the skin model (Luna-Aguilar et al. 2003). The peak of pressure at a sharp rim is in neither:
where the outermost contact radius must be right, edge TIFs are measured (Kim et al. 2009), which is not done here.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from polishd.model.outline import Outline
from polishd.model.process import ToolProcess
from polishd.model.program import Program
from polishd.model.surface import FloatArray
from polishd.process import contact
from polishd.process.dynamic_tif import CorrectedSpot, lean_azimuth_rad
from polishd.process.robot.refusal import refuse_where, require_number
from polishd.process.spot import Spot

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
