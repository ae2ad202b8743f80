"""Less common formats (Wyko .opd, SUR and some forty others) through SurfaceTopography, in a separate process.

It pulls in 38 packages and parses whatever it is given, so none of it is imported here: a worker with bounds on its
memory and time reads the file, and its errors become MapError here.
"""

from __future__ import annotations

from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from polishd.api import MapError, SurfaceMap
from polishd.model.surface import FloatArray
from polishd.plugins.interferometer.formats import sandbox
from polishd.plugins.interferometer.formats.common import (
    MOST_SAMPLES,
    NO_PITCH,
    Date,
    checked,
    content_of,
    extra,
    height_unit,
    instant,
    named,
    parsing,
    pitch,
    sha256_of,
)
from polishd.plugins.interferometer.formats.format import Format

FORMAT = Format("tail", 2)
BOUNDS = sandbox.ResourceLimits(memory_bytes=3 * 2**30, memory_per_byte=16, cpu_s=120.0, wall_s=120.0, is_kept=False)
"""The library's own imports take 1 GiB of address space."""
FORMATS = (
    "al3d:al3d bcr:bcr bcrf:bcr ezd:ezd frt:frt ibw:ibw jpk:jpk lext:lext mdt:mdt mi:mi mnt:mnt nc:nc nid:ezd nms:nms "
    "oir:oir opd:opd opdx:opdx os3d:os3d plu:plu plux:plux poir:poir qep:qep apx:plu spm:di sur:sur tmd:tmd "
    "vk3:vk vk4:vk vk6:vk vk7:vk zmg:zmg zon:zon"
)
FORMAT_OF = {f".{suffix}": name for suffix, name in (pair.split(":") for pair in FORMATS.split())}
"""SurfaceTopography's reader by a file's ending: only that one is tried."""
SUFFIXES = tuple(FORMAT_OF)
OPTICAL_PATH = {".opd", ".zmg"}
"""Interferometers' own: what stands there may be a wavefront."""


def sniff(head: bytes, path: Path) -> bool:  # noqa: ARG001  the formats have no magic number in common
    """True for the endings of formats that no other reader knows."""
    return path.suffix.lower() in SUFFIXES


def read(path: Path) -> SurfaceMap:
    """Read the file's default channel. MapError without the extra, and for all that the worker cannot read in time."""
    if not sniff(b"", path):
        raise MapError(f"{path}: {path.suffix or 'no suffix'} is none of the formats read through SurfaceTopography")
    return sandbox.read(__name__, path, BOUNDS)


def parse(path: Path) -> SurfaceMap:
    """``read``, in this process. The library opens the file by its name: it must still be the one that was hashed."""
    sha256 = sha256_of(content_of(path))
    library = extra(path, "SurfaceTopography", FORMAT.name)
    suffix = path.suffix.lower()
    with parsing(path, "SurfaceTopography"):
        reader = library.open_topography(str(path), format=FORMAT_OF[suffix])
        topography = reader.topography()
        height_nm, unit, pitch_nm = _numbers(path, topography)
        channels, kind = len(reader.channels), str(reader.format())
        instrument, date = _about(topography.info)
    if sha256_of(content_of(path)) != sha256:
        raise MapError(f"{path}: changed while it was read")
    height = height_unit("nm" if unit is not None else "")
    lateral = pitch(path, pitch_nm[0] / 1e6, pitch_nm[1] / 1e6) if pitch_nm else NO_PITCH
    return FORMAT.surface(
        path,
        sha256,
        checked(path, height_nm),
        height=height,
        lateral=lateral,
        format=f"{FORMAT.name}:{kind}",
        factors={"unit": unit, "read_by": "SurfaceTopography"},
        warnings=((f"the default one of {channels} channels is taken",) if channels > 1 else ()) + date.warnings,
        unsaid={"orientation", "surface"} if suffix in OPTICAL_PATH else {"orientation"},
        orientation="as stored, transposed from SurfaceTopography's [x, y]; its formats differ in their first row",
        instrument=instrument,
        taken_at=date.at,
        date_from=date.by,
    )


def _numbers(path: Path, topography: Any) -> tuple[FloatArray, Any, tuple[float, ...]]:
    """Heights in nm, the file's unit, and the pitches in nm; where it has no unit, as they stand, and no pitch."""
    if topography.dim != 2 or not topography.is_uniform:
        raise MapError(f"{path}: holds a topography of {topography.dim - 1} lateral dimensions, not an even map")
    columns, rows = topography.nb_grid_pts
    if min(rows, columns) < 2 or rows * columns > MOST_SAMPLES:
        raise MapError(f"{path}: {rows} rows x {columns} columns are no map of a camera")
    unit = topography.unit
    if unit is not None:
        topography = topography.to_unit("nm")
    masked = np.ma.asarray(topography.heights(), dtype=np.float64)
    if masked.shape != (columns, rows):
        raise MapError(f"{path}: states {columns} x {rows} samples, and has {masked.shape}")
    height_nm = np.ascontiguousarray(np.ma.filled(masked, np.nan).T)  # [x, y] -> [row, column]
    return height_nm, unit, tuple(float(step) for step in topography.pixel_size) if unit is not None else ()


def _about(info: Any) -> tuple[str, Date]:
    """Instrument and time, where the library found them. It fills in what a header's date does not say."""
    instrument, taken = info.get("instrument"), info.get("acquisition_time")
    name = instrument.get("name") if isinstance(instrument, dict) else instrument
    date = instant(taken, datetime.now().astimezone()) if isinstance(taken, datetime) else Date()
    return named(str(name or "")), date


TAIL = FORMAT.reader(read, *SUFFIXES, sniff=sniff)
