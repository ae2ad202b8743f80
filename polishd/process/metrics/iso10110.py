"""Surface form figures of ISO 10110-5:2015, as ISO 14999-4:2015 evaluates them: 3/A(B/C), RMSt, RMSi, RMSa."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.polynomial.legendre import legval, legvander

from polishd.model.surface import BoolArray, FloatArray
from polishd.process.metrics import zernike
from polishd.process.metrics.fitting import points, triangle
from polishd.process.metrics.spread import inside, power, pv_rms, without

RADIAL_DEGREE = 20
"""Highest power of r in the rotationally symmetric part."""


@dataclass(frozen=True, slots=True)
class Iso10110Figures:
    """Figures in nm of the surface, not of the wavefront; piston and tilt are removed from all."""

    a_nm: float
    """A, sagitta error: PV of the approximating sphere."""
    b_nm: float
    """B, irregularity: PV of what the sphere leaves."""
    c_nm: float
    """C, rotationally symmetric irregularity: PV of the irregularity's part that depends on the radius only."""
    rms_t_nm: float
    """RMSt: of the whole deviation, sphere included."""
    rms_i_nm: float
    """RMSi: of the irregularity."""
    rms_a_nm: float
    """RMSa: of the irregularity less its rotationally symmetric part."""
    centre_px: tuple[float, float]
    """(row, column) of the axis of rotation."""
    samples: int


def irregularity(
    height_nm: FloatArray, mask: BoolArray, *, centre_px: tuple[float, float] | None = None
) -> Iso10110Figures:
    """Figures of a map of deviation from the nominal surface.

    The approximating sphere is the least-squares r^2, fitted with piston and tilt over the mask: right for deviations
    that are small beside the radius of curvature. The rotationally symmetric part is the least-squares polynomial in
    even powers of the radius up to ``RADIAL_DEGREE`` of the irregularity, fitted over the mask.

    Args:
        height_nm: (ny, nx), positive = high, finite inside ``mask``.
        mask: (ny, nx) samples that count.
        centre_px: (row, column) of the part's axis; None for the middle of the mask's box.

    Raises:
        BadMap: the mask is empty, or the surface not finite inside it.
    """
    inside(height_nm, mask)
    row, column, _ = zernike.enclosing(mask)
    centre = (row, column) if centre_px is None else centre_px
    sphere, curvature = power(height_nm, mask)
    irregular = (height_nm - sphere)[mask]
    squares = _squared_radius_px(mask, centre)
    symmetric = _symmetric(irregular, squares)
    return Iso10110Figures(
        a_nm=float(abs(curvature) * np.ptp(squares)),
        b_nm=float(np.ptp(irregular)),
        c_nm=float(np.ptp(symmetric)),
        rms_t_nm=pv_rms(without(height_nm, mask, "tilt"), mask)[1],
        rms_i_nm=float(irregular.std()),
        rms_a_nm=float((irregular - symmetric).std()),
        centre_px=centre,
        samples=irregular.size,
    )


def _squared_radius_px(mask: BoolArray, centre_px: tuple[float, float]) -> FloatArray:
    """(m,) of the mask's samples, about the axis."""
    x, y = points(mask, np.arange(mask.shape[1]) - centre_px[1], np.arange(mask.shape[0]) - centre_px[0])
    return np.asarray(x**2 + y**2, dtype=np.float64)


def _symmetric(heights_nm: FloatArray, squares: FloatArray) -> FloatArray:
    """(m,) least-squares polynomial in r^2, in Legendre's polynomials over the range that the mask has."""
    span = float(np.ptp(squares)) or 1.0
    place = np.asarray(2 * (squares - squares.min()) / span - 1, dtype=np.float64)
    degree = RADIAL_DEGREE // 2
    found = triangle(lambda u, _: np.asarray(legvander(u, degree).T, dtype=np.float64), place, place, heights_nm)
    factors = np.linalg.lstsq(found[:, :-1], found[:, -1], rcond=None)[0]
    return np.asarray(legval(place, factors), dtype=np.float64)
