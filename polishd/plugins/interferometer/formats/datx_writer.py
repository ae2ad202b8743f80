"""Writing Zygo Mx ``.datx``: heights in nm as they are, so nothing is lost."""

from __future__ import annotations

import hashlib
import io
import uuid
from typing import TYPE_CHECKING

import numpy as np

from polishd.api import SurfaceMap
from polishd.plugins.interferometer.formats.common import require_stated
from polishd.plugins.interferometer.formats.kept_history import line_of

if TYPE_CHECKING:
    import h5py

WRITER = "polishd"
"""The system type of files that are written here: their instrument stands by itself."""
INSTRUMENT, HISTORY = "polishd Instrument", "polishd History"
"""Attributes that keep what Mx has no place for."""
NO_DATA = float(np.finfo(np.float64).max)
WAVELENGTH_M, SCALE, OBLIQUITY = 632.8e-9, 0.5, 1.0
"""Readers expect them; heights in nm do not use them."""


def write(surface: SurfaceMap) -> bytes:
    """Content of a file that reads back exactly; NaN is ``No Data``, no pitch is a lateral resolution of 0.

    The same map gives the same bytes. BadMap where nobody has said the map's unit.
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
