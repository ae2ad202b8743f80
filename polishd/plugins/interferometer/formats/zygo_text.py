"""Header of Zygo's files, binary (MetroPro) and text, and the readers of the texts."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from polishd.api import MapError, SurfaceMap
from polishd.model.surface import FloatArray
from polishd.plugins.interferometer.formats.common import (
    Pitch,
    block,
    checked,
    content_of,
    floats,
    named,
    pieces,
    require_data,
    require_optics,
    require_size,
    time_of,
)
from polishd.plugins.interferometer.formats.format import Format

RESOLUTION = {0: 4096, 1: 32768, 2: 131072}
"""Counts a wave by PhaseRes."""
MISSING = 2147483640
NOT_CALIBRATED = "CameraRes is 0: the instrument was not calibrated, the map has no lateral scale"


@dataclass(frozen=True, slots=True, kw_only=True)
class ZygoHeader:
    """The fields of a header that decide correctness, as they stand in the file."""

    origin: tuple[int, int]
    columns: int
    rows: int
    timestamp: float
    scale: float
    wavelength_m: float
    obliquity: float
    camera_res_m: float
    resolution: int
    sign: int
    instrument: str
    part: str
    serial: str
    start: int
    """Where the header ends, or the phase begins."""
    fiducials: tuple[float, ...] = ()
    """x, y, x, y ... of up to seven marks, on the camera."""

    @property
    def nm_per_count(self) -> float:
        """Height of one count, sign included."""
        size = self.scale * self.wavelength_m * self.obliquity / RESOLUTION[self.resolution] * 1e9
        return -size if self.sign else size

    @property
    def factors(self) -> dict[str, Any]:
        """What was applied, once."""
        return {
            "scale": self.scale,
            "wavelength_nm": self.wavelength_m * 1e9,
            "obliquity": self.obliquity,
            "counts_per_wave": RESOLUTION[self.resolution],
            "negated": bool(self.sign),
            "nm_per_count": self.nm_per_count,
            "origin_px": self.origin,
        }

    def about(self, path: Path) -> dict[str, Any]:
        """Pitch, part, instrument and time. MapError for a pitch that no camera has."""
        metres = self.camera_res_m
        if metres != 0 and not (math.isfinite(metres) and 1e-8 <= metres <= 0.1):
            raise MapError(f"{path}: CameraRes is {metres:g} m a pixel")
        return {
            "lateral": Pitch(metres * 1e3) if metres else Pitch(None, {"pitch": NOT_CALIBRATED}),
            "part_id": self.serial or self.part,
            "instrument": self.instrument,
            "taken_at": time_of(self.timestamp),
        }

    def check(self, path: Path, most: float) -> None:
        """MapError where a factor or a side is out of range, or the file can hold no more than ``most`` samples."""
        require_size(path, self.rows, self.columns, most)
        if self.resolution not in RESOLUTION:
            raise MapError(f"{path}: PhaseRes is {self.resolution}, not 0, 1 or 2: the height's scale is not known")
        optics = {"IntfScaleFactor": self.scale, "Wavelength (m)": self.wavelength_m, "Obliquity": self.obliquity}
        require_optics(path, optics)


# Zygo's two text formats: a header of 14 lines (13 in some XYZ files), and data, each ended by a line of ``#``.

HASH = re.compile(rb"^[ \t]*#[ \t\r]*$", re.MULTILINE)
MOST_HEADER = 16_384


@dataclass(frozen=True, slots=True)
class TextFormat(Format):
    """A format whose first line is its magic."""

    def sniff(self, head: bytes, path: Path) -> bool:  # noqa: ARG002  a reader may also judge by name
        """True where the first line is the format's name."""
        return head.lstrip().startswith(self.magic)

    def opened(self, path: Path, smallest: int) -> tuple[bytes, ZygoHeader]:
        """The whole content, and its header. ``smallest``: bytes of the shortest sample, which the frame's must fit.

        MapError where it is no such file, or a factor or size is out of range.
        """
        content = content_of(path)
        name = self.magic[0].decode()
        if not self.sniff(content[:4096], path):
            kind = name.removesuffix(" Data File")
            raise MapError(f"{path}: no {kind} file: its first line is not '{name} ...'")
        end = HASH.search(content, 0, MOST_HEADER)
        if end is None:
            raise MapError(f"{path}: its header does not end in a line of '#': torn, or another format")
        lines = [line.strip() for line in content[: end.start()].decode("latin-1").split("\n")][:-1]
        if len(lines) not in (13, 14):
            raise MapError(f"{path}: its header has {len(lines)} lines, not 14")
        try:
            header = _fields(lines, end.end())
        except (ValueError, IndexError, OverflowError) as error:
            raise MapError(f"{path}: its header is not Zygo's: {error}") from error
        header.check(path, (len(content) - header.start) / smallest)
        return content, header


def _fields(lines: list[str], end: int) -> ZygoHeader:
    frame = [int(word) for word in lines[3].split()]
    if len(frame) != 4:
        raise ValueError(f"line 4 has {len(frame)} numbers, not 4")
    optics = [float(word) for word in lines[7].split()]
    if len(optics) != 8:
        raise ValueError(f"line 8 has {len(optics)} numbers, not 8")
    phase = [float(word) for word in lines[10].split()]
    return ZygoHeader(
        origin=(frame[0], frame[1]),
        columns=frame[2],
        rows=frame[3],
        serial=named(lines[5].strip('"')),
        part=named(lines[6].strip('"')),
        scale=optics[1],
        wavelength_m=optics[2],
        obliquity=optics[4],
        camera_res_m=optics[6],
        timestamp=optics[7],
        instrument=f"Zygo, system {lines[8].split()[4]}",
        resolution=int(phase[0]),
        sign=int(phase[7]),
        start=end,
    )


def require_end(path: Path, content: bytes, end: int, what: str) -> None:
    """MapError where anything but blanks follows."""
    if content[end:].strip():
        raise MapError(f"{path}: something follows the end of its {what}: {content[end:].strip()[:20]!r}")


ASCII = TextFormat("zygo_ascii", 1, (b"Zygo ASCII Data File",))


def read(path: Path) -> SurfaceMap:
    """Read a map. MapError with path and reason for whatever is torn, broken or absurd."""
    content, header = ASCII.opened(path, smallest=2)
    counts = block(path, content, _phase(path, content, header.start), (header.rows, header.columns))
    if (counts != np.trunc(counts)).any():
        raise MapError(f"{path}: its phase holds numbers that are no integers")
    missing = counts >= MISSING
    counts *= header.nm_per_count
    counts[missing] = np.nan
    height_nm = require_data(path, counts)
    return ASCII.surface(path, content, height_nm, factors=header.factors, **header.about(path))


def _phase(path: Path, content: bytes, start: int) -> tuple[int, int]:
    """Where the phase stands: between the line that ends the intensities and the one that ends the file."""
    intensity = HASH.search(content, start)
    phase = HASH.search(content, intensity.end()) if intensity else None
    if intensity is None or phase is None:
        raise MapError(f"{path}: its phase does not end in a line of '#': torn, or still being written")
    require_end(path, content, phase.end(), "phase")
    return intensity.end(), phase.start()


ZYGO_ASCII = ASCII.reader(read, ".asc")


# Zygo XYZ data files: the header of Zygo's ASCII files, then a line ``column row height_um`` for each pixel.

ZYGO_XYZ_FORMAT = TextFormat("zygo_xyz", 1, (b"Zygo XYZ Data File",))
NO_DATA = b"No Data"
NM_PER_UM = 1e3
SIGNED = "its header says an inverted sign, and the heights are taken as they stand: the program that wrote them did it"


def read_zygo_xyz(path: Path) -> SurfaceMap:
    """Read a map: each pixel must be listed exactly once. MapError for whatever is torn, broken or absurd."""
    content, header = ZYGO_XYZ_FORMAT.opened(path, smallest=6)
    height_nm = checked(path, _heights_um(path, content, header) * NM_PER_UM, NM_PER_UM)
    factors = {"nm_per_unit": NM_PER_UM, "origin_px": header.origin}
    odd = (SIGNED,) if header.sign else ()
    return ZYGO_XYZ_FORMAT.surface(path, content, height_nm, factors=factors, warnings=odd, **header.about(path))


def _end(path: Path, content: bytes, start: int) -> int:
    """Where the lines end: at a line of ``#`` with nothing after it, or at the end of a whole line."""
    mark = HASH.search(content, start)
    if mark is not None:
        require_end(path, content, mark.end(), "points")
        return mark.start()
    if not content.endswith(b"\n"):
        raise MapError(f"{path}: ends inside a line: torn, or still being written")
    return len(content)


def _heights_um(path: Path, content: bytes, header: ZygoHeader) -> FloatArray:
    grid = np.full(header.rows * header.columns, np.nan)
    seen = np.zeros(grid.size, dtype=np.bool_)
    corner: tuple[int, int] | None = None
    count = 0
    for piece in pieces(path, content, (header.start, _end(path, content, header.start)), (b"\n",)):
        points = _points(path, piece)
        if corner is None and len(points):
            corner = _corner(path, points[0], header)
        column, row = points[:, 0] - (corner or (0, 0))[0], points[:, 1] - (corner or (0, 0))[1]
        inside = (column >= 0) & (column < header.columns) & (row >= 0) & (row < header.rows)
        if not (inside & (column == np.trunc(column)) & (row == np.trunc(row))).all():
            raise MapError(f"{path}: a point lies outside its {header.rows} rows x {header.columns} columns")
        index = (row * header.columns + column).astype(np.intp)
        grid[index] = points[:, 2]
        seen[index] = True
        count += len(points)
    if count != grid.size or not seen.all():
        raise MapError(
            f"{path}: lists {count} points, {np.count_nonzero(seen)} of {grid.size} pixels: torn, or doubled"
        )
    return grid.reshape(header.rows, header.columns)


def _points(path: Path, piece: bytes) -> FloatArray:
    """(n, 3) of a piece's lines, NaN where there is no data; every line must be one point."""
    text = piece.replace(NO_DATA, b"nan")
    if b"nan" in piece or any(len(line.split()) not in (0, 3) for line in text.split(b"\n")):
        raise MapError(f"{path}: a line is not 'column row height'")
    return floats(path, text, but=b"na").reshape(-1, 3)


def _corner(path: Path, first: FloatArray, header: ZygoHeader) -> tuple[int, int]:
    """What columns and rows count from, by the first point, which is a corner of the frame."""
    for x, y in (header.origin, (0, 0)):
        if first[0] in (x, x + header.columns - 1) and first[1] in (y, y + header.rows - 1):
            return x, y
    raise MapError(f"{path}: its first point ({first[0]:g}, {first[1]:g}) is no corner of its phase frame")


ZYGO_XYZ = ZYGO_XYZ_FORMAT.reader(read_zygo_xyz, ".xyz")
