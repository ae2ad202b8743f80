"""A map as its instrument's profile says it lies and counts: applied once, and recorded."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np

from polishd.model.errors import MapError
from polishd.model.instrument import Instrument
from polishd.model.surface import SurfaceMap
from polishd.process.frames import ArrayOrientation
from polishd.process.metrology.conditioning import is_square, resample_square, scale_fault, with_coordinate_unit

ANSWERS = {
    "pitch": "pitch_mm, the width of a pixel on the part",
    "unit": "unit_nm, the nanometres in one unit of its heights",
    "surface": '"surface" in gives, with factor = 0.5 where its heights are of the wavefront',
    "orientation": '"orientation" in gives, with mirror and rotation_deg as they are',
    "square pixels": "nothing: its pixels are not square, of a size not known; export the map with its lateral scale",
}
"""Answers of a profile, and their keys."""
UNIT = "coordinate_unit_mm, the millimeters in one unit of its coordinates, such as 1"
"""Answer for the pitch of a list of points."""
SYSTEM = re.compile(r"(?:Zygo.*, system )?(\d+)")
SHORT = 2**16
"""Zygo's ``.dat`` keeps the last 16 bits of the system's number; its texts and ``.datx`` keep all."""


def apply_profile(surface: SurfaceMap, instrument: Instrument | None, *, partly: bool = False) -> SurfaceMap:
    """The map as it lies on the part, in nm of surface: flipped, turned, signed and scaled as the profile says.

    Args:
        surface: the map as its reader gave it.
        instrument: the profile; None where there is none, and then only a map whose file says all is taken.
        partly: to look at: what the profile does not answer stays ``unsaid``.

    Returns:
        The map with nothing ``unsaid``, and without the warnings that were of it; what was applied stands in
        ``factors["profile"]``.

    Raises:
        MapError: as `require_profile` does.
    """
    require_profile(surface, instrument, partly=partly)
    surface = _in_own_unit(surface, instrument)
    pitch_from = "profile" if "pitch" in _asked(surface) else "file"
    surface = resample_square(surface)
    if instrument is None:
        return surface
    pitch = _pitch_mm(surface, instrument)
    unsaid = surface.unsaid - _answered(instrument)
    settled = {warning for key, warning in surface.doubts.items() if key not in unsaid}
    unit = (instrument.unit_nm or 1.0) if "unit" in surface.unsaid else 1.0
    orientation = ArrayOrientation(instrument.mirror, instrument.rotation_deg)
    scaled = orientation.turn(surface.height_nm) * (instrument.sign * instrument.factor * unit)
    applied = {
        "name": instrument.name, "mirror": instrument.mirror, "rotation_deg": instrument.rotation_deg,
        "sign": instrument.sign, "factor": instrument.factor, "unit_nm": unit, "pitch_mm": pitch,
        "pitch_from": pitch_from,
    }  # fmt: skip
    return replace(
        surface,
        height_nm=np.ascontiguousarray(scaled),
        pitch_mm=pitch,
        factors={**surface.factors, "profile": applied},
        unsaid=unsaid,
        doubts={key: warning for key, warning in surface.doubts.items() if key in unsaid},
        warnings=tuple(warning for warning in surface.warnings if warning not in settled),
        orientation=f"{surface.orientation}; {orientation.name} by the profile {instrument.name}",
        fiducials_px=tuple(orientation.turn_point(mark, surface.height_nm.shape) for mark in surface.fiducials_px),
    )


def require_profile(surface: SurfaceMap, instrument: Instrument | None, *, partly: bool = False) -> None:
    """MapError where a profile, or none, cannot be applied to a map: asked before anybody waits for its answer.

    What the file does not say the profile does not either (no matter where ``partly``), they contradict each other, the
    map is of another instrument, or a profile was applied before, to the map or to one that it was made of. Nor is a
    mean of mixed repeats that is only for viewing (``partly``): its content is undefined.
    """
    name = surface.path.name if surface.path is not None else "the map"
    surface = _in_own_unit(surface, instrument)
    steps = [] if surface.history is None else list(surface.history.steps)
    by_history = instrument is not None and any("profile" in step.options for step in steps)
    if "profile" in surface.factors or by_history:
        raise MapError(f"{name} had the profile applied before: a second time would turn and scale it twice")
    if not partly and any(step.options.get("mixed") for step in steps):
        raise MapError(f"{name}: by its history it holds a mean of mixed repeats, of unknown pitch or several "
                     "instruments: average repeats of one set-up, without --mixed")  # fmt: skip
    if instrument is None:
        _all_said(name, surface)
        return
    _of_this_instrument(name, surface, instrument)
    if not partly:
        require_complete(surface, instrument)
    _require_pitch(name, surface, instrument)


def require_complete(surface: SurfaceMap, instrument: Instrument) -> None:
    """MapError where neither the map, nor the profile, says all that polishing takes of it."""
    name = surface.path.name if surface.path is not None else "the map"
    unanswered = sorted(_asked(surface) - _answered(instrument))
    if unanswered:
        raise MapError(f"{name}: its file does not say its {_words(unanswered)} and neither does the profile "
                     f"{instrument.name!r}: give it {_answers(surface, unanswered)}")  # fmt: skip


def _in_own_unit(surface: SurfaceMap, instrument: Instrument | None) -> SurfaceMap:
    """The map with its coordinates in the profile's unit, where it gives one and the file does not."""
    unit_mm = None if instrument is None else instrument.coordinate_unit_mm
    return surface if unit_mm is None else with_coordinate_unit(surface, unit_mm)


def _asked(surface: SurfaceMap) -> frozenset[str]:
    if surface.pitches_mm is not None:  # it is resampled, and has a pitch then
        return surface.unsaid - {"square pixels"}
    return surface.unsaid | ({"pitch"} if surface.pitch_mm is None else frozenset())


def _answered(instrument: Instrument) -> frozenset[str]:
    numbers = {"pitch": instrument.pitch_mm, "unit": instrument.unit_nm}
    return instrument.gives - set(numbers) | {key for key, number in numbers.items() if number is not None}


def _all_said(name: str, surface: SurfaceMap) -> None:
    asked = sorted(_asked(surface))
    if asked:
        raise MapError(f"{name}: its file does not say its {_words(asked)}, and there is no instrument's profile: "
                     f"add an [instrument] that gives {_answers(surface, asked)}")  # fmt: skip


def _of_this_instrument(name: str, surface: SurfaceMap, instrument: Instrument) -> None:
    words = {surface.instrument, *surface.instrument.replace(",", " ").split()}
    known = words & set(instrument.serials) or any(same_system(surface.instrument, one) for one in instrument.serials)
    if instrument.serials and not known:
        raise MapError(f"{name} is of the instrument {surface.instrument!r}, the profile {instrument.name!r} of "
                     f"{', '.join(instrument.serials)}: choose its own profile, or add it to serials and commission it "
                     "again")  # fmt: skip


def system_number(name: str) -> int | None:
    """The number in the name of a Zygo, or that is all of a name; None where there is none."""
    found = SYSTEM.fullmatch(name)
    return None if found is None else int(found[1])


def same_system(one: str, other: str) -> bool:
    """Return whether two instrument names may be one: equal, or of one system number, cut to 16 bits in either."""
    numbers = [number for number in map(system_number, (one, other)) if number is not None]
    cut = len(numbers) == 2 and min(numbers) < SHORT and numbers[0] % SHORT == numbers[1] % SHORT
    return one == other or cut or (len(numbers) == 2 and numbers[0] == numbers[1])


def _pitch_mm(surface: SurfaceMap, instrument: Instrument) -> float | None:
    """The file's pitch where it gives one, else the profile's; none for samples that are not square."""
    if "square pixels" in surface.unsaid:
        return None
    given, own = surface.pitch_mm, instrument.pitch_mm
    return own if own is not None and (given is None or "pitch" in surface.unsaid) else given


def _require_pitch(name: str, surface: SurfaceMap, instrument: Instrument) -> None:
    unscaled = surface.unscaled_pitches
    if unscaled is not None and instrument.pitch_mm is not None and not is_square(*unscaled):
        raise MapError(
            f"{name}: its pixels are not square, {unscaled[0]:.6g} x {unscaled[1]:.6g} in the unit of its coordinates, "
            f"and the profile {instrument.name!r} gives one pitch_mm. Give it {UNIT}"
        )
    given = surface.pitch_mm if surface.pitches_mm is None else min(surface.pitches_mm)
    own = instrument.pitch_mm
    fault = "" if own is None else scale_fault(surface.height_nm.shape, own)
    if fault:
        raise MapError(
            f"{name}: the profile {instrument.name!r} gives it a pitch of {own:g} mm: {fault}; mend pitch_mm"
        )
    if given is None or own is None or "pitch" in surface.unsaid:
        return
    if not abs(given / own - 1) <= instrument.pitch_tolerance:
        raise MapError(f"{name} has a pitch of {given:g} mm, the profile {instrument.name!r} {own:g} mm, "
                     f"{abs(given / own - 1):.1%} apart and {instrument.pitch_tolerance:.1%} allowed: another zoom or "
                     "camera mode, or a wrong calibration; measure again, or mend the profile")  # fmt: skip


def _words(keys: list[str]) -> str:
    return " and ".join(keys)


def _answers(surface: SurfaceMap, keys: list[str]) -> str:
    own = ANSWERS if surface.unscaled_pitches is None else {**ANSWERS, "pitch": UNIT}
    return "; ".join(own.get(key, f"{key!r} in gives") for key in keys)
