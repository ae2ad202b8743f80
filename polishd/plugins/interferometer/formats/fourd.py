"""4D Technology ``.h5``: waves in ``/measurement0/genraw/data``, and attributes that are texts with units.

``wedge`` is the factor from waves of the wavefront to waves of the surface: 0.5 in reflection, 1.0 where the data are
surface already. Public readers leave it out.
"""

from __future__ import annotations

import re
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from polishd.api import MapError, SurfaceMap
from polishd.plugins.interferometer.formats import hdf5, sandbox
from polishd.plugins.interferometer.formats.common import (
    NO_PITCH,
    Pitch,
    checked,
    date_of,
    named,
    nm_per,
    pitch,
    require_optics,
)
from polishd.plugins.interferometer.formats.format import Format

FORMAT = Format("4d", 3)
GENRAW = "/measurement0/genraw"
MISSING = 1e37
WITH_UNIT = re.compile(r"([-+]?[0-9.]+(?:[eE][-+]?[0-9]+)?)\s*(.*)", re.DOTALL)
NO_WEDGE = "has no wedge factor: shown as if its waves were of the surface, and they may be of the wavefront"
ODD_WEDGE = "its wedge is {:g}, neither 0.5 nor 1.0: is that what makes a surface of its waves?"
ODD_FIDUCIALS = "its fiducials are not used: they are not pairs of x and y on the map"
PARTS = ("part_serial", "part_id", "part", "partname", "part_name", "serial_number")


class ValueWithUnit(NamedTuple):
    """A number and the word after it."""

    value: float
    unit: str


def parse(path: Path) -> SurfaceMap:
    """Read a map. MapError for whatever is torn, linked elsewhere, or without a wavelength; no wedge is ``unsaid``.

    Run in the worker of ``sandbox``: HDF5 may crash, hang or fill the memory on a broken file.
    """
    with hdf5.opened(path) as source:
        data = hdf5.member(source, f"{GENRAW}/data")
        if data is None:
            raise MapError(f"{path}: has no {GENRAW}/data")
        nodes = [data, hdf5.member(source, GENRAW), hdf5.member(source, "/measurement0"), source.file]
        waves = hdf5.samples(source, data)
        wavelength_nm = _wavelength_nm(source, nodes)
        wedge = _wedge(source, nodes)
        scale = _pitch(source, nodes)
        fiducials, odd = _fiducials(source, nodes, waves.shape)
        part = next((found for found in (_text(source, nodes, name) for name in PARTS) if found), "")
        instrument, serial = (_text(source, nodes, name) for name in ("instrument", "head_serial"))
        date = date_of(_text(source, nodes, "date"))
    waves[~(np.abs(waves) < MISSING)] = np.nan
    waves *= wavelength_nm * (1.0 if wedge is None else wedge)
    return FORMAT.surface(
        path,
        source.sha256,
        checked(path, waves, wavelength_nm),
        lateral=scale,
        part_id=part,
        instrument=f"4D {instrument}".strip() + (f", system {serial}" if serial else ""),
        taken_at=date.at,
        date_from=date.by,
        factors={"wavelength_nm": wavelength_nm, "wedge": wedge},
        doubts={} if wedge else {"surface": NO_WEDGE},
        warnings=odd + _odd_wedge(wedge) + date.warnings,
        fiducials_px=fiducials,
    )


def _text(source: hdf5.Hdf5Contents, nodes: list[Any], name: str) -> str:
    return next((found for node in nodes if node is not None and (found := named(hdf5.text(source, node, name)))), "")


def _measure(source: hdf5.Hdf5Contents, nodes: list[Any], name: str) -> ValueWithUnit | None:
    """A number and its unit ("632.8 nm"), or None where it is absent or empty; MapError where it is no number."""
    text = _text(source, nodes, name)
    if not text:
        return None
    found = WITH_UNIT.fullmatch(text)
    try:
        value = float(found[1]) if found else np.nan
    except ValueError:
        value = np.nan
    if found is None or not np.isfinite(value):
        raise MapError(f"{source.path}: its {name} is {text!r}, not a number with a unit")
    return ValueWithUnit(value, found[2].strip())


def _wavelength_nm(source: hdf5.Hdf5Contents, nodes: list[Any]) -> float:
    found = _measure(source, nodes, "wavelength")
    if found is None:
        raise MapError(f"{source.path}: is in waves and does not say its wavelength")
    factor = nm_per(found.unit)
    if factor is None:
        raise MapError(
            f"{source.path}: its wavelength is {found.value:g} {found.unit or '(no unit)'}: the unit is not known"
        )
    require_optics(source.path, {"Wavelength (m)": found.value * factor / 1e9})
    return found.value * factor


def _wedge(source: hdf5.Hdf5Contents, nodes: list[Any]) -> float | None:
    found = _measure(source, nodes, "wedge")
    if found is None:
        return None
    require_optics(source.path, {"IntfScaleFactor": found.value})
    return found.value


def _odd_wedge(wedge: float | None) -> tuple[str, ...]:
    return () if wedge in {None, 0.5, 1.0} else (ODD_WEDGE.format(wedge),)


def _pitch(source: hdf5.Hdf5Contents, nodes: list[Any]) -> Pitch:
    """From ``xpix`` and ``ypix``, or ``xpix`` times ``aspect``; pixels, 0 or nothing: no lateral scale."""
    x_mm, y_mm = (_length_mm(source, nodes, name) for name in ("xpix", "ypix"))
    if x_mm and not y_mm and (aspect := _measure(source, nodes, "aspect")):
        y_mm = x_mm * aspect.value
    return pitch(source.path, x_mm, y_mm) if x_mm and y_mm else NO_PITCH


def _length_mm(source: hdf5.Hdf5Contents, nodes: list[Any], name: str) -> float | None:
    found = _measure(source, nodes, name)
    factor = nm_per(found.unit.partition("/")[0]) if found else None
    return found.value * factor / 1e6 if found and factor else None


def _fiducials(
    source: hdf5.Hdf5Contents, nodes: list[Any], shape: tuple[int, ...]
) -> tuple[tuple[tuple[float, float], ...], tuple[str, ...]]:
    """(row, column) of the marks, listed as x, y; none and a warning where they are not that."""
    value = next((found for node in nodes if (found := _listed(source, node)) is not None), None)
    if value is None:
        return (), ()
    marks = tuple((float(y), float(x)) for x, y in value.reshape(-1, 2)) if value.size % 2 == 0 else ()
    on_map = all(-0.5 <= row <= shape[0] - 0.5 and -0.5 <= column <= shape[1] - 0.5 for row, column in marks)
    return (marks, ()) if marks and on_map else ((), (ODD_FIDUCIALS,))


def _listed(source: hdf5.Hdf5Contents, node: Any) -> Any:
    value = hdf5.attribute(source, node, "fiducials") if node is not None else None
    if value is None or (np.asarray(value).dtype.kind not in "fiu" and not hdf5.text(source, node, "fiducials")):
        return None
    if np.asarray(value).dtype.kind in "fiu":
        return np.asarray(value, dtype=np.float64).ravel()
    words = re.findall(r"[-+]?\d+(?:\.\d+)?", hdf5.text(source, node, "fiducials"))
    return np.array(words or [np.nan], dtype=np.float64)


FOURD = FORMAT.reader(partial(sandbox.read, __name__), ".h5", sniff=partial(hdf5.holds, suffix=".h5"))
