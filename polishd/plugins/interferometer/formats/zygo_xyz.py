"""Zygo XYZ data files: the header of Zygo's ASCII files, then a line ``column row height_um`` for each pixel.

The heights are micrometres of surface: sign, scale and obliquity are already in them. Columns and rows count on the
camera, from the phase frame's corner, or from 0.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from polishd.api import MapError, SurfaceMap
from polishd.model.surface import FloatArray
from polishd.plugins.interferometer.formats.numbers import floats, pieces
from polishd.plugins.interferometer.formats.scales import checked
from polishd.plugins.interferometer.formats.zygo import ZygoHeader
from polishd.plugins.interferometer.formats.zygo_text import HASH, TextFormat, require_end

ZYGO_XYZ_FORMAT = TextFormat("zygo_xyz", 1, (b"Zygo XYZ Data File",))
NO_DATA = b"No Data"
NM_PER_UM = 1e3
SIGNED = "its header says an inverted sign, and the heights are taken as they stand: the program that wrote them did it"


def read_zygo_xyz(path: Path) -> SurfaceMap:
    """Read a map: each pixel must be listed exactly once. BadMap for whatever is torn, broken or absurd."""
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
