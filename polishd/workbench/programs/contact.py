"""How wide a cell's contact is: the distance of a path's lines follows from it."""

from __future__ import annotations

import numpy as np

from polishd.config.cell import CellConfig
from polishd.process import contact
from polishd.process.compliance import depth_ratio
from polishd.process.path_compliance import compliance_at
from polishd.process.paths.wrist import tool_axes


def contact_radius_mm(config: CellConfig) -> float:
    """Radius of the contact that acts at the part's centre."""
    centre, process, placement = np.zeros((1, 3)), config.tool_process(), config.placement()
    options, optic = config.compliance_options(), config.optic()
    axes = tool_axes(centre, optic, config.process.dip_deg, options, placement)
    found = compliance_at(
        centre,
        axes,
        process,
        config.robot_model(),
        placement,
        options=options,
        optic=optic,
    )
    depth = contact.hertz_depth_mm(process)
    gamma = depth_ratio(found.compliance_mm_per_n, process, depth)
    return float(contact.contact_radius_mm(process, gamma * depth)[0])
