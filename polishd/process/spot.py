"""The removal spot on a fine patch, and its integral over the cells of a sample grid.

The patch is ``PATCH`` x ``PATCH`` squares that cover the pressed area exactly, parallel to the part's x and y, row 0
at the largest y. Its squares are shared out among the grid's cells by area, so that nothing is lost or counted twice.
"""

from __future__ import annotations

from functools import cache

import numpy as np

from polishd.model.process import ToolProcess
from polishd.model.surface import FloatArray
from polishd.process import contact

PATCH = 32
"""Squares across the contact: 0.11 mm each in the paper's process, fine enough for cells of 0.5 mm and more."""


def spot_patch(process: ToolProcess, depth_mm: FloatArray, azimuth_rad: FloatArray) -> FloatArray:
    """(n, PATCH, PATCH) volume rate of each square of the patch, nm mm^2/s, at (n,) depths (mm).

    ``azimuth_rad`` (n,) is where the spindle leans, counterclockwise from the part's x. The pressure is averaged over
    each square, the speed taken at its centre, and the whole scaled to the exact volume rate.
    """
    depth = np.asarray(depth_mm, dtype=np.float64)[:, None, None]
    radius = contact.contact_radius_mm(process, depth)
    sine, cosine = np.sin(azimuth_rad)[:, None, None], np.cos(azimuth_rad)[:, None, None]
    centre = radius * ((np.arange(PATCH) + 0.5) * 2 / PATCH - 1)
    right, up = centre, -centre.transpose(0, 2, 1)
    x = right * sine - up * cosine + contact.dissipative_shift_mm(process, depth)
    y = right * cosine + up * sine
    patch = _pressure_squares() * contact.sliding_speed_mm_s(process, depth, x, y)
    volume = contact.volume_rate_nm_mm2_s(process, np.asarray(depth_mm))
    return np.asarray(patch * (volume / patch.sum(axis=(1, 2)))[:, None, None], dtype=np.float64)


def overlap(centre_mm: FloatArray, radius_mm: FloatArray, pitch_mm: float) -> tuple[FloatArray, FloatArray]:
    """How squares of the patch fall on cells of a row, along one coordinate.

    ``centre_mm`` (n,) is the patch's centre, measured from the row's outer edge; ``radius_mm`` (n,) half its side.
    Returns the (n,) first cell (whole numbers, may lie outside the row) and the (n, cells, PATCH) shares: how much of
    each square lies in each cell; over the cells they add up to 1.
    """
    first = np.floor((centre_mm - radius_mm) / pitch_mm)
    cells = int(np.ceil(2 * radius_mm.max(initial=0.0) / pitch_mm)) + 1
    side = (2 * radius_mm / PATCH)[:, None, None]
    start = (centre_mm - radius_mm - first * pitch_mm)[:, None, None] + side * np.arange(PATCH)
    edge = pitch_mm * np.arange(cells)[:, None]
    inside = np.minimum(start + side, edge + pitch_mm) - np.maximum(start, edge)
    return first, np.asarray(np.clip(inside, 0.0, None) / side, dtype=np.float64)


@cache
def _pressure_squares() -> FloatArray:
    """(PATCH, PATCH) integral of ``sqrt(1 - x^2 - y^2)`` over each square of [-1, 1]^2: exact in x, Gauss in y."""
    node, weight = np.polynomial.legendre.leggauss(32)
    edge = np.linspace(-1, 1, PATCH + 1)
    y = edge[:-1, None] + (node + 1) / PATCH
    half = np.sqrt(1 - y**2)[:, :, None]
    x = np.clip(edge, -half, half)
    area = (x * np.sqrt(half**2 - x**2) + half**2 * np.arcsin(x / half)) / 2
    return np.asarray(np.einsum("jgi,g->ji", np.diff(area, axis=2), weight / PATCH), dtype=np.float64)
