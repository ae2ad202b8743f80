"""A radially averaged power spectral density, for looking at."""

from __future__ import annotations

import numpy as np
from scipy import fft, ndimage

from polishd.plugins.run_report.folder import BoolArray, FloatArray

TAPER_MM = 5.0


def radial_psd(height_nm: FloatArray, mask: BoolArray, pitch_mm: float) -> tuple[FloatArray, FloatArray]:
    """Spatial frequency (1/mm), and 2-D PSD averaged over directions (nm^2 mm^2), in bands of equal ratio.

    Mean and tilt are removed in ``mask``; its edge is tapered over some mm so that it leaks little into short
    periods. The whole sum over both dimensions is the variance under the taper.
    """
    valid = mask & np.isfinite(height_nm)
    if np.count_nonzero(valid) < 16:
        raise ValueError("too few samples in the clear aperture for a spectrum")
    taper = edge_taper(valid, pitch_mm)
    field = np.where(valid, without_tilt(height_nm, valid), 0.0) * taper
    power = np.abs(fft.fft2(field)) ** 2 * pitch_mm**2 / np.sum(taper**2)
    ny, nx = field.shape
    radius = np.hypot(fft.fftfreq(ny, pitch_mm)[:, None], fft.fftfreq(nx, pitch_mm)[None, :])
    return in_bands(radius.ravel(), power.ravel(), 1.0 / (max(ny, nx) * pitch_mm), 0.5 / pitch_mm)


def edge_taper(valid: BoolArray, pitch_mm: float) -> FloatArray:
    """1 inside, falling to 0 towards the edge as half a cosine."""
    depth_mm = ndimage.distance_transform_edt(np.pad(valid, 1))[1:-1, 1:-1] * pitch_mm
    return np.asarray(0.5 - 0.5 * np.cos(np.pi * np.clip(depth_mm / TAPER_MM, 0.0, 1.0)), dtype=np.float64)


def without_tilt(height_nm: FloatArray, valid: BoolArray) -> FloatArray:
    """Heights less their best plane in ``valid``."""
    row, column = np.indices(height_nm.shape, dtype=np.float64)
    design = np.stack([np.ones_like(row), row, column], axis=-1)
    plane, *_ = np.linalg.lstsq(design[valid], height_nm[valid], rcond=None)
    return np.asarray(height_nm - design @ plane, dtype=np.float64)


def in_bands(frequency: FloatArray, power: FloatArray, lowest: float, highest: float) -> tuple[FloatArray, FloatArray]:
    """Means in bands, each a sixth of an octave, empty ones left out."""
    edges = np.geomspace(lowest * 0.95, highest, max(int(6 * np.log2(highest / lowest)), 2) + 1)
    band = np.digitize(frequency, edges) - 1
    inside = (band >= 0) & (band < len(edges) - 1)
    count = np.bincount(band[inside], minlength=len(edges) - 1)
    mean_f = np.bincount(band[inside], frequency[inside], len(edges) - 1)[count > 0] / count[count > 0]
    mean_p = np.bincount(band[inside], power[inside], len(edges) - 1)[count > 0] / count[count > 0]
    return mean_f, mean_p
