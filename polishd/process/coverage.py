"""How a path lies on a round part: how far it reaches, and what of the clear aperture it never touches."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from polishd.model.surface import FloatArray

ACROSS = 200
"""Samples across the clear aperture."""
STEPS = 4
"""Samples of the path a radius of the spot."""


@dataclass(frozen=True, slots=True)
class Coverage:
    """What a path covers of a part."""

    reach_mm: float
    """From the part's centre to the farthest point of the path."""
    outside: float
    """Share of the path beyond the part's rim, by its length; of a path of points, by their number."""
    unreached: float
    """Share of the clear aperture that lies farther from the path than the spot's radius."""


def coverage(start_mm: FloatArray, end_mm: FloatArray, *, spot_mm: float, part_mm: float, clear_mm: float) -> Coverage:
    """Of a path of blocks, (n, 3) mm in the part's frame; spot, part and clear aperture by their radii."""
    path = _samples(start_mm[:, :2], end_mm[:, :2], spot_mm / STEPS)
    away = np.linalg.norm(path, axis=1)
    across = np.linspace(-clear_mm, clear_mm, ACROSS)
    aperture = np.stack(np.meshgrid(across, across), axis=-1).reshape(-1, 2)
    aperture = aperture[np.linalg.norm(aperture, axis=1) <= clear_mm]
    near, _ = cKDTree(path).query(aperture, distance_upper_bound=spot_mm)
    return Coverage(float(away.max()), float(np.mean(away > part_mm)), float(np.mean(np.isinf(near))))


def _samples(start_mm: FloatArray, end_mm: FloatArray, step_mm: float) -> FloatArray:
    """(k, 2) points along all blocks, at most a step apart; of a block without length its end."""
    counts = np.maximum(np.ceil(np.linalg.norm(end_mm - start_mm, axis=1) / step_mm), 1).astype(np.int64)
    block = np.repeat(np.arange(counts.size), counts)
    number = np.arange(block.size) - np.repeat(np.cumsum(counts) - counts, counts) + 1
    along = (number / counts[block])[:, None]
    return np.asarray(start_mm[block] + along * (end_mm - start_mm)[block], dtype=np.float64)
