"""Tool axes along a path, and whether a wrist can follow them."""

from __future__ import annotations

import numpy as np

from polishd.model.errors import ComputeError
from polishd.model.process import ComplianceOptions, Optic, Placement
from polishd.model.surface import FloatArray
from polishd.process import frames

TURN_LIMIT_DEG = 95.0
"""Most turn of the wrist in one move. Beside the point where the normal is the C axis, C turns by up to 90 degrees."""


def tool_axes(
    points_mm: FloatArray, optic: Optic, dip_deg: float, options: ComplianceOptions, placement: Placement
) -> FloatArray:
    """(n, 3) unit tool axes at points (n, 3) mm, in the part's frame: the optic's normals, dipped as the options ask.

    Raises ComputeError for a point where the optic or the direction of the dip is not defined.
    """
    base = frames.points_to_base(placement, points_mm)
    normals = frames.surface_normals(placement, points_mm, optic)
    axes = frames.dipped_axes(options, placement, base, normals, dip_deg)
    return np.asarray(axes @ placement.rotation, dtype=np.float64)  # base to part: transposed, on rows


def largest_turn_deg(axis: FloatArray, limit_deg: float = TURN_LIMIT_DEG) -> float:
    """The largest turn of A or C from one of (n, 3) tool axes to the next; ComputeError names one above the limit."""
    a_deg, c_deg = frames.angles_from_axis(axis)
    turn = np.maximum(np.abs(np.diff(a_deg)), np.abs(np.diff(c_deg)))
    largest = float(turn.max(initial=0.0))
    if largest > limit_deg:
        k = int(np.argmax(turn > limit_deg))
        raise ComputeError(
            f"from point {k} to {k + 1} the wrist turns by {turn[k]:.4g} deg (A {a_deg[k]:.4g} to {a_deg[k + 1]:.4g}, "
            f"C {c_deg[k]:.5g} to {c_deg[k + 1]:.5g}), at most {limit_deg:g}: so at "
            f"{np.count_nonzero(turn > limit_deg)} moves. To do: lean more or elsewhere, or take shorter steps"
        )
    return largest
