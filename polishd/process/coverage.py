"""How a path lies on a part: how far it reaches, and what of the clear aperture it never touches."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from polishd.model.outline import Outline
from polishd.model.surface import FloatArray

ACROSS = 200
"""Samples along x and along y across the clear aperture."""
STEPS = 4
"""Samples of the path a radius of the spot."""


@dataclass(frozen=True, slots=True)
class PathCoverage:
    """What a path covers of a part."""

    reach_mm: float
    """From the part's centre to the farthest point of the path."""
    outside: float
    """Share of the path farther beyond the part's rim than landing takes, by its length; of points, by number."""
    unreached: float
    """Share of the clear aperture that lies farther from the path than the spot's radius."""


def coverage(
    start_mm: FloatArray, end_mm: FloatArray, *, spot_mm: float, outline: Outline, edge_mm: float, landing_mm: float
) -> PathCoverage:
    """Of a path of blocks, (n, 3) mm in the part's frame.

    Args:
        start_mm: (n, 3) where each begins.
        end_mm: (n, 3) where each ends.
        spot_mm: radius of the spot.
        outline: of the part.
        edge_mm: width of the rim that the clear aperture leaves out.
        landing_mm: so far beyond the rim a path may run.
    """
    path = _samples(start_mm[:, :2], end_mm[:, :2], spot_mm / STEPS)
    outside = ~outline.contains(path[:, 0], path[:, 1], -landing_mm)
    x, y = np.meshgrid(*(np.linspace(edge_mm - half, half - edge_mm, ACROSS) for half in outline.half_mm))
    aperture = np.stack([x, y], axis=-1)[outline.contains(x, y, edge_mm)]
    near, _ = scipy.spatial.cKDTree(path).query(aperture, distance_upper_bound=spot_mm)
    return PathCoverage(
        float(np.linalg.norm(path, axis=1).max()), float(np.mean(outside)), float(np.mean(np.isinf(near)))
    )


def _samples(start_mm: FloatArray, end_mm: FloatArray, step_mm: float) -> FloatArray:
    """(k, 2) points along all blocks, at most a step apart; of a block without length its end."""
    counts = np.maximum(np.ceil(np.linalg.norm(end_mm - start_mm, axis=1) / step_mm), 1).astype(np.int64)
    block = np.repeat(np.arange(counts.size), counts)
    number = np.arange(block.size) - np.repeat(np.cumsum(counts) - counts, counts) + 1
    along = (number / counts[block])[:, None]
    return np.asarray(start_mm[block] + along * (end_mm - start_mm)[block], dtype=np.float64)
