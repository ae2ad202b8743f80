"""MetroPro .dat files: the instrument's writer, and a small reader for the maps of a simulated part.

Layout and test vector: docs/protocols/metropro_dat.md.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from polishd.model.errors import MapError
from polishd.model.surface import FloatArray

MAGICS = (0x881B036F, 0x881B0370, 0x881B0371)
HEADER = 834
MISSING = 2147483640
RESOLUTION = {0: 4096, 1: 32768, 2: 131072}
SCALE, WAVELENGTH_M, OBLIQUITY = 0.5, 6.328e-7, 1.0
UNIT_NM = SCALE * float(np.float32(WAVELENGTH_M)) * OBLIQUITY / RESOLUTION[2] * 1e9
"""Height of one raw unit in the files written here, nm."""


@dataclass(frozen=True, slots=True)
class DatMap:
    """Content of a file: heights (rows, columns) in nm, NaN = no data, row 0 the top; pitch 0 = not calibrated."""

    height_nm: FloatArray
    pitch_mm: float
    part: str = ""
    taken_s: int = 0
    comment: str = ""
    objective: str = "sim 4in TF"
    origin_px: tuple[int, int] = (0, 0)
    software: str = "Thu Jan 01 00:00:00 1970"


def pack(data: DatMap) -> bytes:
    """Return the bytes of the file."""
    rows, columns = data.height_nm.shape
    raw = np.full(data.height_nm.shape, MISSING, dtype=np.int64)
    valid = np.isfinite(data.height_nm)
    raw[valid] = np.rint(data.height_nm[valid] / UNIT_NM).astype(np.int64)
    header = bytearray(HEADER)
    x, y = data.origin_px
    fields: tuple[tuple[int, str, tuple[int | float | bytes, ...]], ...] = (
        (4, "hih", (1, HEADER, 1)),
        (12, "30s", (data.software.encode(),)),
        (42, "hhh", (8, 3, 5)),
        (64, "hhhhi", (x, y, columns, rows, 4 * rows * columns)),
        (76, "i", (data.taken_s,)),
        (80, "82s", (data.comment.encode(),)),
        (164, "ff", (SCALE, WAVELENGTH_M)),
        (176, "f", (OBLIQUITY,)),
        (184, "f", (data.pitch_mm / 1000.0,)),
        (218, "h", (2,)),
        (234, "hh", (x + columns, y + rows)),
        (246, "12s", (data.objective.encode(),)),
        (258, "40s", (data.part.encode(),)),
        (320, "40s", (data.part.encode(),)),
    )
    struct.pack_into(">I", header, 0, MAGICS[0])
    for offset, layout, values in fields:
        struct.pack_into(">" + layout, header, offset, *values)
    return bytes(header) + raw.astype(">i4").tobytes()


def unpack(data: bytes, name: str = "map") -> DatMap:
    """Parse a complete file. MapError names the problem."""
    if len(data) < HEADER or struct.unpack_from(">I", data)[0] not in MAGICS:
        raise MapError(f"{name}: not a MetroPro file")
    (header,) = struct.unpack_from(">i", data, 6)
    width, height, buckets = struct.unpack_from(">hhh", data, 52)
    x, y, columns, rows = struct.unpack_from(">hhhh", data, 64)
    intensity = 2 * width * height * buckets
    if len(data) != header + intensity + 4 * rows * columns or rows * columns == 0:
        raise MapError(f"{name}: {len(data)} bytes are not what the header announces")
    scale, wavelength = struct.unpack_from(">ff", data, 164)
    (obliquity,) = struct.unpack_from(">f", data, 176)
    (pitch_m,) = struct.unpack_from(">f", data, 184)
    resolution = RESOLUTION.get(struct.unpack_from(">h", data, 218)[0])
    if resolution is None:
        raise MapError(f"{name}: unknown phase resolution")
    sign = -1.0 if struct.unpack_from(">h", data, 232)[0] else 1.0
    raw = np.frombuffer(data, dtype=">i4", offset=header + intensity).reshape(rows, columns)
    nm = np.where(raw >= MISSING, np.nan, raw * (sign * scale * wavelength * obliquity / resolution * 1e9))
    return DatMap(
        height_nm=nm,
        pitch_mm=pitch_m * 1000.0,
        part=_text(data, 258, 40) or _text(data, 320, 40),
        taken_s=struct.unpack_from(">i", data, 76)[0],
        comment=_text(data, 80, 82),
        objective=_text(data, 246, 12),
        origin_px=(x, y),
        software=_text(data, 12, 30),
    )


def read(path: Path) -> DatMap:
    """Read a file."""
    return unpack(path.read_bytes(), str(path))


def _text(data: bytes, offset: int, size: int) -> str:
    return data[offset : offset + size].split(b"\0")[0].decode("latin-1").strip()
