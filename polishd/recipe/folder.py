"""The run folder: what a job leaves behind for people. The journal, not this folder, is what the daemon trusts."""

from __future__ import annotations

import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from polishd.files import write_atomic
from polishd.model.surface import SurfaceMap
from polishd.recipe.encoding import as_json


class RunFolder:
    """Files of one job; each is written whole. Layout: docs/run-folder.md."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def create(self) -> None:
        """Make the folder, with its parents; whoever writes does, for a person may have deleted it meanwhile."""
        self.path.mkdir(parents=True, exist_ok=True)

    def cycle(self, cycle: int) -> RunFolder:
        """The subfolder of one cycle."""
        return RunFolder(self.path / f"cycle-{cycle:02d}")

    def holds(self, name: str) -> bool:
        """Whether the file is there."""
        return (self.path / name).exists()

    def set_aside(self, name: str, patterns: Sequence[str]) -> None:
        """Move files into a subfolder of that name."""
        folder = RunFolder(self.path / name)
        folder.create()
        for path in [path for pattern in patterns for path in self.path.glob(pattern)]:
            path.replace(folder.path / path.name)

    def write(self, files: Mapping[str, bytes]) -> None:
        """What a record leaves (its ``files``)."""
        for name, content in files.items():
            self.bytes(name, content)

    def bytes(self, name: str, content: bytes) -> None:
        """A file as it is."""
        self.create()
        write_atomic(self.path / name, content)

    def json(self, name: str, content: Any) -> None:
        """A JSON object, or a dataclass as one."""
        self.bytes(name, as_json(content))

    def map_file(self, surface: SurfaceMap) -> None:
        """A copy of the file that a map was read from, as ``map`` with its ending; nothing where it has none."""
        if surface.path is None:
            return
        self.create()
        name = f"map{surface.path.suffix}"
        partial = self.path / f".{name}.partial"
        shutil.copyfile(surface.path, partial)
        partial.rename(self.path / name)
