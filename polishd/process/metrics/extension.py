"""A masked surface continued beyond its mask, so that its spectrum is the surface's and not the mask's."""

from __future__ import annotations

import numpy as np
import scipy

from polishd.model.surface import BoolArray, FloatArray

WORKERS = 2
"""Threads of the Fourier transforms: more than that gains little on maps of this size."""
STEPS = 20
"""Steps of the least squares: they settle small holes; what is left in large ones is as long as they are."""
STENCIL = ((0, 0, -4.0), (1, 0, 1.0), (-1, 0, 1.0), (0, 1, 1.0), (0, -1, 1.0))
"""Rows down, columns right, weight: the Laplacian."""


def extended(height_nm: FloatArray, mask: BoolArray, margin: int) -> tuple[FloatArray, tuple[slice, slice]]:
    """The map with a margin, each sample outside the mask that of the nearest edge times a raised cosine.

    Holes in the mask are then bent flat: the steps that the nearest edge leaves in each are short periods, and many
    drop-outs bring more of them than a small HSF has (1 nm beside 15 nm of MSF, 10 % missing: 26 % too high).

    Args:
        height_nm: (ny, nx), finite inside ``mask``; what is outside does not matter.
        mask: (ny, nx) samples that count.
        margin: distance in samples over which the extension falls to zero.

    Returns:
        The wider map, (ny + margin, nx + margin) or a little more, of a size that is fast to transform; and where the
        map is in it. It is periodic: what leaves on one side comes back on the other, where it has fallen to zero.
    """
    found, wide, window = tapered(height_nm, mask, margin)
    return _bent(found, _holes(wide)), window


def tapered(height_nm: FloatArray, mask: BoolArray, margin: int) -> tuple[FloatArray, BoolArray, tuple[slice, slice]]:
    """As `extended`, with holes as the nearest edge leaves them; and the mask in the wider array."""
    shape = tuple(scipy.fft.next_fast_len(n + 2 * margin, real=True) for n in mask.shape)
    window = (slice(margin, margin + mask.shape[0]), slice(margin, margin + mask.shape[1]))
    wide = np.zeros(shape, dtype=np.bool_)
    wide[window] = mask
    # scipy's own distances are of all samples, and cost as much again
    down, right = scipy.ndimage.distance_transform_edt(~wide, return_distances=False, return_indices=True)
    down -= np.arange(shape[0], dtype=down.dtype)[:, None]
    right -= np.arange(shape[1], dtype=right.dtype)
    squared = (down**2 + right**2).ravel()
    near = np.flatnonzero((squared > 0) & (squared < margin**2))
    edge = near + down.ravel()[near] * shape[1] + right.ravel()[near]
    taper = 0.5 + 0.5 * np.cos(np.pi / margin * np.sqrt(np.arange(margin**2)))
    found = np.zeros(shape)
    np.copyto(found[window], height_nm, where=mask)
    flat = found.ravel()
    flat[near] = flat[edge] * taper[squared[near]]
    return found, wide, window


def frequencies(shape: tuple[int, ...], pitch_mm: float, columns: int | None = None) -> FloatArray:
    """(ny, nx // 2 + 1) radial frequency of the real FFT's samples of a map of this shape, 1/mm; its first columns."""
    y, x = scipy.fft.fftfreq(shape[0], pitch_mm), scipy.fft.rfftfreq(shape[1], pitch_mm)[:columns]
    return np.asarray(np.hypot(y[:, None], x[None, :]), dtype=np.float64)


def _holes(mask: BoolArray) -> BoolArray:
    """(ny, nx) what is not in the mask and does not reach the array's border."""
    outside, _ = scipy.ndimage.label(~np.pad(mask, 1))
    return np.asarray(((outside > 0) & (outside != outside[0, 0]))[1:-1, 1:-1], dtype=np.bool_)


def _bent(height_nm: FloatArray, hole: BoolArray) -> FloatArray:
    """The map with its holes filled as a thin plate: of least squared Laplacian, on and beside them."""
    if not hole.any():
        return height_nm
    unknown = np.flatnonzero(hole)
    steps = [down * hole.shape[1] + right for down, right, _ in STENCIL]
    places = np.unique(np.concatenate([unknown + step for step in steps]))  # no hole reaches the border
    filled = height_nm.copy()
    flat = filled.ravel()
    curved, entries = np.zeros(places.size), []
    for step, (_, _, weight) in zip(steps, STENCIL, strict=True):
        curved += weight * flat[places + step]
        number = np.minimum(np.searchsorted(unknown, places + step), unknown.size - 1)
        some = np.flatnonzero(unknown[number] == places + step)
        entries.append((np.full(some.size, weight), some, number[some]))
    weights, rows, columns = (np.concatenate(part) for part in zip(*entries, strict=True))
    laplacian = scipy.sparse.csr_array((weights, (rows, columns)), shape=(places.size, unknown.size))
    flat[unknown] -= scipy.sparse.linalg.lsqr(laplacian, curved, iter_lim=STEPS)[0]
    return filled
