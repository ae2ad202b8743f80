"""What no map can be: of a day on which there were none, or of samples that no instrument takes."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime, timedelta

from polishd.model.surface import SurfaceMap

EARLIEST = datetime(1985, 1, 1, tzinfo=UTC)
"""Before it there were no such files: clocks never set, or days where seconds should be."""
AHEAD = timedelta(days=1)
"""Local times are taken for UTC's where a file names no zone; what is further ahead has another reason."""
LARGEST_PART_MM, SMALLEST_SAMPLE_MM = 20e3, 1e-6
SAME_PITCH = 1e-6
"""Part of a pitch by which two may differ and still be one grid."""


def is_plausible(surface: SurfaceMap, now: datetime, written: datetime | None) -> SurfaceMap:
    """The map as a reader gave it, without a date or a lateral scale that cannot be.

    Args:
        surface: the map.
        now: with a zone.
        written: when its file was, by the file system, with a zone: what dates a map whose header does not.

    Returns:
        The map; what is not believed is a warning, a date then "guessed", and a scale left to the profile ("pitch"). A
        date that is ahead is warned of, too, and stays the header's: in the order of an instrument's maps it counts.
    """
    return _scaled(_dated(surface, now, written))


def scale_fault(shape: tuple[int, ...], pitch_mm: float) -> str:
    """Why no map of (rows, columns) has such a pitch; "" where one may."""
    if not pitch_mm >= SMALLEST_SAMPLE_MM:
        return f"a sample would be {pitch_mm:.4g} mm wide, less than 1 nm"
    if not max(shape) * pitch_mm <= LARGEST_PART_MM:
        size_m = max(shape) * pitch_mm / 1e3
        return f"{max(shape)} samples of {pitch_mm:.7g} mm would be a part of {size_m:.4g} m, more than 20 m"
    return ""


def _scaled(surface: SurfaceMap) -> SurfaceMap:
    fault = "" if surface.pitch_mm is None else scale_fault(surface.height_nm.shape, surface.pitch_mm)
    if not fault:
        return surface
    warning = f"its lateral scale is not used: {fault}"
    return replace(
        surface,
        pitch_mm=None,
        warnings=(*surface.warnings, warning),
        unsaid=surface.unsaid | {"pitch"},
        doubts={**surface.doubts, "pitch": warning},
    )


def _dated(surface: SurfaceMap, now: datetime, written: datetime | None) -> SurfaceMap:
    if surface.taken_at is None:
        return replace(surface, taken_at=written, date_from="file system")
    at = surface.measured_at
    if at is None or EARLIEST <= at <= now + AHEAD:
        return surface
    if at < EARLIEST:
        warning = f"its date, {at.isoformat()}, is before 1985: the map counts as not dated"
        return replace(surface, date_from="guessed", warnings=(*surface.warnings, warning))
    warning = f"its date, {at.isoformat()}, is in the future: the instrument's clock, or this computer's, is wrong"
    return replace(surface, warnings=(*surface.warnings, warning))
