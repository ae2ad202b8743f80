"""NumPy's .npy and .npz: bare arrays, nothing of which says what they are; never pickles.

An .npz with ``X``, ``Y`` and ``Z`` in metres is a map with coordinates; one with a single 2-D array is that array.
"""

from __future__ import annotations

import io
import math
import zipfile
from pathlib import Path

import numpy as np
from numpy.lib import format as npy_format
from numpy.typing import NDArray

from polishd.api import MapError, SurfaceMap
from polishd.plugins.interferometer.formats.common import (
    NO_PITCH,
    HeightUnit,
    checked,
    content_of,
    height_unit,
    members_of,
    parsing,
    pitch,
    require_end,
    require_size,
    scaled,
)
from polishd.plugins.interferometer.formats.format import NOT_SAID, Format
from polishd.plugins.interferometer.formats.points import ORIENTATION, grid_points

FORMAT = Format("npy", 1, (b"\x93NUMPY",))
HEADERS = {(1, 0): npy_format.read_array_header_1_0, (2, 0): npy_format.read_array_header_2_0}
AS_STORED = "as stored: row 0 taken for the top"
METRES = "X, Y and Z are taken for metres: the file does not say"


def sniff(head: bytes, path: Path) -> bool:
    """True for NumPy's magic, and for a zip archive that is called ``.npz``."""
    return FORMAT.sniff(head, path) or (head[:4] == b"PK\x03\x04" and path.suffix.lower() == ".npz")


def read(path: Path) -> SurfaceMap:
    """Read the one map that the file holds. MapError for pickles, complex or 3-D arrays, and several candidates."""
    content = content_of(path)
    if FORMAT.sniff(content, path):
        return _bare(path, array_of(path, "the file", content), content)
    arrays = _arrays(path, content)
    if {"X", "Y", "Z"} <= arrays.keys():
        return _with_coordinates(path, arrays, content)
    maps = [name for name, array in arrays.items() if array.ndim == 2 and min(array.shape) > 1]
    if len(maps) != 1:
        names = ", ".join(f"{name} {array.shape}" for name, array in arrays.items()) or "nothing"
        raise MapError(f"{path}: holds {names}: neither X, Y and Z nor one single 2-D array")
    return _bare(path, arrays[maps[0]], content)


def array_of(path: Path, name: str, content: bytes) -> NDArray[np.generic]:
    """The array of an .npy file, not copied. MapError unless real numbers, and exactly as long as its header says."""
    with parsing(path, "numpy"):
        file = io.BytesIO(content)
        version = npy_format.read_magic(file)
        if version not in HEADERS:
            raise MapError(f"{path}: {name} is .npy of version {version}, not 1.0 or 2.0")
        shape, fortran, dtype = HEADERS[version](file)
        if dtype.kind not in "fiu" or dtype.itemsize > 8:
            raise MapError(f"{path}: {name} holds {dtype}, not real numbers of at most 64 bits")
        expected = file.tell() + math.prod(shape) * dtype.itemsize
        if any(side < 0 for side in shape) or len(content) != expected:
            raise MapError(f"{path}: {name} has {len(content)} bytes of {expected}: torn, or not one array")
        array = np.frombuffer(content, dtype=dtype, offset=file.tell())
        return array.reshape(shape, order="F" if fortran else "C")


def _arrays(path: Path, content: bytes) -> dict[str, NDArray[np.generic]]:
    with parsing(path, "numpy"), zipfile.ZipFile(io.BytesIO(content)) as archive:
        members = members_of(path, archive)
        if len({member.filename for member in members}) < len(members):
            raise MapError(f"{path}: has two arrays of one name")
        names = [member.filename for member in members]
        return {name.removesuffix(".npy"): array_of(path, name, archive.read(name)) for name in names}


def _bare(path: Path, array: NDArray[np.generic], content: bytes) -> SurfaceMap:
    if array.ndim != 2 or not array.size:
        raise MapError(f"{path}: holds an array of shape {array.shape}, not rows and columns")
    require_size(path, *array.shape)
    require_end(path, array)
    return FORMAT.surface(
        path,
        content,
        checked(path, np.array(array, dtype=np.float64, order="C")),
        height=height_unit(""),
        lateral=NO_PITCH,
        factors={"nm_per_unit": 1.0},
        doubts={"surface": NOT_SAID},
        unsaid={"orientation"},
        orientation=AS_STORED,
    )


def _with_coordinates(path: Path, arrays: dict[str, NDArray[np.generic]], content: bytes) -> SurfaceMap:
    shapes = [arrays[name].shape for name in "XYZ"]
    if not shapes[0] == shapes[1] == shapes[2] or len(shapes[2]) != 2:
        raise MapError(f"{path}: X, Y and Z have the shapes {shapes[0]}, {shapes[1]} and {shapes[2]}")
    require_size(path, *shapes[2])
    x, y, z = (np.asarray(arrays[name], dtype=np.float64) for name in "XYZ")
    others = sorted(name for name, array in arrays.items() if name not in "XYZ" and array.shape == z.shape)
    found = grid_points(path, x.ravel(), y.ravel(), z.ravel())
    scale = pitch(path, found.pitch_x * 1e3, found.pitch_y * 1e3)
    return FORMAT.surface(
        path,
        content,
        checked(path, scaled(found.z, 1e9)),
        height=HeightUnit(1e9),
        lateral=scale,
        factors={"nm_per_unit": 1e9},
        warnings=(METRES, *(("Z is taken, not " + ", ".join(others),) if others else ())),
        orientation=ORIENTATION,
    )


NPY = FORMAT.reader(read, ".npy", ".npz", sniff=sniff, dates=False)
