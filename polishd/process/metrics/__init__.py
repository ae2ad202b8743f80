"""Figures of a surface over a stated mask: docs/metrics.md says of each what it is and what not to compare it with."""

from __future__ import annotations

from polishd.process.metrics import indication, iso10110, zernike
from polishd.process.metrics.aberrations import Primary, primary
from polishd.process.metrics.bands import FIT_DEGREE, band_rms, split_bands, surface_stats
from polishd.process.metrics.comparison import Figures, MapComparison, compare
from polishd.process.metrics.psd import RadialPsd, radial_psd
from polishd.process.metrics.slopes import slope, slope_map
from polishd.process.metrics.spread import (
    Removal,
    fitted,
    polynomial,
    pv_rms,
    trimmed,
    without,
)
from polishd.process.metrics.zernike import pvr

__all__ = [
    "FIT_DEGREE",
    "MapComparison",
    "Figures",
    "Primary",
    "RadialPsd",
    "Removal",
    "band_rms",
    "compare",
    "fitted",
    "indication",
    "iso10110",
    "polynomial",
    "primary",
    "pv_rms",
    "pvr",
    "radial_psd",
    "slope",
    "slope_map",
    "split_bands",
    "surface_stats",
    "trimmed",
    "without",
    "zernike",
]
