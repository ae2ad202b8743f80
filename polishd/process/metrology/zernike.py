"""Zernike terms of a masked surface by least squares over its valid samples, whatever the mask's shape.

Never by the inner product with each term, which is right on a whole circle only (25 % off on ellipses).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import atan2, comb, degrees, hypot, isqrt, sqrt
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from polishd.model.errors import MapError
from polishd.model.surface import BoolArray, FloatArray
from polishd.process.metrology.statistics import samples_inside

# Zernike polynomials by their names: three orderings, two norms, and their values.

Ordering = Literal["noll", "fringe", "ansi"]
Norm = Literal["rms", "edge"]
"""rms: each term has RMS 1 over the unit circle; edge: each has amplitude 1 at its edge."""

USUAL_NORM: dict[Ordering, Norm] = {"noll": "rms", "fringe": "edge", "ansi": "rms"}
FIRST: dict[Ordering, int] = {"noll": 1, "fringe": 1, "ansi": 0}
"""Index of piston."""


def order(ordering: Ordering, terms: int) -> tuple[tuple[int, int], ...]:
    """(n, m) of the first ``terms`` polynomials; m > 0 is a cosine, m < 0 a sine of the angle from x towards y.

    Raises:
        ValueError: no such ordering, or no terms.
    """
    if ordering not in _NUMBERED:
        raise ValueError(f"an ordering of Zernike terms is one of {', '.join(_NUMBERED)}, not {ordering!r}")
    if terms < 1:
        raise ValueError(f"a fit has 1 or more terms, not {terms}")
    first = FIRST[ordering]
    return tuple(_NUMBERED[ordering](index) for index in range(first, first + terms))


def values(pairs: Sequence[tuple[int, int]], norm: Norm, x: FloatArray, y: FloatArray) -> FloatArray:
    """Polynomials at points of the unit circle.

    ``R(n, m) = sum_k (-1)^k (n-k)! / (k! ((n+m)/2-k)! ((n-m)/2-k)!) r^(n-2k)``, times cos or sin of m times the angle
    (Noll, J. Opt. Soc. Am. 66, 207, 1976); ``r^m cos`` and ``r^m sin`` are taken as powers of x + iy.

    Args:
        pairs: (n, m) of each polynomial.
        norm: their norm.
        x: (p,) coordinates, 1 = the circle's radius.
        y: (p,) likewise, up.

    Returns:
        (len(pairs), p).
    """
    square = x**2 + y**2
    angular = {0: (np.ones_like(x), np.zeros_like(x))}
    for m in range(1, max(abs(m) for _, m in pairs) + 1):
        c, s = angular[m - 1]
        angular[m] = (c * x - s * y, c * y + s * x)
    found = np.empty((len(pairs), len(x)))
    for index, (n, m) in enumerate(pairs):
        term = found[index]
        term[:], *factors = _radial(n, abs(m))
        for factor in factors:  # Horner in r^2
            term *= square
            term += factor
        if m:
            term *= angular[abs(m)][m < 0]
        if norm == "rms":
            term *= sqrt((n + 1) * (1 if m == 0 else 2))
    return found


def _radial(n: int, m: int) -> list[float]:
    """Factors of R(n, m) / r^m by falling powers of r^2."""
    half = (n - m) // 2
    return [float((-1) ** k * comb(n - k, k) * comb(n - 2 * k, half - k)) for k in range(half + 1)]


def _noll(index: int) -> tuple[int, int]:
    """Noll 1976: within each n by rising |m|, even indices are cosines."""
    n = (isqrt(8 * index - 7) - 1) // 2
    place = index - n * (n + 1) // 2  # 1 ... n + 1 within n
    m = 2 * (place // 2) if n % 2 == 0 else 2 * ((place - 1) // 2) + 1
    return n, m if index % 2 == 0 else -m


def _fringe(index: int) -> tuple[int, int]:
    """University of Arizona: by rising n + |m|, within it by falling |m|, cosine before sine."""
    half = isqrt(index - 1)  # (n + |m|) / 2
    place = index - 1 - half**2
    m = half - place // 2
    return 2 * half - m, m if place % 2 == 0 else -m


def _ansi(index: int) -> tuple[int, int]:
    """ANSI Z80.28 / ISO 24157: by rising n, then m from -n to n; piston is 0."""
    n = (isqrt(8 * index + 1) - 1) // 2
    return n, 2 * index - n * (n + 2)


_NUMBERED: dict[Ordering, Callable[[int], tuple[int, int]]] = {"noll": _noll, "fringe": _fringe, "ansi": _ansi}


# Least squares over very many samples: QR in blocks, so that the whole design matrix is never in memory.

BLOCK = 8192
"""Samples at a time: a block of 37 terms stays in the cache."""

SAMPLED = 3 * BLOCK
"""Samples whose triangle serves as a start for that of all."""
WELL_SAMPLED = 1e4
"""Largest condition of the functions over these samples: a triangle of a worse one is found by QR throughout."""
NEARLY_ORTHOGONAL = 100.0
"""Largest condition of the products of all samples' columns: with a larger one, the samples do not stand for all."""

Basis = Callable[[FloatArray, FloatArray], FloatArray]
"""Function from the coordinates of m samples, x and y, to (k, m) values of k functions."""


def triangle(basis: Basis, x: FloatArray, y: FloatArray, values: FloatArray) -> FloatArray:
    """The R of the QR decomposition of ``[basis, values]``, as it comes from blocks stacked under one another.

    Args:
        basis: the functions to be fitted.
        x: (m,) coordinates.
        y: (m,) coordinates.
        values: (m,) what they are fitted to.

    Returns:
        (k + 1, k + 1) upper triangle, zero rows below if there are fewer samples: the first k columns are the basis's
        own R, the last one is the values in the orthogonal basis; its end is the norm of what the fit leaves.
    """
    stride = len(values) // SAMPLED
    if stride > 1:
        first = _triangle_by_qr(basis, x[::stride], y[::stride], values[::stride])
        found = _triangle_near(first, basis, x, y, values)
        if found is not None:
            return found
    return _triangle_by_qr(basis, x, y, values)


def _triangle_by_qr(basis: Basis, x: FloatArray, y: FloatArray, values: FloatArray) -> FloatArray:
    found = np.zeros((0, 0))
    for start in range(0, len(values), BLOCK):
        part = slice(start, start + BLOCK)
        block = np.vstack([basis(x[part], y[part]), values[None, part]]).T
        found = _r(np.vstack([found, block]) if found.size else block)
    size = found.shape[1]
    return np.vstack([found, np.zeros((size - len(found), size))])


def _triangle_near(
    first: FloatArray, basis: Basis, x: FloatArray, y: FloatArray, values: FloatArray
) -> FloatArray | None:
    """The triangle from that of a part of the samples; None where these do not stand for all.

    In the basis that is orthogonal over some samples, the columns of all samples are nearly orthogonal. Their products
    with each other then lose no digits, and are found in a quarter of the time of a QR decomposition. Of functions that
    are nearly orthogonal themselves, as on a circle, only the values are turned: by what is fitted to some samples.
    """
    size, of_basis = len(first), first[:-1, :-1]
    condition = np.linalg.cond(of_basis)
    if not (condition <= WELL_SAMPLED and abs(first[-1, -1]) > 0):
        return None
    if only_values := condition**2 <= NEARLY_ORTHOGONAL:
        fitted, left = np.linalg.solve(of_basis, first[:-1, -1]), first[-1, -1] / np.linalg.norm(of_basis, 2)
        first = np.eye(size)
        first[:-1, -1], first[-1, -1] = fitted, left
    turned = np.linalg.inv(first).T
    products = np.zeros((size, size))
    block = np.empty((size, BLOCK))
    for start in range(0, len(values), BLOCK):
        part = slice(start, start + BLOCK)
        columns = block[:, : len(values[part])]
        columns[:-1], columns[-1] = basis(x[part], y[part]), values[part]
        if only_values:
            columns[-1] = turned[-1] @ columns
        else:
            columns = turned @ columns
        products += columns @ columns.T
    share = products / len(values)
    if not (np.isfinite(share).all() and np.linalg.cond(share) <= NEARLY_ORTHOGONAL):
        return None
    return np.asarray(np.linalg.cholesky(products).T @ first, dtype=np.float64)


def _r(matrix: FloatArray) -> FloatArray:
    factor: FloatArray = np.linalg.qr(matrix, mode="r")  # type: ignore[assignment]  # numpy's stubs miss this mode
    return factor


def points(mask: BoolArray, x: ArrayLike, y: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """(m,) coordinates of the mask's samples in the order of ``height[mask]``, from those of columns and rows."""
    row, column = np.nonzero(mask)
    return np.asarray(x, dtype=np.float64)[column], np.asarray(y, dtype=np.float64)[row]


WORST_CONDITION = 1e8
"""Condition of the terms over the mask beyond which they cannot be separated."""


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
    """RMS of the residual over the mask."""
    condition: float
    """Condition of the terms over the mask: near 1 to 3 on a circle."""
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
        circle_px: (row, column, radius) of the unit circle; None for the least that ``enclosing_circle`` finds.

    Raises:
        MapError: the surface is not finite inside the mask, there are fewer samples than terms, or the mask's shape
            does not tell the terms apart (condition above ``WORST_CONDITION``).
        ValueError: no such ordering, no terms, or a circle without radius.
    """
    heights = samples_inside(height_nm, mask)
    pairs = order(ordering, terms)
    norm = USUAL_NORM[ordering] if norm is None else norm
    row, column, radius = circle = enclosing_circle(mask) if circle_px is None else circle_px
    if not radius > 0:
        raise ValueError(f"a unit circle of radius {radius:g} pixels")
    if heights.size < terms:
        raise MapError(f"{heights.size} samples are too few for {terms} Zernike terms: fit fewer, or mend the mask")
    found = triangle(lambda x, y: values(pairs, norm, x, y), *unit_coordinates(mask, circle), heights)
    own, projected = found[:terms, :terms], found[:terms, terms]
    condition = float(np.linalg.cond(own))
    if not condition <= WORST_CONDITION:
        raise MapError(
            f"{terms} Zernike terms cannot be separated over this mask (condition {condition:.1e}, at most "
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
    x, y = unit_coordinates(mask, (*fitted.centre_px, fitted.radius_px))
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
        MapError: as ``fit``.
    """
    fitted = fit(height_nm, mask, terms, "fringe")
    pv = float(np.ptp(surface(fitted, mask)[mask]))
    return Pvr(pv + 3 * fitted.residual_rms_nm, pv, fitted.residual_rms_nm, terms, fitted.ordering)


def enclosing_circle(mask: BoolArray) -> tuple[float, float, float]:
    """(row, column, radius) in pixels of a circle around a mask: the middle of its box, out to its furthest sample.

    Raises:
        MapError: an empty mask.
    """
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    if rows.size == 0:
        raise MapError("no sample of the surface lies inside the mask")
    row, column = (rows[0] + rows[-1]) / 2, (columns[0] + columns[-1]) / 2
    # in each row the furthest sample is its first or its last
    first, last = mask[rows].argmax(axis=1), mask.shape[1] - 1 - mask[rows, ::-1].argmax(axis=1)
    across = np.maximum(np.abs(first - column), np.abs(last - column))
    return float(row), float(column), max(float(np.hypot(rows - row, across).max()), 0.5)


def unit_coordinates(mask: BoolArray, circle_px: tuple[float, float, float]) -> tuple[FloatArray, FloatArray]:
    """Coordinates of the mask's samples, 1 = the circle's radius, y up."""
    row, column, radius = circle_px
    x = (np.arange(mask.shape[1]) - column) / radius
    return points(mask, x, (row - np.arange(mask.shape[0])) / radius)


# Primary aberrations of a surface: power, astigmatism, coma and spherical, from its Zernike terms.


@dataclass(frozen=True, slots=True)
class Primary:
    """Amplitudes at the unit circle's edge (fringe terms 4 to 9), nm of the surface, positive = high."""

    power_nm: float
    """Coefficient of 2 r^2 - 1; its PV over the circle is twice this."""
    astigmatism_nm: float
    """Root of the sum of squares of r^2 cos 2t and r^2 sin 2t."""
    astigmatism_deg: float
    """Direction of its high meridian, from x (right) towards y (up), 0 to below 180."""
    coma_nm: float
    """Root of the sum of squares of (3 r^3 - 2 r) cos t and sin t."""
    coma_deg: float
    """Direction of its high side, from x towards y, -180 to 180."""
    spherical_nm: float
    """Coefficient of 6 r^4 - 6 r^2 + 1."""


def primary(fitted: ZernikeFit) -> Primary:
    """The primary aberrations of a fit in any ordering and norm.

    Raises:
        ValueError: the fit ends below the spherical term.
    """
    edge = {
        (n, m): float(value) * (1.0 if fitted.norm == "edge" else sqrt((n + 1) * (1 if m == 0 else 2)))
        for (n, m), value in zip(fitted.terms, fitted.coefficients_nm, strict=True)
    }
    if (4, 0) not in edge:
        raise ValueError(f"{len(fitted.terms)} {fitted.ordering} terms do not reach the primary spherical term")
    astigmatism, coma = (edge[2, 2], edge[2, -2]), (edge[3, 1], edge[3, -1])
    return Primary(
        power_nm=edge[2, 0],
        astigmatism_nm=hypot(*astigmatism),
        astigmatism_deg=degrees(atan2(astigmatism[1], astigmatism[0])) / 2 % 180,
        coma_nm=hypot(*coma),
        coma_deg=degrees(atan2(coma[1], coma[0])),
        spherical_nm=edge[4, 0],
    )
