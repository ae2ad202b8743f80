"""The parallel section of the hybrid robot, with the arrays' components first: what every pose is computed from.

Base frame: origin O at the centre of the U joint, z down. The platform's axes are w (from O to the wrist centre P),
v = w x e / |w x e| (inner U axis, e the outer one) and u = v x w. In that frame the platform's ends of the limbs lie
still, and so does e but for the angle between it and w: nearly all that follows is written in it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from polishd.model.errors import ComputeError
from polishd.model.robot import HybridRobot, Vector
from polishd.model.surface import FloatArray
from polishd.process.robot.refusal import require_number

PARALLEL = 1e-6
"""Below this sine two axes count as parallel."""

_TINY = 1e-300
_Z = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, slots=True)
class Geometry:
    """What does not depend on the pose."""

    base: FloatArray
    """(3, 3) mm, base end of limb i in row i: ``b_i`` of eq. 1."""
    platform: FloatArray
    """(3, 3) mm, platform end of limb i in row i, from the platform's centre, along u, v, w: ``a_i`` of eq. 1."""
    outer: FloatArray
    """(3,) unit outer axis of the U joint, e."""


@dataclass(frozen=True, slots=True)
class Parallel:
    """The parallel section at n poses."""

    frame: FloatArray
    """(3, 3, n) axis (u, v, w), component in the base frame."""
    length_mm: FloatArray
    """(n,) L of the UP limb, from O to the platform's centre."""
    sine: FloatArray
    """(n,) e . u: sine of the angle between e and w."""
    cosine: FloatArray
    """(n,) e . w."""
    limbs_mm: FloatArray
    """(3, 3, n) component (u, v, w), limb, from base to platform: ``q_i w_i`` of eq. 1."""
    limb_mm: FloatArray
    """(3, n) lengths ``q_i``."""
    turns: FloatArray
    """(3, 3, n) axis (u, v, w), limb: growth of ``q_i^2 / 2`` with a turn of the platform about the axis at O, mm^2."""
    motions: FloatArray
    """(3, 3, n) the same with each motion that the UP limb leaves free: turn about e, turn about v, slide along w."""
    cofactors: FloatArray
    """(3, 3, n) motion, limb: over `determinant` the inverse of `motions`, from limbs to motions."""
    determinant: FloatArray
    """(n,) of `motions`; at 0 locked limbs do not hold the platform."""

    @property
    def independence(self) -> FloatArray:
        """(n,) volume spanned by the directions of `motions`' rows, 0 to 1."""
        e, v, w = self.motions
        scale = np.sqrt(dot(e, e) * dot(v, v) * dot(w, w))
        return np.asarray(np.abs(self.determinant) / np.maximum(scale, _TINY), dtype=np.float64)


def geometry_of(robot: HybridRobot) -> Geometry:
    """The geometry as numbers; raises ComputeError where a parameter is out of range, with its value and unit."""
    _require_robot(robot)
    outer = _vectors("outer_axis", (robot.outer_axis,))[0]
    size = float(np.linalg.norm(outer))
    if not np.linalg.norm(np.cross(outer, _Z)) > PARALLEL * size:
        raise ComputeError(f"the robot's outer_axis is {robot.outer_axis}, it must not be parallel to z, nor 0")
    outer = outer / size
    home = axes(_Z[:, None], outer)[0][:, :, 0]
    base = _joints(robot, "base_joints_mm", "base_radius_mm")
    return Geometry(base, _joints(robot, "platform_joints_mm", "platform_radius_mm") @ home.T, outer)


def parallel_at(geometry: Geometry, w: FloatArray, length_mm: FloatArray) -> Parallel:
    """The section for (3, n) unit directions of the UP limb and its (n,) lengths, mm."""
    frame, sine = axes(w, geometry.outer)
    end = geometry.platform[:, :, None]
    reach = length_mm + end[:, 2]
    u, v, along = (side - geometry.base @ axis for side, axis in zip((end[:, 0], end[:, 1], reach), frame, strict=True))
    turns = np.empty((3, *u.shape))
    turns[0] = end[:, 1] * along - reach * v
    turns[1] = reach * u - end[:, 0] * along
    turns[2] = end[:, 0] * v - end[:, 1] * u
    cosine = geometry.outer @ w
    motions = np.stack([sine * turns[0] + cosine * turns[2], turns[1], along])
    cofactors = np.stack([cross(motions[k - 2], motions[k - 1]) for k in range(3)])
    limbs = np.stack([u, v, along])
    limb_mm = np.sqrt(u * u + v * v + along * along)
    determinant = dot(motions[0], cofactors[0])
    return Parallel(frame, length_mm, sine, cosine, limbs, limb_mm, turns, motions, cofactors, determinant)


def axes(w: FloatArray, outer: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(3, 3, n) axes u, v, w of the platform from (3, n) unit w, and the (n,) sine between w and the outer axis."""
    frame = np.empty((3, *w.shape))
    across = cross(w, outer[:, None])
    sine = np.sqrt(dot(across, across))
    frame[1] = across / np.maximum(sine, _TINY)
    frame[0] = cross(frame[1], w)
    frame[2] = w
    return frame, sine


def dot(a: FloatArray, b: FloatArray) -> FloatArray:
    """Scalar products of vectors with components first."""
    return np.asarray(a[0] * b[0] + a[1] * b[1] + a[2] * b[2], dtype=np.float64)


def cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Vector products ``a x b`` of vectors with components first."""
    result = np.empty(np.broadcast_shapes(a.shape, b.shape))
    for k in range(3):
        i, j = (k + 1) % 3, (k + 2) % 3
        result[k] = a[i] * b[j] - a[j] * b[i]
    return result


def _joints(robot: HybridRobot, name: str, radius: str) -> FloatArray:
    """(3, 3) three joints, one a row, mm, base directions: as given, or 120 deg apart on their circle."""
    given: tuple[Vector, ...] | None = getattr(robot, name)
    if given is not None:
        return _vectors(name, given, 3)
    require_number(f"the robot's {radius}", getattr(robot, radius), "mm", above=0.0)
    angle = np.radians(robot.first_limb_deg + np.array([0.0, 120.0, 240.0]))
    return np.asarray(getattr(robot, radius) * np.stack([np.cos(angle), np.sin(angle), np.zeros(3)], axis=1))


def _vectors(name: str, value: tuple[Vector, ...], count: int = 1) -> FloatArray:
    array = np.asarray(value, dtype=np.float64)
    if array.shape != (count, 3) or not np.isfinite(array).all():
        raise ComputeError(f"the robot's {name} is {value}, it must be {count} x 3 finite numbers")
    return array


def _require_robot(robot: HybridRobot) -> None:
    for name in ("wrist_length_mm", "tool_length_mm", "workspace_radius_mm"):
        require_number(f"the robot's {name}", getattr(robot, name), "mm", above=0.0)
    shortest, longest = robot.stroke_mm
    require_number("the shortest limb allowed", shortest, "mm", above=0.0)
    require_number("the longest limb allowed", longest, "mm", above=shortest)
    lowest, highest = robot.workspace_height_mm
    require_number("the workspace's least height", lowest, "mm", above=-np.inf)
    require_number("the workspace's greatest height", highest, "mm", above=lowest)
    require_number("the robot's joint_height_mm", robot.joint_height_mm, "mm", above=-np.inf)
    for name in ("first_limb_deg", "c_zero_deg", "a_zero_deg"):
        require_number(f"the robot's {name}", getattr(robot, name), "deg", above=-np.inf)
