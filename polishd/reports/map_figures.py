"""Facts of the map report: the figures of ``polishd map``, and those that only the report has."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from typing import Any, TypeVar

import numpy as np

from polishd import __version__
from polishd.maps.figures import ISO_KEYS, MapFigures
from polishd.model.errors import MapError, SurfaceError
from polishd.model.surface import FloatArray, Grid
from polishd.model.tolerance import LineResult, ToleranceLine, part_holds
from polishd.process.metrology import zernike
from polishd.process.metrology.spectra import radial_psd
from polishd.process.metrology.statistics import Removal, remove_terms, slope, slope_map
from polishd.process.metrology.tolerance import irregularity, judge_lines, reflected_wavefront, surface_form
from polishd.process.metrology.zernike import FIRST, Ordering, primary

T = TypeVar("T")
WORST_CONDITION = 1e3
"""Condition of a fit beyond which its terms are large and cancel each other: they are not aberrations of the part."""


@dataclass(frozen=True, slots=True)
class MapReportOptions:
    """Options of the report."""

    wavelength_nm: float
    ordering: Ordering
    terms: int
    lines: tuple[ToleranceLine, ...] = ()
    """Of the drawing."""
    repeatability_nm: float | None = None
    """Of the instrument: RMS noise of a map; None: not known."""
    by: str = ""
    """Name of the person who is responsible for the report."""
    judged_by: str = ""
    """File with the lines."""
    alignment: Removal = "tilt"
    """Terms that are removed before the lines are judged."""


@dataclass(frozen=True, slots=True)
class MapReportData:
    """Figures of a map, and the arrays of its pictures."""

    figured: MapFigures
    slope_urad: FloatArray | None
    """(ny, nx) magnitude; None if the map does not support it."""
    lines: tuple[ToleranceLine, ...]
    answer: dict[str, Any]


@dataclass(slots=True)
class _Finder:
    """Computes the figures that a map supports, and lists the others with the reason."""

    found: MapFigures
    options: MapReportOptions
    left_out: list[str] = field(default_factory=list)

    def some(self, name: str, figure: Callable[[], T]) -> T | None:
        """Return the figure; None, listed, if the samples do not support it."""
        try:
            return figure()
        except SurfaceError as error:
            self.left_out.append(f"{name}: {error}")
            return None

    def scaled(self, name: str, figure: Callable[[float], T]) -> T | None:
        """Return a figure that needs the pitch in the same way."""
        pitch = self.found.surface.pitch_mm
        if pitch is None:
            self.left_out.append(f"{name}: the map has no lateral scale")
            return None
        return self.some(name, lambda: figure(pitch))

    def length(self, nm: float) -> dict[str, float]:
        """Return a height in nm and in waves of surface height."""
        return {"nm": nm, "waves": nm / self.options.wavelength_nm}


def reported(found: MapFigures, options: MapReportOptions) -> MapReportData:
    """Return the figures of the report, over the mask and the trim of ``found``, piston and tilt removed.

    Raises:
        MapError: a line of the drawing needs periods that the map does not show.
    """
    level, mask, finder = found.level_nm, found.mask, _Finder(found, options)
    pitch = found.surface.pitch_mm
    grid = Grid(mask.shape[0], mask.shape[1], 1.0 if pitch is None else pitch)
    fitted = finder.some("Zernike", lambda: zernike.fit(level, mask, options.terms, options.ordering))
    iso = finder.some("ISO 10110-5", lambda: irregularity(level, mask))
    slopes = finder.scaled("slope", lambda pitch_mm: slope(level, mask, pitch_mm))
    psd = finder.scaled("PSD", lambda pitch_mm: radial_psd(level, mask, pitch_mm))
    judged = _judged(found, options)
    shown = None if psd is None else psd.frequency_per_mm <= 0.5 / grid.pitch_mm
    places = {"peak": np.nanargmax(level), "valley": np.nanargmin(level)}
    marks = {name: _mark(level, grid, int(place)) for name, place in places.items()}
    answer = {
        **found.answer,
        "wavelength_nm": options.wavelength_nm,
        "level": {
            name: None if found.answer[key] is None else finder.length(found.answer[key])
            for name, key in (("pv", "pv_tilt_removed_nm"), ("rms", "rms_tilt_removed_nm"), ("pvr", "pvr_nm"))
        },
        "aberrations": None if fitted is None else finder.some("aberrations", lambda: _aberrations(finder, fitted)),
        "iso10110_waves": None
        if iso is None
        else {key.removesuffix("_nm"): getattr(iso, key) / options.wavelength_nm for key in ISO_KEYS},
        "indications": None
        if iso is None
        else {
            "iso10110_5": surface_form(iso),
            "iso10110_14": reflected_wavefront(iso),
        },
        "slope": None if slopes is None else asdict(slopes),
        "place_unit": "px" if pitch is None else "mm",
        **marks,
        "profiles": _profiles(level, grid, marks),
        "psd": None
        if psd is None
        else {
            "frequency_per_mm": psd.frequency_per_mm[shown].tolist(),
            "density_nm2_mm2": psd.density_nm2_mm2[shown].tolist(),
        },
        "zernike": None if fitted is None else _zernike(finder, fitted),
        "tolerance": [one.facts() for one in judged],
        "within": part_holds(judged) if judged else None,
        "judged_by": options.judged_by if judged else None,
        "alignment": options.alignment if judged else None,
        "left_out": finder.left_out,
        "computed": {
            "program": "polishd",
            "version": __version__,
            "at": datetime.now(UTC).isoformat(timespec="seconds"),
            "by": options.by,
        },
    }
    slope_urad = None if slopes is None else slope_map(level, mask, grid.pitch_mm)
    return MapReportData(found, slope_urad, options.lines, answer)


def _judged(found: MapFigures, options: MapReportOptions) -> Sequence[LineResult]:
    if not options.lines:
        return ()
    pitch = found.surface.pitch_mm
    if pitch is None:
        raise MapError(
            f"{found.surface.path}: the map has no lateral scale, which a tolerance needs. Name the "
            "instrument's --profile."
        )
    figure = found.level_nm
    if options.alignment != "tilt":
        figure = remove_terms(found.surface.height_nm, found.mask, options.alignment)
    try:
        return judge_lines(options.lines, figure, found.mask, pitch, options.repeatability_nm)
    except MapError as error:
        raise MapError(f"{found.surface.path}: {error}") from error


def _aberrations(finder: _Finder, fitted: zernike.ZernikeFit) -> dict[str, dict[str, float]]:
    if fitted.condition > WORST_CONDITION:
        raise MapError(
            f"condition of the Zernike fit is {fitted.condition:.1e}, more than {WORST_CONDITION:.0e}, for this "
            "shape. Fit fewer --terms, or use a round --mask."
        )
    first = primary(fitted)
    return {
        "power": finder.length(first.power_nm),
        "astigmatism": {**finder.length(first.astigmatism_nm), "deg": first.astigmatism_deg},
        "coma": {**finder.length(first.coma_nm), "deg": first.coma_deg},
        "spherical": finder.length(first.spherical_nm),
    }


def _zernike(finder: _Finder, fitted: zernike.ZernikeFit) -> dict[str, Any]:
    terms = enumerate(zip(fitted.terms, fitted.coefficients_nm.tolist(), strict=True), FIRST[fitted.ordering])
    pitch = finder.found.surface.pitch_mm
    return {
        "ordering": fitted.ordering,
        "norm": fitted.norm,
        "terms": [{"index": index, "n": n, "m": m, **finder.length(nm)} for index, ((n, m), nm) in terms],
        "centre_px": list(fitted.centre_px),
        "radius_px": fitted.radius_px,
        "radius_mm": None if pitch is None else fitted.radius_px * pitch,
        "residual_rms_nm": fitted.residual_rms_nm,
        "condition": fitted.condition,
    }


def _mark(level_nm: FloatArray, grid: Grid, place: int) -> dict[str, float]:
    """Return the position of a sample: x right and y up from the center of the map, row and column."""
    row, column = divmod(place, grid.nx)
    x, y = float(grid.x_mm[column]), float(grid.y_mm[row])
    return {"x": x, "y": y, "row": row, "column": column, "nm": float(level_nm[row, column])}


def _profiles(level_nm: FloatArray, grid: Grid, marks: Mapping[str, Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Return the profiles along x and y through both marks; a sample outside the mask is None."""
    found = []
    for name, mark in marks.items():
        for along, places, heights in (
            ("x", grid.x_mm, level_nm[mark["row"], :]),
            ("y", grid.y_mm, level_nm[:, mark["column"]]),
        ):
            nm = [None if np.isnan(height) else float(height) for height in heights]
            found.append({"through": name, "along": along, "place": places.tolist(), "nm": nm})
    return found
