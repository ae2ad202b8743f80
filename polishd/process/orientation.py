"""The eight ways in which an array can lie: four turns, and the same four of its mirror image. Named in one place."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

Turn = Literal[0, 90, 180, 270]
Point = tuple[float, float]


@dataclass(frozen=True, slots=True)
class ArrayOrientation:
    """Flip left-right where ``mirror``, then turn by ``rotation_deg`` counter-clockwise as displayed (row 0 on top)."""

    mirror: bool
    rotation_deg: Turn

    @property
    def name(self) -> str:
        """What was done to the array, in words: "as it is", "turned 90", "flipped up-down" ..."""
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
    """Those of the eight that keep an array's shape: four where it is not square."""
    return tuple(o for o in ORIENTATIONS if shape[0] == shape[1] or o.rotation_deg % 180 == 0)
