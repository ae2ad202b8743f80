"""A radially averaged power spectral density, for looking at."""

from __future__ import annotations

import numpy as np

from polishd.plugins.run_report.folder import BoolArray, FloatArray
from polishd.process import metrics


def radial_psd(height_nm: FloatArray, mask: BoolArray, pitch_mm: float) -> tuple[FloatArray, FloatArray]:
    """Spatial frequency (1/mm) and ``metrics.radial_psd`` (nm^2 mm^2), its rings gathered to a sixth of an octave each.

    Raises:
        ValueError: fewer than 16 samples.
    """
    valid = mask & np.isfinite(height_nm)
    if np.count_nonzero(valid) < 16:
        raise ValueError("too few samples in the clear aperture for a spectrum")
    psd = metrics.radial_psd(height_nm, valid, pitch_mm, "taper")
    frequency, area = psd.frequency_per_mm, psd.area_per_mm2
    shown = frequency <= 0.5 / pitch_mm  # beyond it, only the corners of the square of frequencies
    band = np.floor(6 * np.log2(frequency[shown] / frequency[0])).astype(np.intp)
    whole = np.bincount(band, area[shown])
    some = whole > 0
    mean_frequency, mean = (
        np.asarray(np.bincount(band, (value * area)[shown])[some] / whole[some], dtype=np.float64)
        for value in (frequency, psd.density_nm2_mm2)
    )
    return mean_frequency, mean
