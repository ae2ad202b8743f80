"""Units of heights and pitches, and what is said of a map whose file leaves them open."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from polishd.api import MapError
from polishd.model.surface import FloatArray
from polishd.plugins.interferometer.formats.common import require_data

NM_PER = {
    name: nm
    for names, nm in (
        ("m meter metre", 1e9),
        ("cm", 1e7),
        ("mm millimeter millimetre", 1e6),
        ("um micrometer micrometre micron", 1e3),
        ("nm nanometer nanometre", 1.0),
        ("angstrom", 0.1),
        ("pm", 1e-3),
        ("in inch", 2.54e7),
    )
    for name in names.split()
}
SQUARE_WITHIN = 1e-3
"""Relative difference of the pitches in x and y that still counts as square pixels."""
MOST_NM = 1e9
"""A metre: what is higher is no height, but in another unit, or a marker of missing data that nobody declared."""
MARKERS = {9999.0, 99999.0, 999999.0, 32767.0, 32768.0, 2147483647.0, 2147483648.0}
"""Numbers that programs write for missing data, in the unit of their file."""


NOTHING: Mapping[str, str] = {}


class Pitch(NamedTuple):
    """A pitch, or None; and by what the file leaves to the profile, what to warn of."""

    mm: float | None
    doubts: Mapping[str, str] = NOTHING
    both_mm: tuple[float, float] | None = None
    """Width and height of a pixel that is not square."""


class HeightUnit(NamedTuple):
    """How many nm a unit of height is; and by what the file leaves to the profile, what to warn of."""

    nm: float
    doubts: Mapping[str, str] = NOTHING


SAID = HeightUnit(1.0)
"""Of heights whose unit the format or the file says."""
IN_UNITS = "pitches_in_its_unit"
"""In a map's ``factors``: its pitches in x and y in the lateral unit that the file does not say."""
NO_PITCH = Pitch(None, {"pitch": "the file gives no lateral scale"})


def nm_per(unit: str) -> float | None:
    """How many nm the unit is, by its usual names; None where it is none of length or not known."""
    name = unit.strip().strip("[]()").replace("\N{MICRO SIGN}", "u").replace("\N{GREEK SMALL LETTER MU}", "u")
    if name in {"\N{LATIN CAPITAL LETTER A WITH RING ABOVE}", "A", "\N{ANGSTROM SIGN}"}:
        return NM_PER["angstrom"]
    known = NM_PER.get(name)  # as it is first: Mm is no mm
    if known is None and len(name) > 2:
        known = NM_PER.get(name.lower()) or NM_PER.get(name.lower().removesuffix("s"))
    return known


def height_unit(unit: str) -> HeightUnit:
    """The unit of heights. One that is not known, or none: 1.0, a warning, and "unit" is left to the profile."""
    factor = nm_per(unit)
    if factor is not None:
        return HeightUnit(factor)
    found = f"the unit of heights, {unit.strip()!r}, is not known" if unit.strip() else "the heights have no unit"
    return HeightUnit(1.0, {"unit": f"{found}: shown as if nm"})


def pitch(path: Path, x_mm: float, y_mm: float) -> Pitch:
    """The one pitch of square pixels. BadMap where either is no length.

    Pixels that are not square keep both: "square pixels" is unsaid until the map is resampled, as conditioning does.
    """
    for axis, value in (("x", x_mm), ("y", y_mm)):
        if not (math.isfinite(value) and value > 0):
            raise MapError(f"{path}: the pitch in {axis} is {value:g} mm, no length")
    if abs(x_mm - y_mm) > SQUARE_WITHIN * max(x_mm, y_mm):
        warning = f"pixels are {x_mm:.6g} mm wide and {y_mm:.6g} mm high: not square; a cell resamples the map"
        return Pitch(None, {"square pixels": warning}, (x_mm, y_mm))
    return Pitch(x_mm / 2 + y_mm / 2)


def checked(path: Path, height_nm: FloatArray, nm: float = 1.0) -> FloatArray:
    """The heights, where ``require_data`` takes them and none is beyond belief; BadMap otherwise.

    Beyond belief are heights above ``MOST_NM``, and an extreme that stands there more than once and is one of
    ``MARKERS`` in the file's unit of ``nm``.
    """
    require_data(path, height_nm)
    for worst in (float(np.nanmin(height_nm)), float(np.nanmax(height_nm))):
        marks = abs(round(worst / nm, 6)) in MARKERS and np.count_nonzero(height_nm == worst) > 1
        if marks or abs(worst) > MOST_NM:
            found = f"has heights of {worst / nm:.7g} x {nm:g} nm"
            raise MapError(f"{path}: {found}: a marker of missing data that the file does not declare?")
    return height_nm
