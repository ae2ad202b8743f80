"""Figures of a map for ``polishd map``: one JSON object a file."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np

from polishd.maps.map_files import band_names, history_record, mask_map, mask_records
from polishd.model.errors import MapError, SurfaceError
from polishd.model.surface import BoolArray, FloatArray, SurfaceMap
from polishd.process.metrology.spectra import split_bands
from polishd.process.metrology.statistics import Removal, pv_rms, remove_terms, trim_mask
from polishd.process.metrology.statistics import slope as metrics_slope
from polishd.process.metrology.tolerance import irregularity
from polishd.process.metrology.zernike import pvr as metrics_pvr

HEIGHTS = {"pv_nm": "PV", "rms_nm": "RMS", "pv_tilt_removed_nm": "PV level", "rms_tilt_removed_nm": "RMS level"}
"""Figures of every map, also without a scale: key and label."""
PVR_TERMS = 36
FEWEST_PERIODS = 3
"""Least number of periods on the part: the bands beside a longer period depend on the extension of the edge."""
ISO_KEYS = ("a_nm", "b_nm", "c_nm", "rms_t_nm", "rms_i_nm", "rms_a_nm")
T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class MapFigures:
    """A map with its figures and the arrays that they come from."""

    surface: SurfaceMap
    mask: BoolArray
    """(ny, nx) samples that count: those with data within the masks, trimmed."""
    level_nm: FloatArray
    """(ny, nx) heights without piston and tilt (or other alignment) over the mask; NaN outside."""
    bands_nm: tuple[FloatArray, ...]
    """(ny, nx) bands of the level surface, whose squared RMS add up; none without a lateral scale."""
    answer: dict[str, Any]


def figured(surface: SurfaceMap, trim: int, edges: Sequence[float], alignment: Removal = "tilt") -> MapFigures:
    """All figures of a map.

    Args:
        surface: the map as read, or as the profile says.
        trim: pixels taken off every edge of the data, holes included: eroded by the cross of 4 neighbours.
        edges: periods between the bands, mm, falling.
        alignment: what the level map is without.

    Raises:
        MapError: no sample is left.
    """
    height, pitch = surface.height_nm, surface.pitch_mm
    mask = trim_mask(surface.valid, trim)
    if not mask.any():
        raise MapError(f"{surface.path}: no sample is left of it with --trim {trim}; trim less")
    level = remove_terms(height, mask, alignment)
    bands = () if pitch is None else split_bands(level, mask, pitch, edges)
    answer = {
        "path": str(surface.path),
        "format": surface.format,
        "rows": height.shape[0],
        "cols": height.shape[1],
        "pitch_mm": pitch,
        "pitches_mm": None if surface.pitches_mm is None else list(surface.pitches_mm),
        "missing": int(np.count_nonzero(~surface.valid)) - mask_map(surface),
        **heights_nm(height, level, mask),
        "bands": None
        if pitch is None
        else band_records([float(band[mask].std()) for band in bands], mask, pitch, edges),
        "sha256": surface.sha256,
        "warnings": list(surface.warnings),
        "trim": trim,
        "samples": int(np.count_nonzero(mask)),
        "masks": mask_records(surface),
        "masked": mask_map(surface),
        **_more(level, mask, pitch),
        **_origin(surface),
    }
    return MapFigures(surface, mask, level, bands, answer)


def heights_nm(height_nm: FloatArray, level_nm: FloatArray, mask: BoolArray) -> dict[str, float]:
    """``HEIGHTS`` of a map over the mask, and its heights (ny, nx) without piston and tilt."""
    found = (*pv_rms(height_nm, mask), *pv_rms(level_nm, mask))
    return dict(zip(HEIGHTS, found, strict=True))


def band_records(
    rms_nm: Sequence[float], mask: BoolArray, pitch_mm: float, edges: Sequence[float]
) -> list[dict[str, Any]]:
    """Each band: name, periods from and to (None: no end), RMS in nm; None where no sample shows such periods.

    ``soft``: fewer than ``FEWEST_PERIODS`` of its end period lie on the mask's longer side.
    """
    longest_mm = pitch_mm * max(np.ptp(np.flatnonzero(mask.any(axis=axis))) + 1 for axis in (0, 1)) / FEWEST_PERIODS
    limits = [None, *edges, None]
    return [
        {
            "name": name,
            "from_mm": limits[k],
            "to_mm": limits[k + 1],
            "rms_nm": None if (limits[k] or math.inf) <= 2 * pitch_mm else rms,
            "soft": bool(max(limits[k] or 0.0, limits[k + 1] or 0.0) > longest_mm),
        }
        for k, (name, rms) in enumerate(zip(band_names(len(rms_nm)), rms_nm, strict=True))
    ]


def _more(level_nm: FloatArray, mask: BoolArray, pitch_mm: float | None) -> dict[str, Any]:
    """PVr, ISO 10110-5 and slope, tilt removed; None where there are too few samples."""
    pvr = _or_none(lambda: metrics_pvr(level_nm, mask, PVR_TERMS))
    iso = _or_none(lambda: irregularity(level_nm, mask))
    slope = None if pitch_mm is None else _or_none(lambda: metrics_slope(level_nm, mask, pitch_mm))
    return {
        "pvr_nm": None if pvr is None else pvr.pvr_nm,
        "pvr_terms": PVR_TERMS,
        "iso10110": None if iso is None else {key: getattr(iso, key) for key in ISO_KEYS},
        "slope_rms_urad": None if slope is None else slope.rms_urad,
        "shortest_period_mm": None if pitch_mm is None else 2 * pitch_mm,
    }


def _or_none(figure: Callable[[], T]) -> T | None:
    try:
        return figure()
    except SurfaceError:
        return None


def _origin(surface: SurfaceMap) -> dict[str, Any]:
    at = surface.measured_at or surface.taken_at
    return {
        "part_id": surface.part_id,
        "instrument": surface.instrument,
        "taken_at": None if surface.measured_at is None else surface.measured_at.isoformat(),
        "dated_at": None if at is None else at.isoformat(),
        "date_from": None if at is None else surface.date_from,
        "orientation": surface.orientation,
        "unsaid": sorted(surface.unsaid),
        "fiducials_px": [list(mark) for mark in surface.fiducials_px],
        "factors": dict(surface.factors),
        "reader_version": surface.reader_version,
        "history": history_record(surface),
    }
