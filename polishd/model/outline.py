"""Outlines in a plane, of a part about its centre or of a mask: a circle, a ring, or a polygon that crosses nowhere."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from polishd.model.errors import ComputeError
from polishd.model.surface import BoolArray, FloatArray

MOST_CORNERS = 500
"""Each costs a look at every sample."""
ROUNDING_MM = 1e-9
"""A sample so near a straight side lies on it."""
DRAWN = 256
"""Corners of a circle that is drawn."""

Point = tuple[float, float]
Lengths = FloatArray | float


@dataclass(frozen=True, slots=True)
class Circle:
    """A circle about the origin, or a ring."""

    radius_mm: float
    hole_mm: float = 0.0
    """Radius of the hole in its middle; 0: there is none."""

    def __post_init__(self) -> None:
        """ComputeError for a radius that cannot be."""
        _require_length("radius", self.radius_mm)
        if not 0 <= self.hole_mm < self.radius_mm:
            raise ComputeError(
                f"the outline's hole is {2 * self.hole_mm:g} mm wide; it must be less than {2 * self.radius_mm:g} mm"
            )

    @property
    def half_mm(self) -> Point:
        """Half the sides of the rectangle about the origin that holds it, along x and y."""
        return self.radius_mm, self.radius_mm

    @property
    def size_mm(self) -> Point:
        """Size along x and along y."""
        return 2 * self.radius_mm, 2 * self.radius_mm

    @property
    def area_mm2(self) -> float:
        """Its area."""
        return math.pi * (self.radius_mm**2 - self.hole_mm**2)

    @property
    def depth_mm(self) -> float:
        """Distance of the center from the rim; of a ring, of the middle between both rims."""
        return (self.radius_mm - self.hole_mm) / 2 if self.hole_mm else self.radius_mm

    def inside_mm(self, x_mm: Lengths, y_mm: Lengths) -> FloatArray:
        """Distance of points from it, in the shape that x and y give together, mm: positive inside, else negative."""
        away = np.hypot(x_mm, y_mm)
        inside = self.radius_mm - away
        return np.asarray(np.minimum(inside, away - self.hole_mm) if self.hole_mm else inside, dtype=np.float64)

    def contains(self, x_mm: Lengths, y_mm: Lengths, edge_mm: float = 0.0) -> BoolArray:
        """Return whether points lie inside, at least ``edge_mm`` from the rim; negative: at most so far outside."""
        away = np.hypot(x_mm, y_mm)
        return np.asarray((away <= self.radius_mm - edge_mm) & (not self.hole_mm or away >= self.hole_mm + edge_mm))

    def corners(self) -> FloatArray:
        """(n, 2) mm: its outer rim as a polygon, for a picture."""
        turn = np.arange(DRAWN) * 2 * np.pi / DRAWN
        return self.radius_mm * np.stack([np.cos(turn), np.sin(turn)], axis=1)

    def __str__(self) -> str:
        hole = f", less a hole of {2 * self.hole_mm:g} mm" if self.hole_mm else ""
        return f"a circle of {2 * self.radius_mm:g} mm{hole}"


@dataclass(frozen=True, slots=True)
class Polygon:
    """Straight sides from corner to corner, and from the last to the first. Has what a ``Circle`` has."""

    corners_mm: tuple[Point, ...]
    name: str = "polygon"

    def __post_init__(self) -> None:
        """ComputeError where the corners enclose nothing, or its sides cross."""
        count = len(self.corners_mm)
        if not 3 <= count <= MOST_CORNERS:
            raise ComputeError(f"a polygon has 3 to {MOST_CORNERS} corners, not {count}")
        if not np.isfinite(self.corners_mm).all():
            raise ComputeError("a corner of the polygon is no finite number")
        for place, (a, b) in enumerate(self._sides(), 1):
            if a == b:
                raise ComputeError(f"corners {place} and {place % count + 1} of the polygon are the same; drop one")
        if crossed := _crossing(self.corners()):
            raise ComputeError(
                "the sides of the polygon that begin at its corners {} and {} cross or touch; give the corners in "
                "order around it".format(*crossed)
            )

    @property
    def radius_mm(self) -> float:
        """Radius of the circumscribed circle about the origin."""
        return float(np.linalg.norm(self.corners(), axis=1).max())

    @property
    def half_mm(self) -> Point:
        """Half the sides of the rectangle about the origin that holds it, along x and y."""
        x, y = np.abs(self.corners()).max(axis=0)
        return float(x), float(y)

    @property
    def size_mm(self) -> Point:
        """Size along x and along y."""
        x, y = np.ptp(self.corners(), axis=0)
        return float(x), float(y)

    @property
    def area_mm2(self) -> float:
        """Its area."""
        return abs(sum(ax * by - bx * ay for (ax, ay), (bx, by) in self._sides())) / 2

    @property
    def depth_mm(self) -> float:
        """Distance of the origin from the rim."""
        return float(self.inside_mm(0.0, 0.0))

    def inside_mm(self, x_mm: Lengths, y_mm: Lengths) -> FloatArray:
        """Distance of points from it, in the shape that x and y give together, mm: positive inside, else negative."""
        x, y = np.broadcast_arrays(x_mm, y_mm)
        nearest, inside = np.full(x.shape, np.inf), np.zeros(x.shape, dtype=np.bool_)
        for (ax, ay), (bx, by) in self._sides():
            ex, ey, px, py = bx - ax, by - ay, x - ax, y - ay
            along = np.clip((px * ex + py * ey) / (ex**2 + ey**2), 0.0, 1.0)
            nearest = np.minimum(nearest, (px - along * ex) ** 2 + (py - along * ey) ** 2)
            if ey != 0:  # a ray to the right is crossed an odd number of times from inside
                inside ^= ((py < 0) != (y < by)) & (px * ey < py * ex if ey > 0 else px * ey > py * ex)
        distance = np.sqrt(nearest)
        return np.asarray(np.where(inside, distance, -distance), dtype=np.float64)

    def contains(self, x_mm: Lengths, y_mm: Lengths, edge_mm: float = 0.0) -> BoolArray:
        """Return whether points lie inside, at least ``edge_mm`` from the rim; negative: at most so far outside."""
        return np.asarray(self.inside_mm(x_mm, y_mm) >= edge_mm - ROUNDING_MM)

    def corners(self) -> FloatArray:
        """(n, 2) mm: its corners."""
        return np.asarray(self.corners_mm, dtype=np.float64)

    def __str__(self) -> str:
        x, y = self.size_mm
        return f"a {self.name} of {x:g} x {y:g} mm"

    def _sides(self) -> list[tuple[Point, Point]]:
        return list(pairwise((*self.corners_mm, self.corners_mm[0])))


Outline = Circle | Polygon


def rectangle(width_mm: float, height_mm: float) -> Polygon:
    """A rectangle about the origin, by its sides along x and y."""
    x, y = _require_length("width", width_mm) / 2, _require_length("height", height_mm) / 2
    return Polygon(((x, y), (-x, y), (-x, -y), (x, -y)), "rectangle")


def hexagon(flats_mm: float) -> Polygon:
    """A regular hexagon about the origin with two corners on the x axis, by its width across flats."""
    half = _require_length("width across flats", flats_mm) / 2
    x = half / math.sqrt(3)
    return Polygon(((2 * x, 0.0), (x, half), (-x, half), (-2 * x, 0.0), (-x, -half), (x, -half)), "hexagon")


def polygon(corners_mm: Sequence[Sequence[float]] | FloatArray) -> Polygon:
    """Any other, by its corners (n, 2) in order around it; a last one that repeats the first is dropped."""
    corners = [(float(x), float(y)) for x, y in corners_mm]
    return Polygon(tuple(corners[:-1] if len(corners) > 3 and corners[0] == corners[-1] else corners))


def _require_length(what: str, value_mm: float) -> float:
    if not 0 < value_mm < math.inf:
        raise ComputeError(f"the outline's {what} is {value_mm:g} mm; it must be above 0. Correct it")
    return value_mm


def _crossing(corner: FloatArray) -> tuple[int, int] | None:
    """Numbers, from 1, of the corners at which two sides begin that meet elsewhere than in a corner that they share."""
    end = np.roll(corner, -1, axis=0)
    side = end - corner
    away = corner[None] - corner[:, None]
    turn = np.sign(side[:, None, 0] * away[..., 1] - side[:, None, 1] * away[..., 0])  # of corner j off side k
    apart = turn * np.roll(turn, -1, axis=1) <= 0
    low, high = np.minimum(corner, end), np.maximum(corner, end)
    near = ((low[:, None] <= high[None]) & (high[:, None] >= low[None])).all(axis=2)
    meet = apart & apart.T & near
    place = np.arange(len(corner))
    following = (place + 1) % len(corner)
    back = np.einsum("kx,kx->k", side, side[following]) < 0
    meet[place, place] = False
    meet[place, following] = meet[following, place] = (turn[place, (place + 2) % len(corner)] == 0) & back
    first = np.argwhere(meet)
    return (int(first[0, 0]) + 1, int(first[0, 1]) + 1) if first.size else None
