"""Zygo Mx ``.datx``: HDF5 in which ``/MetaData`` says where the surface is, and its attributes what it means.

``/MetaData`` is a table of links (Source, Link, Destination), followed Root -> Measurement -> Surface -> Path; older
files have ``/Measurement/Surface`` instead. A fringe is IntfScaleFactor waves, so a height in fringes is
fringes * scale * wavelength * obliquity.
"""

from __future__ import annotations

import hashlib
import io
import math
import uuid
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from polishd.api import MapError, SurfaceMap
from polishd.model.surface import FloatArray
from polishd.plugins.interferometer.formats import hdf5, sandbox
from polishd.plugins.interferometer.formats.common import (
    NO_PITCH,
    HeightUnit,
    Pitch,
    checked,
    height_unit,
    named,
    pitch,
    require_optics,
    require_stated,
    time_of,
)
from polishd.plugins.interferometer.formats.format import Format, found_in, line_of

if TYPE_CHECKING:
    import h5py


# Writing Zygo Mx ``.datx``: heights in nm as they are, so nothing is lost.

WRITER = "polishd"
"""The system type of files that polishd writes: they name the instrument in a separate attribute."""
INSTRUMENT, HISTORY = "polishd Instrument", "polishd History"
"""Attributes that keep what Mx has no place for."""
NO_DATA = float(np.finfo(np.float64).max)
WAVELENGTH_M, SCALE, OBLIQUITY = 632.8e-9, 0.5, 1.0
"""Readers expect them; heights in nm do not use them."""


def write(surface: SurfaceMap) -> bytes:
    """Content of a file that reads back exactly; NaN is ``No Data``, no pitch is a lateral resolution of 0.

    The same map gives the same bytes. MapError where the map's unit is unknown.
    """
    import h5py

    require_stated(surface, "pitch")
    digest = hashlib.sha256(np.ascontiguousarray(surface.height_nm).tobytes()).hexdigest()
    names = (uuid.uuid5(uuid.NAMESPACE_OID, digest + word) for word in "MSA")
    measurement, place, about = (f"{{{name}}}".upper() for name in names)
    links = [
        ("Root", "Measurement", measurement),
        (measurement, "Attributes", f"/Attributes/{about}"),
        (measurement, "Surface", place),
        (measurement, "Name", "polishd"),
        (place, "Path", f"/Data/Surface/{place}"),
        (place, "MpxDataType", "DoubleMatrix2D"),
    ]
    words = h5py.string_dtype("ascii")
    table = np.array(links, dtype=[(name, words) for name in ("Source", "Link", "Destination")])
    held = io.BytesIO()
    with h5py.File(held, "w") as file:
        file.create_dataset("MetaData", data=table, track_times=False)
        _data(file, f"/Data/Surface/{place}", surface)
        _write_attributes(file.create_group(f"/Attributes/{about}"), surface)
    return held.getvalue()


def _data(file: h5py.File, place: str, surface: SurfaceMap) -> None:
    import h5py

    rows, columns = surface.height_nm.shape
    metres = (surface.pitch_mm or 0.0) / 1e3
    height = np.where(np.isfinite(surface.height_nm), surface.height_nm, NO_DATA)
    data = file.create_dataset(place, data=height, track_times=False)
    text = h5py.string_dtype("ascii")
    converter = np.dtype([("Category", text), ("BaseUnit", text), ("Parameters", h5py.vlen_dtype(np.float64))])
    lateral = np.array([("LateralCat", "Pixels", np.array([0.0, metres, 0.0, 0.0]))], dtype=converter)
    optics = np.array([0.0, WAVELENGTH_M, SCALE, OBLIQUITY])
    window = [(name, "<i4") for name in ("RowStart", "ColumnStart", "Width", "Height")]
    data.attrs["Unit"] = np.array(["NanoMeters"], dtype=text)
    data.attrs["No Data"] = np.array([NO_DATA])
    data.attrs["Wavelength"] = np.array([WAVELENGTH_M])
    data.attrs["Interferometric Scale Factor"] = np.array([SCALE])
    data.attrs["Obliquity Factor"] = np.array([OBLIQUITY])
    data.attrs["Coordinates"] = np.array([(0, 0, columns, rows)], dtype=window)
    data.attrs.create("X Converter", lateral, dtype=converter)
    data.attrs.create("Y Converter", lateral, dtype=converter)
    data.attrs.create("Z Converter", np.array([("HeightCat", "NanoMeters", optics)], dtype=converter), dtype=converter)


def _write_attributes(group: h5py.Group, surface: SurfaceMap) -> None:
    import h5py

    text = h5py.string_dtype("utf-8")
    prefix = "Data Context.Data Attributes"
    for name in ("Part Serial Number", "Part Number"):
        group.attrs[f"{prefix}.{name}"] = np.array([surface.part_id], dtype=text)
    group.attrs[f"{prefix}.System Type"] = np.array([WRITER], dtype=text)
    group.attrs[f"{prefix}.{INSTRUMENT}"] = np.array([surface.instrument], dtype=text)
    kept = line_of(surface)
    if kept is not None:
        group.attrs[f"{prefix}.{HISTORY}"] = np.array([kept], dtype=text)
    if surface.measured_at:
        stamp = [("time", "<i8"), ("millitm", "<u2"), ("timezone", "<i2"), ("dstflag", "<i2")]
        seconds, milli = divmod(int(surface.measured_at.timestamp() * 1000), 1000)
        group.attrs[f"{prefix}.Time Stamp"] = np.array([(seconds, milli, 0, 0)], dtype=stamp)


FORMAT = Format("datx", 2)
MOST_LINKS = 10_000
HUGE = 1e30
"""Heights beyond it are "no data", whatever the file says is."""
MISSING = 2147483640.0
"""And from it on in files that do not say: it is MetroPro's."""
OLD_PATH = "/Measurement/Surface"
ALSO_NM = {"microinches": 25.4, "mils": 25_400.0, "inches": 2.54e7, "picometers": 1e-3, "centimeters": 1e7}
OPTICS = {
    "IntfScaleFactor": "Interferometric Scale Factor",
    "Wavelength (m)": "Wavelength",
    "Obliquity": "Obliquity Factor",
}
PIXELS = {"", "pixels", "pixel", "meters", "meter"}
"""Base units of a lateral converter whose parameter is m a pixel."""
PARAMETER = {"Wavelength (m)": 1, "IntfScaleFactor": 2, "Obliquity": 3}
"""Where the Z converter of a file repeats them."""


def parse(path: Path) -> SurfaceMap:
    """Read a map. MapError for whatever is torn, linked elsewhere, or without scale; an unknown unit is ``unsaid``.

    Run in the worker of ``sandbox``: HDF5 may crash, hang or fill the memory on a broken file.
    """
    with hdf5.opened(path) as source:
        links = _links(source)
        data = _surface(source, links)
        height = hdf5.samples(source, data)
        unit, optics = _unit(source, data)
        height = _scaled(height, hdf5.number(source, data, "No Data"), unit.nm)
        about = _read_attributes(source, links)
        scale = _pitch(source, data)
        origin = hdf5.attribute(source, data, "Coordinates")
        odd = _contradictions(source, data, optics)
        factors = {"unit": hdf5.text(source, data, "Unit"), "nm_per_unit": unit.nm, **optics, "window": str(origin)}
    height_nm = checked(path, height, unit.nm)
    history, broken = found_in(about.pop("history", ""))
    return FORMAT.surface(
        path,
        source.sha256,
        height_nm,
        height=unit,
        lateral=scale,
        factors=factors,
        warnings=(*odd, *broken),
        history=history,
        **about,
    )


def _links(source: hdf5.Hdf5Contents) -> dict[tuple[str, str], str]:
    """(source, link) -> destination; empty where there is no table, MapError where it leads to two surfaces."""
    table = hdf5.member(source, "MetaData")
    if table is None:
        return {}
    if not hdf5.is_plain(table, 1) or not {"Source", "Link", "Destination"} <= set(table.dtype.names or ()):
        raise MapError(f"{source.path}: /MetaData is no table of Source, Link and Destination")
    if table.size > MOST_LINKS or table.dtype.itemsize > source.length:
        raise MapError(f"{source.path}: /MetaData has {table.size} links: no map")
    found: dict[tuple[str, str], str] = {}
    for row in table[()]:
        start, link, destination = (_plain(row[name]) for name in ("Source", "Link", "Destination"))
        if found.setdefault((start, link), destination) != destination and link in {"Measurement", "Surface", "Path"}:
            raise MapError(f"{source.path}: /MetaData leads from {start} to two of {link!r}: which one is meant?")
    return found


def _plain(value: Any) -> str:
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)


def _surface(source: hdf5.Hdf5Contents, links: dict[tuple[str, str], str]) -> Any:
    measurement = links.get(("Root", "Measurement"), "")
    surface = links.get((measurement, "Surface"), "")
    place = links.get((surface, "Path"), "" if links else OLD_PATH)
    if not place:
        raise MapError(f"{source.path}: /MetaData leads to no surface (Root -> Measurement -> Surface -> Path)")
    data = hdf5.member(source, place)
    if data is None:
        raise MapError(f"{source.path}: its surface {place} is missing")
    return data


def _scaled(height: FloatArray, no_data: float | None, nm: float) -> FloatArray:
    missing = ~(np.abs(height) < HUGE)
    if no_data is None:
        missing |= height >= MISSING
    else:
        missing |= (height >= no_data) if no_data > HUGE else (height == no_data)
    height[missing] = np.nan
    height *= nm
    return height


def _converter(source: hdf5.Hdf5Contents, data: Any, name: str) -> tuple[str, list[float]]:
    """Base unit and numbers of a converter: a record (category, unit, numbers), or in some versions the numbers alone.

    "" and nothing where there is none.
    """
    value = hdf5.attribute(source, data, name)
    if value is None:
        return "", []
    first, unit = np.ravel(value)[0] if np.asarray(value).dtype.kind in "VO" else value, ""
    if isinstance(first, np.void) and first.dtype.names:
        unit = _plain(first["BaseUnit"]) if "BaseUnit" in first.dtype.names else ""
        first = first["Parameters"] if "Parameters" in first.dtype.names else first[-1]
    try:
        return unit.strip("\0 "), [float(item) for item in np.ravel(first)]
    except (TypeError, ValueError):
        return unit, []


def _unit(source: hdf5.Hdf5Contents, data: Any) -> tuple[HeightUnit, dict[str, float]]:
    """The unit of heights, and what of the optics it needed."""
    name = hdf5.text(source, data, "Unit")
    word = name.lower()
    if word in ALSO_NM:
        return HeightUnit(ALSO_NM[word]), {}
    if word not in {"fringes", "fringe", "waves", "wave"}:
        return height_unit(name), {}
    given = _optics(source, data, {"Wavelength (m)", "Obliquity"} | ({"IntfScaleFactor"} if "f" in word else set()))
    return HeightUnit(float(np.prod(list(given.values()))) * 1e9), given


def _optics(source: hdf5.Hdf5Contents, data: Any, names: set[str]) -> dict[str, float]:
    _, again = _converter(source, data, "Z Converter")
    found: dict[str, float] = {}
    for name in sorted(names):
        value = hdf5.number(source, data, OPTICS[name])
        if value is None and PARAMETER[name] < len(again):
            value = again[PARAMETER[name]]
        if value is None:
            raise MapError(
                f"{source.path}: is in {hdf5.text(source, data, 'Unit')} and does not say its {OPTICS[name]}"
            )
        found[name] = value
    require_optics(source.path, found)
    return found


def _contradictions(source: hdf5.Hdf5Contents, data: Any, optics: dict[str, float]) -> tuple[str, ...]:
    """What to warn of: where the Z converter or the frame is another than the one that was used."""
    unit, again = _converter(source, data, "Z Converter")
    name = hdf5.text(source, data, "Unit")
    pairs = [(field, own, again[PARAMETER[field]]) for field, own in optics.items() if PARAMETER[field] < len(again)]
    unlike = [pair for pair in pairs if not math.isclose(pair[1], pair[2], rel_tol=1e-6)]
    odd = [f"{field} {own:g}, and {other:g}" for field, own, other in unlike]
    if unit and name and unit.lower() != name.lower():
        odd.append(f"heights in {name}, and in {unit}")
    frame = hdf5.first(source, data, "Coordinates")
    if isinstance(frame, np.void) and {"Width", "Height"} <= set(frame.dtype.names or ()):
        frame_size = (int(frame["Height"]), int(frame["Width"]))
        odd += [f"samples of {data.shape}, and a frame of {frame_size}"] if frame_size != data.shape else []
    return tuple(f"its attributes contradict one another: {words}, of which the former is used" for words in odd)


def _pitch(source: hdf5.Hdf5Contents, data: Any) -> Pitch:
    sides = [_converter(source, data, f"{axis} Converter") for axis in "XY"]
    metres = [numbers[1] for _, numbers in sides if len(numbers) > 1]
    if len(metres) < len(sides) or not any(metres):
        return NO_PITCH
    odd = sorted({unit for unit, _ in sides if unit.lower() not in PIXELS})
    if odd:
        return Pitch(None, {"pitch": f"its pitch is in {odd[0]!r} a pixel, not in m: it is not used"})
    return pitch(source.path, metres[0] * 1e3, metres[1] * 1e3)


def _read_attributes(source: hdf5.Hdf5Contents, links: dict[tuple[str, str], str]) -> dict[str, Any]:
    """Part, instrument, time and the text of a history, from the attributes of the measurement."""
    place = links.get((links.get(("Root", "Measurement"), ""), "Attributes"), "/Measurement/Attributes")
    node = hdf5.member(source, place)
    if node is None:
        return {}
    key = {name.rpartition(".")[2]: name for name in reversed(list(node.attrs))}

    def text(name: str) -> str:
        return named(hdf5.text(source, node, key[name])) if name in key else ""

    kind, serial = text("System Type"), text("System Serial Number")
    system = text(INSTRUMENT) if kind == WRITER else f"Zygo {kind}".strip()
    stamp: Any = hdf5.first(source, node, key["Time Stamp"]) if "Time Stamp" in key else None
    stamped = isinstance(stamp, np.void) and "time" in (stamp.dtype.names or ())
    return {
        "part_id": text("Part Serial Number") or text("Part Number"),
        "instrument": f"{system}, system {serial}" if serial else system,
        "taken_at": time_of(float(stamp["time"])) if stamped else None,
        "history": text(HISTORY),
    }


DATX = FORMAT.reader(partial(sandbox.read, __name__), ".datx", sniff=partial(hdf5.holds, suffix=".datx"), write=write)
