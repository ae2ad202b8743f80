"""Zygo MetroPro ``.dat``: header, intensities, phase; see docs/protocols/metropro_dat.md.

What a file does not warrant is not allocated: its length must be the one that its header asks for.
"""

from __future__ import annotations

import os
import struct
from pathlib import Path
from typing import Any

import numpy as np

from polishd.api import MapError, SurfaceMap
from polishd.model.surface import FloatArray
from polishd.plugins.interferometer.formats.common import MOST_BYTES, MOST_SAMPLES, named, require_stated
from polishd.plugins.interferometer.formats.format import Format, brief_of, found_in_brief
from polishd.plugins.interferometer.formats.zygo_text import MISSING, RESOLUTION, ZygoHeader
from polishd.process.metrology.instrument import SHORT, system_number

FORMAT = Format("metropro", 2, (b"\x88\x1b\x03\x6f", b"\x88\x1b\x03\x70", b"\x88\x1b\x03\x71"))
HEADER_BYTES = (834, 4096)
"""The first two versions have the short one, the third the long one; each file states its own."""
FIELDS = {
    "magic": (0, "4s"), "format": (4, "h"), "length": (6, "i"), "software": (10, "h"), "intensity": (52, "3H"),
    "origin": (64, "2h"), "size": (68, "2H"), "phase_bytes": (72, "i"), "timestamp": (76, "i"), "comment": (80, "82s"),
    "scale": (164, "f"), "wavelength_m": (168, "f"), "obliquity": (176, "f"), "camera_res_m": (184, "f"),
    "resolution": (218, "h"), "sign": (232, "h"), "camera": (234, "2H"), "system": (242, "H"), "part": (258, "40s"),
    "serial": (320, "40s"), "fiducials": (428, "h14f"),
}  # fmt: skip
"""Offset and layout of the header's fields, big-endian."""
MOST_FIDUCIALS = 7
ZERO_TAIL = 4
"""So many samples of exactly zero at the very end are not measured: the file was preallocated."""

RESOLVED, SCALE, WAVELENGTH_M = 2, 0.5, float(np.float32(632.8e-9))
COUNT_NM = SCALE * WAVELENGTH_M / RESOLUTION[RESOLVED] * 1e9
"""Height of one count in the files written here: 2.4 pm."""
TEXT_BYTES = 40
MOST_SIDE = 65_535
LATEST_S = 2**31 - 1


def read(path: Path) -> SurfaceMap:
    """Read a map. MapError with path and reason for whatever is torn, broken or absurd."""
    try:
        with path.open("rb") as file:
            header = _header(path, file.read(max(HEADER_BYTES)))
            _check_length(path, header, os.fstat(file.fileno()).st_size)
            file.seek(0)
            content = file.read(_file_bytes(header) + 1)
    except OSError as error:
        raise MapError(f"{path}: cannot be read: {error.strerror}") from error
    _check_length(path, header, len(content))
    height_nm = _height_nm(path, header, content)
    fiducials, odd = _fiducials_px(header)
    return FORMAT.surface(
        path,
        content,
        height_nm,
        factors=header.factors,
        warnings=odd,
        fiducials_px=fiducials,
        history=found_in_brief(_text(content, "comment")),
        **header.about(path),
    )


def _header(path: Path, head: bytes) -> ZygoHeader:
    if not head:
        raise MapError(f"{path}: the file is empty")
    if not FORMAT.sniff(head, path):
        raise MapError(f"{path}: no MetroPro file: it starts with {head[:4].hex(' ')}")
    length = _field(head, "length")[0] if len(head) >= min(HEADER_BYTES) else min(HEADER_BYTES)
    if length not in HEADER_BYTES:
        raise MapError(f"{path}: states a header of {length} bytes, which no version has")
    if len(head) < length:
        raise MapError(f"{path}: ends inside its header of {length} bytes, after {len(head)}")
    width, height, buckets = _field(head, "intensity")
    columns, rows = _field(head, "size")
    count, *marks = _field(head, "fiducials")
    plain = ("timestamp", "scale", "wavelength_m", "obliquity", "camera_res_m", "resolution", "sign")
    header = ZygoHeader(
        start=length + 2 * width * height * buckets,
        columns=columns,
        rows=rows,
        origin=_field(head, "origin"),
        instrument=_instrument(_field(head, "system")[0]),
        part=_text(head, "part"),
        serial=_text(head, "serial"),
        fiducials=tuple(marks[: 2 * count]) if 0 < count <= MOST_FIDUCIALS else (),
        **{name: _field(head, name)[0] for name in plain},
    )
    header.check(path, MOST_SAMPLES)
    if _file_bytes(header) > MOST_BYTES:
        raise MapError(f"{path}: its header asks for {_file_bytes(header)} bytes, more than {MOST_BYTES}")
    return header


def _field(head: bytes, name: str) -> tuple[Any, ...]:
    offset, layout = FIELDS[name]
    return struct.unpack_from(f">{layout}", head, offset)


def _text(head: bytes, name: str) -> str:
    field: bytes = _field(head, name)[0]
    return named(field.partition(b"\0")[0].decode("latin-1"))


def _instrument(system: int) -> str:
    """The instrument with this system number; empty for 0."""
    return f"Zygo MetroPro, system {system}" if system else ""


def _fiducials_px(header: ZygoHeader) -> tuple[tuple[tuple[float, float], ...], tuple[str, ...]]:
    """(row, column) of the marks in the phase block, or none and a warning where one lies outside it."""
    x0, y0 = header.origin
    marks = tuple((y - y0, x - x0) for x, y in zip(header.fiducials[::2], header.fiducials[1::2], strict=True))
    if all(-0.5 <= row <= header.rows - 0.5 and -0.5 <= column <= header.columns - 0.5 for row, column in marks):
        return marks, ()
    return (), (f"its {len(marks)} fiducials are not used: they do not all lie on the map",)


def _file_bytes(header: ZygoHeader) -> int:
    return header.start + 4 * header.columns * header.rows


def _check_length(path: Path, header: ZygoHeader, size: int) -> None:
    asked = _file_bytes(header)
    if size != asked:
        state = "torn, or still being written" if size < asked else "more than its header asks for"
        raise MapError(f"{path}: has {size} bytes of {asked}: {state}")


def _height_nm(path: Path, header: ZygoHeader, content: bytes) -> FloatArray:
    counts = np.frombuffer(content, dtype=">i4", offset=header.start)
    if not counts[-ZERO_TAIL:].any() and counts.size > ZERO_TAIL:
        raise MapError(f"{path}: ends in a tail of zeros: preallocated, and not written to its end")
    missing = counts >= MISSING
    if missing.all():
        raise MapError(f"{path}: no sample holds data")
    height_nm = counts.astype(np.float64)
    height_nm *= header.nm_per_count
    height_nm[missing] = np.nan
    return height_nm.reshape(header.rows, header.columns)


def write(surface: SurfaceMap) -> bytes:
    """Content of a file that reads back to within half a count; NaN is a missing sample, no pitch is CameraRes 0.

    The comment keeps the last step of its history in brief. The system is the last 16 bits of a Zygo's number, as
    its own files have it; 0 for any other instrument.

    MapError for what the format cannot hold: heights beyond 5.2 mm, a part's name of more than 40 characters, a map
    that ends in exact zeros (readers take it for a preallocated file), or whose unit is unknown.
    """
    require_stated(surface, "pitch")
    name = surface.path or "the map"
    rows, columns = surface.height_nm.shape
    if max(rows, columns) > MOST_SIDE or rows * columns > MOST_SAMPLES:
        raise MapError(f"{name}: {rows} rows x {columns} columns do not fit into a MetroPro file")
    counts = np.rint(surface.height_nm / COUNT_NM)
    if (np.abs(counts) >= MISSING).any():
        raise MapError(f"{name}: heights beyond {MISSING * COUNT_NM / 1e6:.1f} mm do not fit into a MetroPro file")
    counts[~np.isfinite(counts)] = MISSING
    if counts.size > ZERO_TAIL and not counts.ravel()[-ZERO_TAIL:].any():
        raise MapError(f"{name}: ends in samples of exactly 0 nm, which a MetroPro file shows as never written: "
                     "subtract its mean, or mask them")  # fmt: skip
    return _written_header(surface, rows, columns) + counts.astype(">i4").tobytes()


def _written_header(surface: SurfaceMap, rows: int, columns: int) -> bytes:
    part = _latin(surface.part_id)
    marks = [value for row, column in surface.fiducials_px[:MOST_FIDUCIALS] for value in (column, row)]
    seconds = int(surface.measured_at.timestamp()) if surface.measured_at else 0
    values: dict[str, tuple[int | float | bytes, ...]] = {
        "magic": FORMAT.magic[:1], "format": (1,), "length": (min(HEADER_BYTES),), "software": (1,),
        "size": (columns, rows), "phase_bytes": (4 * rows * columns,),
        "timestamp": (seconds if 0 < seconds <= LATEST_S else 0,), "comment": (brief_of(surface),),
        "scale": (SCALE,), "wavelength_m": (WAVELENGTH_M,), "obliquity": (1.0,),
        "camera_res_m": ((surface.pitch_mm or 0.0) / 1e3,), "resolution": (RESOLVED,), "camera": (columns, rows),
        "system": ((system_number(surface.instrument) or 0) % SHORT,), "part": (part,), "serial": (part,),
        "fiducials": (len(marks) // 2, *marks, *[0.0] * (2 * MOST_FIDUCIALS - len(marks))),
    }  # fmt: skip
    header = bytearray(min(HEADER_BYTES))
    for name, value in values.items():
        offset, layout = FIELDS[name]
        struct.pack_into(f">{layout}", header, offset, *value)
    return bytes(header)


def _latin(text: str) -> bytes:
    try:
        field = text.encode("latin-1")
    except UnicodeEncodeError as error:
        raise MapError(f"the part's name {text!r} has characters that a MetroPro file cannot hold") from error
    if len(field) > TEXT_BYTES:
        raise MapError(f"the part's name {text!r} is longer than the {TEXT_BYTES} characters of a MetroPro file")
    return field


METROPRO = FORMAT.reader(read, ".dat", write=write)
