"""Zernike terms of a masked surface by least squares over its valid samples, whatever the mask's shape.

Never by the inner product with each term, which is right on a whole circle only (25 % off on ellipses).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from polishd.model.errors import MapError
from polishd.model.surface import BoolArray, FloatArray
from polishd.process.metrics.fitting import BLOCK, points, triangle
from polishd.process.metrics.spread import inside
from polishd.process.metrics.zernike_terms import USUAL_NORM, Norm, Ordering, order, values

WORST_CONDITION = 1e8
"""Condition of the terms over the mask beyond which they cannot be told apart."""


@dataclass(frozen=True, slots=True)
class ZernikeFit:
    """Zernike terms of a surface, and all that is needed to name and to evaluate them."""

    coefficients_nm: FloatArray
    """(k,) of the terms in their order and norm."""
    over_mask_nm: FloatArray
    """(k,) of the same terms made orthonormal over the mask itself, in their order (Gram-Schmidt): each is the RMS
    that its term adds; the first is the mean, and the squares of the others sum to the fit's variance."""
    terms: tuple[tuple[int, int], ...]
    """(n, m) of each; m > 0 is a cosine, m < 0 a sine of the angle from x (right) towards y (up)."""
    ordering: Ordering
    norm: Norm
    centre_px: tuple[float, float]
    """(row, column) of the unit circle's centre."""
    radius_px: float
    residual_rms_nm: float
    """What the fit leaves, over the mask."""
    condition: float
    """Of the terms over the mask: near 1 to 3 on a circle."""
    samples: int
    per_noise: FloatArray
    """(k, k) covariance of the coefficients, nm^2, for white noise of 1 nm in each sample."""


def fit(
    height_nm: FloatArray,
    mask: BoolArray,
    terms: int = 37,
    ordering: Ordering = "noll",
    *,
    norm: Norm | None = None,
    circle_px: tuple[float, float, float] | None = None,
) -> ZernikeFit:
    """Fit Zernike terms over the mask (QR in blocks; the whole design matrix is never in memory).

    Args:
        height_nm: (ny, nx), positive = high, finite inside ``mask``.
        mask: (ny, nx) samples that count.
        terms: how many, from piston on. 36 and 37 differ by a spherical term: say which.
        ordering: "noll" and "fringe" count from 1, "ansi" from 0.
        norm: None for the usual one of the ordering: "edge" for fringe, else "rms".
        circle_px: (row, column, radius) of the unit circle; None for the least that ``enclosing`` finds.

    Raises:
        BadMap: the surface is not finite inside the mask, there are fewer samples than terms, or the mask's shape does
            not tell the terms apart (condition above ``WORST_CONDITION``).
        ValueError: no such ordering, no terms, or a circle without radius.
    """
    heights = inside(height_nm, mask)
    pairs = order(ordering, terms)
    norm = USUAL_NORM[ordering] if norm is None else norm
    row, column, radius = circle = enclosing(mask) if circle_px is None else circle_px
    if not radius > 0:
        raise ValueError(f"a unit circle of radius {radius:g} pixels")
    if heights.size < terms:
        raise MapError(f"{heights.size} samples are too few for {terms} Zernike terms: fit fewer, or mend the mask")
    found = triangle(lambda x, y: values(pairs, norm, x, y), *unit(mask, circle), heights)
    own, projected = found[:terms, :terms], found[:terms, terms]
    condition = float(np.linalg.cond(own))
    if not condition <= WORST_CONDITION:
        raise MapError(
            f"{terms} Zernike terms cannot be told apart over this mask (condition {condition:.1e}, at most "
            f"{WORST_CONDITION:.0e}): fit fewer terms, or a circle that lies closer around the mask"
        )
    sign = np.where(np.diag(own) < 0, -1.0, 1.0)
    root = np.sqrt(heights.size)
    inverse = np.linalg.inv(own)
    return ZernikeFit(
        coefficients_nm=np.asarray(np.linalg.solve(own, projected), dtype=np.float64),
        over_mask_nm=sign * projected / root,
        terms=pairs,
        ordering=ordering,
        norm=norm,
        centre_px=(row, column),
        radius_px=radius,
        residual_rms_nm=float(abs(found[terms, terms]) / root),
        condition=condition,
        samples=heights.size,
        per_noise=inverse @ inverse.T,
    )


def surface(fitted: ZernikeFit, mask: BoolArray) -> FloatArray:
    """(ny, nx) the fitted surface in nm over a mask; NaN outside the mask."""
    x, y = unit(mask, (*fitted.centre_px, fitted.radius_px))
    heights = np.zeros(x.size)
    for start in range(0, x.size, BLOCK):
        part = slice(start, start + BLOCK)
        heights[part] = fitted.coefficients_nm @ values(fitted.terms, fitted.norm, x[part], y[part])
    found = np.full(mask.shape, np.nan)
    found[mask] = heights
    return found


@dataclass(frozen=True, slots=True)
class Pvr:
    """``pvr_nm = fit_pv_nm + 3 * residual_rms_nm``; without the number of terms it says nothing."""

    pvr_nm: float
    fit_pv_nm: float
    """PV of the fitted surface over the mask, piston and nothing else left out."""
    residual_rms_nm: float
    terms: int
    ordering: Ordering


def pvr(height_nm: FloatArray, mask: BoolArray, terms: int = 36) -> Pvr:
    """PV of a Zernike fit plus three times the RMS of what it leaves (C. J. Evans, Opt. Eng. 48(4), 043605, 2009).

    Args:
        height_nm: (ny, nx), finite inside ``mask``; take off tilt or power before where they are alignment.
        mask: (ny, nx) samples that count; the unit circle is ``enclosing(mask)``.
        terms: Zernike terms in fringe order, piston counted. Some programs take 37.

    Raises:
        BadMap: as ``fit``.
    """
    fitted = fit(height_nm, mask, terms, "fringe")
    pv = float(np.ptp(surface(fitted, mask)[mask]))
    return Pvr(pv + 3 * fitted.residual_rms_nm, pv, fitted.residual_rms_nm, terms, fitted.ordering)


def enclosing(mask: BoolArray) -> tuple[float, float, float]:
    """(row, column, radius) in pixels of a circle around a mask: the middle of its box, out to its furthest sample.

    Raises:
        BadMap: an empty mask.
    """
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    if rows.size == 0:
        raise MapError("no sample of the surface lies inside the mask")
    row, column = (rows[0] + rows[-1]) / 2, (columns[0] + columns[-1]) / 2
    # in each row the furthest sample is its first or its last
    first, last = mask[rows].argmax(axis=1), mask.shape[1] - 1 - mask[rows, ::-1].argmax(axis=1)
    across = np.maximum(np.abs(first - column), np.abs(last - column))
    return float(row), float(column), max(float(np.hypot(rows - row, across).max()), 0.5)


def unit(mask: BoolArray, circle_px: tuple[float, float, float]) -> tuple[FloatArray, FloatArray]:
    """Coordinates of the mask's samples, 1 = the circle's radius, y up."""
    row, column, radius = circle_px
    x = (np.arange(mask.shape[1]) - column) / radius
    return points(mask, x, (row - np.arange(mask.shape[0])) / radius)
