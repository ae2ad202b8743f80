"""SDF (ISO 25178-71, ASCII and binary) through sdfio; heights and scales are metres.

The standard's coordinates are right-handed with y growing along the rows, so the first row is the lowest: it is turned
(BCR files, which list them from the top, are brought to the same order by sdfio).
"""

from __future__ import annotations

import io
import math
import struct
from pathlib import Path

import numpy as np

from polishd.api import MapError, SurfaceMap
from polishd.plugins.interferometer.formats.common import (
    NO_PITCH,
    checked,
    content_of,
    parsing,
    pitch,
    require_end,
    require_size,
    scaled,
)
from polishd.plugins.interferometer.formats.format import Format
from polishd.plugins.interferometer.formats.x3p import TURNED

FORMAT = Format("sdf", 2, (b"AISO-", b"BISO-", b"ABCR-", b"BBCR-"))
MOST_ASCII_BYTES = 2**26
BOM = b"\xef\xbb\xbf"
COUNTS_AT = 42
"""Offset of the numbers of columns and rows in binary files."""
HEADER_BYTES, HEADER_BYTES_2 = 81, 85
"""Of binary files, and since the standard's second edition; the last byte but one is the type of the samples."""
ITEM_BYTES = (1, 2, 4, 4, 1, 2, 4, 8)
MARKER = 1e37
"""Counts beyond this are the largest number of a floating type, not heights."""


def sniff(head: bytes, path: Path) -> bool:
    """True where the file starts with the magic of ISO 25178-71 or of its forerunner."""
    return FORMAT.sniff(head.removeprefix(BOM)[:5].upper(), path)


def read(path: Path) -> SurfaceMap:
    """Read a surface. MapError for profiles, for whatever is torn, and for scales that are no number."""
    import sdfio

    whole = content_of(path)
    content = whole.removeprefix(BOM)
    if content[:1] in b"aA" and len(content) > MOST_ASCII_BYTES:
        raise MapError(f"{path}: more than {MOST_ASCII_BYTES} bytes of ASCII: write it as binary SDF")
    _check_size(path, content)
    with parsing(path, "sdfio"):
        file = sdfio.read(io.BytesIO(content))
    if content.find(content[:8], 8) >= 0:
        raise MapError(f"{path}: holds another SDF file: two were written into one")
    require_size(path, *file.data.shape)
    header = file.header
    if not (math.isfinite(header.z_scale) and header.z_scale > 0):
        raise MapError(f"{path}: Zscale is {header.z_scale:g}: the height's scale is not known")
    if min(file.data.shape) < 2:
        raise MapError(f"{path}: holds a profile of {file.data.size} points, not a surface")
    if content[:1] in b"bB":
        require_end(path, file.data)
        start = HEADER_BYTES_2 if content[1:8].upper() == b"ISO-2.0" else HEADER_BYTES
        _require_text(path, content[start + file.data.size * ITEM_BYTES[content[start - 2]] :])
    # ISO marks with a type's minimum, its forerunner with the maximum, and writers mix them up
    marked = (np.abs(file.data) > MARKER * header.z_scale) & np.isfinite(file.data)
    height_nm = scaled(np.where(marked, np.nan, file.data)[::-1], 1e9)
    x_m, y_m = header.x_scale, header.y_scale
    return FORMAT.surface(
        path,
        whole,
        checked(path, height_nm),
        lateral=NO_PITCH if x_m == 0 and y_m == 0 else pitch(path, x_m * 1e3, y_m * 1e3),
        instrument=header.manufacturer_id.strip(),
        taken_at=header.create_date,
        factors={"nm_per_unit": 1e9, "z_scale": header.z_scale},
        orientation=TURNED,
    )


def _check_size(path: Path, content: bytes) -> None:
    """Refuse a binary file that states more samples than any map, before sdfio makes float64 of them."""
    counts = "<II" if content[1:8].upper() == b"ISO-2.0" else "<HH"
    if content[:1] in b"bB" and len(content) >= COUNTS_AT + struct.calcsize(counts):
        columns, rows = struct.unpack_from(counts, content, COUNTS_AT)
        require_size(path, rows, columns)


def _require_text(path: Path, trailer: bytes) -> None:
    """MapError where what follows binary samples is no text: then they are more than the header says."""
    if b"\0" in trailer or any(byte < 32 and byte not in b"\t\r\n\x1a" for byte in trailer[:256]):
        raise MapError(
            f"{path}: {len(trailer)} bytes follow its samples, and are no text: more than its header asks for"
        )


SDF = FORMAT.reader(read, ".sdf", sniff=sniff)
