"""Wyko and Vision ASCII files (``.asc``): a header of blocks, then a line of heights for each column of the map.

The first line is ``Wyko ASCII Data File Format`` and three flags; the second flag is 1 where heights are nanometres, 0
where they are waves: a value times Wavelength (nm) over Mult. ``X Size`` lines of ``Y Size`` values follow the line of
the block; a line runs upwards, "Bad" is no data. Pixel_size is mm, Aspect the height of a pixel over its width.
Readers of others do not agree on which way a line runs: orientation is left to the instrument's profile.
"""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import NamedTuple

import numpy as np

from polishd.api import MapError, SurfaceMap
from polishd.model.surface import FloatArray
from polishd.plugins.interferometer.formats.common import (
    LONGEST,
    NO_PITCH,
    checked,
    content_of,
    floats,
    pieces,
    pitch,
    require_size,
)
from polishd.plugins.interferometer.formats.format import Format

MAGIC = b"Wyko ASCII Data File Format"
FORMAT = Format("wyko_ascii", 1, (MAGIC,))
HEIGHTS = ("RAW_DATA", "RAW DATA", "SAMPLE_DATA", "OPD")
"""Blocks of heights, the first one that is there is taken; others are intensities."""
FLAGS = re.compile(rb"[ \t]+(\d+)[ \t]+(\d+)")
ORIENTATION = "its lines are columns from the left, each from the bottom up"
DOUBT = "a Wyko ASCII file does not say which way its columns run: prove it with an artefact"
WAVELENGTH_NM = (100.0, 20_000.0)


class WykoHeader(NamedTuple):
    """What stands before the heights."""

    columns: int
    rows: int
    values: dict[str, str]
    """Of the blocks that are single values, by name."""
    in_nm: bool


def read(path: Path) -> SurfaceMap:
    """Read the heights. MapError for whatever is torn, broken or absurd, and where no block holds heights."""
    content = content_of(path)
    header, found = _split(path, content)
    name = next((name for name in HEIGHTS if name in found), None)
    if name is None:
        raise MapError(f"{path}: a Wyko ASCII file without heights: no block {', '.join(HEIGHTS)}; export RAW_DATA")
    scale = 1.0 if header.in_nm else _nm_per_wave(path, header)
    height_nm = _heights(path, content, found[name], header) * scale
    width = _number(path, header, "Pixel_size", 0.0)
    lateral = NO_PITCH if width == 0 else pitch(path, abs(width), abs(width) * _number(path, header, "Aspect", 1.0))
    return FORMAT.surface(
        path,
        content,
        checked(path, height_nm, scale),
        lateral=lateral,
        doubts={"orientation": DOUBT},
        factors={"nm_per_unit": scale, "block": name},
        orientation=ORIENTATION,
    )


def _split(path: Path, content: bytes) -> tuple[WykoHeader, dict[str, tuple[int, int]]]:
    """The header, and from where to where each block of an array stands."""
    flags = FLAGS.match(content, len(MAGIC))
    values: dict[str, str] = {}
    blocks: dict[str, tuple[int, int]] = {}
    sizes: dict[str, int] = {}
    at = _next_line(content, 0)
    while at < len(content):
        end = _next_line(content, at)
        name, *rest = (word.strip() for word in content[at : min(end, at + LONGEST)].decode("latin-1").split("\t"))
        at = end
        if name in {"X Size", "Y Size"}:
            sizes[name] = _size(path, name, rest)
        elif len(rest) >= 2 and rest[0] == "3":  # an array: as many lines follow as there are columns
            if len(sizes) < 2:
                raise MapError(
                    f"{path}: has no X Size and Y Size before its block {name!r}: torn, or no Wyko ASCII file"
                )
            for _ in range(sizes["X Size"]):
                if end >= len(content):
                    break
                end = _next_line(content, end)
            blocks[name] = (at, end)
            at = end
        elif len(rest) >= 3:
            values[name] = rest[2]
    if len(sizes) < 2:
        raise MapError(f"{path}: a Wyko ASCII file without X Size and Y Size: torn, or still being written")
    in_nm = flags is not None and int(flags[2]) == 1
    return WykoHeader(sizes["X Size"], sizes["Y Size"], values, in_nm), blocks


def _next_line(content: bytes, at: int) -> int:
    end = content.find(b"\n", at)
    return len(content) if end < 0 else end + 1


def _size(path: Path, name: str, rest: list[str]) -> int:
    try:
        return int(rest[0])
    except (IndexError, ValueError) as error:
        raise MapError(f"{path}: its {name} is no number of pixels") from error


def _number(path: Path, header: WykoHeader, name: str, default: float | None) -> float:
    text = header.values.get(name)
    if text is None and default is not None:
        return default
    try:
        value = float(text or "")
    except ValueError as error:
        raise MapError(f"{path}: its {name} is {text!r}, no number: the heights have no scale") from error
    if not math.isfinite(value):
        raise MapError(f"{path}: its {name} is {text!r}, no number")
    return value


def _nm_per_wave(path: Path, header: WykoHeader) -> float:
    wavelength, mult = _number(path, header, "Wavelength", None), _number(path, header, "Mult", 1.0)
    low, high = WAVELENGTH_NM
    if not low <= wavelength <= high or mult <= 0:
        raise MapError(f"{path}: Wavelength is {wavelength:g} nm and Mult {mult:g}: the heights have no scale")
    return wavelength / mult


def _heights(path: Path, content: bytes, span: tuple[int, int], header: WykoHeader) -> FloatArray:
    """(rows, columns), row 0 the top, in the file's unit."""
    count = header.rows * header.columns
    require_size(path, header.rows, header.columns, most=span[1] - span[0])
    values, filled = np.empty(count), 0
    for piece in pieces(path, content, span, (b"\n", b"\t", b" ")):
        found = floats(path, piece.replace(b"Bad", b"nan"), but=b"na")
        if filled + found.size <= count:
            values[filled : filled + found.size] = found
        filled += found.size
    if filled != count:
        raise MapError(
            f"{path}: has {filled} heights of {header.columns} columns x {header.rows} rows: torn, or still being "
            "written"
        )
    return np.asarray(values.reshape(header.columns, header.rows).T[::-1], dtype=np.float64)


WYKO_TEXT = FORMAT.reader(read, ".asc", dates=False)
