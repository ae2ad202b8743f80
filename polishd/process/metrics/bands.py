"""Figures of a surface over a stated mask: RMS, PV, bands of periods, radial PSD. The mean is always removed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy import fft, ndimage

from polishd.model.errors import BadMap
from polishd.model.surface import BoolArray, FloatArray, SurfaceStats

FIT_DEGREE = 2
"""Total degree of the polynomial taken off before filtering: without it the extension has steep edges."""


@dataclass(frozen=True, slots=True)
class RadialPsd:
    """Power spectral density in rings of frequency; ``sum(density * area)`` is the variance inside the mask."""

    frequency_per_mm: FloatArray
    """(k,) mean frequency of each ring, ascending; the mean's ring is left out."""
    density_nm2_mm2: FloatArray
    """(k,) mean of the two-dimensional density in the ring."""
    area_per_mm2: FloatArray
    """(k,) area of the ring in the frequency plane: its samples times the area of each."""


def surface_stats(
    height_nm: FloatArray,
    mask: BoolArray,
    pitch_mm: float,
    *,
    lsf_period_mm: float,
    band_period_mm: float | None = None,
) -> SurfaceStats:
    """Figures over a mask.

    Args:
        height_nm: (ny, nx), positive = high, finite inside ``mask``.
        mask: (ny, nx) the clear aperture.
        pitch_mm: distance of samples.
        lsf_period_mm: the low-frequency figure is what has longer periods than this.
        band_period_mm: the same for ``band_rms_nm``; None where the whole surface counts.

    Raises:
        BadMap: the mask is empty, or the surface not finite inside it.
    """
    inside = _inside(height_nm, mask)
    return SurfaceStats(
        rms_nm=float(inside.std()),
        pv_nm=float(np.ptp(inside)),
        lsf_rms_nm=band_rms(height_nm, mask, pitch_mm, lsf_period_mm),
        band_rms_nm=None if band_period_mm is None else band_rms(height_nm, mask, pitch_mm, band_period_mm),
        samples=int(inside.size),
    )


def band_rms(height_nm: FloatArray, mask: BoolArray, pitch_mm: float, period_above_mm: float) -> float:
    """RMS in nm (mean removed, inside the mask) of the periods above ``period_above_mm``; see ``split_bands``."""
    return float(split_bands(height_nm, mask, pitch_mm, (period_above_mm,))[0][mask].std())


def split_bands(
    height_nm: FloatArray, mask: BoolArray, pitch_mm: float, edges_mm: Sequence[float]
) -> tuple[FloatArray, ...]:
    """Split a masked surface into bands of periods.

    A low-order fit is taken off (and given to the first band), the rest is extended from the nearest edge and tapered
    to zero, and ideal band-passes are applied. A zero-filled mask would put 13-20 % into the wrong bands.

    Args:
        height_nm: (ny, nx), finite inside ``mask``.
        mask: (ny, nx) samples that count.
        pitch_mm: distance of samples.
        edges_mm: periods between the bands, falling, for instance ``(33.0, 0.12)``. An edge below the Nyquist period
            leaves nothing for the last band.

    Returns:
        ``len(edges_mm) + 1`` maps (ny, nx), longest periods first, NaN outside the mask; they sum to the map.

    Raises:
        BadMap: the mask is empty, or the surface not finite inside it.
        ValueError: edges that do not fall, or are not positive.
    """
    edges = np.asarray(edges_mm, dtype=np.float64)
    if edges.size == 0 or edges.min() <= 0 or (np.diff(edges) >= 0).any():
        raise ValueError(f"periods between bands must be positive and fall, not {tuple(edges_mm)}")
    _inside(height_nm, mask)
    fit = polynomial(height_nm, mask, FIT_DEGREE)
    rest = np.where(mask, height_nm - fit, np.nan)
    extended, margin = _extended(rest, mask, int(np.ceil(min(edges[0] / pitch_mm, max(mask.shape)))))
    spectrum = fft.rfft2(extended)
    frequency = _frequency(extended.shape, pitch_mm)
    window = (slice(margin, margin + mask.shape[0]), slice(margin, margin + mask.shape[1]))
    below = []
    for edge in edges:
        kept = spectrum if edge <= 2 * pitch_mm else np.where(frequency <= 1 / edge, spectrum, 0)
        below.append(fit + fft.irfft2(kept, extended.shape)[window])
    steps = [below[0], *(b - a for a, b in pairwise(below)), height_nm - below[-1]]
    return tuple(np.where(mask, step, np.nan) for step in steps)


def radial_psd(height_nm: FloatArray, mask: BoolArray, pitch_mm: float) -> RadialPsd:
    """Radially averaged power spectral density of a masked surface, nm^2 mm^2.

    The surface is extended beyond the mask and tapered as in ``split_bands`` (plane off, a sixteenth of the map wide),
    and scaled such that the sum over the rings is the variance inside the mask, plane removed (Parseval).

    Args:
        height_nm: (ny, nx), finite inside ``mask``.
        mask: (ny, nx) samples that count.
        pitch_mm: distance of samples.

    Raises:
        BadMap: the mask is empty, or the surface not finite inside it.
    """
    _inside(height_nm, mask)
    rest = np.where(mask, height_nm - polynomial(height_nm, mask, 1), np.nan)
    extended, _ = _extended(rest, mask, max(mask.shape) // 16 + 1)
    power = np.abs(fft.fft2(extended - extended.mean())) ** 2
    ny, nx = power.shape
    cell = 1 / (ny * nx * pitch_mm**2)
    if power.any():
        power *= float(np.var(rest[mask])) / (power.sum() * cell)
    frequency = np.hypot(fft.fftfreq(ny, pitch_mm)[:, None], fft.fftfreq(nx, pitch_mm)[None, :])
    ring = np.rint(frequency * max(ny, nx) * pitch_mm).astype(np.intp).ravel()
    count = np.bincount(ring)
    some = count > 0
    some[0] = False
    mean = np.bincount(ring, power.ravel())[some] / count[some]
    return RadialPsd(np.bincount(ring, frequency.ravel())[some] / count[some], mean, count[some] * cell)


def polynomial(height_nm: FloatArray, mask: BoolArray, degree: int) -> FloatArray:
    """(ny, nx) least-squares polynomial of this total degree over the mask, evaluated everywhere: 0 piston, 1 plane."""
    y, x = (np.linspace(-1, 1, n) for n in height_nm.shape)
    x, y = np.meshgrid(x, y)
    terms = np.stack([x**i * y**j for i in range(degree + 1) for j in range(degree + 1 - i)], axis=-1)
    factors = np.linalg.lstsq(terms[mask], height_nm[mask], rcond=None)[0]
    return np.asarray(terms @ factors, dtype=np.float64)


def _inside(height_nm: FloatArray, mask: BoolArray) -> FloatArray:
    if height_nm.shape != mask.shape:
        raise BadMap(f"the surface is {height_nm.shape}, its mask {mask.shape}")
    inside = height_nm[mask]
    if inside.size == 0:
        raise BadMap("no sample of the surface lies inside the mask")
    if not np.isfinite(inside).all():
        raise BadMap(f"{np.count_nonzero(~np.isfinite(inside))} samples inside the mask have no data")
    return inside


def _extended(height_nm: FloatArray, mask: BoolArray, margin: int) -> tuple[FloatArray, int]:
    """The map padded on all sides, each sample outside the mask that of the nearest edge times a raised cosine."""
    wide = np.pad(mask, margin)
    distance, (row, column) = ndimage.distance_transform_edt(~wide, return_indices=True)
    taper = 0.5 + 0.5 * np.cos(np.pi * np.minimum(distance / margin, 1.0))
    extended: FloatArray = np.pad(height_nm, margin)[row, column] * taper
    return extended, margin


def _frequency(shape: tuple[int, ...], pitch_mm: float) -> FloatArray:
    """Radial frequency of the real FFT's samples, 1/mm."""
    y, x = fft.fftfreq(shape[0], pitch_mm), fft.rfftfreq(shape[1], pitch_mm)
    return np.asarray(np.hypot(y[:, None], x[None, :]), dtype=np.float64)
