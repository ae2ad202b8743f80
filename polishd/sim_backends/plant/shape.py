"""The nominal surface by the plant's own means: heights by iteration, normals and curvature by differences.

The controller has closed forms of the same (`process.optics`); tests hold the two to each other. The part's frame has
its origin on the surface at the part's centre and its z along the normal there; its x and y are the parent's, turned
with z the short way.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from polishd.config.simulator import Plant
from polishd.model.surface import FloatArray

STEP_MM = 0.1
"""Between the nine heights that tell slope and curvature."""
MOST_STEPS = 1000
SETTLED_MM = 1e-13
_NINE = STEP_MM * np.array([[i, j] for j in (-1, 0, 1) for i in (-1, 0, 1)], dtype=np.float64)


@dataclass(frozen=True, slots=True)
class Local:
    """The surface under n points of the part's x and y."""

    height_mm: FloatArray
    """(n,)."""
    normal: FloatArray
    """(n, 3) unit, out of the part."""
    curvature_per_mm: FloatArray
    """(n,) mean of the two principal ones, positive where it is concave."""

    def levelled(self, axis: FloatArray) -> FloatArray:
        """(n, 3) directions of the part's frame as seen where the normal is z: turned with it the short way."""
        along = np.einsum("ni,ni->n", axis, self.normal)
        share = (along + axis[:, 2]) / (1.0 + self.normal[:, 2])
        return np.column_stack([axis[:, :2] - share[:, None] * self.normal[:, :2], along])

    def raised(self, along: FloatArray) -> FloatArray:
        """(n, 3) directions of the part's frame from (n, 2) along the surface: what `levelled` makes of them."""
        share = np.einsum("ni,ni->n", along, self.normal[:, :2]) / (1.0 + self.normal[:, 2])
        flat = np.column_stack([along, np.zeros(len(along))])
        return np.asarray(flat - share[:, None] * (self.normal + np.array([0.0, 0.0, 1.0])))

    @property
    def stretch(self) -> FloatArray:
        """(n, 2, 2) from offsets in the part's x and y to offsets along the surface, in that turned frame."""
        lean, up = self.normal[:, :2], self.normal[:, 2]
        size = 1.0 / (up * (1.0 + up))
        return np.asarray(np.eye(2) + size[:, None, None] * lean[:, :, None] * lean[:, None, :])


@dataclass(frozen=True, slots=True)
class Shape:
    """The optic of a part."""

    plant: Plant
    _centre: FloatArray = field(init=False)
    """(3,) the part's centre in the parent's frame."""
    _axes: FloatArray = field(init=False)
    """(3, 3) the part's axes there, as columns."""

    def __post_init__(self) -> None:
        """Find the frame of a part that lies off the parent's axis."""
        centre = np.array([self.plant.off_axis_mm])
        height, slope, _ = _looked_at(self._parent_mm(centre + _NINE))
        a, b, c = np.array([-slope[0, 0], -slope[0, 1], 1.0]) / math.sqrt(1.0 + float((slope**2).sum()))
        turn = [[1 - a * a / (1 + c), -a * b / (1 + c), a], [-a * b / (1 + c), 1 - b * b / (1 + c), b], [-a, -b, c]]
        object.__setattr__(self, "_centre", np.append(centre[0], height))
        object.__setattr__(self, "_axes", np.array(turn))

    @property
    def flat(self) -> bool:
        """Whether it is a plane."""
        return self.plant.curvature_radius_mm is None and not any(self.plant.even)

    def under(self, place: FloatArray) -> Local:
        """The surface under points whose x and y are the first two columns of (n, 2 or more), part's frame.

        Beyond the ring around the part it goes on as at the ring's end.
        """
        n = len(place)
        if self.flat:
            return Local(np.zeros(n), np.tile([0.0, 0.0, 1.0], (n, 1)), np.zeros(n))
        plane = place[:, :2]
        end_mm = self.plant.outline.radius_mm + self.plant.ring_mm - 2 * STEP_MM
        plane = plane * np.minimum(1.0, end_mm / np.maximum(np.hypot(plane[:, 0], plane[:, 1]), 1e-9))[:, None]
        nine = self._part_mm((plane[:, None] + _NINE).reshape(-1, 2)).reshape(n, 9)
        height, slope, bend = _looked_at(nine)
        size = np.sqrt(1.0 + np.einsum("ni,ni->n", slope, slope))
        normal = np.column_stack([-slope, np.ones(n)]) / size[:, None]
        (zx, zy), (zxx, zxy, zyy) = slope.T, bend.T
        mean = ((1 + zy**2) * zxx - 2 * zx * zy * zxy + (1 + zx**2) * zyy) / (2 * size**3)
        return Local(height, normal, mean)

    def _part_mm(self, plane: FloatArray) -> FloatArray:
        """(n,) heights over (n, 2) of the part's frame: down its z until the parent is met."""
        height = np.zeros(len(plane))
        begin = self._centre + plane @ self._axes[:, :2].T
        for _ in range(MOST_STEPS):
            at = begin + height[:, None] * self._axes[:, 2]
            step = (at[:, 2] - self._parent_mm(at[:, :2])) * self._axes[2, 2]
            height = height - step
            if np.abs(step).max(initial=0.0) < SETTLED_MM:
                break
        return height

    def _parent_mm(self, plane: FloatArray) -> FloatArray:
        """Heights (...,) over (..., 2) of the parent's frame: ``2 R z = r^2 + (1 + k) z^2``, and the even terms."""
        plant, square = self.plant, (plane**2).sum(axis=-1)
        even = np.zeros_like(square)
        for power, factor in enumerate(plant.even, start=2):
            even += factor * square**power
        height = np.zeros_like(square)
        if plant.curvature_radius_mm is None:
            return np.asarray(even)
        for _ in range(MOST_STEPS):
            before = height
            height = (square + (1.0 + plant.conic) * before**2) / (2.0 * plant.curvature_radius_mm)
            if np.abs(height - before).max(initial=0.0) < SETTLED_MM:
                break
        return np.asarray(height + even)


def _looked_at(nine: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Height (n,), slopes (n, 2) and second derivatives xx, xy, yy (n, 3) of (n, 9) heights on `_NINE`."""
    z = nine.reshape(-1, 3, 3)  # row: y, column: x
    slope = np.stack([z[:, 1, 2] - z[:, 1, 0], z[:, 2, 1] - z[:, 0, 1]], axis=1) / (2.0 * STEP_MM)
    along = z[:, 1, 2] - 2.0 * z[:, 1, 1] + z[:, 1, 0]
    across = z[:, 2, 1] - 2.0 * z[:, 1, 1] + z[:, 0, 1]
    twist = (z[:, 2, 2] - z[:, 2, 0] - z[:, 0, 2] + z[:, 0, 0]) / 4.0
    return z[:, 1, 1], slope, np.stack([along, twist, across], axis=1) / STEP_MM**2
