"""TIFF of one page of numbers through tifffile; ImageJ's and OME's metadata give the pitch, nothing gives the unit.

A resolution in inches or centimetres is what a printer needs, set to 72 by most software: it is not taken for a pitch.
"""

from __future__ import annotations

import io
import math
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from polishd.api import MapError, SurfaceMap
from polishd.model.surface import FloatArray
from polishd.plugins.interferometer.formats.common import (
    MOST_SAMPLES,
    NO_PITCH,
    Pitch,
    checked,
    content_of,
    extra,
    height_unit,
    nm_per,
    parsing,
    pitch,
    require_end,
)
from polishd.plugins.interferometer.formats.format import NOT_SAID, Format

FORMAT = Format("tiff", 1, (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"))
DEFLATE_AT_MOST = 1100
"""No compression of TIFF packs tighter: deflate's limit is 1032."""
FLIPPED = {1: (1, 1), 2: (1, -1), 3: (-1, -1), 4: (-1, 1)}
"""Steps along rows and columns that put the tag Orientation's corner at the top left."""
PHOTOMETRIC, ORIENTATION, NODATA = 262, 274, 42113
MIN_IS_BLACK = 1


def read(path: Path) -> SurfaceMap:
    """Read the one page. MapError without tifffile, for several pages, colours, complex numbers, and torn files."""
    tifffile = extra(path, "tifffile", "tiff")
    content = content_of(path)
    with parsing(path, "tifffile"), tifffile.TiffFile(io.BytesIO(content)) as file:
        if len(file.pages) != 1:
            raise MapError(f"{path}: has {len(file.pages)} pages, not one")
        page = file.pages[0]
        _check_page(path, page, len(content))
        height_nm, turned = _heights(path, page)
        lateral = _pitch(path, file, page)
    return FORMAT.surface(
        path,
        content,
        checked(path, height_nm),
        height=height_unit(""),
        lateral=lateral,
        factors={"nm_per_unit": 1.0},
        doubts={"surface": NOT_SAID},
        unsaid={"orientation"},
        orientation=f"as displayed (TIFF's orientation {turned})",
    )


def _check_page(path: Path, page: Any, length: int) -> None:
    """Refuse pictures, and pages that the file is too short for, before anything is allocated."""
    if page.dtype is None or page.dtype.kind not in "fiu" or page.dtype.itemsize > 8:
        raise MapError(f"{path}: holds {page.dtype}, not real numbers of at most 64 bits")
    if len(page.shape) != 2 or page.samplesperpixel != 1:
        raise MapError(f"{path}: holds a picture of shape {page.shape}, not rows and columns of one number")
    shown = int(page.tags[PHOTOMETRIC].value) if PHOTOMETRIC in page.tags else MIN_IS_BLACK
    if shown != MIN_IS_BLACK:
        raise MapError(f"{path}: is a picture (photometric {shown}, not 1): a larger number need not be higher")
    samples = math.prod(page.shape)
    stored = sum(page.databytecounts)
    if stored > length or max(map(sum, zip(page.dataoffsets, page.databytecounts, strict=True)), default=0) > length:
        raise MapError(f"{path}: its page does not fit into {length} bytes: torn, or still being written")
    room = stored * (1 if page.compression == 1 else DEFLATE_AT_MOST)
    if samples > MOST_SAMPLES or samples * page.bitspersample > 8 * room:
        raise MapError(f"{path}: {page.shape[0]} x {page.shape[1]} samples do not fit into {stored} bytes of data")
    _check_pieces(path, page)


def _check_pieces(path: Path, page: Any) -> None:
    """MapError where strips or tiles are not those that the size asks for: tifffile would show zeros in their place."""
    rows, columns = page.shape
    tall, wide = (page.tilelength, page.tilewidth) if page.is_tiled else (min(max(page.rowsperstrip, 1), rows), columns)
    count = -(-rows // max(tall, 1)) * -(-columns // max(wide, 1))
    samples = []
    if count == len(page.databytecounts):  # a broken size asks for milliards
        last = tall if page.is_tiled else rows - (count - 1) * tall
        samples = [tall * wide] * (count - 1) + [last * wide]
    stored, spans = list(page.databytecounts), sorted(zip(page.dataoffsets, page.databytecounts, strict=True))
    whole = len(stored) == len(samples) and min(stored, default=0) > 0
    if whole and page.compression == 1:
        whole = stored == [size * page.bitspersample // 8 for size in samples]
    if not whole or any(at + size > following for (at, size), (following, _) in pairwise(spans)):
        raise MapError(f"{path}: its {len(stored)} pieces of data are not those of {rows} x {columns} samples: broken")


def _heights(path: Path, page: Any) -> tuple[FloatArray, int]:
    """The samples with what the file calls no data as NaN, turned as it says; and that tag."""
    turned = int(page.tags[ORIENTATION].value) if ORIENTATION in page.tags else 1
    if turned not in FLIPPED:
        raise MapError(f"{path}: its orientation {turned} swaps rows and columns: write it with 1")
    rows, columns = FLIPPED[turned]
    raw = page.asarray(maxworkers=1)
    require_end(path, raw)
    height_nm = np.array(raw[::rows, ::columns], dtype=np.float64, order="C")
    if NODATA in page.tags:
        height_nm[height_nm == float(str(page.tags[NODATA].value).strip("\0 "))] = np.nan
    return height_nm, turned


def _pitch(path: Path, file: Any, page: Any) -> Pitch:
    """What OME's or ImageJ's own metadata say; None of them: nothing."""
    if file.is_ome and file.ome_metadata:
        return _ome_pitch(path, file.ome_metadata)
    unit = nm_per(str((file.imagej_metadata or {}).get("unit", "").replace("\\u00B5", "u"))) if file.is_imagej else None
    if unit is None or not {"XResolution", "YResolution"} <= {tag.name for tag in page.tags}:
        return NO_PITCH
    (x, x_per), (y, y_per) = page.tags["XResolution"].value, page.tags["YResolution"].value
    return pitch(path, x_per / x * unit / 1e6, y_per / y * unit / 1e6)


def _ome_pitch(path: Path, text: str) -> Pitch:
    xml = extra(path, "defusedxml.ElementTree", "tiff")
    pixels = [node for node in xml.fromstring(text).iter() if node.tag.rpartition("}")[2] == "Pixels"]
    if len(pixels) != 1 or not {"PhysicalSizeX", "PhysicalSizeY"} <= set(pixels[0].keys()):
        return NO_PITCH
    sizes = []
    for axis in "XY":
        unit = nm_per(pixels[0].get(f"PhysicalSize{axis}Unit", "um"))  # the schema's default
        if unit is None:
            return NO_PITCH
        sizes.append(float(pixels[0].get(f"PhysicalSize{axis}")) * unit / 1e6)
    return pitch(path, sizes[0], sizes[1])


TIFF = FORMAT.reader(read, ".tif", ".tiff", dates=False)
