"""Where the part ends: how far inside its rim a point lies, and which way the rim is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import scipy

from polishd.model.errors import ComputeError
from polishd.model.surface import BoolArray, FloatArray, Grid
from polishd.process.robot.refusal import require_number

SMOOTH = 2.0
"""Sigma, in samples, of the smoothing with which a mask's outward direction is taken."""


class Rim(Protocol):
    """The part's rim as seen from (n, 2) points x, y of the part's frame, mm."""

    def inside_mm(self, point_mm: FloatArray) -> FloatArray:
        """(n,) distance from the rim: positive on the part, negative beside it."""
        ...

    def outward_rad(self, point_mm: FloatArray) -> FloatArray:
        """(n,) direction across the nearest rim and off the part, counterclockwise from x."""
        ...


@dataclass(frozen=True, slots=True)
class RoundRim:
    """A round part about the part's origin."""

    radius_mm: float

    def inside_mm(self, point_mm: FloatArray) -> FloatArray:
        """(n,)."""
        return np.asarray(self.radius_mm - np.hypot(point_mm[:, 0], point_mm[:, 1]), dtype=np.float64)

    def outward_rad(self, point_mm: FloatArray) -> FloatArray:
        """(n,)."""
        return np.asarray(np.arctan2(point_mm[:, 1], point_mm[:, 0]), dtype=np.float64)


@dataclass(frozen=True, slots=True)
class MaskRim:
    """A part of any outline; made by `mask_rim`."""

    grid: Grid
    sample_mm: FloatArray
    """(ny, nx) distance of the samples from the rim."""

    def inside_mm(self, point_mm: FloatArray) -> FloatArray:
        """(n,) bilinear; beyond the map the way to it is added."""
        row, column = _on_grid(self.grid, point_mm)
        near = np.clip(row, 0, self.grid.ny - 1), np.clip(column, 0, self.grid.nx - 1)
        beyond = np.hypot(row - near[0], column - near[1]) * self.grid.pitch_mm
        return np.asarray(scipy.ndimage.map_coordinates(self.sample_mm, near, order=1) - beyond, dtype=np.float64)

    def outward_rad(self, point_mm: FloatArray) -> FloatArray:
        """(n,) down the smoothed distance."""
        row, column = np.gradient(scipy.ndimage.gaussian_filter(self.sample_mm, SMOOTH, mode="nearest"))
        at = _on_grid(self.grid, point_mm)
        x, y = (scipy.ndimage.map_coordinates(slope, at, order=1, mode="nearest") for slope in (-column, row))
        return np.asarray(np.arctan2(y, x), dtype=np.float64)


def round_rim(radius_mm: float) -> RoundRim:
    """The rim of a round part. Raises ComputeError for a radius that cannot be."""
    require_number("the part's radius", radius_mm, "mm", above=0.0)
    return RoundRim(radius_mm)


def mask_rim(grid: Grid, mask: BoolArray) -> MaskRim:
    """The rim of any part: ``mask`` (ny, nx) is True on it, False in a bore. Right within 0.6 samples.

    What lies outside the map is not part. Raises ComputeError for a mask of another grid, or without a part.
    """
    if mask.shape != grid.shape:
        raise ComputeError(f"the part's mask is {mask.shape}, the grid {grid.shape}")
    if not mask.any():
        raise ComputeError("the part's mask is empty: there is no rim")
    part = np.pad(mask, 1)
    # the rim lies half way between the samples on either side of it
    inside = (
        scipy.ndimage.distance_transform_edt(part)
        - scipy.ndimage.distance_transform_edt(~part)
        - np.where(part, 0.5, -0.5)
    )
    return MaskRim(grid, np.asarray(inside[1:-1, 1:-1] * grid.pitch_mm, dtype=np.float64))


def _on_grid(grid: Grid, point_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Row and column, in samples, of (n, 2) points."""
    return (grid.y_mm[0] - point_mm[:, 1]) / grid.pitch_mm, (point_mm[:, 0] - grid.x_mm[0]) / grid.pitch_mm
