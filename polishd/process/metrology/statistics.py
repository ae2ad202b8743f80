"""PV and RMS over a stated mask, and what is taken off a surface before: piston, tilt, power. Nothing is implied."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
import scipy
from numpy.typing import ArrayLike

from polishd.model.errors import MapError
from polishd.model.surface import BoolArray, FloatArray

Removal = Literal["piston", "tilt", "power"]
"""Each with those before it: "tilt" is piston and tilt, "power" is piston, tilt and r^2, fitted together."""
WORST_RATIO = 1e-12
"""Least singular value of the normal equations, relative; below it the mask does not separate the terms."""


def pv_rms(height_nm: FloatArray, mask: BoolArray) -> tuple[float, float]:
    """Highest less lowest sample inside the mask, and RMS there about the mean, both in nm. Nothing else is removed.

    Raises:
        MapError: the mask is empty, or the surface not finite inside it.
    """
    values = samples_inside(height_nm, mask)
    return float(np.ptp(values)), float(values.std())


def trim_mask(mask: BoolArray, pixels: int) -> BoolArray:
    """The mask eroded ``pixels`` times by the cross of 4 neighbours, holes growing likewise: MetroPro's "trim".

    Beyond the array there is nothing: its border is eroded, too.

    Raises:
        ValueError: a negative number of pixels.
    """
    if pixels < 0:
        raise ValueError(f"a mask is trimmed by 0 or more pixels, not {pixels}")
    if pixels == 0:  # ndimage takes 0 for "until nothing changes"
        return mask.copy()
    return np.asarray(scipy.ndimage.binary_erosion(mask, iterations=pixels), dtype=np.bool_)


def remove_terms(height_nm: FloatArray, mask: BoolArray, removal: Removal) -> FloatArray:
    """(ny, nx) the surface less the least-squares fit of these terms over the mask; NaN outside the mask.

    Raises:
        MapError: the mask is empty, or the surface not finite inside it.
        ValueError: no such removal.
    """
    samples_inside(height_nm, mask)
    return np.where(mask, height_nm - fit_terms(height_nm, mask, removal), np.nan)


def fit_terms(height_nm: FloatArray, mask: BoolArray, removal: Removal) -> FloatArray:
    """(ny, nx) least-squares fit of these terms over the mask, evaluated everywhere.

    Raises:
        ValueError: no such removal.
    """
    if removal not in get_args(Removal):
        raise ValueError(f"what can be removed is {', '.join(get_args(Removal))}, not {removal!r}")
    return power(height_nm, mask)[0] if removal == "power" else polynomial(height_nm, mask, int(removal == "tilt"))


def polynomial(height_nm: FloatArray, mask: BoolArray, degree: int) -> FloatArray:
    """(ny, nx) least-squares polynomial of this total degree over the mask, evaluated everywhere: 0 piston, 1 plane."""
    powers = [(i, j) for i in range(degree + 1) for j in range(degree + 1 - i)]
    x, y = _scaled(mask)
    normal, right = _moments(height_nm, mask, np.vander(x, 2 * degree + 1, True), np.vander(y, 2 * degree + 1, True))
    factors = np.zeros((degree + 1, degree + 1))
    matrix = [[normal[i + k, j + m] for k, m in powers] for i, j in powers]
    factors[tuple(zip(*powers, strict=True))] = _solved(matrix, [right[power] for power in powers])
    evaluated: FloatArray = np.vander(y, degree + 1, True) @ factors @ np.vander(x, degree + 1, True).T
    return evaluated


def power(height_nm: FloatArray, mask: BoolArray) -> tuple[FloatArray, float]:
    """Least-squares piston, tilt and r^2 over the mask: the approximating sphere, for a shallow one, with its place.

    Returns:
        (ny, nx) what was fitted, evaluated everywhere; the factor of r^2 in nm per squared pixel, whatever the centre.
    """
    x, y = _scaled(mask, alike=True)
    normal, right = _moments(height_nm, mask, np.vander(x, 5, True), np.vander(y, 5, True))
    terms = [{(0, 0)}, {(0, 1)}, {(1, 0)}, {(0, 2), (2, 0)}]  # powers of y and x; the last is r^2
    matrix = [[sum(normal[i + k, j + m] for i, j in one for k, m in other) for other in terms] for one in terms]
    c = _solved(matrix, [sum(right[power] for power in term) for term in terms])
    evaluated = (c[0] + c[2] * y + c[3] * y**2)[:, None] + (c[1] * x + c[3] * x**2)[None, :]
    longer = x if x.size > y.size else y
    return evaluated, float(c[3] * (np.ptp(longer) / max(longer.size - 1, 1)) ** 2)


def _scaled(mask: BoolArray, *, alike: bool = False) -> tuple[FloatArray, FloatArray]:
    """(nx,) and (ny,) coordinates that are -1 and 1 at the mask's box, so that low powers of them are well conditioned.

    Args:
        mask: (ny, nx).
        alike: one scale for both, that of the longer side: then r^2 is round.
    """
    ends = [np.flatnonzero(mask.any(axis=axis))[[0, -1]] for axis in (0, 1)]
    half = [max((last - first) / 2, 0.5) for first, last in ends]
    if alike:
        half = [max(half)] * 2
    x, y = ((np.arange(n) - np.mean(end)) / h for n, end, h in zip(mask.shape[::-1], ends, half, strict=True))
    return x, y


def _moments(
    height_nm: FloatArray, mask: BoolArray, of_x: FloatArray, of_y: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """(k, k) sums over the mask of the products of powers of y (rows) and x (columns): of 1, and of the heights.

    For so few powers the normal equations lose nothing that shows, and cost two passes over the map.
    """
    return of_y.T @ mask.astype(np.float64) @ of_x, of_y.T @ np.where(mask, height_nm, 0.0) @ of_x


def _solved(matrix: ArrayLike, right: ArrayLike) -> FloatArray:
    """The least of the solutions where the mask does not tell all terms apart (a line of samples and a plane)."""
    return np.asarray(np.linalg.lstsq(np.asarray(matrix), np.asarray(right), rcond=WORST_RATIO)[0], dtype=np.float64)


def samples_inside(height_nm: FloatArray, mask: BoolArray) -> FloatArray:
    """(m,) the samples inside the mask.

    Raises:
        MapError: another shape than the mask's, an empty mask, or samples in it that have no data.
    """
    if height_nm.shape != mask.shape:
        raise MapError(f"the surface is {height_nm.shape}, its mask {mask.shape}")
    values = height_nm[mask]
    if values.size == 0:
        raise MapError("no sample of the surface lies inside the mask")
    if not np.isfinite(values).all():
        raise MapError(f"{np.count_nonzero(~np.isfinite(values))} samples inside the mask have no data")
    return values


# Slope of a surface over a stated integration length.


@dataclass(frozen=True, slots=True)
class SlopeFigures:
    """Slopes in microradians (nm per mm), piston and tilt of the surface removed over the mask."""

    rms_x_urad: float
    pv_x_urad: float
    rms_y_urad: float
    pv_y_urad: float
    rms_urad: float
    """RMS of the magnitude: root of the sum of squares of both."""
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
        MapError: the surface is not finite inside the mask, or the mask nowhere as wide as the length.
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
    level = remove_terms(height_nm, mask, "tilt")
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
