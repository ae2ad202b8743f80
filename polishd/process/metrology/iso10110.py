"""Surface form figures of ISO 10110-5:2015, as ISO 14999-4:2015 evaluates them: 3/A(B/C), RMSt, RMSi, RMSa."""

from __future__ import annotations

from dataclasses import dataclass
from decimal import ROUND_CEILING, Context, Decimal

import numpy as np
from numpy.polynomial.legendre import legval, legvander

from polishd.model.surface import BoolArray, FloatArray
from polishd.process.metrology import zernike
from polishd.process.metrology.statistics import power, pv_rms, remove_terms, samples_inside
from polishd.process.metrology.zernike import points, triangle

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
    samples_inside(height_nm, mask)
    row, column, _ = zernike.enclosing_circle(mask)
    centre = (row, column) if centre_px is None else centre_px
    sphere, curvature = power(height_nm, mask)
    irregular = (height_nm - sphere)[mask]
    squares = _squared_radius_px(mask, centre)
    symmetric = _symmetric(irregular, squares)
    return Iso10110Figures(
        a_nm=float(abs(curvature) * np.ptp(squares)),
        b_nm=float(np.ptp(irregular)),
        c_nm=float(np.ptp(symmetric)),
        rms_t_nm=pv_rms(remove_terms(height_nm, mask, "tilt"), mask)[1],
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


# What a drawing would have to allow for a surface to be within it, as ISO 10110-5 and -14 write it, in nm.

DIGITS = 3
REFLECTED = 2.0
"""The wavefront that is reflected once, at normal incidence, over the surface."""


def surface_form(found: Iso10110Figures) -> str:
    """``3/A(B/C)`` with RMSt, RMSi and RMSa of the surface, each rounded up: the surface is within it."""
    return _indication("3", found, 1.0)


def reflected_wavefront(found: Iso10110Figures) -> str:
    """``13/A(B/C)`` and its RMS figures of the wavefront that the surface reflects, rounded up likewise."""
    return _indication("13", found, REFLECTED)


def _indication(code: str, found: Iso10110Figures, times: float) -> str:
    a, b, c = (_up(times * value) for value in (found.a_nm, found.b_nm, found.c_nm))
    rms = {"t": found.rms_t_nm, "i": found.rms_i_nm, "a": found.rms_a_nm}
    return f"{code}/{a}({b}/{c}); " + "; ".join(f"RMS{name} < {_up(times * value)}" for name, value in rms.items())


def _up(value: float) -> str:
    """To ``DIGITS`` significant digits, never below the value, and never 0, which would be no limit."""
    rounded = Context(prec=DIGITS, rounding=ROUND_CEILING).create_decimal(repr(max(value, 1e-3)))
    return f"{max(rounded.quantize(Decimal('0.001'), rounding=ROUND_CEILING), Decimal('0.001')).normalize():f}"
