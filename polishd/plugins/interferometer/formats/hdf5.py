"""HDF5 within bounds: what of a file is followed, unpacked and believed.

Read in the worker of ``sandbox``, from the bytes that were hashed. Only hard links are followed: no other file is ever
opened. Samples of a compressed data set may take more room than the file, so its length cannot be checked; it is
bounded instead: measured surfaces shrink to a half, with three quarters of them masked to an eighth, and ``MOST_RATIO``
leaves room for smooth ones that a computer made, while a bomb of zeros reaches a thousand.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from polishd.api import MapError
from polishd.model.surface import FloatArray
from polishd.plugins.interferometer.formats.common import content_of, require_end, require_size, sha256_of
from polishd.plugins.interferometer.formats.sandbox import raise_memory_limit

if TYPE_CHECKING:
    import h5py


MAGIC = b"\x89HDF\r\n\x1a\n"
NAMES = {".datx": (b"MetaData\0", b"Measurement\0"), ".h5": (b"measurement0\0",)}
"""Members at the root of each kind of file, by its suffix."""
HEAP = b"GCOL\1\0\0\0"
MOST_RATIO = 32
FREE_BYTES = 2**20
"""So much a file may always unpack to: overheads rule in small ones."""
MOST_ATTRIBUTE_BYTES = 2**16


def holds(head: bytes, path: Path, suffix: str) -> bool:
    """True for an HDF5 file in which the names of this kind stand; one without any known name goes by its suffix."""
    if head[:8] != MAGIC:
        return False
    try:
        content = content_of(path)
    except MapError:
        content = b""
    found = {kind for kind, names in NAMES.items() if any(name in content for name in names)}
    return suffix in (found or {path.suffix.lower()})


@dataclass(frozen=True, slots=True)
class Hdf5Contents:
    """A file in memory."""

    path: Path
    file: h5py.File
    length: int
    sha256: str


@contextmanager
def opened(path: Path) -> Iterator[Hdf5Contents]:
    """The file in memory; errors of the library become MapError."""
    import h5py

    content = content_of(path)
    if content[:8] != MAGIC:
        raise MapError(f"{path}: no HDF5 file: it starts with {content[:8].hex(' ')}")
    if content.find(MAGIC, 1) >= 0:
        raise MapError(f"{path}: holds another HDF5 file: two were written into one")
    _require_heaps(path, content)
    length, sha256 = len(content), sha256_of(content)
    try:
        with h5py.File.in_memory(content) as file:
            del content  # the library has made its own
            yield Hdf5Contents(path, file, length, sha256)
    except MemoryError as error:
        raise MapError(f"{path}: HDF5 asks for more memory than such a file can need: it is broken") from error
    except (OSError, RuntimeError, KeyError, ValueError, TypeError, NotImplementedError) as error:
        raise MapError(f"{path}: HDF5 cannot read it: {str(error)[:200] or type(error).__name__}") from error


def _require_heaps(path: Path, content: bytes) -> None:
    """MapError where a heap of texts does not end where it says: HDF5 walks some of those for ever.

    A heap is "GCOL", version, 3 zeros, its size (8 bytes), then objects: number, count, 4 zeros, size (2, 2, 4, 8,
    little-endian), and the object itself, filled up to 8 bytes; number 0 is the room that is left.
    """
    at = content.find(HEAP)
    while at >= 0:
        (size,) = struct.unpack_from("<Q", content, at + 8) if at + 16 <= len(content) else (0,)
        place, end = at + 16, at + size
        while place + 16 <= end <= len(content):
            number, length = struct.unpack_from("<H6xQ", content, place)
            if length < 16 and not number:
                break
            place += 16 + -(-length // 8) * 8 if number else length
        if not end - 16 < place <= end:
            raise MapError(f"{path}: a heap of its texts is broken: torn, or not HDF5")
        at = content.find(HEAP, at + 1)


def member(source: Hdf5Contents, name: str) -> Any:
    """The group or data set of this name, or None; MapError where a link to it is soft or leads to another file."""
    import h5py

    node: Any = source.file
    for part in name.strip("/").split("/"):
        link = node.get(part, getlink=True) if isinstance(node, h5py.Group) and part else None
        if link is None:
            return None
        if not isinstance(link, h5py.HardLink):
            kind = type(link).__name__
            raise MapError(f"{source.path}: {name} is a {kind}, which is not followed: write a file of one piece")
        node = node[part]
    return node


def attribute(source: Hdf5Contents, node: Any, name: str) -> Any:
    """The value of an attribute, or None where it is absent or empty."""
    if name not in node.attrs:
        return None
    kept = node.attrs.get_id(name)
    if not kept.get_space().get_simple_extent_npoints():
        return None
    if kept.get_storage_size() > MOST_ATTRIBUTE_BYTES:
        raise MapError(f"{source.path}: its attribute {name!r} is larger than {MOST_ATTRIBUTE_BYTES} bytes")
    return node.attrs[name]


def first(source: Hdf5Contents, node: Any, name: str) -> Any:
    """The value of an attribute, its first where it is a list, or None where it is absent or empty."""
    value = attribute(source, node, name)
    return value.ravel()[0] if isinstance(value, np.ndarray) else value


def text(source: Hdf5Contents, node: Any, name: str) -> str:
    """The text of an attribute; "" where it is absent."""
    value = first(source, node, name)
    if isinstance(value, bytes):
        value = value.decode("latin-1")
    return value.strip("\0 \t\r\n") if isinstance(value, str) else "" if value is None else str(value)


def number(source: Hdf5Contents, node: Any, name: str) -> float | None:
    """The number of an attribute; None where it is absent. MapError for anything else."""
    value = first(source, node, name)
    try:
        return None if value is None else float(value)
    except (TypeError, ValueError) as error:
        found = attribute(source, node, name)
        raise MapError(f"{source.path}: its attribute {name!r} is {found!r}, not a number") from error


def is_plain(data: Any, dimensions: int) -> bool:
    """True for a data set of so many dimensions whose samples lie in the file itself."""
    import h5py

    whole = isinstance(data, h5py.Dataset) and len(data.shape or ()) == dimensions
    return whole and not data.is_virtual and not data.external


def samples(source: Hdf5Contents, data: Any) -> FloatArray:
    """The data set as float64, (rows, columns); MapError where it is no array, is incomplete, or exceeds its limits."""
    import h5py

    path = source.path
    if not isinstance(data, h5py.Dataset) or len(data.shape or ()) != 2 or not _is_usual(data.id.get_type()):
        raise MapError(f"{path}: {data.name} is no array of numbers in rows and columns")
    if data.is_virtual or data.external:
        raise MapError(f"{path}: the samples of {data.name} lie in other files: write a file of one piece")
    require_size(path, *data.shape)
    most = MOST_RATIO * source.length + FREE_BYTES
    pieces = math.prod(data.chunks or ()) * data.dtype.itemsize
    if max(data.size * data.dtype.itemsize, pieces) > most:
        raise MapError(f"{path}: {data.name} would unpack to more than {MOST_RATIO} times the file")
    _require_written(path, data)
    raise_memory_limit(8 * data.size + pieces)
    values = np.empty(data.shape)
    data.read_direct(values)
    require_end(path, values)
    return values


def _is_usual(kind: Any) -> bool:
    """True for integers and floats that computers have: HDF5 reads whatever a broken type says into other numbers."""
    import h5py

    if not isinstance(kind, h5py.h5t.TypeIntegerID | h5py.h5t.TypeFloatID):
        return False
    return bool(h5py.h5t.py_create(kind.dtype).equal(kind))


def _require_written(path: Path, data: Any) -> None:
    """MapError where samples were never stored, and HDF5 would show its fill value, or more than the shape says."""
    if data.chunks:
        wanted = math.prod(-(-side // chunk) for side, chunk in zip(data.shape, data.chunks, strict=True))
        found = data.id.get_num_chunks()
    else:
        wanted, found = data.size * data.dtype.itemsize, data.id.get_storage_size()
    unit = "chunks" if data.chunks else "bytes"
    if found < wanted:
        raise MapError(f"{path}: holds {found} of the {wanted} {unit} of {data.name}: not written to its end")
    if found > wanted:
        raise MapError(f"{path}: holds {found} {unit} of {data.name}, and its shape has {wanted}: broken")
