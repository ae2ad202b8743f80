"""Zygo MetroPro ``.dat``: header, intensities, phase; see docs/protocols/metropro_dat.md.

What a file does not warrant is not allocated: its length must be the one that its header asks for.
"""

from __future__ import annotations

import math
import os
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from polishd.api import BadMap, SurfaceMap, SurfaceReader
from polishd.model.surface import FloatArray
from polishd.plugins.interferometer.formats.common import MOST_BYTES, require_optics, require_size, sha256_of, time_of

NAME = "metropro"
VERSION = 2
MAGIC = (b"\x88\x1b\x03\x6f", b"\x88\x1b\x03\x70", b"\x88\x1b\x03\x71")
HEADER_BYTES = (834, 4096)
"""The first two versions have the short one, the third the long one; each file states its own."""
RESOLUTION = {0: 4096, 1: 32768, 2: 131072}
MISSING = 2147483640
MOST_FIDUCIALS = 7
NOT_CALIBRATED = "CameraRes is 0: the instrument was not calibrated, the map has no lateral scale"
ZERO_TAIL = 4
"""So many samples of exactly zero at the very end are not measured: the file was preallocated."""


@dataclass(frozen=True, slots=True)
class Header:
    """The fields of the header that decide correctness, as they stand in the file."""

    length: int
    intensity_bytes: int
    columns: int
    rows: int
    origin: tuple[int, int]
    timestamp: int
    scale: float
    wavelength_m: float
    obliquity: float
    camera_res_m: float
    resolution: int
    sign: int
    system: int
    part: str
    serial: str
    fiducials: tuple[float, ...]
    """x, y, x, y ... of up to seven marks, on the camera."""

    @property
    def file_bytes(self) -> int:
        """Length of the whole file."""
        return self.length + self.intensity_bytes + 4 * self.columns * self.rows

    @property
    def nm_per_count(self) -> float:
        """Height of one count, sign included."""
        size = self.scale * self.wavelength_m * self.obliquity / RESOLUTION[self.resolution] * 1e9
        return -size if self.sign else size


def sniff(head: bytes, path: Path) -> bool:  # noqa: ARG001  a reader may also judge by name
    """True where the file starts with one of MetroPro's magic numbers."""
    return head[:4] in MAGIC


def read(path: Path) -> SurfaceMap:
    """Read a map. BadMap with path and reason for whatever is torn, broken or absurd."""
    try:
        with path.open("rb") as file:
            header = _header(path, file.read(max(HEADER_BYTES)))
            _check_length(path, header, os.fstat(file.fileno()).st_size)
            file.seek(0)
            content = file.read(header.file_bytes + 1)
    except OSError as error:
        raise BadMap(f"{path}: cannot be read: {error.strerror}") from error
    _check_length(path, header, len(content))
    height_nm = _height_nm(path, header, content)
    pitch, warnings = pitch_mm(path, header.camera_res_m)
    fiducials, odd = _fiducials_px(header)
    return SurfaceMap(
        height_nm=height_nm,
        pitch_mm=pitch,
        part_id=header.serial or header.part,
        instrument=f"Zygo MetroPro, system {header.system}",
        taken_at=time_of(header.timestamp),
        sha256=sha256_of(content),
        path=path,
        format=NAME,
        factors=_factors(header),
        warnings=warnings + odd,
        unsaid=frozenset({"pitch"}) if pitch is None else frozenset(),
        fiducials_px=fiducials,
        reader_version=VERSION,
    )


def _header(path: Path, head: bytes) -> Header:
    if not head:
        raise BadMap(f"{path}: the file is empty")
    if head[:4] not in MAGIC:
        raise BadMap(f"{path}: no MetroPro file: it starts with {head[:4].hex(' ')}")
    length = struct.unpack_from(">i", head, 6)[0] if len(head) >= min(HEADER_BYTES) else min(HEADER_BYTES)
    if length not in HEADER_BYTES:
        raise BadMap(f"{path}: states a header of {length} bytes, which no version has")
    if len(head) < length:
        raise BadMap(f"{path}: ends inside its header of {length} bytes, after {len(head)}")
    width, height, buckets = struct.unpack_from(">HHH", head, 52)
    columns, rows = struct.unpack_from(">HH", head, 68)
    scale, wavelength_m = struct.unpack_from(">ff", head, 164)
    header = Header(
        length=length,
        intensity_bytes=2 * width * height * buckets,
        columns=columns,
        rows=rows,
        origin=struct.unpack_from(">hh", head, 64),
        timestamp=struct.unpack_from(">i", head, 76)[0],
        scale=scale,
        wavelength_m=wavelength_m,
        obliquity=struct.unpack_from(">f", head, 176)[0],
        camera_res_m=struct.unpack_from(">f", head, 184)[0],
        resolution=struct.unpack_from(">h", head, 218)[0],
        sign=struct.unpack_from(">h", head, 232)[0],
        system=struct.unpack_from(">H", head, 242)[0],
        part=_text(head[258:298]),
        serial=_text(head[320:360]),
        fiducials=_marks(head),
    )
    _check_fields(path, header)
    return header


def _text(field: bytes) -> str:
    return field.partition(b"\0")[0].decode("latin-1").strip()


def _marks(head: bytes) -> tuple[float, ...]:
    (count,) = struct.unpack_from(">h", head, 428)
    return struct.unpack_from(f">{2 * count}f", head, 430) if 0 < count <= MOST_FIDUCIALS else ()


def _fiducials_px(header: Header) -> tuple[tuple[tuple[float, float], ...], tuple[str, ...]]:
    """(row, column) of the marks in the phase block, or none and a warning where one lies outside it."""
    x0, y0 = header.origin
    marks = tuple((y - y0, x - x0) for x, y in zip(header.fiducials[::2], header.fiducials[1::2], strict=True))
    if all(-0.5 <= row <= header.rows - 0.5 and -0.5 <= column <= header.columns - 0.5 for row, column in marks):
        return marks, ()
    return (), (f"its {len(marks)} fiducials are not used: they do not all lie on the map",)


def _check_fields(path: Path, header: Header) -> None:
    require_size(path, header.rows, header.columns)
    if header.file_bytes > MOST_BYTES:
        raise BadMap(f"{path}: its header asks for {header.file_bytes} bytes, more than {MOST_BYTES}")
    if header.resolution not in RESOLUTION:
        raise BadMap(f"{path}: PhaseRes is {header.resolution}, not 0, 1 or 2: the height's scale is not known")
    optics = {"IntfScaleFactor": header.scale, "Wavelength (m)": header.wavelength_m, "Obliquity": header.obliquity}
    require_optics(path, optics)


def _check_length(path: Path, header: Header, size: int) -> None:
    if size != header.file_bytes:
        state = "torn, or still being written" if size < header.file_bytes else "more than its header asks for"
        raise BadMap(f"{path}: has {size} bytes of {header.file_bytes}: {state}")


def _height_nm(path: Path, header: Header, content: bytes) -> FloatArray:
    counts = np.frombuffer(content, dtype=">i4", offset=header.length + header.intensity_bytes)
    if not counts[-ZERO_TAIL:].any() and counts.size > ZERO_TAIL:
        raise BadMap(f"{path}: ends in a tail of zeros: preallocated, and not written to its end")
    missing = counts >= MISSING
    if missing.all():
        raise BadMap(f"{path}: no sample holds data")
    height_nm = counts.astype(np.float64)
    height_nm *= header.nm_per_count
    height_nm[missing] = np.nan
    return height_nm.reshape(header.rows, header.columns)


def pitch_mm(path: Path, metres: float) -> tuple[float | None, tuple[str, ...]]:
    """Pitch of a CameraRes in m a pixel, and warnings; None where the instrument was not calibrated (0)."""
    if metres == 0:
        return None, (NOT_CALIBRATED,)
    if not (math.isfinite(metres) and 1e-8 <= metres <= 0.1):
        raise BadMap(f"{path}: CameraRes is {metres:g} m a pixel")
    return metres * 1e3, ()


def _factors(header: Header) -> dict[str, Any]:
    return {
        "scale": header.scale,
        "wavelength_nm": header.wavelength_m * 1e9,
        "obliquity": header.obliquity,
        "counts_per_wave": RESOLUTION[header.resolution],
        "negated": bool(header.sign),
        "nm_per_count": header.nm_per_count,
        "origin_px": header.origin,
    }


def _write(surface: SurfaceMap) -> bytes:
    from polishd.plugins.interferometer.formats.metropro_writer import write

    return write(surface)


METROPRO = SurfaceReader(name=NAME, sniff=sniff, read=read, suffixes=(".dat",), write=_write)
