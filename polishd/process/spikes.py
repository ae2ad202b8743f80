"""Samples that are not surface: spikes, and islands of data beside the part."""

from __future__ import annotations

import numpy as np
import scipy

from polishd.model.errors import MapError
from polishd.model.surface import FloatArray, SurfaceMap
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


def cleaned(surface: SurfaceMap, mads: float) -> tuple[SurfaceMap, int]:
    """The map without spikes and islands, and the number of spikes; ``mads`` = 0 leaves it as it is.

    Raises:
        BadMap: see ``without_spikes``.
    """
    if not mads:
        return surface, 0
    height_nm, spikes = without_spikes(surface.height_nm, mads)
    return surface.with_height(without_islands(height_nm)), spikes


def without_spikes(
    height_nm: FloatArray, mads: float = SPIKE_MADS, most: float = MOST_SPIKES
) -> tuple[FloatArray, int]:
    """Take out what stands off the 36-term Zernike fit by more than ``mads`` robust standard deviations.

    Args:
        height_nm: (ny, nx), NaN = no data.
        mads: the threshold, in 1.4826 median absolute deviations of what the fit leaves.
        most: share of the samples that may be spikes.

    Returns:
        (ny, nx) the map, without data where spikes were, grown by a pixel on all sides; number of spikes before that.

    Raises:
        BadMap: no data, data that tell no Zernike terms apart, or more spikes than ``most``.
        ValueError: a threshold that is not positive.
    """
    if not mads > 0:
        raise ValueError(f"spikes are off by a positive number of deviations, not {mads:g}")
    valid = np.isfinite(height_nm)
    spike = np.zeros_like(valid)
    for _ in range(ROUNDS):
        fitted = zernike.fit(height_nm, valid & ~spike, TERMS, "fringe", circle_px=zernike.enclosing(valid))
        off = np.abs(height_nm - zernike.surface(fitted, valid))
        threshold = mads * max(SIGMA_PER_MAD * float(np.median(off[valid & ~spike])), FLOOR_NM)
        before, spike = spike, valid & (off > threshold)
        if np.count_nonzero(spike) > most * np.count_nonzero(valid):
            raise MapError(
                f"{np.count_nonzero(spike)} samples stand more than {threshold:.1f} nm off the surface, more than "
                f"{most:.1%} of the map: measure again, or mask what is not the part"
            )
        if (spike == before).all():
            break
    grown = scipy.ndimage.binary_dilation(spike, structure=np.ones((3, 3), dtype=np.bool_))
    return np.where(grown, np.nan, height_nm), int(np.count_nonzero(spike))


def without_islands(height_nm: FloatArray, smallest: float = SMALLEST_ISLAND) -> FloatArray:
    """Take out pieces of data that are far smaller than the largest: reflections, and pixels beyond the part's edge.

    Args:
        height_nm: (ny, nx), NaN = no data.
        smallest: share of the largest piece's samples that a piece must have to stay.
    """
    pieces, count = scipy.ndimage.label(np.isfinite(height_nm))
    if count < 2:
        return height_nm.copy()
    sizes = np.bincount(pieces.ravel())
    gone = sizes < smallest * sizes[1:].max()
    gone[0] = False
    return np.where(gone[pieces], np.nan, height_nm)
