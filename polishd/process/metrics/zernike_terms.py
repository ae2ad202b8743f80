"""Zernike polynomials by their names: three orderings, two norms, and their values."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import comb, isqrt, sqrt
from typing import Literal

import numpy as np

from polishd.model.surface import FloatArray

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
        term[:] = 0.0
        for factor in _radial(n, abs(m)):  # Horner in r^2
            term *= square
            term += factor
        term *= angular[abs(m)][m < 0] * (sqrt((n + 1) * (1 if m == 0 else 2)) if norm == "rms" else 1.0)
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
