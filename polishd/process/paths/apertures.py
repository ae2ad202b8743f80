"""Clear apertures, by how far they reach in each direction: so that one that is larger all round is exact, too."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from polishd.model.errors import ComputeError
from polishd.model.outline import Circle, Outline
from polishd.model.surface import BoolArray, FloatArray, Grid
from polishd.process.robot.refusal import require_number

DIRECTIONS = 4096
UP, DOWN = DIRECTIONS // 4, DIRECTIONS // 4 * 3
STEP_RAD = 2 * np.pi / DIRECTIONS
AZIMUTH_RAD = np.arange(DIRECTIONS) * STEP_RAD
TOWARDS = np.stack([np.cos(AZIMUTH_RAD), np.sin(AZIMUTH_RAD)], axis=1)


@dataclass(frozen=True, slots=True)
class Aperture:
    """A convex aperture in the part's plane, which holds the part's centre; a hole is round and central."""

    reach_mm: FloatArray
    """(DIRECTIONS,) distance of the straight edge that touches it from outside, facing each azimuth from +x."""
    hole_mm: float = 0.0
    """Radius of the hole; 0 where there is none."""

    def __post_init__(self) -> None:
        """ComputeError where the part's centre lies outside."""
        require_number("the least way from the part's centre to the rim", float(self.reach_mm.min()), "mm", above=0.0)

    @property
    def radius_mm(self) -> float:
        """Radius of the circle about the centre that holds it."""
        return float(self.reach_mm.max())

    def larger(self, by_mm: float) -> Aperture:
        """The same with its rim moved outwards, corners rounded, and its hole made smaller."""
        return replace(self, reach_mm=self.reach_mm + by_mm, hole_mm=max(self.hole_mm - by_mm, 0.0))

    def turned(self, by_deg: float) -> Aperture:
        """The same, turned counterclockwise about the centre."""
        azimuth = AZIMUTH_RAD - np.radians(by_deg)
        return replace(self, reach_mm=np.interp(azimuth, AZIMUTH_RAD, self.reach_mm, period=2 * np.pi))

    def outline_mm(self) -> FloatArray:
        """(DIRECTIONS, 2) corners of the polygon around it, counterclockwise; corner j ends the edge that faces j."""
        following = np.roll(self.reach_mm, -1)
        along = (following - self.reach_mm * np.cos(STEP_RAD)) / np.sin(STEP_RAD)
        across = np.stack([-TOWARDS[:, 1], TOWARDS[:, 0]], axis=1)
        return np.asarray(self.reach_mm[:, None] * TOWARDS + along[:, None] * across, dtype=np.float64)

    @property
    def heights_mm(self) -> tuple[float, float]:
        """Y of its lowest and of its highest point."""
        return -float(self.reach_mm[DOWN]), float(self.reach_mm[UP])

    def spans_mm(self, y_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(n,) left and right ends of its cuts along y = (n,); above and below it those of its top and bottom."""
        outline = self.outline_mm()
        right = np.concatenate([outline[DOWN:], outline[:UP]])
        left = outline[UP:DOWN][::-1]
        ends = [np.interp(y_mm, np.maximum.accumulate(side[:, 1]), side[:, 0]) for side in (left, right)]
        return ends[0], ends[1]

    def rim_mm(self, azimuth_rad: FloatArray) -> FloatArray:
        """(n,) distance of the rim from the centre in the directions (n,)."""
        outline = self.outline_mm()
        corner = np.unwrap(np.arctan2(outline[:, 1], outline[:, 0]))
        past = (np.asarray(azimuth_rad) - corner[0]) % (2 * np.pi)
        facing = np.searchsorted(corner - corner[0], past, side="right") % DIRECTIONS
        return np.asarray(self.reach_mm[facing] / np.cos(azimuth_rad - AZIMUTH_RAD[facing]), dtype=np.float64)


def circle(diameter_mm: float) -> Aperture:
    """A disc."""
    return ellipse(diameter_mm, diameter_mm)


def annulus(outer_mm: float, inner_mm: float) -> Aperture:
    """A disc with a round hole in its centre, by their diameters."""
    require_number("the diameter of the hole", inner_mm, "mm", above=0.0, below=outer_mm)
    return replace(circle(outer_mm), hole_mm=inner_mm / 2)


def ellipse(width_mm: float, height_mm: float) -> Aperture:
    """An ellipse of these diameters along x and y."""
    half = np.array([_length("width", width_mm), _length("height", height_mm)]) / 2
    return Aperture(np.linalg.norm(TOWARDS * half, axis=1))


def rectangle(width_mm: float, height_mm: float) -> Aperture:
    """A rectangle of these lengths along x and y."""
    half = np.array([_length("width", width_mm), _length("height", height_mm)]) / 2
    return Aperture(np.asarray(np.abs(TOWARDS) @ half, dtype=np.float64))


def over_outline(outline: Outline) -> Aperture:
    """The smallest convex aperture that holds an outline: itself where that is convex."""
    if isinstance(outline, Circle):
        return annulus(2 * outline.radius_mm, 2 * outline.hole_mm) if outline.hole_mm else circle(2 * outline.radius_mm)
    return Aperture(np.asarray((outline.corners() @ TOWARDS.T).max(axis=0), dtype=np.float64))


def over_mask(grid: Grid, mask: BoolArray) -> Aperture:
    """The smallest convex aperture that holds the samples (ny, nx) of a mask, each as large as its pixel."""
    if not mask.any():
        raise ComputeError("the mask is empty: there is nothing to cover")
    rows = np.flatnonzero(mask.any(axis=1))
    first, last = mask[rows].argmax(axis=1), grid.nx - 1 - mask[rows, ::-1].argmax(axis=1)
    ends = np.concatenate([np.stack([grid.x_mm[column], grid.y_mm[rows]], axis=1) for column in (first, last)])
    pixel = np.abs(TOWARDS).sum(axis=1) * grid.pitch_mm / 2
    return Aperture(np.asarray((ends @ TOWARDS.T).max(axis=0) + pixel, dtype=np.float64))


def _length(what: str, value_mm: float) -> float:
    require_number(f"the aperture's {what}", value_mm, "mm", above=0.0)
    return value_mm
