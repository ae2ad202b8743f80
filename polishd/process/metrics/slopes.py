"""Slope of a surface over a stated integration length."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from polishd.model.errors import MapError
from polishd.model.surface import BoolArray, FloatArray
from polishd.process.metrics.spread import without


@dataclass(frozen=True, slots=True)
class SlopeFigures:
    """Slopes in microradians (nm per mm), piston and tilt of the surface removed over the mask."""

    rms_x_urad: float
    pv_x_urad: float
    rms_y_urad: float
    pv_y_urad: float
    rms_urad: float
    """Of the magnitude: root of the sum of squares of both."""
    max_urad: float
    """Largest magnitude; its least is near 0, so this is its PV, too."""
    integration_mm: float
    """Distance of the two samples whose difference a slope is: a longer one has less noise and fewer short periods."""
    samples: int
    """Places where both slopes are known."""


def slope(height_nm: FloatArray, mask: BoolArray, pitch_mm: float, integration_mm: float | None = None) -> SlopeFigures:
    """Slopes along x and y as differences over the integration length, centred on the samples.

    Args:
        height_nm: (ny, nx), positive = high, finite inside ``mask``.
        mask: (ny, nx) samples that count; a slope counts where the sample and both its ends are inside.
        pitch_mm: distance of samples.
        integration_mm: the length wanted; the nearest even number of pitches is taken, and at least two (None).

    Raises:
        BadMap: the surface is not finite inside the mask, or the mask nowhere as wide as the length.
        ValueError: a length that is not positive.
    """
    x, y, reach = _differences(height_nm, mask, pitch_mm, integration_mm)
    length = 2 * reach * pitch_mm
    known = np.isfinite(x)
    x, y = x[known], y[known]
    size = np.hypot(x, y)
    return SlopeFigures(
        rms_x_urad=_rms(x),
        pv_x_urad=float(np.ptp(x)),
        rms_y_urad=_rms(y),
        pv_y_urad=float(np.ptp(y)),
        rms_urad=_rms(size),
        max_urad=float(size.max()),
        integration_mm=length,
        samples=size.size,
    )


def slope_map(
    height_nm: FloatArray, mask: BoolArray, pitch_mm: float, integration_mm: float | None = None
) -> FloatArray:
    """(ny, nx) the slope's magnitude that ``slope`` has the figures of, urad; NaN where it does not count."""
    x, y, reach = _differences(height_nm, mask, pitch_mm, integration_mm)
    return np.pad(np.hypot(x, y), reach, constant_values=np.nan)


def _differences(
    height_nm: FloatArray, mask: BoolArray, pitch_mm: float, integration_mm: float | None
) -> tuple[FloatArray, FloatArray, int]:
    """(ny - 2 k, nx - 2 k) each: slopes along x and y, NaN where one of both does not count; and k, half the length."""
    if integration_mm is not None and not integration_mm > 0:
        raise ValueError(f"an integration length of {integration_mm:g} mm")
    level = without(height_nm, mask, "tilt")
    reach = 1 if integration_mm is None else max(1, round(integration_mm / (2 * pitch_mm)))
    length = 2 * reach * pitch_mm
    if min(mask.shape) <= 2 * reach:
        raise MapError(f"the map is nowhere as wide as the integration length, {length:g} mm")
    inner = slice(reach, -reach)
    x = (level[inner, 2 * reach :] - level[inner, : -2 * reach]) / length
    y = (level[: -2 * reach, inner] - level[2 * reach :, inner]) / length  # row 0 is the top
    known = np.isfinite(x) & np.isfinite(y) & mask[inner, inner]
    if not known.any():
        raise MapError(f"the mask is nowhere as wide as the integration length, {length:g} mm")
    return np.where(known, x, np.nan), np.where(known, y, np.nan), reach


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))
