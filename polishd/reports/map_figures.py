"""All that ``polishd map report`` says of a map: the figures of ``polishd map``, and those that only the page has."""

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
from polishd.process.metrology import iso10110, zernike
from polishd.process.metrology.spectra import radial_psd
from polishd.process.metrology.statistics import Removal, remove_terms, slope, slope_map
from polishd.process.metrology.tolerance import judge_lines
from polishd.process.metrology.zernike import FIRST, Ordering, primary

T = TypeVar("T")
WORST_CONDITION = 1e3
"""Of a fit beyond which its single terms are large and cancel each other: they are no aberrations of the part."""


@dataclass(frozen=True, slots=True)
class MapReportOptions:
    """What the page is to have beside what every map has."""

    wavelength_nm: float
    ordering: Ordering
    terms: int
    lines: tuple[ToleranceLine, ...] = ()
    """The drawing's."""
    repeatability_nm: float | None = None
    """Of the instrument, RMS of a map's noise; None: not known."""
    by: str = ""
    """Who answers for the page."""
    judged_by: str = ""
    """The file in which the lines stand."""
    alignment: Removal = "tilt"
    """What the lines do not count."""


@dataclass(frozen=True, slots=True)
class MapReportData:
    """A map's figures, with what its pictures are drawn of."""

    figured: MapFigures
    grid: Grid
    """The map's; with a pitch of 1 px where it has none."""
    unit: str
    """Of places on it: mm, or px."""
    slope_urad: FloatArray | None
    """(ny, nx) magnitude; None where the map does not carry it."""
    lines: tuple[ToleranceLine, ...]
    answer: dict[str, Any]


@dataclass(slots=True)
class _Finder:
    """Computes what the map carries, and keeps the reasons of what it does not."""

    found: MapFigures
    asked: MapReportOptions
    left_out: list[str] = field(default_factory=list)

    def some(self, name: str, figure: Callable[[], T]) -> T | None:
        """The figure, or None, noted, where the samples do not carry it."""
        try:
            return figure()
        except SurfaceError as error:
            self.left_out.append(f"{name}: {error}")
            return None

    def scaled(self, name: str, figure: Callable[[float], T]) -> T | None:
        """Likewise of what needs the pitch."""
        pitch = self.found.surface.pitch_mm
        if pitch is None:
            self.left_out.append(f"{name}: the map has no lateral scale")
            return None
        return self.some(name, lambda: figure(pitch))

    def length(self, nm: float) -> dict[str, float]:
        """A height in nm and in waves of the surface."""
        return {"nm": nm, "waves": nm / self.asked.wavelength_nm}


def reported(found: MapFigures, asked: MapReportOptions) -> MapReportData:
    """The figures of the page, over the mask and the trim of ``found``, piston and tilt removed.

    Raises:
        BadMap: a line of the drawing counts what the map does not show.
    """
    level, mask, finder = found.level_nm, found.mask, _Finder(found, asked)
    pitch = found.surface.pitch_mm
    grid = Grid(mask.shape[0], mask.shape[1], 1.0 if pitch is None else pitch)
    fitted = finder.some("Zernike", lambda: zernike.fit(level, mask, asked.terms, asked.ordering))
    iso = finder.some("ISO 10110-5", lambda: iso10110.irregularity(level, mask))
    slopes = finder.scaled("slope", lambda pitch_mm: slope(level, mask, pitch_mm))
    psd = finder.scaled("PSD", lambda pitch_mm: radial_psd(level, mask, pitch_mm))
    judged = _judged(found, asked)
    shown = None if psd is None else psd.frequency_per_mm <= 0.5 / grid.pitch_mm
    places = {"peak": np.nanargmax(level), "valley": np.nanargmin(level)}
    marks = {name: _mark(level, grid, int(place)) for name, place in places.items()}
    answer = {
        **found.answer,
        "wavelength_nm": asked.wavelength_nm,
        "level": {
            name: None if found.answer[key] is None else finder.length(found.answer[key])
            for name, key in (("pv", "pv_tilt_removed_nm"), ("rms", "rms_tilt_removed_nm"), ("pvr", "pvr_nm"))
        },
        "aberrations": None if fitted is None else finder.some("aberrations", lambda: _aberrations(finder, fitted)),
        "iso10110_waves": None
        if iso is None
        else {key.removesuffix("_nm"): getattr(iso, key) / asked.wavelength_nm for key in ISO_KEYS},
        "indications": None
        if iso is None
        else {
            "iso10110_5": iso10110.surface_form(iso),
            "iso10110_14": iso10110.reflected_wavefront(iso),
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
        "judged_by": asked.judged_by if judged else None,
        "alignment": asked.alignment if judged else None,
        "left_out": finder.left_out,
        "computed": {
            "program": "polishd",
            "version": __version__,
            "at": datetime.now(UTC).isoformat(timespec="seconds"),
            "by": asked.by,
        },
    }
    slope_urad = None if slopes is None else slope_map(level, mask, grid.pitch_mm)
    return MapReportData(found, grid, answer["place_unit"], slope_urad, asked.lines, answer)


def _judged(found: MapFigures, asked: MapReportOptions) -> Sequence[LineResult]:
    if not asked.lines:
        return ()
    pitch = found.surface.pitch_mm
    if pitch is None:
        raise MapError(
            f"{found.surface.path}: has no lateral scale to judge a tolerance by; give the instrument's --profile"
        )
    figure = found.level_nm
    if asked.alignment != "tilt":
        figure = remove_terms(found.surface.height_nm, found.mask, asked.alignment)
    try:
        return judge_lines(asked.lines, figure, found.mask, pitch, asked.repeatability_nm)
    except MapError as error:
        raise MapError(f"{found.surface.path}: {error}") from error


def _aberrations(finder: _Finder, fitted: zernike.ZernikeFit) -> dict[str, dict[str, float]]:
    if fitted.condition > WORST_CONDITION:
        raise MapError(
            f"over this shape the Zernike terms are hard to tell apart (condition {fitted.condition:.1e}, at most "
            f"{WORST_CONDITION:.0e}): fit fewer --terms, or lay a round --mask"
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
    """Where a sample is: x right and y up from the map's centre, and its row and column."""
    row, column = divmod(place, grid.nx)
    x, y = float(grid.x_mm[column]), float(grid.y_mm[row])
    return {"x": x, "y": y, "row": row, "column": column, "nm": float(level_nm[row, column])}


def _profiles(level_nm: FloatArray, grid: Grid, marks: Mapping[str, Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Along x and along y through both marks; a sample outside the mask is None."""
    found = []
    for name, mark in marks.items():
        for along, places, heights in (
            ("x", grid.x_mm, level_nm[mark["row"], :]),
            ("y", grid.y_mm, level_nm[:, mark["column"]]),
        ):
            nm = [None if np.isnan(height) else float(height) for height in heights]
            found.append({"through": name, "along": along, "place": places.tolist(), "nm": nm})
    return found
