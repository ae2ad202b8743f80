"""A surface judged by its drawing: each line's figure on the map's own pixels in the clear aperture.

Surface form figures are those of ISO 10110-5:2015, as ISO 14999-4:2015 evaluates them: 3/A(B/C), RMSt, RMSi, RMSa.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from decimal import ROUND_CEILING, Context, Decimal
from functools import cached_property

import numpy as np
import scipy
from numpy.polynomial.legendre import legval, legvander

from polishd.model.errors import MapError
from polishd.model.surface import BoolArray, FloatArray, SurfaceMap
from polishd.model.tolerance import NORMS, LineResult, ToleranceLine
from polishd.process.metrology import zernike
from polishd.process.metrology.resampling import Registration
from polishd.process.metrology.spectra import RadialPsd, radial_psd, split_bands
from polishd.process.metrology.statistics import Removal, fit_terms, power, pv_rms, remove_terms, samples_inside, slope
from polishd.process.metrology.zernike import points, triangle
from polishd.process.removal.ripple import NO_RIPPLE, Ripple, RippleLine

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
        MapError: the mask is empty, or the surface not finite inside it.
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


SLOPE_LENGTHS = 1.5
"""Most by which the shortest length that a map has, two pitches, may be longer than a slope's integration length."""


@dataclass(frozen=True)
class _Surface:
    """A surface, and what its lines have in common."""

    height_nm: FloatArray
    mask: BoolArray
    pitch_mm: float

    @cached_property
    def iso(self) -> Iso10110Figures:
        """Figures of ISO 10110-5."""
        return irregularity(self.height_nm, self.mask)

    @cached_property
    def psd(self) -> RadialPsd:
        """Radially averaged density."""
        return radial_psd(self.height_nm, self.mask, self.pitch_mm)

    def band(self, line: ToleranceLine) -> FloatArray:
        """(ny, nx) what has the line's periods."""
        edges = [edge for edge in (line.below_mm, line.above_mm) if edge]
        if not edges:
            return self.height_nm
        return split_bands(self.height_nm, self.mask, self.pitch_mm, edges)[0 if line.below_mm is None else 1]


def judge_lines(
    lines: Iterable[ToleranceLine],
    height_nm: FloatArray,
    mask: BoolArray,
    pitch_mm: float,
    repeatability_nm: float | None = None,
    *,
    ripple: Ripple = NO_RIPPLE,
) -> tuple[LineResult, ...]:
    """What was measured of each line, and what it is with the ripple that the map's samples average away.

    Args:
        lines: of the drawing.
        height_nm: (ny, nx) the figure on the map's own pixels, without what is alignment; finite inside ``mask``.
        mask: (ny, nx) the clear aperture.
        pitch_mm: distance of samples.
        repeatability_nm: RMS of the instrument's noise in one map; None: not known.
        ripple: forecast of the passes whose lines are on the surface, none of which is subtracted from the map.

    Raises:
        MapError: a line counts what a map of this pitch cannot show, or the mask is empty.
    """
    surface = _Surface(height_nm, mask, pitch_mm)
    found = []
    for line in lines:
        _require_seen(line, pitch_mm)
        uncertainty = repeatability_nm if line.figure in NORMS else None
        value = _figure(line, surface)
        nominal, high = (_with_ripple(line, surface, value, ripple, high=high) for high in (False, True))
        one = LineResult(line.what, value, line.limit, line.unit, uncertainty)
        found.append(replace(one, with_ripple=nominal, with_ripple_high=high))
    return tuple(found)


# Ripple of the path that a map does not show. Samples average over their distance: of a line they keep the square of
# sinc(sample / period) of its mean square, and that share is in the measured figure already.


def ripple_rms_nm(line: ToleranceLine, ripple: Ripple, sample_mm: float | None = None, *, high: bool = False) -> float:
    """Return the RMS of a ripple in a tolerance line's periods: all of it, or what samples do not show of it."""
    parts = _in_periods(line, ripple)
    return float(np.sqrt(sum(_hidden(one, sample_mm, high=high) ** 2 for one in parts)))


def _in_periods(line: ToleranceLine, ripple: Ripple) -> list[RippleLine]:
    longest = np.inf if line.below_mm is None else line.below_mm
    return [one for one in ripple.lines if line.above_mm < one.period_mm < longest]


def _hidden(one: RippleLine, sample_mm: float | None, *, high: bool) -> float:
    """RMS of a line that samples do not show, nm."""
    rms = one.rms_high_nm if high else one.rms_nm
    return rms if sample_mm is None else rms * float(np.sqrt(1.0 - one.kept(sample_mm)))


def ripple_slope_urad(
    line: ToleranceLine, ripple: Ripple, sample_mm: float | None = None, *, high: bool = False
) -> float:
    """Return the RMS slope of a ripple over a line's integration length: all of it, or what samples do not show."""
    length = line.integration_mm or 0.0
    parts = [
        2 * np.pi / one.period_mm * abs(np.sinc(length / one.period_mm)) * _hidden(one, sample_mm, high=high)
        for one in _in_periods(line, ripple)
    ]
    return float(np.linalg.norm(parts))  # nm / mm = urad


def ripple_psd(line: ToleranceLine, ripple: Ripple, psd: RadialPsd, sample_mm: float, *, high: bool = False) -> float:
    """Return a PSD line's factor where ripple is: its power, spread over its ring, beside the measured density.

    A measured spectrum spreads a line over about two rings: the factor is up to a third too high.
    """
    density = psd.density_nm2_mm2.copy()
    for one in _in_periods(line, ripple):
        ring = int(np.argmin(np.abs(psd.frequency_per_mm - 1 / one.period_mm)))
        density[ring] += _hidden(one, sample_mm, high=high) ** 2 / psd.area_per_mm2[ring]
    return _above_line(line, RadialPsd(psd.frequency_per_mm, density, psd.area_per_mm2))


def ripple_psd_alone(line: ToleranceLine, ripple: Ripple, side_mm: float) -> float:
    """Return a PSD line's factor of a ripple alone, 95 % value, in rings as wide as a map of that side has."""
    parts = [
        one.rms_high_nm**2 * side_mm * one.period_mm / (2 * np.pi) / one.period_mm**line.exponent
        for one in _in_periods(line, ripple)
    ]
    return max(parts, default=0.0)


def _with_ripple(line: ToleranceLine, surface: _Surface, value: float, ripple: Ripple, *, high: bool) -> float | None:
    """Return a figure with the ripple that the map does not show; None where that does not enter it.

    RMS figures add in quadrature; PV and largest slope add the pattern's own, zero to peak on either side.
    """
    if not _in_periods(line, ripple):
        return None
    hidden_nm = ripple_rms_nm(line, ripple, surface.pitch_mm, high=high)
    match line.figure:
        case "rms" | "RMSt" | "RMSi" | "RMSa":
            return float(np.hypot(value, hidden_nm))
        case "pv" | "B":
            return value + 2 * 2**0.5 * hidden_nm
        case "slope_rms":
            return float(np.hypot(value, ripple_slope_urad(line, ripple, surface.pitch_mm, high=high)))
        case "slope_max":
            return value + 2**0.5 * ripple_slope_urad(line, ripple, surface.pitch_mm, high=high)
        case "psd":
            return ripple_psd(line, ripple, surface.psd, surface.pitch_mm, high=high)
        case _:
            return None


def in_line_band(line: ToleranceLine, height_nm: FloatArray, mask: BoolArray, pitch_mm: float) -> FloatArray:
    """(ny, nx) what of a surface has the line's periods; arguments as for `judge_lines`."""
    return _Surface(height_nm, mask, pitch_mm).band(line)


def tolerance_notes(judged: Iterable[LineResult]) -> tuple[str, ...]:
    """Return notes on figures whose limit lies within the instrument's repeatability or the ripple's 95 % value."""
    return tuple(
        f"{one}: it {'holds' if one.holds else 'does not hold'}, and the instrument's repeatability or the ripple's "
        "uncertainty could have it the other way"
        for one in judged
        if one.unsure
    )


def unreachable_lines(
    lines: Sequence[ToleranceLine], height_nm: FloatArray, mask: BoolArray, pitch_mm: float, cutoff_period_mm: float
) -> tuple[LineResult, ...]:
    """The lines that a spot cannot make hold: they do not of what is left where all periods above its cut-off are gone.

    Arguments: `judge_lines`. On a grid that averages over the map's pixels less is left than on the map: a line that is
    named here is out of reach, one that is not may be. Those that the grid cannot show are left out.
    """
    if cutoff_period_mm <= 2 * pitch_mm:
        return ()
    beyond = split_bands(height_nm, mask, pitch_mm, (cutoff_period_mm,))[1]
    some = [line for line in lines if _unseen(line, pitch_mm) is None and line.above_mm < cutoff_period_mm]
    return tuple(one for one in judge_lines(some, beyond, mask, pitch_mm) if not one.holds)


def lines_below_cutoff(lines: Iterable[ToleranceLine], cutoff_period_mm: float) -> tuple[ToleranceLine, ...]:
    """Lines that count no period above a spot's cut-off: it changes nothing of them for the better."""
    return tuple(line for line in lines if line.below_mm is not None and line.below_mm <= cutoff_period_mm)


def _figure(line: ToleranceLine, surface: _Surface) -> float:
    match line.figure:
        case "rms":
            return pv_rms(surface.band(line), surface.mask)[1]
        case "pv":
            return pv_rms(surface.band(line), surface.mask)[0]
        case "slope_rms" | "slope_max":
            found = slope(surface.band(line), surface.mask, surface.pitch_mm, line.integration_mm)
            return found.rms_urad if line.figure == "slope_rms" else found.max_urad
        case "psd":
            return _above_line(line, surface.psd)
        case "A" | "B" | "C":
            return float(getattr(surface.iso, f"{line.figure.lower()}_nm"))
        case _:
            return float(getattr(surface.iso, f"rms_{line.figure[-1]}_nm"))


def _above_line(line: ToleranceLine, psd: RadialPsd) -> float:
    """The factor A of the lowest line ``A / f**exponent`` that no ring of the periods is above."""
    frequency = psd.frequency_per_mm
    counted = (frequency >= 1 / (line.below_mm or np.inf)) & (frequency <= 1 / line.above_mm)
    if not counted.any():
        raise MapError(
            f"the map has no frequency in {line.what}: it is too small, or the periods too near to each other"
        )
    return float((psd.density_nm2_mm2 * frequency**line.exponent)[counted].max())


def _require_seen(line: ToleranceLine, pitch_mm: float) -> None:
    problem = _unseen(line, pitch_mm)
    if problem is not None:
        raise MapError(
            f"{line.what} cannot be judged on this map: {problem}; measure with a finer pitch, or mend the line"
        )


def _unseen(line: ToleranceLine, pitch_mm: float) -> str | None:
    """Why a map of this pitch does not show what a line counts; None where it does.

    A band without a lower end counts what the map shows; one with an end must be shown to that.
    """
    shortest = 2 * pitch_mm
    if line.above_mm and line.above_mm < shortest:
        return f"it shows periods above {shortest:.3g} mm only"
    if line.below_mm is not None and line.below_mm <= shortest:
        return f"it shows periods above {shortest:.3g} mm only"
    if line.integration_mm is not None and shortest > SLOPE_LENGTHS * line.integration_mm:
        return f"its shortest slope is over {shortest:.3g} mm"
    return None


# What of a map is alignment: said where it is large, or where it is polished.

LARGE_NM = 50.0
"""PV of a tilt that a person should know of where the figure is smaller than it: a sixth of a fringe."""


def alignment_notes(height_nm: FloatArray, mask: BoolArray, removal: Removal, tolerance_nm: float) -> tuple[str, ...]:
    """What a person should know of a map's tilt: that much was taken off, or that it was left in and is polished.

    Args:
        height_nm: (ny, nx) the map as measured, finite inside ``mask``.
        mask: (ny, nx) clear aperture.
        removal: what is taken off as alignment.
        tolerance_nm: RMS of the figure that is wanted: less tilt than this is not worth a word.
    """
    figure_nm = float(remove_terms(height_nm, mask, removal)[mask].std())
    tilt = fit_terms(height_nm, mask, "tilt" if removal == "piston" else removal)
    pv, rms = pv_rms(tilt, mask)
    if removal == "piston" and rms > tolerance_nm:
        note = (
            f"of the figure's {figure_nm:.3g} nm RMS a tilt makes {rms:.3g} ({pv:.3g} nm PV), and it is polished away: "
            'part.alignment = "piston" says so, "tilt" takes it for alignment'
        )
        return (note,)
    if removal != "piston" and pv > LARGE_NM and rms > figure_nm:
        terms = "tilt" if removal == "tilt" else "tilt and power"
        note = (
            f"{terms} of {pv:.4g} nm PV in the clear aperture taken off as alignment (part.alignment), "
            f"which leaves {figure_nm:.3g} nm RMS of figure"
        )
        return (note,)
    return ()


# The form that is wanted: maps are measured against it.


def subtract_nominal(surface: SurfaceMap, nominal: SurfaceMap, lies: Registration) -> SurfaceMap:
    """The map less the form wanted, so that what is left is the error to polish away.

    Args:
        surface: the map.
        nominal: the form, its array centred on the part and in the part's own directions; finite all over the part.
        lies: where the part lies in the map.

    Returns:
        The map on its own samples; NaN where the form says nothing.

    Raises:
        MapError: either has no pitch.
    """
    if surface.pitch_mm is None or nominal.pitch_mm is None:
        raise MapError(f"{nominal.path or 'the nominal form'}: it and the map need a lateral scale to be compared")
    grid = nominal.grid
    x, y = lies.on_part_mm(surface.grid)
    places = [(grid.y_mm[0] - y) / grid.pitch_mm, (x - grid.x_mm[0]) / grid.pitch_mm]
    wanted = scipy.ndimage.map_coordinates(nominal.height_nm, places, order=1, cval=np.nan)
    return surface.with_height(surface.height_nm - wanted)
