"""Two maps of one part beside each other, as the paper's Table V and fig. 15 have them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from polishd.model.surface import BoolArray, FloatArray
from polishd.process.metrics.bands import EDGES_MM, split_bands
from polishd.process.metrics.psd import RadialPsd, radial_psd
from polishd.process.metrics.spread import pv_rms, without


@dataclass(frozen=True, slots=True)
class Figures:
    """A surface's figures over the mask of the comparison, the mean removed and nothing else."""

    pv_nm: float
    rms_nm: float
    band_rms_nm: tuple[float, ...]
    """Longest periods first: with the usual two edges LSF, MSF and HSF."""
    psd: RadialPsd


@dataclass(frozen=True, slots=True)
class MapComparison:
    """Table V: each change is relative to the surface before, ``after / before - 1``; negative is better.

    The PSDs are those of fig. 15. A change from 0 is 0 or infinite.
    """

    before: Figures
    after: Figures
    edges_mm: tuple[float, ...]
    pv_change: float
    rms_change: float
    band_changes: tuple[float, ...]
    removed_rms_nm: float
    """RMS about its mean of ``before - after``: a small one says that the two are one measurement."""
    samples: int


def compare(
    before_nm: FloatArray,
    after_nm: FloatArray,
    mask: BoolArray,
    pitch_mm: float,
    edges_mm: Sequence[float] = EDGES_MM,
) -> MapComparison:
    """Figures of two registered maps over one mask, and their relative changes.

    Args:
        before_nm: (ny, nx), finite inside ``mask``; level both before, in the same way, where tilt is alignment.
        after_nm: (ny, nx) likewise.
        mask: (ny, nx) one mask for both: a trim alone changes RMS by 30 %.
        pitch_mm: distance of samples.
        edges_mm: periods between the bands, falling.

    Raises:
        BadMap: the mask is empty, has another shape, or a surface is not finite inside it.
        ValueError: edges that do not fall, or are not positive.
    """
    before, after = (figures(height, mask, pitch_mm, edges_mm) for height in (before_nm, after_nm))
    return MapComparison(
        before=before,
        after=after,
        edges_mm=tuple(edges_mm),
        pv_change=_change(before.pv_nm, after.pv_nm),
        rms_change=_change(before.rms_nm, after.rms_nm),
        band_changes=tuple(map(_change, before.band_rms_nm, after.band_rms_nm)),
        removed_rms_nm=pv_rms(before_nm - after_nm, mask)[1],
        samples=int(np.count_nonzero(mask)),
    )


def figures(height_nm: FloatArray, mask: BoolArray, pitch_mm: float, edges_mm: Sequence[float] = EDGES_MM) -> Figures:
    """PV and RMS of one surface, band RMS and PSD of it without tilt; arguments and errors are those of ``compare``."""
    pv, rms = pv_rms(height_nm, mask)
    bands = split_bands(without(height_nm, mask, "tilt"), mask, pitch_mm, edges_mm)
    return Figures(pv, rms, tuple(float(band[mask].std()) for band in bands), radial_psd(height_nm, mask, pitch_mm))


def _change(before: float, after: float) -> float:
    if before > 0:
        return after / before - 1
    return 0.0 if after == before else float("inf")
