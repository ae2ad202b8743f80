"""A removal spot that was measured, as the contact's depth and the spindle's azimuth change it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from polishd.model.errors import ComputeError
from polishd.model.process import MeasuredTif, ToolProcess
from polishd.model.surface import FloatArray
from polishd.process.contact import check_process
from polishd.process.robot.refusal import require_number
from polishd.process.spot import cell_shares, rotate_spot

SQUARES = 64
"""Squares across the measured spot, at most: where the map has fewer samples, they are the squares."""
TURN_DEG = 0.25
"""The spot is turned to the nearest multiple of this: 0.01 mm at the rim of one that is 10 mm wide."""


@dataclass(frozen=True, slots=True)
class MeasuredSpot:
    """The Spot of a measured TIF; made by `measured_spot`.

    Taken at the depth ratio g0 it acts at gamma scaled as a Hertz contact is: its size by ``sqrt(gamma / g0)``, its
    volume by ``(gamma / g0)^depth_exponent``. It turns with the spindle's azimuth where the TIF says so.
    """

    tif: MeasuredTif
    process: ToolProcess
    half_mm: float
    """Half the side of the patch at the depth ratio of the measurement."""
    core_mm: float
    """Radius of the disc as large as the area above half of the peak, there."""
    squares: FloatArray
    """(s, s) volume rate of each square, nm mm^2/s, there and as it lies in the map."""

    def half_width_mm(self, depth_ratio: FloatArray) -> FloatArray:
        """(n,) half the side of a square that holds the spot, however it is turned."""
        return self.half_mm * np.sqrt(depth_ratio / self.tif.depth_ratio)

    def step_mm(self, depth_ratio: FloatArray) -> FloatArray:
        """(n,) half the radius of the spot's core."""
        return self.core_mm / 2 * np.sqrt(depth_ratio / self.tif.depth_ratio)

    def offset_mm(self, depth_ratio: FloatArray, azimuth_rad: FloatArray) -> FloatArray:
        """(n, 2) the configured offset of the spot's centroid."""
        x_mm, y_mm = self.process.spot_offset_mm
        return rotate_spot(np.full_like(depth_ratio, x_mm), y_mm, azimuth_rad)

    def patch(self, depth_ratio: FloatArray, azimuth_rad: FloatArray) -> FloatArray:
        """(n, s, s) nm mm^2/s."""
        volume = (depth_ratio / self.tif.depth_ratio) ** self.process.depth_exponent
        turn = np.degrees(azimuth_rad) - self.tif.azimuth_deg if self.tif.rotates else np.zeros_like(volume)
        steps, which = np.unique(np.round(turn / TURN_DEG) % (360 / TURN_DEG), return_inverse=True)
        patches = np.stack([self._turned(step * TURN_DEG) for step in steps]) if steps.size else self.squares[None]
        return np.asarray(patches[which] * volume[:, None, None], dtype=np.float64)

    def _turned(self, degrees: float) -> FloatArray:
        """The squares turned counterclockwise, by cubic splines, with their volume kept."""
        if degrees == 0:
            return self.squares
        image = scipy.ndimage.rotate(self.squares, degrees, reshape=False, order=3)
        image = np.clip(image, 0.0, None)
        return np.asarray(image * (self.squares.sum() / image.sum()), dtype=np.float64)


def measured_spot(tif: MeasuredTif, process: ToolProcess) -> MeasuredSpot:
    """The spot of a measured TIF; its map's centre is the spot's centre.

    Raises ComputeError for a TIF that is not a finite, non-negative map with something in it, or for numbers that
    cannot be.
    """
    check_process(process)
    rate = np.asarray(tif.rate_nm_s, dtype=np.float64)
    require_number("the measured TIF's pitch", tif.pitch_mm, "mm", above=0.0)
    require_number("the measured TIF's depth_ratio", tif.depth_ratio, "", above=0.0)
    require_number("the measured TIF's azimuth_deg", tif.azimuth_deg, "deg", above=-np.inf)
    if rate.ndim != 2 or rate.size == 0 or not np.isfinite(rate).all():
        raise ComputeError(f"the measured TIF must be a map of finite rates, its shape is {rate.shape}")
    if rate.min() < 0 or rate.max() == 0:
        raise ComputeError(
            f"the measured TIF runs from {rate.min():g} to {rate.max():g} nm/s, it must remove something"
        )
    samples = _samples_across(rate)
    half, count = samples * tif.pitch_mm / 2, min(samples, SQUARES)
    down, across = (_samples_to_squares(n, tif.pitch_mm, half, count) for n in rate.shape)
    squares = down @ rate @ across.T * tif.pitch_mm**2
    core = tif.pitch_mm * float(np.sqrt(np.count_nonzero(rate > rate.max() / 2) / np.pi))
    return MeasuredSpot(tif, process, half, core, squares)


def _samples_across(rate: FloatArray) -> int:
    """Side, in samples, of the square about the map's centre that holds the spot however it is turned."""
    row, column = np.nonzero(rate)
    down = np.abs(row - (rate.shape[0] - 1) / 2) + 0.5
    across = np.abs(column - (rate.shape[1] - 1) / 2) + 0.5
    odd = int(rate.shape[0] % 2)
    return 2 * int(np.ceil(np.hypot(down, across).max() - odd / 2)) + odd


def _samples_to_squares(n: int, pitch_mm: float, half_mm: float, count: int) -> FloatArray:
    """(count, n) how much of each of n samples, centred, lies in each of the squares that fill [-half, half]."""
    # the samples are the squares of `shares` here, and the squares its cells
    centre, half = np.array([half_mm]), np.array([n * pitch_mm / 2])
    return np.asarray(cell_shares(centre, half, 2 * half_mm / count, count, n)[0], dtype=np.float64)
