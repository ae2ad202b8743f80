"""Frames: part and base, the surface normal, the tool's dip, and tool axes as A/C angles of a program.

A tool axis is a unit vector from the tip into the spindle. The dip is its angle from the surface normal, and its
azimuth is where the spindle leans.
"""

from __future__ import annotations

import numpy as np

from polishd.model.errors import ComputeError
from polishd.model.process import Placement
from polishd.model.surface import FloatArray
from polishd.process.robot.refusal import refuse_where, require_number, require_unit_vectors, require_vectors


def rotation_from_rpy_deg(roll: float, pitch: float, yaw: float) -> FloatArray:
    """(3, 3) rotation by intrinsic x-y'-z'' angles in degrees: ``Rx(roll) Ry(pitch) Rz(yaw)``."""
    a, b, c = np.radians([roll, pitch, yaw])
    rx = np.array([[1, 0, 0], [0, np.cos(a), -np.sin(a)], [0, np.sin(a), np.cos(a)]])
    ry = np.array([[np.cos(b), 0, np.sin(b)], [0, 1, 0], [-np.sin(b), 0, np.cos(b)]])
    rz = np.array([[np.cos(c), -np.sin(c), 0], [np.sin(c), np.cos(c), 0], [0, 0, 1]])
    return np.asarray(rx @ ry @ rz, dtype=np.float64)


def points_to_base(placement: Placement, part_mm: FloatArray) -> FloatArray:
    """(n, 3) points from the part's frame to the robot's base frame, mm."""
    points = require_vectors("point in the part's frame", part_mm, "mm")
    return directions_to_base(placement, points) + np.asarray(placement.origin_mm, dtype=np.float64)


def directions_to_base(placement: Placement, part: FloatArray) -> FloatArray:
    """(n, 3) directions from the part's frame to the robot's base frame; lengths are kept."""
    rotation = np.asarray(placement.rotation, dtype=np.float64)
    proper = rotation.shape == (3, 3) and np.allclose(rotation @ rotation.T, np.eye(3), rtol=0, atol=1e-9)
    if not (proper and np.linalg.det(rotation) > 0 and np.isfinite(placement.origin_mm).all()):
        raise ComputeError("the part's placement needs a proper (3, 3) rotation and a finite origin in mm")
    return np.asarray(require_vectors("direction in the part's frame", part, "") @ rotation.T, dtype=np.float64)


def surface_normals(placement: Placement, n: int) -> FloatArray:
    """(n, 3) unit normals of a flat part in the base frame, out of the part: its frame's z."""
    return directions_to_base(placement, np.tile([0.0, 0.0, 1.0], (n, 1)))


def inward_axis(tip_mm: FloatArray, normal: FloatArray, dip_deg: float) -> FloatArray:
    """(n, 3) tool axes dipped so that the spindle leans towards the base's z axis, along the surface.

    ``tip_mm`` (n, 3) mm and ``normal`` (n, 3) unit, out of the part, base frame. Raises ComputeError for a point where
    that direction is not defined: on the base's z axis, or where the inward direction is the normal itself.
    """
    require_number("the dip", dip_deg, "deg", above=-90.0, below=90.0)
    tip = require_vectors("tool tip", tip_mm, "mm")
    normal = require_unit_vectors("surface normal", normal)
    inward = tip * [-1.0, -1.0, 0.0]
    inward = inward - np.einsum("ni,ni->n", inward, normal)[:, None] * normal
    length = np.linalg.norm(inward, axis=1)
    refuse_where(length < 1e-6, length, "the way to the base's z axis along the surface", "mm", "it has no direction")
    dip = np.radians(dip_deg)
    return np.asarray(np.cos(dip) * normal + np.sin(dip) * inward / length[:, None], dtype=np.float64)


def dips_deg(axis: FloatArray, normal: FloatArray) -> FloatArray:
    """(n,) angle between (n, 3) tool axes and (n, 3) surface normals, degrees, 0 to 180."""
    sine = np.linalg.norm(np.cross(axis, normal), axis=1)
    return np.asarray(np.degrees(np.arctan2(sine, np.einsum("ni,ni->n", axis, normal))), dtype=np.float64)


def axis_from_angles(a_deg: FloatArray, c_deg: FloatArray) -> FloatArray:
    """(n, 3) unit tool axes ``(sin C sin A, -cos C sin A, cos A)`` from (n,) A and C, degrees, program frame."""
    a, c = np.radians(a_deg), np.radians(c_deg)
    return np.stack([np.sin(c) * np.sin(a), -np.cos(c) * np.sin(a), np.cos(a)], axis=-1)


def angles_from_axis(axis: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(A, C) in degrees, (n,) each, of (n, 3) unit tool axes: A from 0 to 180, C without jumps of a turn.

    Where A is 0 (or 180) C is not defined: it stays what it was, and starts as what it becomes.
    """
    axis = require_unit_vectors("tool axis", axis)
    sine = np.hypot(axis[:, 0], axis[:, 1])
    a_deg = np.degrees(np.arctan2(sine, axis[:, 2]))
    c_deg = np.zeros(len(axis))
    defined = np.flatnonzero(sine > 1e-9)
    if defined.size:
        turning = np.unwrap(np.degrees(np.arctan2(axis[defined, 0], -axis[defined, 1])), period=360.0)
        last = np.searchsorted(defined, np.arange(len(axis)), side="right") - 1
        c_deg = turning[np.maximum(last, 0)]
    return a_deg, c_deg
