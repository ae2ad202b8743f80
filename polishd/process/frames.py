"""Frames: part and base, the surface normal, the path's Frenet frame, the tool's dip, and axes as A/C of a program.

A tool axis is a unit vector from the tip into the spindle. The dip is its angle from the surface normal, and its
azimuth is where the spindle leans.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from polishd.model.errors import ComputeError
from polishd.model.process import FLAT, ComplianceOptions, Optic, Placement
from polishd.model.surface import BoolArray, FloatArray
from polishd.process.checks import refuse_where, require_number, require_unit_vectors, require_vectors
from polishd.process.optic_surface import unit_normals

STRAIGHT_DEG = 0.05
"""A path that turns by less from point to point is straight: the rounding of a program turns it by as much."""


def rotation_from_rpy_deg(roll: float, pitch: float, yaw: float) -> FloatArray:
    """(3, 3) rotation by intrinsic x-y'-z'' angles in degrees: ``Rx(roll) Ry(pitch) Rz(yaw)``."""
    a, b, c = np.radians([roll, pitch, yaw])
    rx = np.array([[1, 0, 0], [0, np.cos(a), -np.sin(a)], [0, np.sin(a), np.cos(a)]])
    ry = np.array([[np.cos(b), 0, np.sin(b)], [0, 1, 0], [-np.sin(b), 0, np.cos(b)]])
    rz = np.array([[np.cos(c), -np.sin(c), 0], [np.sin(c), np.cos(c), 0], [0, 0, 1]])
    return np.asarray(rx @ ry @ rz, dtype=np.float64)


def rotation_vectors(rotation: FloatArray) -> FloatArray:
    """(n, 3) axis times angle, 0 to pi rad, of (n, 3, 3) rotations."""
    # Four times the products of the quaternions' components, scalar first: any row is a quaternion but for its length,
    # and that of the largest component is the exact one.
    products = np.empty((len(rotation), 4, 4))
    diagonal = np.einsum("nii->ni", rotation)
    trace = diagonal.sum(axis=1)
    np.einsum("nii->ni", products)[:] = 1.0 + np.column_stack([trace, 2.0 * diagonal - trace[:, None]])
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        products[:, 0, i + 1] = products[:, i + 1, 0] = rotation[:, k, j] - rotation[:, j, k]
        products[:, j + 1, k + 1] = products[:, k + 1, j + 1] = rotation[:, k, j] + rotation[:, j, k]
    largest = np.einsum("nii->ni", products).argmax(axis=1)
    quaternion = products[np.arange(len(products)), largest]
    quaternion *= np.where(quaternion[:, :1] < 0, -1.0, 1.0)
    sine = np.linalg.norm(quaternion[:, 1:], axis=1)
    angle = 2.0 * np.arctan2(sine, quaternion[:, 0])
    return np.asarray((angle / np.where(sine > 0, sine, 1.0))[:, None] * quaternion[:, 1:])


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


def surface_normals(placement: Placement, part_mm: FloatArray, optic: Optic = FLAT) -> FloatArray:
    """(n, 3) unit normals of the nominal optic, out of the part, in the base frame.

    ``part_mm`` (n, 3) are points of the part's frame, of which x and y count.
    Raises ComputeError for a point that lies beyond the optic's rim.
    """
    points = require_vectors("point in the part's frame", part_mm, "mm")
    return directions_to_base(placement, unit_normals(optic, points[:, :2]))


def dipped_axes(
    options: ComplianceOptions, placement: Placement, tip_mm: FloatArray, normal: FloatArray, dip_deg: float
) -> FloatArray:
    """(n, 3) tool axes at ``tip_mm`` (n, 3) mm with the dip off ``normal`` (n, 3) unit that the options ask for.

    All in the base frame. Raises ComputeError for a point where the direction of the dip is not defined.
    """
    require_number("the dip", dip_deg, "deg", above=-90.0, below=90.0)
    normal = require_unit_vectors("surface normal", normal)
    lean = lean_directions(options, placement, require_vectors("tool tip", tip_mm, "mm"), normal)
    dip = np.radians(dip_deg)
    return np.asarray(np.cos(dip) * normal + np.sin(dip) * lean, dtype=np.float64)


def lean_directions(
    options: ComplianceOptions, placement: Placement, tip_mm: FloatArray, normal: FloatArray
) -> FloatArray:
    """(n, 3) unit directions along the surface in which the spindle leans; arguments as for `dipped_axes`."""
    match options.dip_direction:
        case "inward":
            way, what = tip_mm * [-1.0, -1.0, 0.0], "the way to the base's z axis along the surface"
        case "fixed":
            azimuth = np.radians(options.dip_azimuth_deg)
            one = np.array([[np.cos(azimuth), np.sin(azimuth), 0.0]])
            way, what = np.repeat(directions_to_base(placement, one), len(tip_mm), axis=0), "the dip's fixed direction"
        case "along":
            way, what = path_tangents(tip_mm), "the path's direction"
        case "across":
            way, what = np.cross(normal, path_tangents(tip_mm)), "the direction across the path"
        case _:
            raise ComputeError(f"the dip's direction {options.dip_direction!r} is none of inward, fixed, along, across")
    way = way - np.einsum("ni,ni->n", way, normal)[:, None] * normal
    length = np.linalg.norm(way, axis=1)
    refuse_where(length < 1e-6, length, what, "mm", "it has no direction")
    return np.asarray(way / length[:, None], dtype=np.float64)


def normals_from_axes(axis: FloatArray, lean: FloatArray, dip_deg: float) -> FloatArray:
    """(n, 3) unit normals: tool axes (n, 3) turned back by the dip, against the way they ``lean`` (n, 3), unit."""
    against = lean - np.einsum("ni,ni->n", lean, axis)[:, None] * axis
    length = np.linalg.norm(against, axis=1)
    refuse_where(length < 1e-6, length, "the sine between the tool axis and its lean", "", "it must be above 0")
    dip = np.radians(dip_deg)
    return np.asarray(np.cos(dip) * axis - np.sin(dip) * against / length[:, None], dtype=np.float64)


def axes_on_level_surface(axis: FloatArray, normal: FloatArray) -> FloatArray:
    """(n, 3) axes as seen where the surface lies level: turned with their (n, 3) unit normals the short way to z."""
    both = normal + np.array([0.0, 0.0, 1.0])
    size = 1 + normal[:, 2]
    refuse_where(size < 1e-6, size, "1 + the cosine between the normal and the part's z", "", "the surface looks down")
    turned = axis - (np.einsum("ni,ni->n", both, axis) / size)[:, None] * both
    turned[:, 2] += 2 * np.einsum("ni,ni->n", normal, axis)
    return np.asarray(turned, dtype=np.float64)


def path_tangents(point_mm: FloatArray) -> FloatArray:
    """(n, 3) unit tangents of the path through (n, 3) points by central differences (paper eq. 34).

    Where points coincide the path has the direction that it had before.
    """
    if len(point_mm) < 2:
        raise ComputeError(f"a path of {len(point_mm)} points has no direction")
    way = np.gradient(point_mm, axis=0)
    length = np.linalg.norm(way, axis=1)
    moving = np.flatnonzero(length > 1e-9)
    if moving.size == 0:
        raise ComputeError("the path has no direction: all of its points coincide")
    last = np.searchsorted(moving, np.arange(len(way)), side="right") - 1
    taken = moving[np.maximum(last, 0)]
    return np.asarray(way[taken] / length[taken][:, None], dtype=np.float64)


def frenet_binormals(point_mm: FloatArray) -> tuple[FloatArray, BoolArray]:
    """(n, 3) unit binormals of the path through (n, 3) points, and where they are defined (paper eq. 34-38).

    Central differences; ``d x dd`` normalised (eq. 38's last line is the curvature times the binormal). The path has no
    binormal at its ends, nor where it turns by less than `STRAIGHT_DEG` from point to point: there the result is 0.
    """
    before, after = np.zeros_like(point_mm), np.zeros_like(point_mm)
    before[1:-1] = point_mm[1:-1] - point_mm[:-2]
    after[1:-1] = point_mm[2:] - point_mm[1:-1]
    cross = np.cross(before, after)  # of d and dd: (after + before) / 2 x (after - before)
    size = np.linalg.norm(cross, axis=1)
    lengths = np.linalg.norm(before, axis=1) * np.linalg.norm(after, axis=1)
    defined = size > np.sin(np.radians(STRAIGHT_DEG)) * np.maximum(lengths, 1e-18)
    return np.where(defined[:, None], cross / np.maximum(size, 1e-300)[:, None], 0.0), np.asarray(defined)


def dips_deg(axis: FloatArray, normal: FloatArray) -> FloatArray:
    """(n,) angle between (n, 3) tool axes and (n, 3) surface normals, degrees, 0 to 180."""
    sine = np.linalg.norm(np.cross(axis, normal), axis=1)
    return np.asarray(np.degrees(np.arctan2(sine, np.einsum("ni,ni->n", axis, normal))), dtype=np.float64)


def angles_from_axis(axis: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(A, C) in degrees, (n,) each, of (n, 3) unit tool axes: without jumps of a turn.

    The wrist's other solution (-A, C + 180) is taken from where it is the nearer one: a path that passes over A = 0
    changes A's sign. A starts from 0 to 180. Where A is 0 (or 180) C is not defined: it stays what it was, and
    starts as what it becomes.
    """
    axis = require_unit_vectors("tool axis", axis)
    sine = np.hypot(axis[:, 0], axis[:, 1])
    a_deg = np.degrees(np.arctan2(sine, axis[:, 2]))
    c_deg = np.zeros(len(axis))
    defined = np.flatnonzero(sine > 1e-9)
    if defined.size:
        raw = np.degrees(np.arctan2(axis[defined, 0], -axis[defined, 1]))
        other = _on_other_branch(a_deg[defined], raw)
        turning = np.unwrap(raw + 180.0 * other, period=360.0)
        last = np.maximum(np.searchsorted(defined, np.arange(len(axis)), side="right") - 1, 0)
        c_deg = turning[last]
        a_deg = np.where(other[last], -a_deg, a_deg)
    return a_deg, c_deg


def _on_other_branch(a_deg: FloatArray, c_deg: FloatArray) -> BoolArray:
    """(m,) True where (-A, C + 180) replaces (A, C): the wrist moves least from each to the next."""
    turn = np.abs((np.diff(c_deg) + 180.0) % 360.0 - 180.0)
    stay = np.hypot(np.diff(a_deg), turn)
    change = np.hypot(a_deg[1:] + a_deg[:-1], 180.0 - turn)
    return np.concatenate([[False], np.cumsum(change < stay) % 2 == 1])


# The eight ways in which an array can lie: four turns, and the same four of its mirror image. Named in one place.

Turn = Literal[0, 90, 180, 270]
Point = tuple[float, float]


@dataclass(frozen=True, slots=True)
class ArrayOrientation:
    """Flip left-right where ``mirror``, then turn by ``rotation_deg`` counter-clockwise as displayed (row 0 on top)."""

    mirror: bool
    rotation_deg: Turn

    @property
    def name(self) -> str:
        """Name of the turn: "as it is", "turned 90", "flipped up-down" ..."""
        return _NAMES[self.mirror, self.rotation_deg]

    def turn(self, array: NDArray[Any]) -> NDArray[Any]:
        """The array, (ny, nx), turned; (nx, ny) after 90 or 270 degrees."""
        return np.rot90(array[:, ::-1] if self.mirror else array, self.rotation_deg // 90)

    def turn_point(self, point_px: Point, shape: tuple[int, int]) -> Point:
        """(row, column) px of a point in an array of this shape, where the turned array has it."""
        (row, column), (ny, nx) = point_px, shape
        if self.mirror:
            column = nx - 1 - column
        for _ in range(self.rotation_deg // 90):
            row, column, ny, nx = nx - 1 - column, row, nx, ny
        return (row, column)

    def turn_vector(self, vector: Point) -> Point:
        """(x right, y up) as it points after the turn."""
        x, y = (-vector[0] if self.mirror else vector[0]), vector[1]
        for _ in range(self.rotation_deg // 90):
            x, y = -y, x
        return (x, y)

    def then(self, later: ArrayOrientation) -> ArrayOrientation:
        """The one orientation that does what this one and then ``later`` do."""
        own = -self.rotation_deg if later.mirror else self.rotation_deg  # a flip reverses the turns before it
        return _BY_NAME[_NAMES[self.mirror != later.mirror, (own + later.rotation_deg) % 360]]

    @property
    def undone(self) -> ArrayOrientation:
        """The orientation that leads back."""
        return next(back for back in ORIENTATIONS if self.then(back) == ORIENTATIONS[0])


_NAMES: dict[tuple[bool, int], str] = {
    (False, 0): "as it is",
    (False, 90): "turned 90",
    (False, 180): "turned 180",
    (False, 270): "turned 270",
    (True, 0): "flipped left-right",
    (True, 90): "transposed",
    (True, 180): "flipped up-down",
    (True, 270): "transposed across",
}
_TURNS: tuple[Turn, ...] = (0, 90, 180, 270)
ORIENTATIONS = tuple(ArrayOrientation(mirror, turn) for mirror in (False, True) for turn in _TURNS)
"""All eight; the first is "as it is"."""
_BY_NAME = {orientation.name: orientation for orientation in ORIENTATIONS}


def orientations(shape: tuple[int, ...]) -> tuple[ArrayOrientation, ...]:
    """Return the orientations that keep an array's shape: four where it is not square."""
    return tuple(o for o in ORIENTATIONS if shape[0] == shape[1] or o.rotation_deg % 180 == 0)
