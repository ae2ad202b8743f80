"""The run folder: files of a job for people. The daemon trusts the journal, not this folder."""

from __future__ import annotations

import shutil
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

from polishd.hookspecs import SurfaceReader, looks_like
from polishd.model.errors import MapError, ProgramError
from polishd.model.surface import SurfaceMap
from polishd.pipeline.records import as_json
from polishd.util.files import read_input, write_atomic


class RunFolder:
    """Files of one job; each is written completely. Layout: docs/reference/run-folder.md."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def create(self) -> None:
        """Make the folder with its parents. Each writer calls this, since a person may have deleted the folder."""
        self.path.mkdir(parents=True, exist_ok=True)

    def cycle(self, cycle: int) -> RunFolder:
        """Subfolder of one cycle."""
        return RunFolder(self.path / f"cycle-{cycle:02d}")

    def holds(self, name: str) -> bool:
        """Whether the file exists."""
        return (self.path / name).exists()

    def set_aside(self, name: str, patterns: Sequence[str]) -> None:
        """Move files into a subfolder of that name."""
        folder = RunFolder(self.path / name)
        folder.create()
        for path in [path for pattern in patterns for path in self.path.glob(pattern)]:
            path.replace(folder.path / path.name)

    def write(self, files: Mapping[str, bytes]) -> None:
        """Write the files of a record (its ``files``)."""
        for name, content in files.items():
            self.bytes(name, content)

    def bytes(self, name: str, content: bytes) -> None:
        """Write a file unchanged."""
        self.create()
        write_atomic(self.path / name, content)

    def json(self, name: str, content: Any) -> None:
        """Write a JSON object, or a dataclass as one."""
        self.bytes(name, as_json(content))

    def map_file(self, surface: SurfaceMap) -> None:
        """Copy the file of a map as ``map`` with its ending, where it has one."""
        if surface.path is None:
            return
        self.create()
        name = f"map{surface.path.suffix}"
        partial = self.path / f".{name}.partial"
        shutil.copyfile(surface.path, partial)
        partial.rename(self.path / name)


# Reading of programs and maps from people, with one clear error each.

SNIFF_BYTES = 4096


def read_program_bytes(path: Path) -> bytes:
    """A program file's content; ProgramError where it cannot be read or is empty."""
    try:
        content = read_input(path)
    except OSError as error:
        raise ProgramError(f"{path}: cannot be read: {error.strerror}; name the RNC program's file") from error
    if not content.strip():
        raise ProgramError(f"{path}: the file is empty; name the RNC program's file")
    return content


def read_map(path: Path, readers: Collection[SurfaceReader]) -> SurfaceMap:
    """Read a map with the first reader that knows the file; SurfaceError where none does or the reader refuses."""
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
    hint = looks_like(readers, head, path) or ". Export the map in one of these formats"
    raise MapError(f"{path}: no loaded reader knows this file (tried: {', '.join(tried) or 'none'}){hint}")
