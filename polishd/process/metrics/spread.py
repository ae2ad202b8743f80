"""PV and RMS over a stated mask, and what is taken off a surface before: piston, tilt, power. Nothing is implied."""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np
import scipy

from polishd.model.errors import BadMap
from polishd.model.surface import BoolArray, FloatArray
from polishd.process.metrics.fitting import points, triangle

Removal = Literal["piston", "tilt", "power"]
"""Each with those before it: "tilt" is piston and tilt, "power" is piston, tilt and r^2, fitted together."""


def pv_rms(height_nm: FloatArray, mask: BoolArray) -> tuple[float, float]:
    """Highest less lowest sample inside the mask, and RMS there about the mean, both in nm. Nothing else is removed.

    Raises:
        BadMap: the mask is empty, or the surface not finite inside it.
    """
    values = inside(height_nm, mask)
    return float(np.ptp(values)), float(values.std())


def trimmed(mask: BoolArray, pixels: int) -> BoolArray:
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


def without(height_nm: FloatArray, mask: BoolArray, removal: Removal) -> FloatArray:
    """(ny, nx) the surface less the least-squares fit of these terms over the mask; NaN outside the mask.

    Raises:
        BadMap: the mask is empty, or the surface not finite inside it.
        ValueError: no such removal.
    """
    inside(height_nm, mask)
    return np.where(mask, height_nm - fitted(height_nm, mask, removal), np.nan)


def fitted(height_nm: FloatArray, mask: BoolArray, removal: Removal) -> FloatArray:
    """(ny, nx) least-squares fit of these terms over the mask, evaluated everywhere.

    Raises:
        ValueError: no such removal.
    """
    if removal not in get_args(Removal):
        raise ValueError(f"what can be removed is {', '.join(get_args(Removal))}, not {removal!r}")
    return power(height_nm, mask)[0] if removal == "power" else polynomial(height_nm, mask, int(removal == "tilt"))


def polynomial(height_nm: FloatArray, mask: BoolArray, degree: int) -> FloatArray:
    """(ny, nx) least-squares polynomial of this total degree over the mask, evaluated everywhere: 0 piston, 1 plane."""
    y, x = (np.linspace(-1, 1, n) for n in height_nm.shape)
    powers = [(i, j) for i in range(degree + 1) for j in range(degree + 1 - i)]
    found = triangle(lambda u, v: np.stack([u**i * v**j for i, j in powers]), *points(mask, x, y), height_nm[mask])
    factors = np.zeros((degree + 1, degree + 1))
    factors[tuple(zip(*powers, strict=True))] = np.linalg.lstsq(found[:, :-1], found[:, -1], rcond=None)[0]
    evaluated: FloatArray = np.vander(y, degree + 1, increasing=True) @ factors.T @ np.vander(x, degree + 1, True).T
    return evaluated


def power(height_nm: FloatArray, mask: BoolArray) -> tuple[FloatArray, float]:
    """Least-squares piston, tilt and r^2 over the mask: the approximating sphere, for a shallow one, with its place.

    Returns:
        (ny, nx) what was fitted, evaluated everywhere; the factor of r^2 in nm per squared pixel, whatever the centre.
    """
    rows, columns = height_nm.shape
    half = max(rows, columns) / 2  # one scale for both: r^2 is round whatever the array's shape
    y, x = ((rows - 1) / 2 - np.arange(rows)) / half, (np.arange(columns) - (columns - 1) / 2) / half
    found = triangle(lambda u, v: np.stack([np.ones_like(u), u, v, u**2 + v**2]), *points(mask, x, y), height_nm[mask])
    c = np.linalg.lstsq(found[:, :-1], found[:, -1], rcond=None)[0]
    return (c[0] + c[2] * y + c[3] * y**2)[:, None] + (c[1] * x + c[3] * x**2)[None, :], float(c[3] / half**2)


def inside(height_nm: FloatArray, mask: BoolArray) -> FloatArray:
    """(m,) the samples inside the mask.

    Raises:
        BadMap: another shape than the mask's, an empty mask, or samples in it that have no data.
    """
    if height_nm.shape != mask.shape:
        raise BadMap(f"the surface is {height_nm.shape}, its mask {mask.shape}")
    values = height_nm[mask]
    if values.size == 0:
        raise BadMap("no sample of the surface lies inside the mask")
    if not np.isfinite(values).all():
        raise BadMap(f"{np.count_nonzero(~np.isfinite(values))} samples inside the mask have no data")
    return values
