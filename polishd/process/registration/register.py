"""Register a map as its instrument's profile asks, within the profile's limits."""

from __future__ import annotations

from dataclasses import replace

from polishd.model.errors import MapError
from polishd.model.instrument import Instrument
from polishd.model.outline import Circle, Outline
from polishd.model.surface import SurfaceMap
from polishd.process.registration import fiducials, marks, outline, sides
from polishd.process.registration.record import Registration


def register(
    surface: SurfaceMap, instrument: Instrument | None, part: Outline, last: Registration | None = None
) -> Registration:
    """Where the part lies in a map that has been turned as its profile says.

    Args:
        surface: the map (`process.instrument.as_profiled`).
        instrument: the profile; None: the centre of the array is the part's centre, as without a profile's wish.
        part: its outline, which maps show where the profile gives no other.
        last: the last map's registration of the same part; None: no drift is judged.

    Raises:
        BadMap: nothing to register by, or the part lies too far off, too far turned, or has moved too much.
        ConfigError: the profile's fiducials are too few, or symmetric.
    """
    if instrument is None or instrument.register_by == "none":
        return Registration()
    if surface.pitch_mm is None:
        raise MapError("the map has no lateral scale: give the instrument's profile a pitch")
    found = {
        "aperture": lambda: _by_aperture(surface, instrument, part),
        "fiducials": lambda: _by_fiducials(surface, instrument),
        "both": lambda: _by_both(surface, instrument, part),
    }[instrument.register_by]()
    _within_limits(found, instrument)
    if last is not None and last.by != "none":
        drift = found.drift_mm(last)
        if drift > instrument.max_drift_mm:
            raise MapError(f"the part's centre lies {drift:.3f} mm from where the last map had it, "
                         f"{instrument.max_drift_mm:g} mm allowed: it has moved in its fixture, or the "
                         "instrument was set anew; seat the part, measure again, or begin a new job")  # fmt: skip
    return found


def _by_aperture(surface: SurfaceMap, instrument: Instrument, part: Outline) -> Registration:
    height, pitch, tolerance = surface.height_nm, surface.grid.pitch_mm, instrument.aperture_tolerance_mm
    seen = part if instrument.aperture_mm is None else Circle(instrument.aperture_mm / 2)
    if isinstance(seen, Circle):
        return outline.fit_circle(height, pitch, 2 * seen.radius_mm, tolerance)
    return sides.fit_polygon(height, pitch, seen, tolerance)


def _by_fiducials(surface: SurfaceMap, instrument: Instrument) -> Registration:
    """By the marks that the file lists; where it lists too few, by those seen in the map."""
    listed, pitch = surface.fiducials_px, surface.grid.pitch_mm
    found = listed if len(listed) >= fiducials.FEWEST else marks.find(surface.height_nm, pitch)
    shape = surface.grid.shape
    return fiducials.fit(found, instrument.fiducials_mm, shape, pitch, instrument.fiducial_tolerance_mm)


def _by_both(surface: SurfaceMap, instrument: Instrument, part: Outline) -> Registration:
    """By the fiducials; the outline must have the centre in the same place."""
    found, seen = _by_fiducials(surface, instrument), _by_aperture(surface, instrument, part)
    apart = found.drift_mm(seen)
    if apart > instrument.fiducial_tolerance_mm:
        raise MapError(f"by its fiducials the part has its {found}, by its outline its {seen}: {apart:.3f} mm apart, "
                     f"{instrument.fiducial_tolerance_mm:g} mm allowed; check instrument.fiducials_mm, and that "
                     "nothing covers the rim")  # fmt: skip
    return replace(found, by="both")


def _within_limits(found: Registration, instrument: Instrument) -> None:
    if abs(found.rotation_deg) > instrument.max_turn_deg:
        raise MapError(f"the part is turned by {found.rotation_deg:.2f} deg in the map, {instrument.max_turn_deg:g} deg "
                     "allowed: seat it as the fixture has it, or mend the profile's rotation_deg")  # fmt: skip
    if found.distance_mm > instrument.max_shift_mm:
        x, y = found.shift_mm
        raise MapError(f"the part's centre lies at ({x:.3f}, {y:.3f}) mm in the map, {instrument.max_shift_mm:g} mm from "
                     "its centre allowed: centre the part before the instrument and measure again")  # fmt: skip
