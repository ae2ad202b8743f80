"""What a part's own curvature makes of a contact: Hertz's ellipse on the surface, and how a map sees it from above.

A bonnet lies closer to a concave part than to a flat, so that under the same force its contact is wider and less deep;
where the two principal curvatures differ it is an ellipse (Hertz; Johnson, Contact Mechanics, 1985, section 4.2). Where
the surface slopes, what is removed along its normal covers less of the map: an offset along the slope by its cosine.
The force is the same, and so is the pressure's sum: with Preston's law the volume along the normal stays what it is.

Left out: that pressure and speed change over the contact by more than on a flat (of the order of contact radius over
the part's).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
import scipy

from polishd.model.process import Optic, ToolProcess
from polishd.model.surface import FloatArray
from polishd.process import optics
from polishd.process.robot.refusal import refuse_where

STEP_MM = 0.05
"""On either side of a point: what the normals' differences tell of curvature; they are exact but for rounding."""
CLOSEST = 0.9
"""Part of the bonnet's curvature that a concave part may have: closer, and it is touched all round."""
SLIMMEST = 0.05
"""Ratio of an ellipse's axes down to which it is tabulated."""


@dataclass(frozen=True, slots=True)
class CurvedContact:
    """Contacts at n points of a part, beside the same bonnet's on a flat."""

    deeper: FloatArray
    """(n,) depth under the same force, over that on a flat."""
    wider: FloatArray
    """(n, 2) half its width along the part's x and y, seen along z, over the radius on a flat."""
    seen: FloatArray
    """(n,) share of the removed volume that a map shows: the cosine of the slope."""
    askew: FloatArray
    """(n,) correlation of x and y over the ellipse: 0 where its axes lie along them."""

    @property
    def note(self) -> str:
        """What an answer says of it."""
        wide = f"contacts {self.wider.min():.3f} to {self.wider.max():.3f} times as wide as on a flat"
        return f"curved part: {wide}, the slope takes up to {1 - self.seen.min():.2%} of what a map shows"


def on_curved(
    process: ToolProcess, optic: Optic, place_mm: FloatArray, *, contact: bool = True
) -> CurvedContact | None:
    """The contacts over points (n, 2 or more) of the part's frame; None on a flat.

    Without ``contact`` only the slope counts: a spot that was measured is as wide as it was measured.
    Raises ComputeError as `optics.unit_normals`, and where the bonnet does not fit into the part.
    """
    if optics.is_flat(optic) or not len(place_mm):
        return None
    normal, curvature, level = _shape(optic, np.asarray(place_mm[:, :2], dtype=np.float64))
    deeper, axes = np.ones(len(normal)), np.tile(np.eye(2), (len(normal), 1, 1))
    if contact:
        deeper, axes = _ellipse(process, curvature)
    above = np.linalg.solve(level, axes)
    square = above @ above.transpose(0, 2, 1)
    wider = np.sqrt(np.einsum("nii->ni", square))
    return CurvedContact(deeper, wider, normal[:, 2], square[:, 0, 1] / wider.prod(axis=1))


def _shape(optic: Optic, plane: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Unit normals (n, 3); curvatures (n, 2, 2), 1/mm, concave positive; and offsets in x and y to those along it.

    All but the normals in the frame that is turned with the normal, the short way to z.
    """
    normal = optics.unit_normals(optic, plane)
    lean, up = normal[:, :2], normal[:, 2]
    level = np.eye(2) + lean[:, :, None] * lean[:, None, :] / (up * (1 + up))[:, None, None]
    ways = STEP_MM * np.eye(2)
    turns = [(optics.unit_normals(optic, plane + way) - optics.unit_normals(optic, plane - way)) for way in ways]
    turn = np.stack(turns, axis=2) / (2 * STEP_MM)  # (n, 3, 2): of the normal, by x and y
    along = turn[:, :2] - (lean / (1 + up)[:, None])[:, :, None] * turn[:, 2:]
    bend = -along @ np.linalg.inv(level)
    return normal, (bend + bend.transpose(0, 2, 1)) / 2, level


def _ellipse(process: ToolProcess, curvature: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(n,) depth and (n, 2, 2) the unit disc's map to the contact, both over the flat's; curvatures (n, 2, 2), 1/mm."""
    own = 1 / process.tool_radius_mm
    value, vector = np.linalg.eigh(own * np.eye(2) - curvature)
    part_mm = 1 / np.maximum(own - value[:, 0], 1e-12)
    refuse_where(
        value[:, 0] < (1 - CLOSEST) * own, part_mm, "the part's radius of curvature", "mm",
        f"the bonnet of {process.tool_radius_mm:g} mm does not lie in it with a spot",
    )  # fmt: skip
    ratio, slim, size, depth = _table()
    k, by = (np.interp(value[:, 0] / value[:, 1], ratio, of) for of in (slim, size))
    mean_mm = 1 / np.sqrt(value.prod(axis=1))
    across = (mean_mm * own) ** (1 / 3) * by
    half = np.stack([across / np.sqrt(k), across * np.sqrt(k)], axis=1)
    deeper = (mean_mm * own) ** (-1 / 3) * np.interp(value[:, 0] / value[:, 1], ratio, depth)
    return deeper, vector * half[:, None, :] @ vector.transpose(0, 2, 1)


@cache
def _table() -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Ratio of the principal relative curvatures, ascending; of the ellipse's axes; and Johnson's F1 and F2."""
    k = np.append(np.linspace(SLIMMEST, 1 - 1e-3, 400), 1.0)
    m = 1 - k[:-1] ** 2
    first, second = scipy.special.ellipk(m), scipy.special.ellipe(m)
    high, low = second / k[:-1] ** 2 - first, first - second
    f_1 = (4 / (np.pi * m)) ** (1 / 3) * np.sqrt(k[:-1]) * (high * low) ** (1 / 6)
    f_2 = 2 / np.pi * np.sqrt(k[:-1]) / f_1 * first
    return np.append(low / high, 1.0), k, np.append(f_1, 1.0), np.append(f_2, 1.0)
