"""Where the part ends: how far inside its rim a point lies."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from polishd.model.surface import FloatArray
from polishd.process.robot.refusal import require_number


@dataclass(frozen=True, slots=True)
class Rim:
    """The rim of a round part about the part's origin."""

    radius_mm: float

    def inside_mm(self, point_mm: FloatArray) -> FloatArray:
        """(n,) distance from the rim of (n, 2) points of the part's frame, mm: positive on the part, else negative."""
        return np.asarray(self.radius_mm - np.hypot(point_mm[:, 0], point_mm[:, 1]), dtype=np.float64)


def round_rim(radius_mm: float) -> Rim:
    """The rim of a round part. Raises ComputeError for a radius that cannot be."""
    require_number("the part's radius", radius_mm, "mm", above=0.0)
    return Rim(radius_mm)
