"""A masked surface continued beyond its mask, so that its spectrum is the surface's and not the mask's."""

from __future__ import annotations

import numpy as np
import scipy

from polishd.model.surface import BoolArray, FloatArray

WORKERS = 2
"""Threads of the Fourier transforms: more than that gains little on maps of this size."""


def extended(height_nm: FloatArray, mask: BoolArray, margin: int) -> tuple[FloatArray, tuple[slice, slice]]:
    """The map with a margin, each sample outside the mask that of the nearest edge times a raised cosine.

    Args:
        height_nm: (ny, nx), finite inside ``mask``; what is outside does not matter.
        mask: (ny, nx) samples that count.
        margin: distance in samples over which the extension falls to zero.

    Returns:
        The wider map, (ny + margin, nx + margin) or a little more, of a size that is fast to transform; and where the
        map is in it. It is periodic: what leaves on one side comes back on the other, where it has fallen to zero.
    """
    shape = tuple(scipy.fft.next_fast_len(n + 2 * margin, real=True) for n in mask.shape)
    window = (slice(margin, margin + mask.shape[0]), slice(margin, margin + mask.shape[1]))
    wide = np.zeros(shape, dtype=np.bool_)
    wide[window] = mask
    distance, (row, column) = scipy.ndimage.distance_transform_edt(~wide, return_indices=True)
    taper = 0.5 + 0.5 * np.cos(np.pi * np.minimum(distance / margin, 1.0))
    found: FloatArray = height_nm[row - margin, column - margin] * taper
    return found, window
