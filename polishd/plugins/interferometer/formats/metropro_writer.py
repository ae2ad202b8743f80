"""Writing MetroPro ``.dat``; see docs/protocols/metropro_dat.md."""

from __future__ import annotations

import struct

import numpy as np

from polishd.api import BadMap, SurfaceMap
from polishd.plugins.interferometer.formats.common import MOST_SAMPLES, require_said
from polishd.plugins.interferometer.formats.metropro import MISSING, MOST_FIDUCIALS, RESOLUTION, ZERO_TAIL

HEADER, RESOLVED = 834, 2
SCALE = 0.5
WAVELENGTH_M = float(np.float32(632.8e-9))
COUNT_NM = SCALE * WAVELENGTH_M / RESOLUTION[RESOLVED] * 1e9
"""Height of one count in the files written here: 2.4 pm."""
TEXT_BYTES = 40
MOST_SIDE = 65_535
LATEST_S = 2**31 - 1


def write(surface: SurfaceMap) -> bytes:
    """Content of a file that reads back to within half a count; NaN is a missing sample, no pitch is CameraRes 0.

    BadMap for what the format cannot hold: heights beyond 5.2 mm, a part's name of more than 40 characters, a map that
    ends in exact zeros (readers take it for a file that was preallocated), or whose unit nobody has said.
    """
    require_said(surface, "pitch")
    name = surface.path or "the map"
    rows, columns = surface.height_nm.shape
    if max(rows, columns) > MOST_SIDE or rows * columns > MOST_SAMPLES:
        raise BadMap(f"{name}: {rows} rows x {columns} columns do not fit into a MetroPro file")
    counts = np.rint(surface.height_nm / COUNT_NM)
    if (np.abs(counts) >= MISSING).any():
        raise BadMap(f"{name}: heights beyond {MISSING * COUNT_NM / 1e6:.1f} mm do not fit into a MetroPro file")
    counts[~np.isfinite(counts)] = MISSING
    if counts.size > ZERO_TAIL and not counts.ravel()[-ZERO_TAIL:].any():
        raise BadMap(f"{name}: ends in samples of exactly 0 nm, which a MetroPro file shows as never written: "
                     "subtract its mean, or mask them")  # fmt: skip
    return _header(surface) + counts.astype(">i4").tobytes()


def _header(surface: SurfaceMap) -> bytes:
    rows, columns = surface.height_nm.shape
    part = _latin(surface.part_id)
    marks = [value for row, column in surface.fiducials_px[:MOST_FIDUCIALS] for value in (column, row)]
    seconds = int(surface.taken_at.timestamp()) if surface.taken_at else 0
    fields: tuple[tuple[int, str, tuple[int | float | bytes, ...]], ...] = (
        (0, "4s", (b"\x88\x1b\x03\x6f",)),
        (4, "hih", (1, HEADER, 1)),
        (68, "HHi", (columns, rows, 4 * rows * columns)),
        (76, "i", (seconds if 0 < seconds <= LATEST_S else 0,)),
        (80, "82s", (b"written by polishd",)),
        (164, "ff", (SCALE, WAVELENGTH_M)),
        (176, "f", (1.0,)),
        (184, "f", ((surface.pitch_mm or 0.0) / 1e3,)),
        (218, "h", (RESOLVED,)),
        (234, "HH", (columns, rows)),
        (258, "40s", (part,)),
        (320, "40s", (part,)),
        (428, f"h{len(marks)}f", (len(marks) // 2, *marks)),
    )
    header = bytearray(HEADER)
    for offset, layout, values in fields:
        struct.pack_into(f">{layout}", header, offset, *values)
    return bytes(header)


def _latin(text: str) -> bytes:
    try:
        field = text.encode("latin-1")
    except UnicodeEncodeError as error:
        raise BadMap(f"the part's name {text!r} has characters that a MetroPro file cannot hold") from error
    if len(field) > TEXT_BYTES:
        raise BadMap(f"the part's name {text!r} is longer than the {TEXT_BYTES} characters of a MetroPro file")
    return field
