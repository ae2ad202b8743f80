"""Reading what people hand over: programs and maps, with one clear error each."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

from polishd.hookspecs import SurfaceReader, looks_like
from polishd.model.errors import MapError, ProgramError
from polishd.model.surface import SurfaceMap

SNIFF_BYTES = 4096


def read_program_bytes(path: Path) -> bytes:
    """A program file's content; ProgramError where it cannot be read or is empty."""
    try:
        content = path.read_bytes()
    except OSError as error:
        raise ProgramError(f"{path}: cannot be read: {error.strerror}; name the RNC program's file") from error
    if not content.strip():
        raise ProgramError(f"{path}: the file is empty; name the RNC program's file")
    return content


def read_map(path: Path, readers: Collection[SurfaceReader]) -> SurfaceMap:
    """Read a map with the first reader that knows the file; SurfaceError where none does, or that one refuses."""
    try:
        with path.open("rb") as file:
            head = file.read(SNIFF_BYTES)
    except OSError as error:
        raise MapError(f"{path}: cannot be read: {error.strerror}; name a map file") from error
    if not head:
        raise MapError(f"{path}: the file is empty; export the map again")
    tried = []
    for reader in readers:
        surface = reader.surface_of(head, path)
        if surface is not None:
            return surface
        tried.append(reader.name)
    hint = looks_like(readers, head, path)
    raise MapError(f"{path}: no loaded reader knows this file (tried: {', '.join(tried) or 'none'}){hint}")
