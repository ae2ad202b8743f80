"""Lists of points, one x y z a line: .csv, .xyz, .txt; separated by commas, semicolons, tabs or blanks.

A line of names before the first point may give units: ``x_mm,y_mm,z_nm`` or ``X [mm]; Y [mm]; Z [um]``.
"""

from __future__ import annotations

import io
import re
from pathlib import Path
from typing import NamedTuple

import numpy as np

from polishd.api import BadMap, SurfaceMap, SurfaceReader
from polishd.model.surface import FloatArray
from polishd.plugins.interferometer.formats.common import content_of, scaled, sha256_of
from polishd.plugins.interferometer.formats.gridded import ORIENTATION, Gridded, gridded
from polishd.plugins.interferometer.formats.library import parsing
from polishd.plugins.interferometer.formats.scales import NO_PITCH, Pitch, checked, height_unit, nm_per, pitch

NAME = "points"
VERSION = 1
SUFFIXES = (".csv", ".xyz", ".txt", ".asc", ".pts")
MOST_HEADER_LINES = 64
NUMBER = rb"[-+]?(?:\d+[.,]?\d*|[.,]\d+)(?:[eE][-+]?\d+)?"
POINT = re.compile(rb"[ \t]*" + NUMBER + rb"(?:[ \t]*[,;][ \t]*|[ \t]+)" + NUMBER + rb"(?:[ \t,;]|$)")
TITLE = re.compile(r"^\W*([a-z]+)\W*?(?:[_\s]*[\[(/]\s*|[_\s]+)?([a-z\u00b5\u03bc\u00c5]*)[\])]?\W*$", re.IGNORECASE)
NO_DATA = re.compile(rb"no[ _]?data|n/?a(?=[\s,;]|$)|bad|-{2,}", re.IGNORECASE)
WAVEFRONT = re.compile(r"wave|opd|phase", re.IGNORECASE)


class Header(NamedTuple):
    """Units of the three columns as they stand there, and whether the third is a wavefront's."""

    units: tuple[str, str, str] = ("", "", "")
    wavefront: bool = False


def sniff(head: bytes, path: Path) -> bool:
    """True for text of the usual names whose first lines come to two numbers at the start of one."""
    if path.suffix.lower() not in SUFFIXES or b"\0" in head or head.startswith(b"Zygo"):
        return False
    return any(POINT.match(line) for line in head.splitlines()[:MOST_HEADER_LINES])


def read(path: Path) -> SurfaceMap:
    """Read points on a regular grid, in any order, with holes. BadMap where they are on none, or no such list."""
    content = content_of(path)
    sha256 = sha256_of(content)
    header, body = _split(path, content)
    del content
    table = _table(path, body)
    del body
    found = gridded(path, table[:, 0], table[:, 1], table[:, 2])
    lateral = _pitch(path, header, found)
    height = height_unit(header.units[2])
    height_nm = scaled(found.z, height.nm)
    unsaid = lateral.unsaid | height.unsaid | ({"surface"} if header.wavefront else set())
    return SurfaceMap(
        height_nm=checked(path, height_nm),
        pitch_mm=lateral.mm,
        sha256=sha256,
        path=path,
        format=NAME,
        factors={"nm_per_unit": height.nm, "points": len(table)},
        warnings=height.warnings + lateral.warnings + (("its heights are a wavefront's",) if header.wavefront else ()),
        unsaid=unsaid,
        orientation=ORIENTATION,
        reader_version=VERSION,
    )


def _split(path: Path, content: bytes) -> tuple[Header, bytes]:
    """The header, and everything from the first point on."""
    header, at = Header(), 3 if content.startswith(b"\xef\xbb\xbf") else 0
    if b"\0" in content:
        raise BadMap(f"{path}: is no text")
    for _ in range(MOST_HEADER_LINES):
        end = content.find(b"\n", at)
        line = content[at : end if end >= 0 else len(content)].rstrip(b"\r")
        if POINT.match(line):
            return header, content[at:]
        header = _header(line.decode("utf-8", "replace")) or header
        if end < 0:
            break
        at = end + 1
    raise BadMap(f"{path}: no line of its first {MOST_HEADER_LINES} is a point: x y z")


def _header(line: str) -> Header | None:
    """The header that a line of titles is, of which the first are x and y; None for any other line."""
    titles = [title for title in re.split(r"[,;\t]|\s+(?![\[(])", line.strip().lstrip("#%! ")) if title]
    found = [TITLE.match(title.strip()) for title in titles]
    if len(titles) != 3 or None in found or not titles[0].strip(" \"'").lower().startswith("x"):
        return None
    names, units = zip(*((match[1], match[2]) for match in found if match), strict=True)
    return Header((units[0], units[1], units[2]), bool(WAVEFRONT.search(names[2])))


def _table(path: Path, body: bytes) -> FloatArray:
    """(n, 3) numbers, missing heights NaN."""
    first = body[: body.find(b"\n") if b"\n" in body else len(body)]
    if b";" in first:  # then a comma is a decimal one
        body = body.replace(b",", b".").replace(b";", b",")
    if b"," in first or b";" in first:
        body = re.sub(rb",[ \t]*(?=[\r\n]|$)", b",nan", body).replace(b",", b" ")
    body = NO_DATA.sub(b"nan", body)
    with parsing(path, "numpy"):
        lines = io.TextIOWrapper(io.BytesIO(body), encoding="latin-1")
        table: FloatArray = np.loadtxt(lines, dtype=np.float64, ndmin=2, comments="#")
    if table.shape[1] != 3:
        raise BadMap(f"{path}: has {table.shape[1]} columns, not x, y and z")
    return table


def _pitch(path: Path, header: Header, found: Gridded) -> Pitch:
    units = [nm_per(unit) for unit in header.units[:2]]
    if units[0] is None or units[1] is None:
        return NO_PITCH
    return pitch(path, found.pitch_x * units[0] / 1e6, found.pitch_y * units[1] / 1e6)


POINTS = SurfaceReader(name=NAME, sniff=sniff, read=read, suffixes=SUFFIXES)
