"""From how a robot language writes an orientation to the tool axis."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Literal

import numpy as np
import scipy

from polishd.model.surface import FloatArray

Convention = Literal["quaternion", "euler_deg", "rotation_vector_rad"]

ROWS = 1 << 14
"""Orientations that are turned into axes at once."""
UNIT_WITHIN = 1e-3
"""How far a quaternion's norm may be from 1: the rounding of three or more written digits, and no more."""


def is_rotation(convention: Convention, values: Sequence[float]) -> bool:
    """Whether the numbers (3 or 4) of one orientation are one: finite, and a quaternion of unit length."""
    if not all(map(math.isfinite, values)):
        return False
    return convention != "quaternion" or abs(math.hypot(*values) - 1) <= UNIT_WITHIN


def tool_axis(convention: Convention, axes: str, values: FloatArray, *, tool_z_into_part: bool) -> FloatArray:
    """Unit tool axis (n, 3), from the tip into the spindle, of n orientations.

    ``values`` is (n, 4) for quaternions (scalar first) and (n, 3) otherwise; ``axes`` are those of Euler angles in
    degrees, in the order of ``values``, upper case for turned axes (``ZYX``: KUKA's A, B, C), lower for fixed ones
    (``xyz``: FANUC's W, P, R). The tool's z is the rotation's third column; it
    mostly points from the tip into the part.
    """
    found = np.empty((len(values), 3))
    for first in range(0, len(values), ROWS):  # a matrix is three times what is asked of it
        part = values[first : first + ROWS]
        if convention == "quaternion":
            rotation = scipy.spatial.transform.Rotation.from_quat(part[:, [1, 2, 3, 0]])
        elif convention == "euler_deg":
            rotation = scipy.spatial.transform.Rotation.from_euler(axes, part, degrees=True)
        else:
            rotation = scipy.spatial.transform.Rotation.from_rotvec(part)
        found[first : first + ROWS] = rotation.as_matrix()[:, :, 2]
    return np.negative(found, out=found) if tool_z_into_part else found
