"""The removal spot on a fine patch, and its integral over the cells of a sample grid.

A patch is a square of squares, parallel to the part's x and y, row 0 at the largest y, that covers the spot exactly.
Its squares are shared out among the grid's cells by area, so that nothing is lost or counted twice.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Protocol

import numpy as np
import scipy
from numpy.typing import NDArray

from polishd.model.errors import ComputeError
from polishd.model.process import MeasuredTif, ToolProcess
from polishd.model.surface import FloatArray
from polishd.process.checks import require_number
from polishd.process.removal import contact
from polishd.process.removal.contact import check_process

PATCH = 32
"""Squares across a Hertz contact: 0.11 mm each in the paper's process, fine enough for cells of 0.5 mm and more."""
SQUARES_IN_CELL = 4
MOST_PATCH = 256
"""Squares across a contact that is large against the grid's cells: 0.23 mm each at a radius of 30 mm."""


class Spot(Protocol):
    """A removal spot as it changes with the contact's depth and with where the spindle leans.

    ``depth_ratio`` (n,) is gamma of eq. 48, the contact's depth over the rigid robot's; ``azimuth_rad`` (n,) is where
    the spindle leans, counterclockwise from the part's x.
    """

    def half_width_mm(self, depth_ratio: FloatArray) -> FloatArray:
        """(n,) half the side of the patch."""
        ...

    def step_mm(self, depth_ratio: FloatArray) -> FloatArray:
        """(n,) how far two Gauss points carry the spot when it moves: about half the radius of its core."""
        ...

    def offset_mm(self, depth_ratio: FloatArray, azimuth_rad: FloatArray) -> FloatArray:
        """(n, 2) the patch's centre from the programmed point, part's x and y."""
        ...

    def patch(self, depth_ratio: FloatArray, azimuth_rad: FloatArray) -> FloatArray:
        """(n, squares, squares) volume rate of each square of the patch, nm mm^2/s, not negative."""
        ...


@dataclass(frozen=True, slots=True)
class HertzSpot:
    """Hertz pressure and Preston's law (paper eq. 16-33, 45)."""

    process: ToolProcess
    squares: int = PATCH
    """Across the patch."""

    def depth_mm(self, depth_ratio: FloatArray) -> FloatArray:
        """(n,) contact depth, mm."""
        return contact.hertz_depth_mm(self.process) * np.asarray(depth_ratio, dtype=np.float64)

    def half_width_mm(self, depth_ratio: FloatArray) -> FloatArray:
        """(n,) the contact's radius."""
        return contact.contact_radius_mm(self.process, self.depth_mm(depth_ratio))

    def step_mm(self, depth_ratio: FloatArray) -> FloatArray:
        """(n,) half the contact's radius."""
        return self.half_width_mm(depth_ratio) / 2

    def offset_mm(self, depth_ratio: FloatArray, azimuth_rad: FloatArray) -> FloatArray:
        """(n, 2) the configured offset, and the dissipative shift of the pressure."""
        x_mm, y_mm = self.process.spot_offset_mm
        return rotate_spot(
            x_mm + contact.dissipative_shift_mm(self.process, self.depth_mm(depth_ratio)), y_mm, azimuth_rad
        )

    def patch(self, depth_ratio: FloatArray, azimuth_rad: FloatArray) -> FloatArray:
        """(n, squares, squares) nm mm^2/s.

        The pressure is averaged over each square, the speed taken at its centre, and the whole scaled to the exact
        volume rate. In memory the spots come last: they are worked on by long rows.
        """
        depth = self.depth_mm(depth_ratio)
        right, down = self._sliding(depth, azimuth_rad)
        right *= right
        down *= down
        patch = np.asarray(right + down[:, None])
        np.sqrt(patch, out=patch)  # hypot takes four times as long
        patch *= _pressure_squares(self.squares)[:, :, None]
        whole = np.cumsum(patch.sum(axis=0), axis=0)[-1]  # one by one: a spot is the same, however many there are
        patch *= contact.volume_rate_nm_mm2_s(self.process, depth) / whole
        return patch.transpose(2, 0, 1)

    def _sliding(self, depth: FloatArray, azimuth: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(squares, n) of columns and of rows: the sliding velocity's two components, over the spin.

        It is linear in the place, and turned by a quarter: a component goes by the column alone, the other by the row.
        """
        sine, cosine, dip = np.sin(azimuth), np.cos(azimuth), np.radians(self.process.dip_deg)
        middle = np.sin(dip) * (self.process.tool_radius_mm - depth)
        shift = np.cos(dip) * contact.dissipative_shift_mm(self.process, depth)
        across = ((np.arange(self.squares) + 0.5) * 2 / self.squares - 1)[:, None]
        place = np.cos(dip) * contact.contact_radius_mm(self.process, depth) * across
        return middle * cosine + shift * sine + place, middle * sine - shift * cosine - place


@dataclass(frozen=True, slots=True)
class WiderSpot:
    """A spot spread over another width, its volume the same."""

    spot: Spot
    factor: float

    def half_width_mm(self, depth_ratio: FloatArray) -> FloatArray:
        """(n,) mm."""
        return self.factor * self.spot.half_width_mm(depth_ratio)

    def step_mm(self, depth_ratio: FloatArray) -> FloatArray:
        """(n,) mm."""
        return self.factor * self.spot.step_mm(depth_ratio)

    def offset_mm(self, depth_ratio: FloatArray, azimuth_rad: FloatArray) -> FloatArray:
        """(n, 2) mm, as it was."""
        return self.spot.offset_mm(depth_ratio, azimuth_rad)

    def patch(self, depth_ratio: FloatArray, azimuth_rad: FloatArray) -> FloatArray:
        """(n, squares, squares) nm mm^2/s: the squares grow, what each removes does not."""
        return self.spot.patch(depth_ratio, azimuth_rad)


def hertz_spot(process: ToolProcess, pitch_mm: float) -> HertzSpot:
    """Hertz's spot for a grid of this pitch: its squares are no wider than a quarter of a cell, down to MOST_PATCH.

    Wider ones show: a spot of 10 mm radius is wrong by up to 6 % of its peak in cells of 0.5 mm with 32 squares across,
    by 0.4 % with 128. ComputeError for an impossible process or pitch.
    """
    require_number("the grid's pitch", pitch_mm, "mm", above=0.0)
    width = 2 * float(contact.contact_radius_mm(process, contact.hertz_depth_mm(process)))
    return HertzSpot(process, min(max(PATCH, int(np.ceil(SQUARES_IN_CELL * width / pitch_mm))), MOST_PATCH))


def rotate_spot(x_mm: float | FloatArray, y_mm: float | FloatArray, azimuth_rad: FloatArray) -> FloatArray:
    """(n, 2) part's x and y of a vector in the tool's frame (y where the spindle leans), mm."""
    sine, cosine = np.sin(azimuth_rad), np.cos(azimuth_rad)
    return np.stack([x_mm * sine + y_mm * cosine, y_mm * sine - x_mm * cosine], axis=-1)


def tilt_spot(patch: FloatArray, correlation: FloatArray, rows: NDArray[np.int64] | None = None) -> FloatArray:
    """(n, squares, squares) patches of discs, each row moved and narrowed so that they are ellipses within the patch.

    ``correlation`` (n,) of x and y over each ellipse; as wide and as tall as the disc was. What a row holds is kept.
    With ``rows`` (n, r) the patches are (n, r, squares): these rows of each alone.
    """
    squares = patch.shape[-1]
    content = np.concatenate([np.zeros((*patch.shape[:2], 1)), np.cumsum(patch, axis=2)], axis=2)
    edge = np.linspace(-1, 1, squares + 1)
    up = 1 - ((np.arange(squares) if rows is None else rows) + 0.5) * 2 / squares
    moved = (edge - correlation[:, None, None] * up[..., None]) / np.sqrt(1 - correlation**2)[:, None, None]
    place = np.clip((moved + 1) * squares / 2, 0, squares)
    left = np.minimum(place.astype(np.int64), squares - 1)
    low, high = (np.take_along_axis(content, left + k, axis=2) for k in (0, 1))
    return np.asarray(np.diff(low + (place - left) * (high - low), axis=2), dtype=np.float64)


def cell_shares(centre_mm: FloatArray, half_mm: FloatArray, pitch_mm: float, cells: int, squares: int) -> FloatArray:
    """(n, cells, squares) how much of each square lies in each cell; the (n,) centres from the first cell's edge."""
    side = (2 * half_mm / squares)[:, None, None]
    start = (centre_mm - half_mm)[:, None, None] + side * np.arange(squares)
    edge = pitch_mm * np.arange(cells)[:, None]
    inside = np.minimum(start + side, edge + pitch_mm) - np.maximum(start, edge)
    return np.asarray(np.clip(inside, 0.0, None) / side, dtype=np.float64)


@cache
def _pressure_squares(squares: int) -> FloatArray:
    """(squares, squares) integral of ``sqrt(1 - x^2 - y^2)`` over each square of [-1, 1]^2: exact in x, Gauss in y."""
    node, weight = np.polynomial.legendre.leggauss(32)
    edge = np.linspace(-1, 1, squares + 1)
    y = edge[:-1, None] + (node + 1) / squares
    half = np.sqrt(1 - y**2)[:, :, None]
    x = np.clip(edge, -half, half)
    area = (x * np.sqrt(half**2 - x**2) + half**2 * np.arcsin(x / half)) / 2
    return np.asarray(np.einsum("jgi,g->ji", np.diff(area, axis=2), weight / squares), dtype=np.float64)


# A removal spot that was measured, as the contact's depth and the spindle's azimuth change it.

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
