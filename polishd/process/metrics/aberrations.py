"""Primary aberrations of a surface: power, astigmatism, coma and spherical, from its Zernike terms."""

from __future__ import annotations

from dataclasses import dataclass
from math import atan2, degrees, hypot, sqrt

from polishd.process.metrics.zernike import ZernikeFit


@dataclass(frozen=True, slots=True)
class Primary:
    """Amplitudes at the unit circle's edge (fringe terms 4 to 9), nm of the surface, positive = high."""

    power_nm: float
    """Of 2 r^2 - 1: its PV over the circle is twice this."""
    astigmatism_nm: float
    """Root of the sum of squares of r^2 cos 2t and r^2 sin 2t."""
    astigmatism_deg: float
    """Direction of its high meridian, from x (right) towards y (up), 0 to below 180."""
    coma_nm: float
    """Root of the sum of squares of (3 r^3 - 2 r) cos t and sin t."""
    coma_deg: float
    """Direction of its high side, from x towards y, -180 to 180."""
    spherical_nm: float
    """Of 6 r^4 - 6 r^2 + 1."""


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
