"""Zygo Mx ``.datx``: HDF5 in which ``/MetaData`` says where the surface is, and its attributes what it means.

``/MetaData`` is a table of links (Source, Link, Destination), followed Root -> Measurement -> Surface -> Path; older
files have ``/Measurement/Surface`` instead. A fringe is IntfScaleFactor waves, so a height in fringes is
fringes * scale * wavelength * obliquity.
"""

from __future__ import annotations

from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from polishd.api import BadMap, SurfaceMap, SurfaceReader
from polishd.model.surface import FloatArray
from polishd.plugins.interferometer.formats import apart, hdf5
from polishd.plugins.interferometer.formats.common import (
    require_data,
    require_optics,
    time_of,
)
from polishd.plugins.interferometer.formats.scales import NO_PITCH, HeightUnit, Pitch, height_unit, pitch

NAME = "datx"
VERSION = 1
MOST_LINKS = 10_000
HUGE = 1e30
"""Heights beyond it are "no data" in files that do not say what is."""
OLD_PATH = "/Measurement/Surface"
ALSO_NM = {"microinches": 25.4, "mils": 25_400.0, "inches": 2.54e7, "picometers": 1e-3, "centimeters": 1e7}
OPTICS = {
    "IntfScaleFactor": "Interferometric Scale Factor",
    "Wavelength (m)": "Wavelength",
    "Obliquity": "Obliquity Factor",
}
PARAMETER = {"Wavelength (m)": 1, "IntfScaleFactor": 2, "Obliquity": 3}
"""Where the Z converter of a file repeats them."""


def sniff(head: bytes, path: Path) -> bool:
    """True for an HDF5 file with Mx's table of links, or its older measurement."""
    return hdf5.holds(head, path, ".datx")


def read(path: Path) -> SurfaceMap:
    """Read a map. BadMap for whatever is torn, linked elsewhere, or without scale; an unknown unit is ``unsaid``."""
    return apart.read(__name__, path)


def parse(path: Path) -> SurfaceMap:
    """``read``, in this process: HDF5 may crash, hang or fill the memory on a broken file."""
    with hdf5.opened(path) as source:
        links = _links(source)
        data = _surface(source, links)
        height = hdf5.samples(source, data)
        unit, optics = _unit(source, data)
        height = _scaled(height, hdf5.number(source, data, "No Data"), unit.nm)
        about = _about(source, links)
        scale = _pitch(source, data)
        origin = hdf5.attribute(source, data, "Coordinates")
        factors = {"unit": hdf5.text(source, data, "Unit"), "nm_per_unit": unit.nm, **optics, "window": str(origin)}
    return SurfaceMap(
        height_nm=require_data(path, height),
        pitch_mm=scale.mm,
        sha256=source.sha256,
        path=path,
        format=NAME,
        factors=factors,
        warnings=unit.warnings + scale.warnings,
        unsaid=unit.unsaid | scale.unsaid,
        reader_version=VERSION,
        **about,
    )


def _links(source: hdf5.Opened) -> dict[tuple[str, str], str]:
    """(source, link) -> destination, the first of each; empty where there is no table."""
    table = hdf5.member(source, "MetaData")
    if table is None:
        return {}
    if not hdf5.is_plain(table, 1) or not {"Source", "Link", "Destination"} <= set(table.dtype.names or ()):
        raise BadMap(f"{source.path}: /MetaData is no table of Source, Link and Destination")
    if table.size > MOST_LINKS or table.dtype.itemsize > source.length:
        raise BadMap(f"{source.path}: /MetaData has {table.size} links: no map")
    found: dict[tuple[str, str], str] = {}
    for row in table[()]:
        start, link, destination = (_plain(row[name]) for name in ("Source", "Link", "Destination"))
        found.setdefault((start, link), destination)
    return found


def _plain(value: Any) -> str:
    return value.decode("latin-1") if isinstance(value, bytes) else str(value)


def _surface(source: hdf5.Opened, links: dict[tuple[str, str], str]) -> Any:
    measurement = links.get(("Root", "Measurement"), "")
    surface = links.get((measurement, "Surface"), "")
    place = links.get((surface, "Path"), "" if links else OLD_PATH)
    if not place:
        raise BadMap(f"{source.path}: /MetaData leads to no surface (Root -> Measurement -> Surface -> Path)")
    data = hdf5.member(source, place)
    if data is None:
        raise BadMap(f"{source.path}: its surface {place} is missing")
    return data


def _scaled(height: FloatArray, no_data: float | None, nm: float) -> FloatArray:
    missing = ~(np.abs(height) < HUGE)
    if no_data is not None:
        missing |= (height >= no_data) if no_data > HUGE else (height == no_data)
    height[missing] = np.nan
    height *= nm
    return height


def _parameters(source: hdf5.Opened, data: Any, name: str) -> list[float]:
    """The numbers of a converter: a record (category, unit, parameters), or in some versions the parameters alone."""
    value = hdf5.attribute(source, data, name)
    if value is None:
        return []
    first = np.ravel(value)[0] if np.asarray(value).dtype.kind in "VO" else value
    if isinstance(first, np.void) and first.dtype.names:
        first = first["Parameters"] if "Parameters" in first.dtype.names else first[-1]
    try:
        return [float(item) for item in np.ravel(first)]
    except (TypeError, ValueError):
        return []


def _unit(source: hdf5.Opened, data: Any) -> tuple[HeightUnit, dict[str, float]]:
    """The unit of heights, and what of the optics it needed."""
    name = hdf5.text(source, data, "Unit")
    word = name.lower()
    if word in ALSO_NM:
        return HeightUnit(ALSO_NM[word]), {}
    if word not in {"fringes", "fringe", "waves", "wave"}:
        return height_unit(name), {}
    given = _optics(source, data, {"Wavelength (m)", "Obliquity"} | ({"IntfScaleFactor"} if "f" in word else set()))
    return HeightUnit(float(np.prod(list(given.values()))) * 1e9), given


def _optics(source: hdf5.Opened, data: Any, names: set[str]) -> dict[str, float]:
    again = _parameters(source, data, "Z Converter")
    found: dict[str, float] = {}
    for name in sorted(names):
        value = hdf5.number(source, data, OPTICS[name])
        if value is None and PARAMETER[name] < len(again):
            value = again[PARAMETER[name]]
        if value is None:
            raise BadMap(f"{source.path}: is in {hdf5.text(source, data, 'Unit')} and does not say its {OPTICS[name]}")
        found[name] = value
    require_optics(source.path, found)
    return found


def _pitch(source: hdf5.Opened, data: Any) -> Pitch:
    sides = [_parameters(source, data, f"{axis} Converter")[1:2] for axis in "XY"]
    metres = [side[0] for side in sides if side]
    if not any(metres):
        return NO_PITCH
    return pitch(source.path, metres[0] * 1e3, metres[-1] * 1e3)


def _about(source: hdf5.Opened, links: dict[tuple[str, str], str]) -> dict[str, Any]:
    """Part, instrument and time, from the attributes of the measurement."""
    place = links.get((links.get(("Root", "Measurement"), ""), "Attributes"), "/Measurement/Attributes")
    node = hdf5.member(source, place)
    if node is None:
        return {}
    key = {name.rpartition(".")[2]: name for name in reversed(list(node.attrs))}

    def text(name: str) -> str:
        return hdf5.text(source, node, key[name]) if name in key else ""

    system = " ".join(["Zygo", text("System Type")]).strip()
    serial = text("System Serial Number")
    return {
        "part_id": text("Part Serial Number") or text("Part Number"),
        "instrument": f"{system}, system {serial}" if serial else system,
        "taken_at": _time(hdf5.attribute(source, node, key["Time Stamp"])) if "Time Stamp" in key else None,
    }


def _time(value: Any) -> datetime | None:
    first = np.ravel(value)[0] if value is not None else None
    if not isinstance(first, np.void) or "time" not in (first.dtype.names or ()):
        return None
    return time_of(float(first["time"]))


def _write(surface: SurfaceMap) -> bytes:
    from polishd.plugins.interferometer.formats.datx_writer import write

    return write(surface)


DATX = SurfaceReader(name=NAME, sniff=sniff, read=read, suffixes=(".datx",), write=_write)
