"""What a fit leaves: its size, the area over which it is one and the same, and the samples that do not belong to it."""

from __future__ import annotations

import numpy as np
import scipy

from polishd.model.surface import BoolArray, FloatArray
from polishd.process.identification.passes import RemovalNoise

NORMAL = 1.4826
"""Standard deviation over the median of the magnitudes, of a normal distribution."""
OUTLIER = 4.5
"""Standard deviations from which a sample, or the mean of a window, is none of the pass: 1 of 150,000 by chance."""
WINDOW = 3
"""Samples across the window: a bump of no sample's own."""
LOCAL = 0.1
"""Share of the samples up to which outliers are something local: more is a model that does not fit."""
NEGLIGIBLE = 0.05
"""Correlation below which the noise of two samples is taken for independent."""


def outliers(residual_nm: FloatArray, mask: BoolArray, noise: RemovalNoise, pitch_mm: float) -> BoolArray:
    """(ny, nx) samples that are none of the pass: pits, drop-outs read as heights, a local bump, and their rims.

    A bump of more than `LOCAL` of the map stays, and so do single samples: that is no local matter.

    Args:
        residual_nm: (ny, nx) of a robust fit of all parameters.
        mask: (ny, nx) samples with data.
        noise: what is stated of the map.
        pitch_mm: of the grid.
    """
    left = np.where(mask, residual_nm - np.median(residual_nm[mask]), 0.0)
    sigma = size_nm(left, mask, noise)
    alone = mask & (abs(left) > OUTLIER * sigma)
    calm = mask & ~alone
    total = _box(np.where(calm, left, 0.0))
    count = np.rint(_box(calm.astype(np.float64)))
    apart = np.sqrt(np.maximum(count, 1) * noise.cells(pitch_mm))
    raised = (count >= WINDOW) & (abs(total) > OUTLIER * sigma * apart)
    alone = scipy.ndimage.binary_dilation(alone)
    for found in (mask & (alone | raised), mask & alone):
        if found.sum() <= LOCAL * mask.sum():
            return np.asarray(found, dtype=np.bool_)
    return np.zeros_like(mask)


def size_nm(residual_nm: FloatArray, mask: BoolArray, noise: RemovalNoise) -> float:
    """Standard deviation of a residual by its median magnitude; not less than the map's stated noise."""
    return max(noise.sigma_nm, NORMAL * float(np.median(abs(residual_nm[mask]))))


def own_noise(residual_nm: FloatArray, mask: BoolArray, noise: RemovalNoise, pitch_mm: float) -> RemovalNoise:
    """The noise that a fit has to reckon with: what is stated, or what is left where that is more.

    The area is the sum of the residual's autocorrelation over the rings of lags, out to the first that is negligible.
    """
    left = np.where(mask, residual_nm - residual_nm[mask].mean(), 0.0)
    shape = [scipy.fft.next_fast_len(2 * n, real=True) for n in mask.shape]
    power, count = (
        scipy.fft.irfft2(abs(scipy.fft.rfft2(v, shape)) ** 2, shape) for v in (left, mask.astype(np.float64))
    )
    rows, columns = (np.fft.fftfreq(n, 1 / n) for n in shape)
    ring = np.rint(np.hypot(rows[:, None], columns[None, :])).astype(int)
    reach = min(mask.shape) // 4
    near = (ring <= reach) & (count > 0.5)
    pairs = np.bincount(ring[near], count[near], minlength=reach + 1)
    alike = np.bincount(ring[near], power[near], minlength=reach + 1) / np.maximum(pairs, 1)
    lags = np.bincount(ring[near], minlength=reach + 1)
    correlation = alike / alike[0] if alike[0] > 0 else np.eye(1, reach + 1)[0]
    end = int(np.argmax(correlation < NEGLIGIBLE)) or reach
    cells = float((correlation * lags)[:end].sum())
    return RemovalNoise(size_nm(left, mask, noise), max(noise.area_mm2, cells * pitch_mm**2))


def without_plane(values: FloatArray, mask: BoolArray) -> FloatArray:
    """(N,) or (N, k) values at a mask's samples, less the plane that fits each best: without piston and tilt."""
    rows, across = np.nonzero(mask)
    plane = np.linalg.qr(np.column_stack([np.ones(rows.size), rows - rows.mean(), across - across.mean()]))[0]
    return np.asarray(values - plane @ (plane.T @ values), dtype=np.float64)


def _box(values: FloatArray) -> FloatArray:
    """Sums over the window about each sample."""
    means = scipy.ndimage.uniform_filter(values, WINDOW, mode="constant")
    return np.asarray(means * WINDOW**2, dtype=np.float64)
