"""FITS images through astropy, also packed by gzip: the primary array, or the first image extension, of two axes.

FITS counts rows from the bottom as displayed, so they are turned. What the numbers are (surface or wavefront) and how
the part lay, no keyword of the standard says: that is left to the instrument's profile.
"""

from __future__ import annotations

import io
import math
import zlib
from itertools import islice
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
    date_of,
    extra,
    height_unit,
    named,
    nm_per,
    parsing,
    pitch,
    require_end,
)
from polishd.plugins.interferometer.formats.format import NOT_SAID, Format
from polishd.plugins.interferometer.formats.hdf5 import FREE_BYTES, MOST_RATIO

FORMAT = Format("fits", 2, (b"SIMPLE  =",))
BITPIX = (8, 16, 32, 64, -32, -64)
MOST_EXTENSIONS = 64
"""Header-and-data units that are looked at: a small packed file may hold hundreds of thousands."""
GZIP, GZIP_WINDOW = b"\x1f\x8b\x08", 31
UNIT_KEYS = ("BUNIT", "UNITS", "ZUNITS")


def sniff(head: bytes, path: Path) -> bool:
    """True where the file, or what gzip packed into it, starts as FITS does."""
    if not head.startswith(GZIP):
        return FORMAT.sniff(head, path)
    try:
        return FORMAT.sniff(zlib.decompressobj(GZIP_WINDOW).decompress(head, len(FORMAT.magic[0])), path)
    except zlib.error:
        return False


def read(path: Path) -> SurfaceMap:
    """Read the first image. MapError without astropy, for torn files, tables, cubes and compressed images."""
    fits = extra(path, "astropy.io.fits", "fits")
    packed = content_of(path)
    content = _unpacked(path, packed) if packed.startswith(GZIP) else packed
    if not FORMAT.sniff(content, path):
        raise MapError(f"{path}: no FITS file: it starts with {content[:9]!r}")
    with parsing(path, "astropy"):
        options = {"memmap": False, "lazy_load_hdus": True, "disable_image_compression": True}
        with fits.open(io.BytesIO(content), do_not_scale_image_data=True, **options) as hdus:
            hdu = _image(path, hdus)
            header = hdu.header
            _check_size(path, hdu, len(content))
            height = height_unit(next((str(header[key]) for key in UNIT_KEYS if header.get(key)), ""))
            lateral = _pitch(path, header)
            height_nm, factors = _scaled(path, header, hdu.data)
            date = date_of(str(header.get("DATE-OBS", "")), utc=True)
            others = sum(_is_image(other.header) for other in islice(hdus, MOST_EXTENSIONS)) - 1
    height_nm *= height.nm
    height_nm[np.isinf(height_nm)] = np.inf  # both signs alike: refused below
    return FORMAT.surface(
        path,
        packed,
        checked(path, height_nm, height.nm),
        height=height,
        lateral=lateral,
        part_id=named(str(header.get("OBJECT", ""))),
        instrument=named(str(header.get("INSTRUME", ""))),
        taken_at=date.at,
        date_from=date.by,
        factors=factors | {"nm_per_unit": height.nm},
        doubts={"surface": NOT_SAID},
        warnings=((f"the first of {others + 1} images is taken",) if others else ()) + date.warnings,
        unsaid={"orientation"},
        orientation="rows turned upside down: FITS counts them from the bottom",
    )


def _unpacked(path: Path, packed: bytes) -> bytes:
    """What gzip packed, within the bounds of HDF5's samples."""
    most = MOST_RATIO * len(packed) + FREE_BYTES
    unpacking = zlib.decompressobj(GZIP_WINDOW)
    try:
        content = unpacking.decompress(packed, most)
    except zlib.error as error:
        raise MapError(f"{path}: gzip cannot unpack it: {error}") from error
    if unpacking.unconsumed_tail:
        raise MapError(f"{path}: would unpack to more than {MOST_RATIO} times the file")
    if not unpacking.eof or unpacking.unused_data:
        raise MapError(f"{path}: {'something follows' if unpacking.eof else 'torn before'} the end of what gzip packed")
    return content


def _image(path: Path, hdus: Any) -> Any:
    """The first header-and-data unit that is an image with data."""
    for hdu in islice(hdus, MOST_EXTENSIONS):
        header = hdu.header
        if _is_image(header):
            if header["NAXIS"] != 2 or header.get("GROUPS") is True:
                raise MapError(f"{path}: its image has {header['NAXIS']} axes, not two")
            return hdu
    raise MapError(f"{path}: holds no image (tables and compressed images are none)")


def _is_image(header: Any) -> bool:
    return bool(header.get("NAXIS", 0) > 0 and header.get("XTENSION", "IMAGE").strip() == "IMAGE")


def _check_size(path: Path, hdu: Any, length: int) -> None:
    """Refuse what states more samples than the file holds, before anything is allocated."""
    header = hdu.header
    columns, rows, bits = header["NAXIS1"], header["NAXIS2"], header["BITPIX"]
    if bits not in BITPIX or not all(isinstance(side, int) and side > 0 for side in (columns, rows)):
        raise MapError(f"{path}: BITPIX {bits}, {rows} rows x {columns} columns: no image")
    offset = int(hdu.fileinfo()["datLoc"])
    if rows * columns > MOST_SAMPLES or offset + rows * columns * abs(bits) // 8 > length:
        raise MapError(
            f"{path}: {rows} x {columns} samples do not fit into {length} bytes: torn, or still being written"
        )


def _scaled(path: Path, header: Any, data: Any) -> tuple[FloatArray, dict[str, Any]]:
    """BZERO + BSCALE x value, BLANK as NaN, rows turned: in float64, where astropy would take float32."""
    scale, zero = float(header.get("BSCALE", 1.0)), float(header.get("BZERO", 0.0))
    if not (math.isfinite(scale) and math.isfinite(zero) and scale != 0):
        raise MapError(f"{path}: BSCALE {scale:g} and BZERO {zero:g}: the height's scale is not known")
    require_end(path, np.asarray(data))
    raw = np.asarray(data)[::-1]
    values = np.array(raw, dtype=np.float64, order="C")
    blank = header.get("BLANK")
    if raw.dtype.kind in "iu" and isinstance(blank, int):
        values[raw == blank] = np.nan
    values *= scale
    values += zero
    return values, {"bscale": scale, "bzero": zero}


def _pitch(path: Path, header: Any) -> Pitch:
    """Pitch of CDELTn or CDn_n where CUNITn is a length; turned axes are refused."""
    turned = [name for name in ("CD1_2", "CD2_1", "PC1_2", "PC2_1", "CROTA2") if header.get(name, 0)]
    if turned:
        raise MapError(f"{path}: {turned[0]} turns its axes: write it along the rows and columns")
    steps = [header.get(f"CD{axis}_{axis}", header.get(f"CDELT{axis}")) for axis in (1, 2)]
    units = [nm_per(str(header.get(f"CUNIT{axis}", ""))) for axis in (1, 2)]
    if not all(isinstance(step, int | float) for step in steps) or None in units:
        return NO_PITCH
    x_mm, y_mm = (abs(float(step)) * (unit or 0.0) / 1e6 for step, unit in zip(steps, units, strict=True))
    return pitch(path, x_mm, y_mm)


FITS = FORMAT.reader(read, ".fits", ".fit", ".fts", ".fits.gz", sniff=sniff)
