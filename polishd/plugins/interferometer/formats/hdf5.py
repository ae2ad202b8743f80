"""HDF5 within bounds: what of a file is followed, unpacked and believed.

A file is opened from the bytes that were hashed. Only hard links are followed: no other file is ever opened. Samples of
a compressed data set may take more room than the file, so its length cannot be checked; it is bounded instead:
measured surfaces shrink to a half, with three quarters of them masked to an eighth, and ``MOST_RATIO`` leaves room for
smooth ones that a computer made, while a bomb of zeros reaches a thousand.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from polishd.api import BadMap
from polishd.model.surface import FloatArray
from polishd.plugins.interferometer.formats.common import require_size

if TYPE_CHECKING:
    import h5py

MAGIC = b"\x89HDF\r\n\x1a\n"
HEAP = b"GCOL\1\0\0\0"
MOST_HEAPS = 1000
NO_ADDRESS = 0xFFFFFFFF
"""Half of HDF5's "nowhere", which may stand before a number that only looks like a heap's place."""
MOST_RATIO = 32
FREE_BYTES = 2**20
"""So much a file may always unpack to: overheads rule in small ones."""
MOST_ATTRIBUTE_BYTES = 2**16
ZERO_TAIL = 16
"""So many samples of exactly zero at the very end are not measured: the file was preallocated."""


def holds(head: bytes, path: Path, suffix: str, *names: str) -> bool:
    """True for an HDF5 file with one of these members at its root; one that cannot be opened goes by its suffix."""
    if head[:8] != MAGIC:
        return False
    import h5py

    try:
        with h5py.File(path, "r", locking=False) as file:
            return any(name in file for name in names)
    except (OSError, RuntimeError, KeyError, ValueError):
        return path.suffix.lower() == suffix


@contextmanager
def opened(path: Path, content: bytes) -> Iterator[h5py.File]:
    """The file in memory; whatever the library raises meanwhile is a BadMap."""
    import h5py

    if content[:8] != MAGIC:
        raise BadMap(f"{path}: no HDF5 file: it starts with {content[:8].hex(' ')}")
    _require_heaps(path, content)
    try:
        with h5py.File.in_memory(content) as file:
            yield file
    except (OSError, RuntimeError, KeyError, ValueError, TypeError, MemoryError, NotImplementedError) as error:
        raise BadMap(f"{path}: HDF5 cannot read it: {str(error)[:200] or type(error).__name__}") from error


def _require_heaps(path: Path, content: bytes) -> None:
    """BadMap where a heap of texts is broken, or something in it is said to be longer than the file.

    HDF5 2.0 walks some broken heaps for ever, and allocates the length of a text before it looks. A heap is "GCOL",
    version, 3 zeros, its size (8 bytes), then objects: number, count, 4 zeros, size (2, 2, 4, 8 bytes, little-endian),
    and the object itself, filled up to 8 bytes; number 0 is the room that is left. What refers to one is its length,
    the heap's place and the number (4, 8, 4 bytes).
    """
    at, heaps = content.find(HEAP), 0
    while at >= 0:
        numbers, heaps = _walk(content, at), heaps + 1
        if not numbers or heaps > MOST_HEAPS:
            raise BadMap(f"{path}: a heap of its texts is broken: torn, or not HDF5")
        place = struct.pack("<Q", at)
        used = content.find(place, 4)
        while 4 <= used <= len(content) - 12:
            length, _, number = struct.unpack_from("<IQI", content, used - 4)
            if length > len(content) and (number in numbers or length != NO_ADDRESS):
                raise BadMap(f"{path}: one of its texts is longer than the file: torn, or not HDF5")
            used = content.find(place, used + 1)
        at = content.find(HEAP, at + 1)


def _walk(content: bytes, at: int) -> set[int]:
    """The numbers of the objects of the heap at this place; none where it does not end where it says."""
    (size,) = struct.unpack_from("<Q", content, at + 8) if at + 16 <= len(content) else (0,)
    place, end, numbers = at + 16, at + size, {0}
    while place + 16 <= end <= len(content):
        number, length = struct.unpack_from("<H6xQ", content, place)
        if length < 16 and not number:
            return set()
        place += 16 + -(-length // 8) * 8 if number else length
        numbers.add(number)
    return numbers if end - 16 < place <= end else set()


def member(path: Path, file: h5py.File, name: str) -> Any:
    """The group or data set of this name, or None; BadMap where a link on the way is soft or leads to another file."""
    import h5py

    node: Any = file
    for part in name.strip("/").split("/"):
        link = node.get(part, getlink=True) if isinstance(node, h5py.Group) and part else None
        if link is None:
            return None
        if not isinstance(link, h5py.HardLink):
            raise BadMap(f"{path}: {name} is a {type(link).__name__}, which is not followed: write a file of one piece")
        node = node[part]
    return node


def attribute(path: Path, node: Any, name: str) -> Any:
    """The value of an attribute, or None where it is absent or empty."""
    if name not in node.attrs:
        return None
    kept = node.attrs.get_id(name)
    if not kept.get_space().get_simple_extent_npoints():
        return None
    if kept.get_storage_size() > MOST_ATTRIBUTE_BYTES:
        raise BadMap(f"{path}: its attribute {name!r} is larger than {MOST_ATTRIBUTE_BYTES} bytes")
    return node.attrs[name]


def text(path: Path, node: Any, name: str) -> str:
    """The text of an attribute, its first where it is a list; "" where it is absent."""
    value = attribute(path, node, name)
    if isinstance(value, np.ndarray):
        value = value.ravel()[0]
    if isinstance(value, bytes):
        value = value.decode("latin-1")
    return value.strip("\0 \t\r\n") if isinstance(value, str) else "" if value is None else str(value)


def number(path: Path, node: Any, name: str) -> float | None:
    """The number of an attribute, its first where it is a list; None where it is absent. BadMap for anything else."""
    value = attribute(path, node, name)
    if value is None:
        return None
    try:
        return float(np.ravel(value)[0])
    except (TypeError, ValueError) as error:
        raise BadMap(f"{path}: its attribute {name!r} is {value!r}, not a number") from error


def is_plain(data: Any, dimensions: int) -> bool:
    """True for a data set of so many dimensions whose samples lie in the file itself."""
    import h5py

    whole = isinstance(data, h5py.Dataset) and len(data.shape or ()) == dimensions
    return whole and not data.is_virtual and not data.external


def samples(path: Path, data: Any, content: bytes) -> FloatArray:
    """The data set as float64, (rows, columns); BadMap where it is no array, is not all there, or bursts its bounds."""
    import h5py

    if not isinstance(data, h5py.Dataset) or len(data.shape or ()) != 2 or data.dtype.kind not in "fiu":
        raise BadMap(f"{path}: {data.name} is no array of numbers in rows and columns")
    if data.is_virtual or data.external:
        raise BadMap(f"{path}: the samples of {data.name} lie in other files: write a file of one piece")
    require_size(path, *data.shape)
    most = MOST_RATIO * len(content) + FREE_BYTES
    pieces = math.prod(data.chunks or ()) * data.dtype.itemsize
    if max(data.size * data.dtype.itemsize, pieces) > most:
        raise BadMap(f"{path}: {data.name} would unpack to more than {MOST_RATIO} times the file")
    _require_written(path, data)
    with np.errstate(invalid="ignore"):  # a broken float type converts to NaN
        values = np.asarray(data[()], dtype=np.float64)
    if values.size > ZERO_TAIL and not values.ravel()[-ZERO_TAIL:].any():
        raise BadMap(f"{path}: ends in a tail of zeros: preallocated, and not written to its end")
    return values


def _require_written(path: Path, data: Any) -> None:
    """BadMap where samples were never stored: HDF5 would show its fill value in their place."""
    if data.chunks:
        wanted = math.prod(-(-side // chunk) for side, chunk in zip(data.shape, data.chunks, strict=True))
        found = data.id.get_num_chunks()
    else:
        wanted, found = data.size * data.dtype.itemsize, data.id.get_storage_size()
    if found < wanted:
        unit = "chunks" if data.chunks else "bytes"
        raise BadMap(f"{path}: holds {found} of the {wanted} {unit} of {data.name}: not written to its end")
