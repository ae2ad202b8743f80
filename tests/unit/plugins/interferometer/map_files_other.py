"""Small valid files of the formats that other instruments and programs write, made by hand or by their libraries."""

from __future__ import annotations

import gzip
import io
import struct
import zipfile
from typing import Any

import numpy as np
import sdfio
import tifffile
import x3pio
from gwyfile.objects import GwyContainer, GwyDataField
from numpy.typing import NDArray

from polishd.model.surface import FloatArray

ROWS, COLUMNS = 9, 7
PITCH_MM = 0.125
HOLES = ((0, 6), (4, 2))
FITS_BLOCK = 2880


def heights_nm(missing: bool = True) -> FloatArray:
    """(9, 7) as displayed, row 0 on top: no two samples alike under any turn or flip; two holes at HOLES."""
    row, column = np.mgrid[:ROWS, :COLUMNS].astype(float)
    z: FloatArray = 40.0 * row + 3.0 * column + row * column - 100.5
    if missing:
        for place in HOLES:
            z[place] = np.nan
    return z


def x3p_file(**options: Any) -> bytes:
    """Return an X3P file by x3pio: meters, first row the lowest."""
    file = io.BytesIO()
    options = {"x_scale": PITCH_MM / 1e3, "y_scale": PITCH_MM / 1e3} | options
    x3pio.write(file, heights_nm()[::-1] / 1e9, **options)
    return file.getvalue()


def zipped(members: dict[str, bytes], compression: int = zipfile.ZIP_DEFLATED) -> bytes:
    """A zip archive."""
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", compression) as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    return file.getvalue()


def unzipped(content: bytes) -> dict[str, bytes]:
    """Members of a zip archive."""
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def sdf_binary(z_scale: float = 1e-9, pitch_m: tuple[float, float] = (PITCH_MM / 1e3, PITCH_MM / 1e3)) -> bytes:
    """Return an SDF file after ISO 25178-71: header ISO-1.0, doubles, DBL_MAX where not measured, first row lowest."""
    z = heights_nm()[::-1]
    head = b"bISO-1.0" + b"polisher".ljust(10) + b"010220251230" + b"010220251231"
    head += struct.pack("<HHddddBBB", COLUMNS, ROWS, *pitch_m, z_scale, -1.0, 0, 7, 0)
    return head + np.where(np.isnan(z), np.finfo(float).max, z).astype("<f8").tobytes()


def sdf_second(kind: sdfio.DataType = sdfio.DataType.BINARY64, **header: Any) -> bytes:
    """Return an SDF file of the second edition by sdfio: two counts of 4 bytes make the header 85 bytes long."""
    file = io.BytesIO()
    metadata = sdfio.Metadata(revision=sdfio.Revision.ISO_2_0, data_type=kind, **header)
    pitch_m = PITCH_MM / 1e3
    sdfio.write(file, heights_nm()[::-1] / 1e9, x_scale=pitch_m, y_scale=pitch_m, metadata=metadata)
    return file.getvalue()


def sdf_ascii(**options: Any) -> bytes:
    """Return an SDF file as text by sdfio."""
    file = io.BytesIO()
    words: dict[str, Any] = {"x_scale": PITCH_MM / 1e3, "y_scale": PITCH_MM / 1e3, "format": sdfio.FileFormat.ASCII}
    sdfio.write(file, heights_nm()[::-1] / 1e9, **(words | options))
    return file.getvalue()


def gwy_file(unit: str = "m", lateral: str = "m", masked: bool = True, **fields: Any) -> bytes:
    """Return a Gwyddion file by gwyfile: heights without holes, and a mask over HOLES."""
    z = heights_nm(missing=False)
    size = {"xreal": COLUMNS * PITCH_MM / 1e3, "yreal": ROWS * PITCH_MM / 1e3} | fields
    container = GwyContainer()
    container["/0/data/title"] = "Height"
    container["/0/data"] = GwyDataField(z / 1e9, si_unit_xy=lateral, si_unit_z=unit, **size)
    if masked:
        mask = np.isnan(heights_nm()).astype(float)
        container["/0/mask"] = GwyDataField(mask, si_unit_xy=lateral, si_unit_z="", **size)
    return gwy_bytes(container)


def gwy_bytes(container: Any) -> bytes:
    """A container as a file."""
    return bytes(b"GWYP" + container.serialize())


def fits_file(array: NDArray[Any] | None = None, **cards: Any) -> bytes:
    """Return a FITS file by astropy: big-endian doubles in nm unless an array is given; first row the lowest."""
    from astropy.io import fits as astropy_fits

    hdu = astropy_fits.PrimaryHDU(heights_nm()[::-1] if array is None else array)
    words = {"BUNIT": "nm", "CDELT1": PITCH_MM, "CDELT2": PITCH_MM, "CUNIT1": "mm", "CUNIT2": "mm"}
    for name, value in (words | cards).items():
        if value is not None:
            hdu.header[name] = value
    file = io.BytesIO()
    hdu.writeto(file)
    return file.getvalue()


def fits_by_hand(cards: dict[str, str], data: bytes) -> bytes:
    """A FITS file of exactly these cards (values as they are to stand there)."""
    text = "".join(f"{name:8}= {value:>20}".ljust(80) for name, value in cards.items()) + "END".ljust(80)
    head = text.ljust(-(-len(text) // FITS_BLOCK) * FITS_BLOCK).encode()
    return head + data + b"\0" * (-len(data) % FITS_BLOCK)


def tiff_file(array: NDArray[Any] | None = None, **options: Any) -> bytes:
    """Return a TIFF file by tifffile: doubles as displayed."""
    file = io.BytesIO()
    tifffile.imwrite(file, heights_nm() if array is None else array, **options)
    return file.getvalue()


def npy_file(array: NDArray[Any] | None = None) -> bytes:
    """Return a .npy file by NumPy."""
    file = io.BytesIO()
    np.save(file, heights_nm() if array is None else array, allow_pickle=True)
    return file.getvalue()


def coordinates_m() -> tuple[FloatArray, FloatArray]:
    """X and Y of every sample, metres, y up, away from the origin."""
    row, column = np.mgrid[:ROWS, :COLUMNS]
    return 0.02 + column * PITCH_MM / 1e3, 0.05 - row * PITCH_MM / 1e3


def npz_file(**arrays: NDArray[Any]) -> bytes:
    """Return a .npz file by NumPy: X, Y and Z in meters, and the given arrays."""
    x, y = coordinates_m()
    file = io.BytesIO()
    np.savez(file, **({"X": x, "Y": y, "Z": heights_nm() / 1e9} | arrays))
    return file.getvalue()


def points_file(separator: str = ",", header: str = "x_mm,y_mm,z_nm\n", missing: str = "nan", end: str = "\n") -> bytes:
    """A list of points in mm and nm, from the lowest row up."""
    x, y = coordinates_m()
    lines = []
    for row in reversed(range(ROWS)):
        for column in range(COLUMNS):
            z = heights_nm()[row, column]
            text = missing if np.isnan(z) else f"{z:.3f}"
            lines.append(separator.join((f"{x[row, column] * 1e3:.4f}", f"{y[row, column] * 1e3:.4f}", text)))
    return (header + end.join(lines) + end).encode()


def wyko_text(
    heights: FloatArray, *, in_nm: int = 1, block: str = "RAW_DATA", aspect: str = "", pixel: str = "0.002"
) -> str:
    """A Wyko ASCII file of (rows, columns) heights, row 0 the top."""
    """A Wyko ASCII file of (rows, columns) heights, row 0 the top."""
    rows, columns = heights.shape
    lines = [
        f"Wyko ASCII Data File Format 0\t{in_nm}\t1",
        f"X Size\t{columns}",
        f"Y Size\t{rows}",
        "Block Name\tType\tLength\tValue",
        f"Pixel_size\t7\t4\t{pixel}",
        "Wavelength\t7\t4\t632.8",
        "Mult\t7\t4\t2",
        "Title\t5\t20\tblank 7",
        *([f"Aspect\t7\t4\t{aspect}"] if aspect else []),
        f"Intensity\t3\t{4 * heights.size}\t",
        *("\t".join(["7"] * rows) for _ in range(columns)),
        f"{block}\t3\t{4 * heights.size}\t",
        *("\t".join("Bad" if np.isnan(value) else f"{value:g}" for value in column[::-1]) for column in heights.T),
    ]
    return "\r\n".join(lines) + "\r\n"


EXAMPLES: dict[str, tuple[str, bytes]] = {
    "x3p": ("map.x3p", x3p_file()),
    "x3p-int16": ("map.x3p", x3p_file(z_type=x3pio.DataType.INT16)),
    "x3p-xml": ("map.x3p", x3p_file(storage=x3pio.DataStorage.XML)),
    "sdf": ("map.sdf", sdf_binary()),
    "sdf-2": ("map.sdf", sdf_second()),
    "sdf-2-int16": ("map.sdf", sdf_second(sdfio.DataType.INT16)),
    "sdf-ascii": ("map.sdf", sdf_ascii()),
    "gwy": ("map.gwy", gwy_file()),
    "fits": ("map.fits", fits_file(**{"DATE-OBS": "2019-03-14T10:22:33"})),
    "fits-gzip": ("map.fits.gz", gzip.compress(fits_file(), mtime=0)),
    "tiff": ("map.tif", tiff_file()),
    "tiff-deflate": ("map.tif", tiff_file(compression="zlib")),
    "npy": ("map.npy", npy_file()),
    "npz": ("map.npz", npz_file()),
    "points": ("map.csv", points_file()),
    "wyko": ("map.asc", wyko_text(heights_nm()).encode()),
    "points-blanks": ("map.xyz", points_file(" ", "", "No Data")),
}
"""Name and content of a file by what it is."""
