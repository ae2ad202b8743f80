"""Samples that are not surface: spikes, and islands of data beside the part."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from polishd.model.errors import BadMap
from polishd.model.surface import BoolArray, FloatArray, SurfaceMap
from polishd.process.metrics import zernike

SPIKE_MADS = 12.0
"""Default distance from the Zernike fit, in scaled median absolute deviations: MSF ripple stays within 3."""
MOST_SPIKES = 0.01
"""Share of a map's samples that may be spikes: beyond it the map, not a sample, is bad."""
TERMS = 36
FLOOR_NM = 0.1
"""Least scatter believed: a computed surface has none."""
ROUNDS = 10
"""Fits at most: each without the spikes that the one before found, which drew the fit towards them."""
SIGMA_PER_MAD = 1.4826
SMALLEST_ISLAND = 0.001
"""Share of the largest piece of data below which a piece that does not touch it is no part of the part."""


@dataclass(frozen=True, slots=True)
class Despiked:
    """A map whose spikes have no data any more."""

    height_nm: FloatArray
    """(ny, nx), NaN = no data."""
    masked: BoolArray
    """(ny, nx) what was taken out: the spikes grown by a pixel on all sides."""
    spikes: int
    """Samples beyond the threshold, before they were grown."""
    threshold_nm: float
    """Distance from the fit beyond which a sample was a spike."""


def cleaned(surface: SurfaceMap, mads: float) -> tuple[SurfaceMap, int]:
    """The map without spikes and islands, and the number of spikes; ``mads`` = 0 leaves it as it is.

    Raises:
        BadMap: see ``without_spikes``.
    """
    if not mads:
        return surface, 0
    despiked = without_spikes(surface.height_nm, mads)
    return surface.with_height(without_islands(despiked.height_nm)[0]), despiked.spikes


def without_spikes(height_nm: FloatArray, mads: float = SPIKE_MADS, most: float = MOST_SPIKES) -> Despiked:
    """Take out what stands off the 36-term Zernike fit by more than ``mads`` robust standard deviations.

    Args:
        height_nm: (ny, nx), NaN = no data.
        mads: the threshold, in 1.4826 median absolute deviations of what the fit leaves.
        most: share of the samples that may be spikes.

    Raises:
        BadMap: no data, data that tell no Zernike terms apart, or more spikes than ``most``.
        ValueError: a threshold that is not positive.
    """
    if not mads > 0:
        raise ValueError(f"spikes are off by a positive number of deviations, not {mads:g}")
    valid = np.isfinite(height_nm)
    spike, threshold = np.zeros_like(valid), np.inf
    for _ in range(ROUNDS):
        fitted = zernike.fit(height_nm, valid & ~spike, TERMS, "fringe", circle_px=zernike.enclosing(valid))
        off = np.abs(height_nm - zernike.surface(fitted, valid))
        threshold = mads * max(SIGMA_PER_MAD * float(np.median(off[valid & ~spike])), FLOOR_NM)
        before, spike = spike, valid & (off > threshold)
        if np.count_nonzero(spike) > most * np.count_nonzero(valid):
            raise BadMap(
                f"{np.count_nonzero(spike)} samples stand more than {threshold:.1f} nm off the surface, more than "
                f"{most:.1%} of the map: measure again, or mask what is not the part"
            )
        if (spike == before).all():
            break
    masked = (
        valid & scipy.ndimage.binary_dilation(spike, structure=np.ones((3, 3), dtype=np.bool_))
        if spike.any()
        else spike
    )
    return Despiked(np.where(masked, np.nan, height_nm), masked, int(np.count_nonzero(spike)), threshold)


def without_islands(height_nm: FloatArray, smallest: float = SMALLEST_ISLAND) -> tuple[FloatArray, int]:
    """Take out pieces of data that are far smaller than the largest: reflections, and pixels beyond the part's edge.

    Args:
        height_nm: (ny, nx), NaN = no data.
        smallest: share of the largest piece's samples that a piece must have to stay.

    Returns:
        (ny, nx) what stays, and how many samples were taken out.
    """
    pieces, count = scipy.ndimage.label(np.isfinite(height_nm))
    if count < 2:
        return height_nm.copy(), 0
    sizes = np.bincount(pieces.ravel())
    gone = sizes < smallest * sizes[1:].max()
    gone[0] = False
    return np.where(gone[pieces], np.nan, height_nm), int(sizes[gone].sum())
